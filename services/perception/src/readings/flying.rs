//! Readings that hang in the air between two surfaces, taken out.
//!
//! A depth camera mixes what its pixel sees at an outline: the reading comes to lie between the near and the far surface, where there is
//! nothing. Seen along a row or column, such a pixel is far from the pixels on both sides of it, nearer than the one and farther than the
//! other. How far two neighbouring pixels of one surface can be apart grows with its slope: steeper than `max_slope` is no surface.
//! What is far from all four neighbours is a speckle and goes as well. What has no neighbours is one too, unless there is much of it: depth
//! that was registered into a larger picture lies a pixel apart.

use repose_geometry::Image;

use crate::settings::FlyingSettings;

/// Readings without any beside them are speckles where fewer than one of so many readings is such a one.
const ONE_ALONE_OF: usize = 20;

/// What was found of flying readings.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Flying {
    /// How many readings were taken out.
    pub removed: usize,
    /// Whether most readings have none beside them.
    pub is_sparse: bool,
}

/// How far two neighbouring readings of one surface may be apart in a picture.
#[derive(Debug, Clone, Copy)]
pub struct StepLimit {
    per_depth: f32,
    noise_per_m2: f32,
}

impl StepLimit {
    /// In a picture of a focal length, pixels.
    pub fn new(settings: &FlyingSettings, focal_px: f32) -> Self {
        Self { per_depth: settings.max_slope / focal_px, noise_per_m2: settings.noise_per_m2 }
    }

    /// At a depth, metres.
    #[inline]
    pub fn at_m(&self, depth_m: f32) -> f32 {
        self.per_depth * depth_m + self.noise_per_m2 * depth_m * depth_m
    }
}

