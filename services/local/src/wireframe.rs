//! Lines over pictures: boxes of the world as a camera sees them.

use image::{Rgb, RgbImage};
use nalgebra::{Point2, Point3};
use repose_geometry::Pinhole;
use repose_pictures::projection::{camera_from_world, pinhole};
use repose_proto::Scene;

/// Ends of lines nearer to the camera's plane than this are cut off there, metres.
const NEAREST_M: f64 = 0.05;
/// Ends of lines farther outside the picture than this are cut off there, pixels.
const FARTHEST_PX: f64 = 5_000.0;

/// Draws the edges of a box along the world's axes, as the scene's camera sees them; nothing where the camera's pose is not known.
pub fn draw_box(picture: &mut RgbImage, scene: &Scene, min_m: [f64; 3], max_m: [f64; 3], color: Rgb<u8>) {
    let camera = pinhole(&scene.meta.camera);
    let Some(camera_from_world) = camera_from_world(scene) else { return };
    let corner = |bits: usize| Point3::from(std::array::from_fn(|k| if bits >> k & 1 == 0 { min_m[k] } else { max_m[k] }));
    for from in 0..8usize {
        for axis in (0..3).filter(|axis| from >> axis & 1 == 0) {
            let ends = [corner(from), corner(from | 1 << axis)].map(|end| camera_from_world * end);
            draw_edge(picture, &camera, ends, color);
        }
    }
}

/// A straight edge in the camera's frame: what lies behind the camera is cut off.
fn draw_edge(picture: &mut RgbImage, camera: &Pinhole, ends: [Point3<f64>; 2], color: Rgb<u8>) {
    let [a, b] = ends;
    if a.z.max(b.z) < NEAREST_M {
        return;
    }
    let cut = |near: Point3<f64>, far: Point3<f64>| match near.z < NEAREST_M {
        true => near + (far - near) * ((NEAREST_M - near.z) / (far.z - near.z)),
        false => near,
    };
    let (Some(from), Some(to)) = (camera.project(&cut(a, b)), camera.project(&cut(b, a))) else { return };
    draw_line(picture, (from.x.round() as i64, from.y.round() as i64), (to.x.round() as i64, to.y.round() as i64), color);
}

/// The part of a line that is in the picture or not far from it; ends that are not far stay as they are. An edge of a zone that goes past the
/// camera is millions of pixels long.
fn near_picture(picture: &RgbImage, [from, to]: [Point2<f64>; 2]) -> Option<[Point2<f64>; 2]> {
    let along = to - from;
    let limits = [picture.width(), picture.height()].map(|size| (-FARTHEST_PX, f64::from(size) + FARTHEST_PX));
    let (mut begin, mut end) = (0.0f64, 1.0f64);
    for (k, (low, high)) in limits.into_iter().enumerate() {
        if along[k] == 0.0 {
            if !(low..=high).contains(&from[k]) {
                return None;
            }
            continue;
        }
        let (a, b) = ((low - from[k]) / along[k], (high - from[k]) / along[k]);
        (begin, end) = (begin.max(a.min(b)), end.min(a.max(b)));
    }
    // Clamped, for what is so far away that the part is lost in rounding.
    let at = |share: f64| Point2::from([0usize, 1].map(|k| (from[k] + along[k] * share).clamp(limits[k].0, limits[k].1)));
    (begin < end).then(|| [if begin > 0.0 { at(begin) } else { from }, if end < 1.0 { at(end) } else { to }])
}

/// A line one pixel wide; ends outside the picture are fine, however far.
pub fn draw_line(picture: &mut RgbImage, from: (i64, i64), to: (i64, i64), color: Rgb<u8>) {
    let Some(ends) = near_picture(picture, [from, to].map(|(x, y)| Point2::new(x as f64, y as f64))) else { return };
    let [from, to] = ends.map(|end| (end.x.round() as i64, end.y.round() as i64));
    let steps = (to.0 - from.0).abs().max((to.1 - from.1).abs()).max(1);
    for step in 0..=steps {
        put(picture, from.0 + (to.0 - from.0) * step / steps, from.1 + (to.1 - from.1) * step / steps, color);
    }
}

/// One pixel, where it is in the picture.
pub fn put(picture: &mut RgbImage, x: i64, y: i64, color: Rgb<u8>) {
    if x >= 0 && y >= 0 && x < i64::from(picture.width()) && y < i64::from(picture.height()) {
        picture.put_pixel(x as u32, y as u32, color);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_edge_is_drawn_across_the_picture_however_far_it_goes_on() {
        let camera = Pinhole { width: 64, height: 48, fx: 60.0, fy: 60.0, cx: 32.0, cy: 24.0 };
        let drawn = |ends: [Point3<f64>; 2]| {
            let mut picture = RgbImage::new(64, 48);
            draw_edge(&mut picture, &camera, ends, Rgb([255; 3]));
            picture.pixels().filter(|pixel| pixel.0 == [255; 3]).count()
        };
        for half_m in [1.0, 1e3, 1e6, 1e12] {
            assert_eq!(drawn([Point3::new(-half_m, 0.0, 1.0), Point3::new(half_m, 0.0, 1.0)]), 64, "{half_m} m");
            assert_eq!(drawn([Point3::new(0.0, half_m, 1.0), Point3::new(0.0, -half_m, 1.0)]), 48, "{half_m} m");
        }
        assert_eq!(drawn([Point3::new(-1e6, 1e6, 1.0), Point3::new(1e6, 1e6, 1.0)]), 0, "it passes far below");
        // So far away that nothing is left of where it passes: whatever is drawn then, the picture is made.
        drawn([Point3::new(-1e300, 0.0, 1.0), Point3::new(1e300, 1e300, 1.0)]);
    }
}
