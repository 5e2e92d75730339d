//! Points kept in the picture's order, so that neighbours in the picture are neighbours in memory.
//!
//! A pixel without a reading holds NaN: every comparison with it is false, which is what "not known" should do in a test.

use repose_geometry::{Image, Isometry3, Point3, Vector3};

/// One point per pixel; NaN coordinates where there is no reading. What frame the points are in, the holder's name says.
pub type PointMap = Image<Point3<f32>>;

/// What stands for "no reading".
pub const MISSING: Point3<f32> = Point3::new(f32::NAN, f32::NAN, f32::NAN);

/// Whether a pixel holds a reading.
pub fn is_reading(p: &Point3<f32>) -> bool {
    !p.x.is_nan()
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