/// Replaces flying readings by NaN; what was found of them.
///
/// `depth_m` holds NaN where there is no reading, `focal_px` is the focal length of the same picture.
pub fn remove(depth_m: &mut Image<f32>, focal_px: f32, settings: &FlyingSettings) -> Flying {
    let (width, height) = (depth_m.width(), depth_m.height());
    if width < 3 || height < 3 {
        return Flying::default();
    }
    // Judged on the readings as they came: a pixel taken out must not make its neighbour flying. Around the picture nothing was read: its outermost
    // pixels are judged by the neighbours that they have.
    let stride = width + 2;
    let mut before = vec![f32::NAN; stride * (height + 2)];
    for (v, pixels) in depth_m.pixels().chunks_exact(width).enumerate() {
        before[(v + 1) * stride + 1..][..width].copy_from_slice(pixels);
    }
    let row = |v: usize| &before[v * stride..(v + 1) * stride];
    let step = StepLimit::new(settings, focal_px);
    let mut removed = 0;
    let mut alone = Vec::new();
    let mut flying = vec![false; width];
    for v in 0..height {
        let (above, here, below) = (row(v), row(v + 1), row(v + 2));
        // Slices of one length, so that the loop runs over many pixels at once.
        let sides = here[..width].iter().zip(&here[2..]).zip(&above[1..=width]).zip(&below[1..=width]);
        for ((flying, z), (((left, right), above), below)) in flying.iter_mut().zip(&here[1..=width]).zip(sides) {
            let limit = step.at_m(*z);
            // Comparisons with a missing neighbour are false: it is no step to either side, and near nobody.
            let between = |a: f32, b: f32| ((z - a > limit) & (b - z > limit)) | ((a - z > limit) & (z - b > limit));
            let near = |a: f32| (a - z).abs() <= limit;
            let speckle = !(near(*left) | near(*right) | near(*above) | near(*below));
            *flying = (between(*left, *right) | between(*above, *below) | speckle) & !z.is_nan();
        }
        // Few are left to be looked at one by one.
        for u in flying.iter().enumerate().filter(|(_, flying)| **flying).map(|(u, _)| u) {
            if [here[u], here[u + 2], above[u + 1], below[u + 1]].iter().all(|z| z.is_nan()) {
                alone.push(v * width + u);
            } else {
                depth_m.pixels_mut()[v * width + u] = f32::NAN;
                removed += 1;
            }
        }
    }
    if alone.is_empty() {
        return Flying { removed, is_sparse: false };
    }
    let readings = before.iter().filter(|z| !z.is_nan()).count();
    if ONE_ALONE_OF * alone.len() < readings {
        removed += alone.len();
        alone.iter().for_each(|i| depth_m.pixels_mut()[*i] = f32::NAN);
    }
    Flying { removed, is_sparse: 2 * alone.len() > readings }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::{Solid, cast};
    use proptest::prelude::*;
    use repose_geometry::transform::look_at;
    use repose_geometry::{Pinhole, Point3, Vector3};

    const CAMERA: Pinhole = Pinhole { width: 160, height: 120, fx: 130.0, fy: 130.0, cx: 79.5, cy: 59.5 };

    fn table_with_box(height_m: f64) -> Image<f32> {
        let world_from_camera = look_at(&Point3::new(0.2, -0.8, height_m), &Point3::origin(), &Vector3::z());
        let solids = [Solid::table(0.0), Solid::cuboid([0.0, 0.0, 0.06], [0.1, 0.1, 0.06])];
        cast(&solids, &CAMERA, &world_from_camera).map(|s| s.map_or(f32::NAN, |(z, _)| z as f32))
    }

    fn settings() -> FlyingSettings {
        FlyingSettings::default()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(12))]
        #[test]
        fn clean_surfaces_keep_their_readings(height_m in 0.45..1.2f64) {
            let mut depth_m = table_with_box(height_m);
            let readings = depth_m.pixels().iter().filter(|z| !z.is_nan()).count();
            // A side of the box that is seen at a glance may be a single pixel wide: that cannot be told from a mixed one.
            prop_assert!(remove(&mut depth_m, 130.0, &settings()).removed * 200 <= readings);
        }

        #[test]
        fn mixed_readings_at_an_outline_are_taken_out(share in 0.4..0.6f32) {
            let mut depth_m = table_with_box(0.6);
            let clean = depth_m.clone();
            let mut mixed = Vec::new();
            for v in 1..119 {
                for u in 1..158 {
                    let (a, b) = (clean[(u, v)], clean[(u + 1, v)]);
                    // Every other row, so that a mixed pixel's neighbours above and below are whole.
                    if v % 2 == 0 && (a - b).abs() > 0.15 {
                        depth_m[(u, v)] = a + share * (b - a);
                        mixed.push((u, v));
                    }
                }
            }
            prop_assert!(mixed.len() > 5, "{}", mixed.len());
            remove(&mut depth_m, 130.0, &settings());
            prop_assert!(mixed.iter().all(|at| depth_m[*at].is_nan()));
        }
    }

    #[test]
    fn a_speckle_goes_and_a_hole_beside_a_surface_does_not_widen() {
        let mut depth_m = Image::filled(9, 9, 1.0f32);
        depth_m[(4, 4)] = 0.8;
        depth_m[(7, 4)] = f32::NAN;
        assert_eq!(remove(&mut depth_m, 500.0, &settings()), Flying { removed: 1, is_sparse: false });
        assert!(depth_m[(4, 4)].is_nan() && depth_m[(6, 4)] == 1.0 && depth_m[(7, 4)].is_nan());
    }

    #[test]
    fn the_outermost_pixels_of_a_picture_are_judged_too() {
        // Near on one side and far on the other, in all rows and then in all columns, and what the outline mixes between them.
        let side_m = |at: usize| match at {
            0..10 => 1.0,
            10 => 1.3,
            _ => 2.0,
        };
        let in_rows = Image::from_pixels(20, 3, (0..60).map(|i| side_m(i % 20)).collect()).unwrap();
        let in_columns = Image::from_pixels(3, 20, (0..60).map(|i| side_m(i / 3)).collect()).unwrap();
        for (mut depth_m, mixed) in [(in_rows, [(10, 0), (10, 1), (10, 2)]), (in_columns, [(0, 10), (1, 10), (2, 10)])] {
            assert_eq!(remove(&mut depth_m, 500.0, &settings()), Flying { removed: 3, is_sparse: false });
            assert!(mixed.iter().all(|at| depth_m[*at].is_nan()), "{depth_m:?}");
        }
        let mut corner = Image::filled(9, 9, 1.0f32);
        corner[(0, 0)] = 0.8;
        assert_eq!(remove(&mut corner, 500.0, &settings()).removed, 1);
    }

    #[test]
    fn depth_in_a_larger_picture_stays_and_a_lone_reading_in_a_hole_does_not() {
        let of_every_second = |at: usize| if at.is_multiple_of(2) { 1.0 } else { f32::NAN };
        let pixels = (0..40 * 30).map(|i| of_every_second(i % 40) + of_every_second(i / 40) - 1.0).collect();
        let mut sparse = Image::from_pixels(40, 30, pixels).unwrap();
        assert_eq!(remove(&mut sparse, 500.0, &settings()), Flying { removed: 0, is_sparse: true });
        assert_eq!(sparse.pixels().iter().filter(|z| !z.is_nan()).count(), 20 * 15);
        let mut hole = Image::filled(40, 30, 1.0f32);
        (8..13).for_each(|v| (8..13).for_each(|u| hole[(u, v)] = f32::NAN));
        hole[(10, 10)] = 1.0;
        assert_eq!(remove(&mut hole, 500.0, &settings()), Flying { removed: 1, is_sparse: false });
        assert!(hole[(10, 10)].is_nan());
    }
}
