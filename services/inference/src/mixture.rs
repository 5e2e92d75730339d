//! Draws from the prior's mixture, and its density.
//!
//! The mixture lives in the viewer's axes, as an offset δ from the anchor's centroid to the query's; candidates live in the world.

use std::f64::consts::{PI, TAU};

use nalgebra::{Point3, Vector3};
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;
use repose_geometry::ViewerFrame;
use repose_geometry::transform::wrap_angle;
use repose_proto::place::Rotation;
use repose_proto::scoring::MixtureComponent;

/// Draws `count` candidates: world position of the query's centroid and yaw, one row each, and the component that each came from.
///
/// Every candidate takes the same number of draws whatever its component, so that a longer list starts with the shorter one.
pub fn draw(
    mixture: &[MixtureComponent],
    anchor_in_world: &Point3<f64>,
    viewer: &ViewerFrame,
    rotation: Rotation,
    count: usize,
    rng: &mut Pcg64,
) -> (Vec<[f32; 4]>, Vec<u8>) {
    let world_from_viewer = viewer.world_from_viewer();
    let total: f64 = mixture.iter().map(|c| c.weight).sum();
    let mut candidates = Vec::with_capacity(count);
    let mut components = Vec::with_capacity(count);
    let turns: Vec<Turns> = match rotation {
        Rotation::Fixed => Vec::new(),
        Rotation::Yaw | Rotation::Stable => mixture.iter().map(Turns::of).collect(),
    };
    for _ in 0..count {
        let mut left = rng.random_range(0.0..1.0) * total;
        let index = mixture.iter().position(|c| {
            left -= c.weight;
            left < 0.0
        });
        let index = index.unwrap_or(mixture.len().saturating_sub(1));
        let normals: [f64; 3] = std::array::from_fn(|_| StandardNormal.sample(rng));
        let turn = [(); 2].map(|()| rng.random_range(0.0..1.0));
        let Some(component) = mixture.get(index) else { break };
        let offset_in_viewer = Vector3::from_fn(|k, _| component.mean_m[k] + component.sigma_m[k] * normals[k]);
        let position = anchor_in_world + world_from_viewer * offset_in_viewer;
        let yaw_rad = turns.get(index).map_or(0.0, |turns| turns.at(turn));
        candidates.push([position.x as f32, position.y as f32, position.z as f32, yaw_rad as f32]);
        components.push(index as u8);
    }
    (candidates, components)
}

/// The von Mises angles of a component, by inverting their distribution function on a fixed grid.
///
/// Rejection samplers take a varying number of draws, which would make one candidate's yaw depend on its neighbours'.
struct Turns {
    mean_rad: f64,
    /// Of every cell of the grid, not normalised.
    densities: [f64; Self::CELLS],
    total: f64,
}

impl Turns {
    const CELLS: usize = 360;

    fn of(component: &MixtureComponent) -> Self {
        let density = |cell: usize| {
            let angle = -PI + (cell as f64 + 0.5) * TAU / Self::CELLS as f64;
            (component.yaw_concentration * (angle.cos() - 1.0)).exp()
        };
        let densities = std::array::from_fn(density);
        Self { mean_rad: component.yaw_mean_rad, total: densities.iter().sum(), densities }
    }

    /// The angle of two uniform numbers: the first chooses the cell, the second the place in it.
    fn at(&self, uniform: [f64; 2]) -> f64 {
        let mut left = uniform[0] * self.total;
        let cell = self.densities.iter().position(|density| {
            left -= density;
            left < 0.0
        });
        let cell = cell.unwrap_or(Self::CELLS - 1);
        wrap_angle(self.mean_rad - PI + (cell as f64 + uniform[1]) * TAU / Self::CELLS as f64)
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    fn component(weight: f64, mean_m: [f64; 3], yaw_mean_rad: f64) -> MixtureComponent {
        MixtureComponent { weight, mean_m, sigma_m: [0.01; 3], yaw_mean_rad, yaw_concentration: 50.0 }
    }

    #[test]
    fn offsets_turn_with_the_viewer_in_both_senses() {
        let right = [component(1.0, [0.2, 0.0, 0.0], 0.0)];
        for (yaw, expected) in [(PI / 2.0, [0.0, 0.2]), (-PI / 2.0, [0.0, -0.2]), (PI, [-0.2, 0.0]), (0.0, [0.2, 0.0])] {
            let viewer = ViewerFrame::from_yaw(yaw);
            let (candidates, _) = draw(&right, &Point3::new(1.0, 2.0, 0.5), &viewer, Rotation::Fixed, 500, &mut Pcg64::seed_from_u64(1));
            let mean = |k: usize| candidates.iter().map(|c| f64::from(c[k])).sum::<f64>() / 500.0;
            assert!((mean(0) - 1.0 - expected[0]).abs() < 0.003 && (mean(1) - 2.0 - expected[1]).abs() < 0.003, "viewer at {yaw}");
            assert!(candidates.iter().all(|c| c[3] == 0.0));
        }
    }

    #[test]
    fn components_are_drawn_by_their_weights_and_a_prefix_is_a_prefix() {
        let two = [component(0.25, [0.0; 3], 1.0), component(0.75, [1.0, 0.0, 0.0], -1.0)];
        let viewer = ViewerFrame::from_yaw(0.0);
        let draws = |n| draw(&two, &Point3::origin(), &viewer, Rotation::Yaw, n, &mut Pcg64::seed_from_u64(9));
        let (candidates, components) = draws(2000);
        let second = components.iter().filter(|c| **c == 1).count();
        assert!((1400..1600).contains(&second), "{second}");
        for (candidate, component) in candidates.iter().zip(&components) {
            let mean = if *component == 0 { 1.0 } else { -1.0 };
            assert!((f64::from(candidate[3]) - mean).abs() < 0.8);
        }
        assert_eq!(draws(10).0, candidates[..10]);
    }
}
