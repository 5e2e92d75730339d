//! Pictures for people: a scene as its camera saw it, with an object drawn where it is to go, and several of them side by side.

use image::{Rgb, RgbImage};
use nalgebra::{Isometry3, Point3};
use repose_geometry::transform::from_row_major;
use repose_geometry::{Image, Pinhole};
use repose_proto::{CallError, CameraModel, PlaceResult, Scene};
use repose_simulator::sheet::colors::{PAPER, object_color};
use repose_simulator::sheet::drawing::{LINE_HEIGHT, blit, number_pixels, write_lines};

const NOTHING: Rgb<u8> = Rgb([255, 255, 255]);
const PLACED: [u8; 3] = [40, 200, 60];
/// Half the side of the square that a point is drawn as, pixels.
const SPLAT: i64 = 1;

/// The intrinsics of a camera message.
pub fn pinhole(camera: &CameraModel) -> Pinhole {
    Pinhole { width: camera.width, height: camera.height, fx: camera.fx, fy: camera.fy, cx: camera.cx, cy: camera.cy }
}

/// The scene with object ids, and beside it the scene with the best placement drawn in, where there is one.
///
/// # Errors
/// When the placement is no rigid transform.
pub fn before_and_after(scene: &Scene, result: &PlaceResult) -> Result<RgbImage, CallError> {
    let mut before = scene_picture(scene, Coloring::Seen, None);
    draw_ids(&mut before, scene);
    let before = captioned(&before, "as seen, with object ids");
    let Some(best) = result.placements.first() else { return Ok(before) };
    let placed_from_observed = from_row_major(&best.placed_from_observed.0)
        .map_err(|e| CallError::invalid("placements[0].placed_from_observed", e.to_string()))?;
    let after = scene_picture(scene, Coloring::Seen, Some((result.query, &placed_from_observed)));
    Ok(side_by_side(&[before, captioned(&after, "where the object is to stand: green")]))
}

/// A placement's motion of world space.
///
/// # Errors
/// `invalid_argument` on `placed_from_observed` when it is no rigid transform.
pub fn placed(placed_from_observed: &[f64; 16]) -> Result<Isometry3<f64>, CallError> {
    from_row_major(placed_from_observed).map_err(|e| CallError::invalid("placed_from_observed", e.to_string()))
}

/// How a scene's points are colored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Coloring {
    /// As the camera saw them; by object where it saw no color.
    Seen,
    /// By object, background grey.
    Objects,
}

/// The scene seen from its own camera; `moved` names an object and where its points go. The hole that it leaves stays white.
pub fn scene_picture(scene: &Scene, coloring: Coloring, moved: Option<(u16, &Isometry3<f64>)>) -> RgbImage {
    let camera = pinhole(&scene.meta.camera);
    let world_from_camera = scene.meta.camera.world_from_camera.and_then(|t| from_row_major(&t.0).ok()).unwrap_or_else(Isometry3::identity);
    let camera_from_world = world_from_camera.inverse();
    let mut picture = RgbImage::from_pixel(camera.width as u32, camera.height as u32, NOTHING);
    let mut nearest = vec![f64::INFINITY; camera.width * camera.height];
    for (i, (point, &label)) in scene.points.iter().zip(&scene.labels).enumerate() {
        let mut in_world = Point3::from(*point).cast::<f64>();
        let seen = match (&scene.colors, coloring) {
            (Some(colors), Coloring::Seen) => colors[i],
            _ if label == 0 => [190; 3],
            _ => object_color(label),
        };
        let mut color = seen;
        if let Some((_, placed_from_observed)) = moved.filter(|(id, _)| *id == label) {
            in_world = placed_from_observed * in_world;
            color = std::array::from_fn(|k| ((u16::from(seen[k]) + 2 * u16::from(PLACED[k])) / 3) as u8);
        }
        let in_camera = camera_from_world * in_world;
        let Some(pixel) = camera.project(&in_camera) else { continue };
        let (u, v) = (pixel.x.round() as i64, pixel.y.round() as i64);
        for (x, y) in (v - SPLAT..=v + SPLAT).flat_map(|y| (u - SPLAT..=u + SPLAT).map(move |x| (x, y))) {
            if x < 0 || y < 0 || x >= camera.width as i64 || y >= camera.height as i64 {
                continue;
            }
            let slot = y as usize * camera.width + x as usize;
            // A splat's border must not cover a neighbour at the same depth.
            let depth = in_camera.z + if (x, y) == (u, v) { 0.0 } else { 0.002 };
            if depth < nearest[slot] {
                nearest[slot] = depth;
                picture.put_pixel(x as u32, y as u32, Rgb(color));
            }
        }
    }
    picture
}

