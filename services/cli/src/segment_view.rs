//! The picture of a segmentation: color, depth, the objects with ids and boxes, and the surfaces from above with what was not seen.

use image::{Rgb, RgbImage};
use repose_geometry::Image;
use repose_perception::Segmented;
use repose_pictures::colors::object_color;
use repose_proto::{Frame, Scene, UnseenSpace};

use repose_local::picture::{Coloring, captioned, color_picture, draw_number, scene_picture, side_by_side};
use repose_local::wireframe::{draw_box, draw_line, put};

/// Gap between the rows of panels, pixels.
const GAP: u32 = 6;
/// Width of the strip around the map from above, metres.
const RIM_M: f64 = 0.05;
/// How far the middle of a number stays from the left and right, and from the upper and lower end of a panel, pixels.
const NUMBER_RIM: (i64, i64) = (30, 12);
const PAPER: Rgb<u8> = Rgb([255, 255, 255]);
const UNSEEN: [u8; 3] = [70, 70, 90];
const FURNITURE: Rgb<u8> = Rgb([20, 90, 200]);

/// Four panels, two by two, each as large as the frame and with a legend below it.
pub fn segment_view(frame: &Frame, segmented: &Segmented) -> RgbImage {
    let (width, height) = (frame.camera.width as u32, frame.camera.height as u32);
    let unit_m = frame.camera.depth_unit_m;
    let (near, far) = depth_range(frame);
    let color = match &frame.color {
        Some(color) => color_picture(frame.camera.width, frame.camera.height, color),
        None => scene_picture(&segmented.scene, Coloring::Objects, None),
    };
    let objects = objects_panel(&color, segmented);
    let panels = [
        (color, if frame.color.is_some() { "Color" } else { "No color; points by object" }.to_owned(), String::new()),
        (
            depth_panel(frame, near, far),
            "Depth".to_owned(),
            format!("red {:.2} m or less, blue {:.2} m or more, black no reading", near * unit_m, far * unit_m),
        ),
        (objects, "Objects: mask, box of its points, id".to_owned(), "paler: uncertain border, its readings are dropped".to_owned()),
        (
            map_panel(&segmented.scene, width, height),
            "From above, world x right, y up. Blue: furniture, mm above the lowest".to_owned(),
            "dots: objects, dark outlines: their tops; darker ground: more unseen above it".to_owned(),
        ),
    ];
    let panels = panels.map(|(panel, title, explained)| captioned(&captioned(&panel, &title), &explained));
    let [top, bottom] = [&panels[..2], &panels[2..]].map(side_by_side);
    let mut sheet = RgbImage::from_pixel(top.width(), top.height() + GAP + bottom.height(), PAPER);
    image::imageops::replace(&mut sheet, &top, 0, 0);
    image::imageops::replace(&mut sheet, &bottom, 0, i64::from(top.height() + GAP));
    sheet
}

/// The depth counts below and above which two in a hundred readings lie.
fn depth_range(frame: &Frame) -> (f64, f64) {
    let mut readings: Vec<u16> = frame.depth.iter().copied().filter(|d| Frame::is_reading(*d)).collect();
    readings.sort_unstable();
    let at = |share: f64| readings.get((readings.len() as f64 * share) as usize).map_or(0.0, |d| f64::from(*d));
    (at(0.02), at(0.98).max(at(0.02) + 1.0))
}

/// Depth from red (near) to blue (far); black where there is none.
fn depth_panel(frame: &Frame, near: f64, far: f64) -> RgbImage {
    let width = frame.camera.width;
    RgbImage::from_fn(width as u32, frame.camera.height as u32, |u, v| match frame.depth[v as usize * width + u as usize] {
        count if !Frame::is_reading(count) => Rgb([0; 3]),
        count => Rgb(rainbow(((f64::from(count) - near) / (far - near)).clamp(0.0, 1.0))),
    })
}

/// Red through green to blue.
fn rainbow(share: f64) -> [u8; 3] {
    let hump = |center: f64| (1.5 - (4.0 * share - center).abs()).clamp(0.0, 1.0);
    [hump(0.5), hump(2.0), hump(3.5)].map(|c| (255.0 * c) as u8)
}

/// The picture with the masks over it, the band that was cleaned off them paler, their boxes and ids.
fn objects_panel(under: &RgbImage, segmented: &Segmented) -> RgbImage {
    let (scene, labels) = (&segmented.scene, &segmented.labels);
    let mut panel = under.clone();
    for (i, pixel) in panel.pixels_mut().enumerate() {
        let id = labels.pixels()[i];
        let share = match (id, segmented.cleaned.pixels()[i]) {
            (0, _) => continue,
            (_, 0) => 1,
            _ => 2,
        };
        let color = object_color(id);
        pixel.0 = std::array::from_fn(|k| ((u16::from(pixel.0[k]) * (4 - share) + u16::from(color[k]) * share) / 4) as u8);
    }
    for object in &scene.meta.objects {
        let (low, high) = scene.points_of(object.id).fold(([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]), |(low, high), p| {
            (std::array::from_fn(|k| low[k].min(f64::from(p[k]))), std::array::from_fn(|k| high[k].max(f64::from(p[k]))))
        });
        draw_box(&mut panel, scene, low, high, Rgb(object_color(object.id)));
    }
    for object in &scene.meta.objects {
        if let Some(at) = middle_of(labels, object.id) {
            draw_number(&mut panel, object.id, at);
        }
    }
    panel
}

