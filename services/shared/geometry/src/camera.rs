//! The pinhole camera: x right, y down, z forward (OpenCV); pixel centres at integer coordinates.

use nalgebra::{Point2, Point3};

/// Intrinsics of an undistorted camera. Focal lengths and the principal point are in pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pinhole {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Horizontal focal length, pixels.
    pub fx: f64,
    /// Vertical focal length, pixels.
    pub fy: f64,
    /// Column of the principal point, pixels.
    pub cx: f64,
    /// Row of the principal point, pixels.
    pub cy: f64,
}

impl Pinhole {
    /// The camera of a smaller picture of the same view, of `columns` columns at most: whole blocks of pixels become one.
    pub fn shrunk(&self, columns: usize) -> Self {
        let block = self.width.div_ceil(columns.max(1)).max(1);
        let side = block as f64;
        Self {
            width: self.width.div_ceil(block),
            height: self.height.div_ceil(block),
            fx: self.fx / side,
            fy: self.fy / side,
            // Pixel centres have whole coordinates: those of a block lie around its middle.
            cx: (self.cx + 0.5) / side - 0.5,
            cy: (self.cy + 0.5) / side - 0.5,
        }
    }

    /// The point at `depth_m` along the optical axis seen at pixel (`u`, `v`).
    pub fn unproject(&self, u: f64, v: f64, depth_m: f64) -> Point3<f64> {
        Point3::new((u - self.cx) / self.fx * depth_m, (v - self.cy) / self.fy * depth_m, depth_m)
    }

    /// Pixel coordinates (column, row) of a point in front of the camera, or `None` behind it. May lie outside the image.
    #[inline]
    pub fn project(&self, point_in_camera: &Point3<f64>) -> Option<Point2<f64>> {
        (point_in_camera.z > 1e-9).then(|| {
            Point2::new(
                self.fx * point_in_camera.x / point_in_camera.z + self.cx,
                self.fy * point_in_camera.y / point_in_camera.z + self.cy,
            )
        })
    }

    /// The pixel (column, row) that a point falls on, or `None` outside the image or behind the camera.
    #[inline]
    pub fn pixel_of(&self, point_in_camera: &Point3<f64>) -> Option<(usize, usize)> {
        let p = self.project(point_in_camera)?;
        Some((nearest_pixel(p.x, self.width)?, nearest_pixel(p.y, self.height)?))
    }
}

/// The pixel of `0..count` nearest to a coordinate, halves upwards; `None` outside.
///
/// [`f64::round`] without the call that it is on processors' oldest instruction set: scenes are projected point by point.
#[inline]
fn nearest_pixel(at: f64, count: usize) -> Option<usize> {
    // Larger numbers do not fit the conversion, and NaN is not greater.
    if !(at > -0.5 && at < f64::from(i32::MAX)) {
        return None;
    }
    let whole = at as i32;
    let pixel = (whole + i32::from(at - f64::from(whole) >= 0.5)) as usize;
    (pixel < count).then_some(pixel)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const CAMERA: Pinhole = Pinhole { width: 640, height: 480, fx: 525.0, fy: 520.0, cx: 319.5, cy: 239.5 };

    proptest! {
        #[test]
        fn a_pixel_survives_the_round_trip(u in 0.0..640.0f64, v in 0.0..480.0f64, depth in 0.1..5.0f64) {
            let back = CAMERA.project(&CAMERA.unproject(u, v, depth)).unwrap();
            prop_assert!((back - Point2::new(u, v)).norm() < 1e-9);
        }

        #[test]
        fn the_nearest_pixel_is_the_rounded_coordinate(at in -3.0..20.0f64, halves in -6i32..40) {
            for at in [at, f64::from(halves) / 2.0, (f64::from(halves) / 2.0).next_down(), (f64::from(halves) / 2.0).next_up()] {
                let rounded = at.round();
                prop_assert_eq!(nearest_pixel(at, 16), (0.0..16.0).contains(&rounded).then_some(rounded as usize), "{}", at);
            }
        }
    }

    #[test]
    fn a_shrunk_picture_shows_a_place_in_the_block_of_its_pixel() {
        let small = CAMERA.shrunk(160);
        assert_eq!((small.width, small.height), (160, 120));
        for (u, v) in [(0, 0), (3, 3), (4, 0), (319, 239), (639, 479)] {
            assert_eq!(small.pixel_of(&CAMERA.unproject(u as f64, v as f64, 0.9)), Some((u / 4, v / 4)));
        }
        assert_eq!(CAMERA.shrunk(1000), CAMERA);
    }

    #[test]
    fn coordinates_that_are_no_numbers_or_far_away_have_no_pixel() {
        for at in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e12, -1e12] {
            assert_eq!(nearest_pixel(at, usize::MAX), None, "{at}");
        }
    }

    #[test]
    fn points_behind_or_beside_the_image_have_no_pixel() {
        assert_eq!(CAMERA.pixel_of(&Point3::new(0.0, 0.0, -1.0)), None);
        assert_eq!(CAMERA.pixel_of(&Point3::new(5.0, 0.0, 1.0)), None);
        assert_eq!(CAMERA.pixel_of(&CAMERA.unproject(12.0, 34.0, 0.7)), Some((12, 34)));
    }
}
