//! Points kept in the picture's order, so that neighbours in the picture are neighbours in memory.
//!
//! A pixel without a reading holds NaN: every comparison with it is false, which is what "not known" should do in a test.

use repose_geometry::{Image, Isometry3, Pinhole, Point3, Vector3};

/// One point per pixel; NaN coordinates where there is no reading. What frame the points are in, the holder's name says.
pub type PointMap = Image<Point3<f32>>;

/// What stands for "no reading".
pub const MISSING: Point3<f32> = Point3::new(f32::NAN, f32::NAN, f32::NAN);

/// Whether a pixel holds a reading.
pub fn is_reading(p: &Point3<f32>) -> bool {
    !p.x.is_nan()
}

/// Pixels further off the optical axis than this (a slope, 84°) hold no reading: no pinhole camera sees them, and extreme intrinsics
/// would turn them into infinities.
const MAX_SLOPE: f32 = 10.0;

/// The points that a depth picture shows, in the camera frame. Readings of 0 or beyond `max_depth_m` are missing.
///
/// `depth` holds counts of `depth_unit_m`, row by row, `camera.width * camera.height` of them.
pub fn unproject(depth: &[u16], depth_unit_m: f64, camera: &Pinhole, max_depth_m: f32) -> PointMap {
    let unit = depth_unit_m as f32;
    let ray_x: Vec<f32> = (0..camera.width).map(|u| ((u as f64 - camera.cx) / camera.fx) as f32).collect();
    let mut points = Image::filled(camera.width, camera.height, MISSING);
    let rows = points.pixels_mut().chunks_exact_mut(camera.width).zip(depth.chunks_exact(camera.width));
    for (v, (out, counts)) in rows.enumerate() {
        let ray_y = ((v as f64 - camera.cy) / camera.fy) as f32;
        for ((p, &count), &x) in out.iter_mut().zip(counts).zip(&ray_x) {
            let z = f32::from(count) * unit;
            if count > 0 && z <= max_depth_m && x.abs().max(ray_y.abs()) <= MAX_SLOPE {
                *p = Point3::new(x * z, ray_y * z, z);
            }
        }
    }
    points
}

/// The points moved by a rigid transform; missing ones stay missing.
pub fn transformed(points: &PointMap, to_from: &Isometry3<f64>) -> PointMap {
    let rotation = to_from.rotation.to_rotation_matrix().into_inner().cast::<f32>();
    let translation: Vector3<f32> = to_from.translation.vector.cast();
    points.map(|p| Point3::from(rotation * p.coords + translation))
}

/// Every `stride`-th column and row of a picture, starting at 0; `stride` is at least 1.
pub fn strided<T: Copy + Default>(picture: &Image<T>, stride: usize) -> Image<T> {
    let (width, height) = (picture.width().div_ceil(stride), picture.height().div_ceil(stride));
    let mut coarse = Image::filled(width, height, T::default());
    let rows = picture.pixels().chunks_exact(picture.width().max(1)).step_by(stride);
    for (out, row) in coarse.pixels_mut().chunks_exact_mut(width.max(1)).zip(rows) {
        for (o, p) in out.iter_mut().zip(row.iter().step_by(stride)) {
            *o = *p;
        }
    }
    coarse
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: Pinhole = Pinhole { width: 5, height: 3, fx: 4.0, fy: 5.0, cx: 2.0, cy: 1.0 };

    #[test]
    fn pixels_without_a_usable_reading_are_missing_and_the_others_project_back() {
        let mut depth = vec![1000u16; 15];
        depth[3] = 0;
        depth[7] = 5000;
        let points = unproject(&depth, 0.001, &CAMERA, 4.0);
        for (i, p) in points.pixels().iter().enumerate() {
            assert_eq!(is_reading(p), i != 3 && i != 7);
            if is_reading(p) {
                assert_eq!(CAMERA.pixel_of(&p.cast()), Some((i % 5, i / 5)));
            }
        }
    }

    #[test]
    fn extreme_intrinsics_give_no_points_rather_than_infinite_ones() {
        for camera in [Pinhole { fx: 1e-300, ..CAMERA }, Pinhole { cy: 1e300, ..CAMERA }] {
            let points = unproject(&[1000; 15], 0.001, &camera, 4.0);
            assert!(points.pixels().iter().all(|p| !is_reading(p) || p.coords.iter().all(|c| c.is_finite())));
        }
    }

    #[test]
    fn a_strided_picture_keeps_every_nth_pixel() {
        let picture = Image::from_pixels(5, 3, (0..15u16).collect()).unwrap();
        assert_eq!(strided(&picture, 2).pixels(), [0, 2, 4, 10, 12, 14]);
        assert_eq!(strided(&picture, 1), picture);
    }

    #[test]
    fn missing_points_stay_missing_when_moved() {
        let mut points = Image::filled(2, 1, MISSING);
        points[(1, 0)] = Point3::new(1.0, 2.0, 3.0);
        let moved = transformed(&points, &Isometry3::translation(1.0, 0.0, 0.0));
        assert!(!is_reading(&moved[(0, 0)]));
        assert_eq!(moved[(1, 0)], Point3::new(2.0, 2.0, 3.0));
    }
}