/// The world from above, x to the right and y up: furniture and tops with their outlines and heights in millimetres, objects' points, and
/// cells darker the more of the space above them was not seen.
fn map_panel(scene: &Scene, width: u32, height: u32) -> RgbImage {
    let mut panel = RgbImage::from_pixel(width, height, PAPER);
    let corners = || scene.meta.surfaces.iter().flat_map(|s| s.outline_m.iter());
    let (low, high) = corners().fold(([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]), |(low, high), c| {
        (std::array::from_fn(|k| low[k].min(c[k])), std::array::from_fn(|k| high[k].max(c[k])))
    });
    if low[0] >= high[0] || low[1] >= high[1] {
        return panel;
    }
    let span = [high[0] - low[0] + 2.0 * RIM_M, high[1] - low[1] + 2.0 * RIM_M];
    let per_m = (f64::from(width) / span[0]).min(f64::from(height) / span[1]);
    let to_pixel = |x: f64, y: f64| (((x - low[0] + RIM_M) * per_m) as i64, i64::from(height) - 1 - ((y - low[1] + RIM_M) * per_m) as i64);
    if let Some(space) = &scene.meta.unseen.space {
        draw_unseen(&mut panel, space, &to_pixel);
    }
    for (p, id) in scene.points.iter().zip(&scene.labels).filter(|(_, id)| **id != 0) {
        let (x, y) = to_pixel(f64::from(p[0]), f64::from(p[1]));
        put(&mut panel, x, y, Rgb(object_color(*id)));
    }
    for surface in &scene.meta.surfaces {
        let color = surface.object.map_or(FURNITURE, |id| Rgb(object_color(id).map(|c| c / 2)));
        let outline: Vec<(i64, i64)> = surface.outline_m.iter().map(|c| to_pixel(c[0], c[1])).collect();
        for k in 0..outline.len() {
            draw_line(&mut panel, outline[k], outline[(k + 1) % outline.len()], color);
        }
        if let (Some((x, y)), None) = (outline.first(), surface.object) {
            // The height over the lowest surface: a number without a sign.
            let lowest_m = scene.meta.surfaces.iter().map(|s| s.height_m).fold(f64::INFINITY, f64::min);
            draw_number(
                &mut panel,
                ((surface.height_m - lowest_m) * 1e3).round().clamp(0.0, 9999.0) as u16,
                (off_the_rim(*x, NUMBER_RIM.0, i64::from(width)), off_the_rim(*y, NUMBER_RIM.1, i64::from(height))),
            );
        }
    }
    panel
}

/// The place along a side that is nearest to `at` and so far from both ends; the middle, where there is no room for that.
fn off_the_rim(at: i64, rim: i64, side: i64) -> i64 {
    let rim = rim.min(side / 2);
    at.clamp(rim, side - rim)
}

fn draw_unseen(panel: &mut RgbImage, space: &UnseenSpace, to_pixel: &impl Fn(f64, f64) -> (i64, i64)) {
    for row in 0..space.rows {
        for column in 0..space.columns {
            // The lower half of the levels tells of shadows; the upper half is often above the picture.
            let hidden = (space.hidden[row * space.columns + column] & 0xffff).count_ones() as u16;
            let color = Rgb(UNSEEN.map(|c| ((u16::from(c) * hidden + 255 * (16 - hidden)) / 16) as u8));
            let (x, y) = (space.origin_m[0] + column as f64 * space.cell_m, space.origin_m[1] + row as f64 * space.cell_m);
            let ((left, bottom), (right, top)) = (to_pixel(x, y), to_pixel(x + space.cell_m, y + space.cell_m));
            for v in top..=bottom {
                for u in left..=right {
                    put(panel, u, v, color);
                }
            }
        }
    }
}

/// The mean place of an object's mask.
fn middle_of(labels: &Image<u16>, id: u16) -> Option<(i64, i64)> {
    let width = labels.width();
    let places = labels.pixels().iter().enumerate().filter(|(_, other)| **other == id);
    let (u, v, n) = places.fold((0, 0, 0), |(u, v, n), (i, _)| (u + i % width, v + i / width, n + 1));
    (n > 0).then(|| ((u / n) as i64, (v / n) as i64))
}

#[cfg(test)]
mod tests {
    use repose_proto::CameraModel;

    use super::*;

    #[test]
    fn the_greatest_count_is_no_reading_in_the_picture_of_depth() {
        let camera = CameraModel { width: 4, height: 1, fx: 9.0, fy: 9.0, cx: 1.5, cy: 0.0, depth_unit_m: 1e-3, world_from_camera: None };
        let frame = Frame::new("test".to_owned(), 0, camera, vec![0, 500, 1000, u16::MAX]);
        let (near, far) = depth_range(&frame);
        assert_eq!((near, far), (500.0, 1000.0));
        let panel = depth_panel(&frame, near, far);
        let is_black = |u: u32| panel.get_pixel(u, 0).0 == [0; 3];
        assert_eq!([0, 1, 2, 3].map(is_black), [true, false, false, true]);
    }

    #[test]
    fn a_number_stays_off_the_rim_and_in_the_middle_of_what_is_smaller_than_two_rims() {
        assert_eq!([-5, 40, 300].map(|at| off_the_rim(at, 30, 100)), [30, 40, 70]);
        assert_eq!([-5, 25, 300].map(|at| off_the_rim(at, 30, 50)), [25; 3]);
        assert_eq!([0, 9].map(|at| off_the_rim(at, 30, 1)), [0, 1]);
    }
}
