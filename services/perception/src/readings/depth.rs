//! A depth picture in metres, with the ray of each of its columns and rows.
//!
//! Points are made from it where they are needed: three quarters of a frame's pixels are only ever looked at for their depth. A pixel
//! without a reading holds NaN: every comparison with it is false, which is what "not known" should do in a test.

use repose_geometry::{Image, Pinhole, Point3};
use repose_proto::Frame;

use crate::readings::point_map::{MISSING, PointMap, is_reading};
use crate::readings::repeats;

/// Pixels further off the optical axis than this (a slope, 84°) hold no reading: no pinhole camera sees them, and extreme intrinsics
/// would turn them into infinities.
const MAX_SLOPE: f32 = 10.0;

/// Depth along the optical axis, NaN where there is no reading.
#[derive(Debug, Clone)]
pub struct DepthMap {
    depth_m: Image<f32>,
    /// x over z of each column's rays.
    slope_x: Vec<f32>,
    /// y over z of each row's rays.
    slope_y: Vec<f32>,
    /// How many pixels wide and high it repeats each reading.
    repeat_px: usize,
}

impl DepthMap {
    /// From counts of `depth_unit_m`, row by row, `camera.width * camera.height` of them. Counts that are no reading, and readings beyond
    /// `max_depth_m` are missing.
    pub fn new(counts: &[u16], depth_unit_m: f64, camera: &Pinhole, max_depth_m: f32) -> Self {
        let unit = depth_unit_m as f32;
        let slopes = |n: usize, center: f64, focal: f64| -> Vec<f32> { (0..n).map(|i| ((i as f64 - center) / focal) as f32).collect() };
        let slope_x = slopes(camera.width, camera.cx, camera.fx);
        let slope_y = slopes(camera.height, camera.cy, camera.fy);
        let mut depth_m = Image::filled(camera.width, camera.height, f32::NAN);
        let rows = depth_m.pixels_mut().chunks_exact_mut(camera.width.max(1)).zip(counts.chunks_exact(camera.width.max(1)));
        for ((out, counts), y) in rows.zip(&slope_y) {
            if y.abs() > MAX_SLOPE || y.is_nan() {
                continue;
            }
            for ((z, &count), x) in out.iter_mut().zip(counts).zip(&slope_x) {
                let reading = f32::from(count) * unit;
                *z = if Frame::is_reading(count) && reading <= max_depth_m && x.abs() <= MAX_SLOPE { reading } else { f32::NAN };
            }
        }
        // Told by what hangs in the air, before anybody takes that out.
        let repeat_px = repeats::repeat_px(&depth_m);
        Self { depth_m, slope_x, slope_y, repeat_px }
    }

    /// The depths, metres.
    pub fn depth_m(&self) -> &Image<f32> {
        &self.depth_m
    }

    /// The depths, to take readings out of.
    pub fn depth_m_mut(&mut self) -> &mut Image<f32> {
        &mut self.depth_m
    }

    /// x over z of each column's rays.
    pub fn slope_x(&self) -> &[f32] {
        &self.slope_x
    }

    /// y over z of each row's rays.
    pub fn slope_y(&self) -> &[f32] {
        &self.slope_y
    }

    /// How many pixels wide and high each reading is repeated, as where a driver registered it into a larger picture; 1 in a camera's own.
    pub fn repeat_px(&self) -> usize {
        self.repeat_px
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.depth_m.width()
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.depth_m.height()
    }

    /// How many pixels hold a reading.
    pub fn readings(&self) -> usize {
        self.depth_m.pixels().iter().map(|z| usize::from(!z.is_nan())).sum()
    }

    /// No reading is farther from the camera than this, metres; 0 without one.
    pub fn farthest_m(&self) -> f64 {
        let deepest_m = self.depth_m.pixels().iter().copied().filter(|z| !z.is_nan()).fold(0.0, f32::max);
        // Those of columns and rows that are steeper hold none.
        let steepest = |slopes: &[f32]| slopes.iter().map(|slope| slope.abs()).filter(|slope| *slope <= MAX_SLOPE).fold(0.0, f32::max);
        let (x, y) = (f64::from(steepest(&self.slope_x)), f64::from(steepest(&self.slope_y)));
        f64::from(deepest_m) * (1.0 + x * x + y * y).sqrt()
    }

    /// The point at column `u`, row `v`, camera frame; NaN without a reading.
    pub fn point(&self, u: usize, v: usize) -> Point3<f32> {
        let z = self.depth_m.pixels()[v * self.depth_m.width() + u];
        Point3::new(self.slope_x[u] * z, self.slope_y[v] * z, z)
    }

