//! The learned prior's mixture as the planner uses it: its means as candidates, its density as a cost, its components as modes.
//!
//! A component is a diagonal Gaussian over the offset of the query's centroid from the main anchor's, in the viewer's axes, times a von
//! Mises over the yaw (paper, section 2.1, "Pose prior"; the yaw is ours).

use nalgebra::{Point3, Vector3};
use repose_geometry::ViewerFrame;
use repose_proto::place::Rotation;
use repose_proto::scoring::MixtureComponent;

use crate::scene::candidate::CandidatePose;

/// The mixture of a request.
#[derive(Debug, Clone)]
pub struct PriorMixture {
    components: Vec<MixtureComponent>,
    anchor: Point3<f64>,
    viewer: ViewerFrame,
    rotation: Rotation,
}

impl PriorMixture {
    /// The mixture around an anchor's observed centroid (world frame), in a viewer's axes.
    pub fn new(components: Vec<MixtureComponent>, anchor: Point3<f64>, viewer: ViewerFrame, rotation: Rotation) -> Self {
        Self { components, anchor, viewer, rotation }
    }

    /// The components' means as candidates, heaviest first.
    pub fn means(&self) -> Vec<CandidatePose> {
        let mut heaviest: Vec<&MixtureComponent> = self.components.iter().collect();
        heaviest.sort_by(|a, b| b.weight.total_cmp(&a.weight));
        let world_from_viewer = self.viewer.world_from_viewer();
        let yaw = |c: &MixtureComponent| if self.rotation == Rotation::Fixed { 0.0 } else { c.yaw_mean_rad };
        heaviest.into_iter().map(|c| CandidatePose::new(&(self.anchor + world_from_viewer * Vector3::from(c.mean_m)), yaw(c))).collect()
    }

    /// The logarithm of the density at a candidate, per cubic metre (and radian, where yaw is searched).
    pub fn log_density(&self, candidate: &CandidatePose) -> f64 {
        let offset = self.viewer.viewer_from_world() * (candidate.centroid() - self.anchor);
        let logs: Vec<f64> = self.components.iter().map(|c| self.log_component(c, &offset, f64::from(candidate.yaw_rad))).collect();
        let largest = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        if largest == f64::NEG_INFINITY {
            return largest;
        }
        largest + logs.iter().map(|l| (l - largest).exp()).sum::<f64>().ln()
    }

    /// For each component the mode it belongs to: components whose means are within `apart_m` are one.
    pub fn modes(&self, apart_m: f64) -> Vec<usize> {
        let mut modes: Vec<usize> = Vec::with_capacity(self.components.len());
        for (i, component) in self.components.iter().enumerate() {
            let close = |j: &usize| (Vector3::from(self.components[*j].mean_m) - Vector3::from(component.mean_m)).norm() <= apart_m;
            let mode = (0..i).find(close).map_or(i, |j| modes[j]);
            modes.push(mode);
        }
        modes
    }

    fn log_component(&self, c: &MixtureComponent, offset: &Vector3<f64>, yaw_rad: f64) -> f64 {
        let gaussian: f64 = (0..3)
            .map(|k| {
                let z = (offset[k] - c.mean_m[k]) / c.sigma_m[k];
                -0.5 * z * z - c.sigma_m[k].ln() - 0.5 * std::f64::consts::TAU.ln()
            })
            .sum();
        let yaw = match self.rotation {
            Rotation::Fixed => 0.0,
            Rotation::Yaw | Rotation::Stable => {
                c.yaw_concentration * (yaw_rad - c.yaw_mean_rad).cos() - std::f64::consts::TAU.ln() - log_bessel_0(c.yaw_concentration)
            }
        };
        c.weight.ln() + gaussian + yaw
    }
}

/// log I₀(κ): the power series below 30, the asymptotic one above.
fn log_bessel_0(kappa: f64) -> f64 {
    if kappa >= 30.0 {
        let t = 1.0 / (8.0 * kappa);
        return kappa - 0.5 * (std::f64::consts::TAU * kappa).ln() + (1.0 + t * (1.0 + t * (4.5 + t * 37.5))).ln();
    }
    let (quarter, mut term, mut sum, mut k) = (kappa * kappa / 4.0, 1.0, 1.0, 1.0);
    while term > 1e-16 * sum {
        term *= quarter / (k * k);
        sum += term;
        k += 1.0;
    }
    f64::ln(sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn component(weight: f64, mean_m: [f64; 3]) -> MixtureComponent {
        MixtureComponent { weight, mean_m, sigma_m: [0.02, 0.03, 0.01], yaw_mean_rad: 0.4, yaw_concentration: 3.0 }
    }

    #[test]
    fn the_density_integrates_to_one() {
        let components = vec![component(0.7, [0.0; 3]), component(0.3, [0.05, -0.02, 0.0])];
        for (rotation, yaw_steps) in [(Rotation::Fixed, 1), (Rotation::Yaw, 24)] {
            let mixture = PriorMixture::new(components.clone(), Point3::new(0.1, 0.2, 0.3), ViewerFrame::from_yaw(0.8), rotation);
            let (step, mut total) = (0.01, 0.0);
            let yaw_step = std::f64::consts::TAU / f64::from(yaw_steps);
            for (i, j, k) in (-20..=20).flat_map(|i| (-20..=20).flat_map(move |j| (-6..=6).map(move |k| (i, j, k)))) {
                for yaw in 0..yaw_steps {
                    let at = Point3::new(0.1 + step * f64::from(i), 0.2 + step * f64::from(j), 0.3 + step * f64::from(k));
                    total += mixture.log_density(&CandidatePose::new(&at, yaw_step * f64::from(yaw))).exp();
                }
            }
            let cell = step * step * step * if rotation == Rotation::Yaw { yaw_step } else { 1.0 };
            assert!((total * cell - 1.0).abs() < 0.02, "{}", total * cell);
        }
    }

    #[test]
    fn means_turn_with_the_viewer_both_ways_and_come_heaviest_first() {
        let components = vec![component(0.2, [0.0; 3]), component(0.8, [0.1, 0.0, 0.0])];
        for (yaw, expected) in [(0.5f64, [0.1 * 0.5f64.cos(), 0.1 * 0.5f64.sin()]), (-0.5, [0.1 * 0.5f64.cos(), -0.1 * 0.5f64.sin()])] {
            let mixture = PriorMixture::new(components.clone(), Point3::origin(), ViewerFrame::from_yaw(yaw), Rotation::Fixed);
            let first = mixture.means()[0];
            assert!((f64::from(first.centroid_m[0]) - expected[0]).abs() < 1e-6);
            assert!((f64::from(first.centroid_m[1]) - expected[1]).abs() < 1e-6);
            assert_eq!(first.yaw_rad, 0.0);
        }
        let mixture = PriorMixture::new(components, Point3::origin(), ViewerFrame::from_yaw(0.0), Rotation::Yaw);
        assert_eq!(mixture.modes(0.03), [0, 1]);
        assert_eq!(mixture.modes(0.2), [0, 0]);
    }
}
