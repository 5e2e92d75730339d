//! The Gaussian that candidates of later iterations are drawn from, refitted to the elites of one mode (Algorithm 1, line 17).
//!
//! Its covariance is the elites', shrunk towards its diagonal (few samples in four dimensions show spurious correlations), plus a floor
//! that keeps the search from collapsing on its first lucky draw. Yaws are averaged around the best elite's.

use nalgebra::{Matrix4, Point3, Vector4};
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use repose_geometry::transform::wrap_angle;
use repose_proto::place::Rotation;

use crate::scene::candidate::CandidatePose;
use crate::settings::SurrogateSettings;

/// A Gaussian over x, y, z (world frame, metres) and yaw (radians).
#[derive(Debug, Clone, PartialEq)]
pub struct Surrogate {
    mean: Vector4<f64>,
    /// Lower triangular factor of the covariance.
    factor: Matrix4<f64>,
    rotation: Rotation,
}

impl Surrogate {
    /// Fits the Gaussian to elites, the best first; none without any.
    pub fn fit(elites: &[CandidatePose], rotation: Rotation, settings: &SurrogateSettings) -> Option<Self> {
        let reference_rad = f64::from(elites.first()?.yaw_rad);
        let vector = |c: &CandidatePose| c.centroid().coords.push(reference_rad + wrap_angle(f64::from(c.yaw_rad) - reference_rad));
        let n = elites.len() as f64;
        let mean = elites.iter().map(vector).sum::<Vector4<f64>>() / n;
        let scatter: Matrix4<f64> = elites.iter().map(|c| vector(c) - mean).map(|d| d * d.transpose()).sum::<Matrix4<f64>>() / n;
        let diagonal = Matrix4::from_diagonal(&scatter.diagonal());
        let floor = Matrix4::from_diagonal(&Vector4::from(settings.floor).map(|s| s * s));
        let covariance = scatter * (1.0 - settings.shrinkage) + diagonal * settings.shrinkage + floor;
        let factor = covariance.cholesky().map_or_else(|| Matrix4::from_diagonal(&Vector4::from(settings.floor)), |c| c.l());
        Some(Self { mean, factor, rotation })
    }

    /// One draw.
    pub fn draw(&self, rng: &mut Pcg64) -> CandidatePose {
        let normal = Vector4::from_fn(|_, _| StandardNormal.sample(rng));
        let drawn = self.mean + self.factor * normal;
        let yaw_rad = if self.rotation == Rotation::Fixed { 0.0 } else { drawn.w };
        CandidatePose::new(&Point3::from(drawn.xyz()), yaw_rad)
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    #[test]
    fn draws_have_the_elites_mean_and_at_least_the_floors_spread() {
        let settings = SurrogateSettings::default();
        let elites =
            vec![CandidatePose { centroid_m: [0.1, 0.2, 0.3], yaw_rad: 3.1 }, CandidatePose { centroid_m: [0.1, 0.2, 0.3], yaw_rad: -3.1 }];
        let surrogate = Surrogate::fit(&elites, Rotation::Yaw, &settings).unwrap();
        let mut rng = Pcg64::seed_from_u64(7);
        let draws: Vec<CandidatePose> = (0..4000).map(|_| surrogate.draw(&mut rng)).collect();
        let mean_x = draws.iter().map(|c| f64::from(c.centroid_m[0])).sum::<f64>() / 4000.0;
        let spread_x = (draws.iter().map(|c| (f64::from(c.centroid_m[0]) - mean_x).powi(2)).sum::<f64>() / 4000.0).sqrt();
        assert!((mean_x - 0.1).abs() < 5e-4 && (spread_x - 0.005).abs() < 3e-4, "{mean_x} {spread_x}");
        assert!(draws.iter().all(|c| c.yaw_rad.abs() > 2.5), "yaws on both sides of ±π average to π, not to 0");
        let fixed = Surrogate::fit(&elites, Rotation::Fixed, &settings).unwrap();
        assert_eq!(fixed.draw(&mut rng).yaw_rad, 0.0);
        assert_eq!(Surrogate::fit(&[], Rotation::Fixed, &settings), None);
    }
}
