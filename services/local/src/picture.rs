//! Pictures for people: a scene as its camera saw it, with an object drawn where it is to go, and several of them side by side.

use image::{Rgb, RgbImage};
use nalgebra::Isometry3;
use repose_geometry::Image;
use repose_geometry::transform::from_row_major;
use repose_pictures::colors::PAPER;
use repose_pictures::drawing::{LINE_HEIGHT, blit, number_pixels, write_lines};
use repose_proto::{CallError, PlaceResult, Scene};

pub use repose_pictures::projection::{pinhole, pixel_of_object};
pub use repose_pictures::scene::Coloring;

const NOTHING: Rgb<u8> = Rgb([255, 255, 255]);

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

/// The scene seen from its own camera; `moved` names an object and where its points go. The hole that it leaves stays white.
pub fn scene_picture(scene: &Scene, coloring: Coloring, moved: Option<(u16, &Isometry3<f64>)>) -> RgbImage {
    rgb_image(&repose_pictures::scene::scene_picture(scene, coloring, moved))
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

/// Writes every object's id on a picture of the scene.
pub fn draw_ids(picture: &mut RgbImage, scene: &Scene) {
    for object in &scene.meta.objects {
        if let Some(at) = pixel_of_object(scene, object.id) {
            draw_number(picture, object.id, at);
        }
    }
}