/// A color image as it came from a camera.
pub fn color_picture(width: usize, height: usize, color: &[[u8; 3]]) -> RgbImage {
    RgbImage::from_fn(width as u32, height as u32, |u, v| Rgb(color[v as usize * width + u as usize]))
}

/// Pictures next to each other, a thin gap between them.
pub fn side_by_side(pictures: &[RgbImage]) -> RgbImage {
    const GAP: u32 = 6;
    let width = pictures.iter().map(|p| p.width() + GAP).sum::<u32>().saturating_sub(GAP);
    let height = pictures.iter().map(RgbImage::height).max().unwrap_or(0);
    let mut sheet = RgbImage::from_pixel(width, height, NOTHING);
    let mut left = 0;
    for picture in pictures {
        image::imageops::replace(&mut sheet, picture, i64::from(left), 0);
        left += picture.width() + GAP;
    }
    sheet
}

/// A picture with a line of text below it.
pub fn captioned(picture: &RgbImage, caption: &str) -> RgbImage {
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    let mut sheet = Image::filled(width, height + LINE_HEIGHT + 4, PAPER);
    blit(&mut sheet, &library_picture(picture), 0, 0);
    write_lines(&mut sheet, 2, height + 2, caption, &[]);
    rgb_image(&sheet)
}

/// Writes an object's id in the middle of a picture's region, so that people can name objects to `--move` and `--goal`.
pub fn draw_number(picture: &mut RgbImage, number: u16, at: (i64, i64)) {
    number_pixels(number, at, |x, y, grey| {
        if let (Ok(x), Ok(y)) = (u32::try_from(x), u32::try_from(y))
            && let Some(pixel) = picture.get_pixel_mut_checked(x, y)
        {
            *pixel = Rgb([grey; 3]);
        }
    });
}

/// A picture of the library's own kind, to be written to a file.
pub fn rgb_image(picture: &Image<[u8; 3]>) -> RgbImage {
    color_picture(picture.width(), picture.height(), picture.pixels())
}

/// A picture of this program as one of the library's own kind.
pub fn library_picture(picture: &RgbImage) -> Image<[u8; 3]> {
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    let pixels = picture.pixels().map(|p| p.0).collect();
    Image::from_pixels(width, height, pixels).unwrap_or_else(|_| Image::filled(width, height, NOTHING.0))
}

/// Where an object's centroid falls in its camera's picture.
pub fn pixel_of_object(scene: &Scene, id: u16) -> Option<(i64, i64)> {
    let world_from_camera = from_row_major(&scene.meta.camera.world_from_camera?.0).ok()?;
    let centroid = scene.object(id)?.centroid_m;
    let pixel = pinhole(&scene.meta.camera).project(&(world_from_camera.inverse() * Point3::from(centroid)))?;
    Some((pixel.x.round() as i64, pixel.y.round() as i64))
}

/// Writes every object's id on a picture of the scene.
pub fn draw_ids(picture: &mut RgbImage, scene: &Scene) {
    for object in &scene.meta.objects {
        if let Some(at) = pixel_of_object(scene, object.id) {
            draw_number(picture, object.id, at);
        }
    }
}
