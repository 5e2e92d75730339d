//! Which pixels show a surface that faces up.
//!
//! The normal is the cross product of two differences across the pixel, over a fixed length in space rather than in pixels: a
//! structured-light camera's steps of one or two millimetres would otherwise tilt it by tens of degrees.

use repose_geometry::{Image, Point3};

use crate::readings::point_map::PointMap;

/// Half the length over which a normal is taken, metres.
const ARM_M: f32 = 0.012;
/// Longest arm, pixels; a nearer surface is smooth over less.
const MAX_ARM_PX: usize = 12;
/// How far the middle of an arm's ends may lie from the pixel, as a share of their distance: more is an edge or a jump, not a surface.
const MAX_BEND: f32 = 0.2;

/// Pixels whose surface normal is within `max_tilt_rad` of up.
///
/// `depth_m` gives each pixel's depth (NaN where it is missing), `focal_px` the focal length, both of the same (coarse) picture as `in_world`.
pub fn upward_facing(in_world: &PointMap, depth_m: &Image<f32>, focal_px: f32, max_tilt_rad: f32) -> Image<bool> {
    let (width, height) = (in_world.width(), in_world.height());
    let points = in_world.pixels();
    // Squared below: a surface that may tilt further than upright would be no surface to stand on.
    let least_cos = max_tilt_rad.cos().max(0.0);
    let mut upward = Image::filled(width, height, false);
    for (i, (out, &depth)) in upward.pixels_mut().iter_mut().zip(depth_m.pixels()).enumerate() {
        if depth.is_nan() {
            continue;
        }
        let (u, v) = (i % width, i / width);
        let arm = arm_px(depth, focal_px, ARM_M, MAX_ARM_PX);
        if u < arm || v < arm || u + arm >= width || v + arm >= height {
            continue;
        }
        // False where an end is missing.
        let straight = |a: &Point3<f32>, b: &Point3<f32>| {
            (nalgebra::center(a, b) - points[i]).norm_squared() <= MAX_BEND * MAX_BEND * (b - a).norm_squared()
        };
        let (left, right) = (&points[i - arm], &points[i + arm]);
        let (above, below) = (&points[i - arm * width], &points[i + arm * width]);
        if !straight(left, right) || !straight(above, below) {
            continue;
        }
        // Down the picture times right across it points at the camera, whatever the surface.
        let normal = (below - above).cross(&(right - left));
        *out = normal.z > 0.0 && normal.z * normal.z >= least_cos * least_cos * normal.norm_squared();
    }
    upward
}

/// An arm of `length_m` at a depth, in pixels of a picture with focal length `focal_px`; 1 to `most`.
pub fn arm_px(depth_m: f32, focal_px: f32, length_m: f32, most: usize) -> usize {
    ((length_m * focal_px / depth_m).round() as usize).clamp(1, most)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::readings::point_map::{MISSING, transformed};
    use crate::synthetic::{Solid, cast, render};
    use repose_geometry::transform::look_at;
    use repose_geometry::{Pinhole, Vector3};

    const CAMERA: Pinhole = Pinhole { width: 160, height: 120, fx: 130.0, fy: 130.0, cx: 79.5, cy: 59.5 };

    #[test]
    fn tops_face_up_and_sides_do_not() {
        let world_from_camera = look_at(&Point3::new(0.3, -0.8, 0.6), &Point3::origin(), &Vector3::z());
        let solids = [Solid::table(0.0), Solid::cuboid([0.0, 0.0, 0.06], [0.1, 0.1, 0.06])];
        let in_camera = render(&solids, &CAMERA, &world_from_camera);
        let in_world = transformed(&in_camera, &world_from_camera);
        let depth = in_camera.map(|p| p.z);
        let upward = upward_facing(&in_world, &depth, 130.0, 0.3);
        let seen = cast(&solids, &CAMERA, &world_from_camera);
        let (mut top, mut side, mut side_up) = (0, 0, 0);
        for (i, up) in upward.pixels().iter().enumerate() {
            let on_box = seen.pixels()[i].is_some_and(|(_, solid)| solid == 1);
            let high = in_world.pixels()[i].z > 0.119;
            top += usize::from(on_box && high && *up);
            side += usize::from(on_box && !high);
            side_up += usize::from(on_box && !high && *up);
        }
        assert!(top > 50 && side > 100, "{top} on top, {side} on the sides");
        assert_eq!(side_up, 0);
    }

    #[test]
    fn a_pixel_without_a_reading_faces_nowhere() {
        let points = PointMap::filled(30, 30, MISSING);
        assert!(upward_facing(&points, &Image::filled(30, 30, f32::NAN), 100.0, 0.3).pixels().iter().all(|up| !up));
    }
}
