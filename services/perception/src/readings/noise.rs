//! How far a reading may lie from the surface that it shows.
//!
//! Cameras that measure disparity err along the line of sight, by an amount that grows with the square of the depth. What that does to a
//! height above a level surface depends on how steeply the camera looks down at it: at a glance an error slides along the surface.

/// The standard deviation of a disparity camera's readings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthNoise {
    /// At a depth of one metre, metres; it grows with the square of the depth.
    pub per_m2: f32,
}

impl DepthNoise {
    /// The noise of a reading's height above a level surface, one standard deviation, metres.
    ///
    /// `drop_m` is how far the camera is above the reading, `depth_m` the reading's depth along the optical axis: their ratio is how far
    /// the height moves per metre of depth.
    pub fn height_m(&self, depth_m: f32, drop_m: f32) -> f32 {
        self.per_m2 * depth_m * drop_m.abs()
    }

    /// The noise that explains deviations of heights from a level surface: their median absolute value over that of a normal
    /// distribution, each beside what it would be with a noise of one (`DepthNoise { per_m2: 1.0 }.height_m`). `None` without any.
    pub fn explaining(mut shares: Vec<f32>) -> Option<Self> {
        /// The median of |x| of a standard normal distribution.
        const MEDIAN_ABSOLUTE: f32 = 0.674_5;
        let middle = shares.len() / 2;
        if shares.is_empty() {
            return None;
        }
        shares.iter_mut().for_each(|share| *share = share.abs());
        let median = *shares.select_nth_unstable_by(middle, f32::total_cmp).1;
        Some(Self { per_m2: median / MEDIAN_ABSOLUTE })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rand::{RngExt, SeedableRng};

    proptest! {
        #[test]
        fn the_noise_that_readings_were_given_is_found_in_them(per_m2 in 0.0005..0.005f32, seed: u64) {
            let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
            // The sum of twelve uniform numbers is near enough to a normal one.
            let mut normal = || (0..12).map(|_| rng.random_range(-0.5..0.5f32)).sum::<f32>();
            let shares = (0..4000).map(|_| per_m2 * normal()).collect();
            let found = DepthNoise::explaining(shares).unwrap().per_m2;
            prop_assert!((found / per_m2 - 1.0).abs() < 0.1, "{found} for {per_m2}");
        }
    }

    #[test]
    fn a_glance_moves_heights_less_than_a_look_from_above() {
        let noise = DepthNoise { per_m2: 0.002 };
        assert!((noise.height_m(1.0, 1.0) - 0.002).abs() < 1e-9 && (noise.height_m(1.0, 0.3) - 0.0006).abs() < 1e-9);
        assert_eq!(DepthNoise::explaining(Vec::new()), None);
    }
}
