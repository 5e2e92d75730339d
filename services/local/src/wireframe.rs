//! Lines over pictures: boxes of the world as a camera sees them.

use image::{Rgb, RgbImage};
use nalgebra::Point3;
use repose_geometry::Pinhole;
use repose_pictures::projection::{camera_from_world, pinhole};
use repose_proto::Scene;

/// Ends of lines nearer to the camera's plane than this are cut off there, metres.
const NEAREST_M: f64 = 0.05;

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

/// A line one pixel wide; ends outside the picture are fine.
pub fn draw_line(picture: &mut RgbImage, from: (i64, i64), to: (i64, i64), color: Rgb<u8>) {
    // Far outside nothing would be seen for a long time.
    const FAR: i64 = 20_000;
    let steps = (to.0 - from.0).abs().max((to.1 - from.1).abs()).clamp(1, FAR);
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
