//! Readings that hang in the air between two surfaces, taken out.
//!
//! A depth camera mixes what its pixel sees at an outline: the reading comes to lie between the near and the far surface, where there is
//! nothing. Seen along a row or column, such a pixel is far from the pixels on both sides of it, nearer than the one and farther than the
//! other. How far two neighbouring pixels of one surface can be apart grows with its slope: steeper than `max_slope` is no surface.
//! What is far from all four neighbours is a speckle and goes as well. What has no neighbours is one too, unless there is much of it: depth
//! that was registered into a larger picture lies a pixel apart. Or it fills that picture with blocks of one reading each ([`repeats`]): then the
//! nearest other readings are the neighbours.

use repose_geometry::Image;

use crate::readings::repeats;
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
/// `depth_m` holds NaN where there is no reading and repeats each reading `repeat_px` wide ([`repeats`]), `focal_px` is the focal length of the same picture.
pub fn remove(depth_m: &mut Image<f32>, repeat_px: usize, focal_px: f32, settings: &FlyingSettings) -> Flying {
    let (width, height) = (depth_m.width(), depth_m.height());
    if width < 3 || height < 3 {
        return Flying::default();
    }
    // Judged on the readings as they came: a pixel taken out must not make its neighbour flying.
    let before = Before::of(depth_m, repeat_px);
    // From one block to the next there is as much surface as between two pixels of a picture of so many blocks.
    let step = StepLimit::new(settings, focal_px / repeat_px as f32);
    let mut removed = 0;
    let mut alone = Vec::new();
    let mut flying = vec![false; width];
    for v in 0..height {
        let (here, [left, right, above, below]) = before.row(v);
        // Slices of one length, so that the loop runs over many pixels at once.
        let sides = left.iter().zip(right).zip(above).zip(below);
        for ((flying, z), (((left, right), above), below)) in flying.iter_mut().zip(here).zip(sides) {
            let limit = step.at_m(*z);
            // Comparisons with a missing neighbour are false: it is no step to either side, and near nobody.
            let between = |a: f32, b: f32| ((z - a > limit) & (b - z > limit)) | ((a - z > limit) & (z - b > limit));
            let near = |a: f32| (a - z).abs() <= limit;
            let speckle = !(near(*left) | near(*right) | near(*above) | near(*below));
            *flying = (between(*left, *right) | between(*above, *below) | speckle) & !z.is_nan();
        }
        // Few are left to be looked at one by one.
        for u in flying.iter().enumerate().filter(|(_, flying)| **flying).map(|(u, _)| u) {
            if [left[u], right[u], above[u], below[u]].iter().all(|z| z.is_nan()) {
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
    let readings = before.readings();
    if ONE_ALONE_OF * alone.len() < readings {
        removed += alone.len();
        alone.iter().for_each(|i| depth_m.pixels_mut()[*i] = f32::NAN);
    }
    Flying { removed, is_sparse: 2 * alone.len() > readings }
}

/// A picture as it came, with what is beside its pixels.
enum Before {
    /// The next pixels are. Around the picture nothing was read: its outermost pixels are judged by the neighbours that they have.
    Own { framed: Vec<f32>, stride: usize },
    /// The nearest other readings are, to the left, right, above and below.
    Repeated { pixels: Vec<f32>, width: usize, others: [Vec<f32>; 4] },
}

impl Before {
    /// Of a picture that repeats each reading so wide.
    fn of(depth_m: &Image<f32>, repeat_px: usize) -> Self {
        let (width, height) = (depth_m.width(), depth_m.height());
        if repeat_px > 1 {
            return Self::Repeated { pixels: depth_m.pixels().to_vec(), width, others: repeats::others(depth_m, repeat_px) };
        }
        let stride = width + 2;
        let mut framed = vec![f32::NAN; stride * (height + 2)];
        for (v, pixels) in depth_m.pixels().chunks_exact(width).enumerate() {
            framed[(v + 1) * stride + 1..][..width].copy_from_slice(pixels);
        }
        Self::Own { framed, stride }
    }

    /// The pixels of a row, and what is to the left and right of each, above and below it.
    fn row(&self, v: usize) -> (&[f32], [&[f32]; 4]) {
        match self {
            Self::Own { framed, stride } => {
                let width = stride - 2;
                let row = |v: usize| &framed[v * stride..(v + 1) * stride];
                let (above, here, below) = (row(v), row(v + 1), row(v + 2));
                (&here[1..=width], [&here[..width], &here[2..], &above[1..=width], &below[1..=width]])
            }
            Self::Repeated { pixels, width, others } => {
                let row = v * width..(v + 1) * width;
                (&pixels[row.clone()], others.each_ref().map(|side| &side[row.clone()]))
            }
        }
    }

    fn readings(&self) -> usize {
        let (Self::Own { framed: pixels, .. } | Self::Repeated { pixels, .. }) = self;
        pixels.iter().filter(|z| !z.is_nan()).count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::readings::repeats::tests::{comb, registered};
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

    /// Of a picture that repeats its readings as wide as it tells by itself.
    fn remove(depth_m: &mut Image<f32>, focal_px: f32, settings: &FlyingSettings) -> Flying {
        super::remove(depth_m, repeats::repeat_px(depth_m), focal_px, settings)
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

        #[test]
        fn in_a_cameras_own_picture_each_pixel_is_judged_by_the_four_beside_it(
            seed in prop::collection::vec(0u16..60, 24 * 18), height_m in 0.45..1.2f64, is_box: bool,
        ) {
            // Steps of 5 mm from nothing to 30 cm, with holes, or a picture of surfaces.
            let of_steps = |k: &u16| if *k < 6 { f32::NAN } else { 0.7 + 0.005 * f32::from(*k) };
            let before = if is_box { table_with_box(height_m) } else { Image::from_pixels(24, 18, seed.iter().map(of_steps).collect()).unwrap() };
            let mut after = before.clone();
            remove(&mut after, 130.0, &settings());
            for (v, u) in (0..before.height()).flat_map(|v| (0..before.width()).map(move |u| (v, u))) {
                let at = |du: isize, dv: isize| {
                    let (u, v) = (u.checked_add_signed(du)?, v.checked_add_signed(dv)?);
                    before.get(u, v).copied().filter(|z| !z.is_nan())
                };
                let z = before[(u, v)];
                let limit = StepLimit::new(&settings(), 130.0).at_m(z);
                let beside = [at(-1, 0), at(1, 0), at(0, -1), at(0, 1)];
                let hangs = |a: Option<f32>, b: Option<f32>| {
                    a.zip(b).is_some_and(|(a, b)| (z - a > limit && b - z > limit) || (a - z > limit && z - b > limit))
                };
                // What has nobody beside it is judged with all others like it.
                let has_some = beside.iter().any(Option::is_some);
                let is_far = !beside.iter().flatten().any(|other| (other - z).abs() <= limit);
                let goes = hangs(beside[0], beside[1]) || hangs(beside[2], beside[3]) || is_far;
                let expected = if goes { f32::NAN } else { z };
                prop_assert!(z.is_nan() || !has_some || after[(u, v)].to_bits() == expected.to_bits(), "({u}, {v})");
            }
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
    fn mixed_readings_go_where_every_pixel_is_there_twice_in_both_directions() {
        let side_m = |at: usize| match at / 2 {
            0..10 => 1.0,
            10 => 1.3,
            _ => 2.0,
        };
        let in_rows = Image::from_pixels(40, 6, (0..240).map(|i| side_m(i % 40)).collect()).unwrap();
        let in_columns = Image::from_pixels(6, 40, (0..240).map(|i| side_m(i / 6)).collect()).unwrap();
        for mut depth_m in [in_rows, in_columns] {
            let before = depth_m.clone();
            assert_eq!(remove(&mut depth_m, 1000.0, &settings()), Flying { removed: 12, is_sparse: false });
            assert!(before.pixels().iter().zip(depth_m.pixels()).all(|(before, after)| after.is_nan() == (*before == 1.3)), "{depth_m:?}");
        }
    }

    #[test]
    fn of_depth_that_a_driver_registered_into_a_larger_picture_only_mixed_readings_go() {
        let own = comb();
        let is_mixed = |u: usize| u % 24 == 11 || u % 24 == 23;
        let all_mixed: Vec<f32> =
            (0..72).flat_map(|v| (0..95).map(move |u| (u, v))).filter(|(u, _)| is_mixed(*u)).map(|at| own[at]).collect();
        for scale in [1.9, 2.0, 2.15, 3.0] {
            let before = registered(&own, scale);
            let mut after = before.clone();
            remove(&mut after, 500.0 * scale as f32, &settings());
            for (before, after) in before.pixels().iter().zip(after.pixels()) {
                assert_eq!(after.is_nan(), all_mixed.contains(before), "{before} m, registered by {scale}");
            }
        }
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