    /// The points of every `stride`-th column and row, starting at 0, camera frame; `stride` is at least 1.
    pub fn points(&self, stride: usize) -> PointMap {
        let (width, height) = (self.width().div_ceil(stride), self.height().div_ceil(stride));
        let mut points = Image::filled(width, height, MISSING);
        for (row, v) in points.pixels_mut().chunks_exact_mut(width.max(1)).zip((0..).step_by(stride)) {
            let depths = &self.depth_m.pixels()[v * self.depth_m.width()..][..self.depth_m.width()];
            let y = self.slope_y[v];
            for ((p, z), x) in row.iter_mut().zip(depths.iter().step_by(stride)).zip(self.slope_x.iter().step_by(stride)) {
                *p = Point3::new(x * z, y * z, *z);
            }
        }
        points
    }

    /// The same, but where a pixel holds no reading, that of another one of its `stride` × `stride` block where one does: surfaces seen at a
    /// glance lose readings here and there, and would fall apart.
    pub fn points_of_blocks(&self, stride: usize) -> PointMap {
        let mut points = self.points(stride);
        let (columns, width, height) = (points.width(), self.width(), self.height());
        for (i, p) in points.pixels_mut().iter_mut().enumerate().filter(|(_, p)| !is_reading(p)) {
            let (u0, v0) = (i % columns * stride, i / columns * stride);
            let block = (v0..(v0 + stride).min(height)).flat_map(|v| (u0..(u0 + stride).min(width)).map(move |u| (u, v)));
            if let Some(other) = block.map(|(u, v)| self.point(u, v)).find(is_reading) {
                *p = other;
            }
        }
        points
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: Pinhole = Pinhole { width: 5, height: 3, fx: 4.0, fy: 5.0, cx: 2.0, cy: 1.0 };

    #[test]
    fn pixels_without_a_usable_reading_are_missing_and_the_others_project_back() {
        let mut counts = vec![1000u16; 15];
        counts[3] = 0;
        counts[7] = 5000;
        let depth = DepthMap::new(&counts, 0.001, &CAMERA, 4.0);
        assert_eq!(depth.readings(), 13);
        for (i, p) in depth.points(1).pixels().iter().enumerate() {
            assert_eq!(is_reading(p), i != 3 && i != 7);
            if is_reading(p) {
                assert_eq!(CAMERA.pixel_of(&p.cast()), Some((i % 5, i / 5)));
                assert_eq!(depth.point(i % 5, i / 5), *p);
            }
        }
    }

    #[test]
    fn the_greatest_count_is_no_reading_however_fine_the_unit() {
        // In a twentieth of a millimetre it would lie at 3.3 m.
        let depth = |count: u16| DepthMap::new(&[count; 15], 5e-5, &CAMERA, 4.0).readings();
        assert_eq!([depth(0), depth(1), depth(u16::MAX - 1), depth(u16::MAX)], [0, 15, 15, 0]);
    }

    #[test]
    fn extreme_intrinsics_give_no_points_rather_than_infinite_ones() {
        for camera in [Pinhole { fx: 1e-300, ..CAMERA }, Pinhole { cy: 1e300, ..CAMERA }] {
            let points = DepthMap::new(&[1000; 15], 0.001, &camera, 4.0).points(1);
            assert!(points.pixels().iter().all(|p| !is_reading(p) || p.coords.iter().all(|c| c.is_finite())));
        }
    }

    #[test]
    fn a_block_has_a_reading_where_any_of_its_pixels_has_one() {
        let mut counts: Vec<u16> = (1..16).map(|i| i * 100).collect();
        (counts[0], counts[2], counts[3], counts[7], counts[8]) = (0, 0, 0, 0, 0);
        let depth = DepthMap::new(&counts, 0.001, &CAMERA, 4.0);
        let blocks = depth.points_of_blocks(2);
        assert_eq!(blocks[(0, 0)], depth.point(1, 0));
        assert!(!is_reading(&blocks[(1, 0)]));
        assert_eq!(blocks[(2, 1)], depth.point(4, 2));
    }

    #[test]
    fn a_stride_keeps_every_nth_point() {
        let counts: Vec<u16> = (1..16).map(|i| i * 100).collect();
        let depth = DepthMap::new(&counts, 0.001, &CAMERA, 4.0);
        let all = depth.points(1);
        let coarse = depth.points(2);
        assert_eq!((coarse.width(), coarse.height()), (3, 2));
        for (v, u) in [(0, 0), (0, 2), (1, 1)] {
            assert_eq!(coarse[(u, v)], all[(2 * u, 2 * v)]);
        }
    }
}
