//! A cloud prepared for measuring: once per object and turn, for any number of places and partners.

use std::sync::OnceLock;

use nalgebra::{Point3, Vector2, Vector3};
use repose_relations::ViewerExtents;

use super::middles::{Guess, Middles, without_strays};
use super::slices::{Band, bands};
use crate::points::{ObjectCloud, Rim};

/// Directions tried for the plane between two clouds before the best is refined: azimuths, and their elevations.
const AZIMUTHS: usize = 16;
const ELEVATIONS: [f32; 3] = [0.0, std::f32::consts::FRAC_PI_4, -std::f32::consts::FRAC_PI_4];
pub(super) const DIRECTIONS: usize = AZIMUTHS * ELEVATIONS.len() + 2;
/// The share of points that a box leaves out at either end of each axis, as in the rules on observed clouds.
const STRAY_SHARE: f32 = 0.01;

/// Which outline of an object is measured.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum OutlineSource {
    /// The cloud's.
    Observed,
    /// With what cleaning took put back on ([`Rim`]).
    Restored,
    /// That, and its half turn about a guess at the object's middle: what of it is hidden looks like what shows.
    Completed(Guess),
}

/// A cloud prepared for measuring.
#[derive(Debug, Clone)]
pub struct MeasuredCloud {
    /// Coordinates relative to the centroid, by axis.
    pub(super) axes: [Vec<f32>; 3],
    /// The box without strays, relative to the centroid.
    pub(super) low: [f32; 3],
    pub(super) high: [f32; 3],
    /// What cleaning took.
    pub(super) rim: Rim,
    /// Guesses at the object's middle.
    pub(super) middles: Middles,
    /// Its level slices.
    pub(super) bands: Vec<Band>,
    /// How far the cloud reaches in each of [`directions`], from its centroid, and how much farther the object does.
    reaches: [f32; DIRECTIONS],
    beyond: [f32; DIRECTIONS],
    /// How far it does when completed by each of [`Guess::ALL`].
    completed: [[f32; DIRECTIONS]; Guess::ALL.len()],
}

impl MeasuredCloud {
    /// Prepares a cloud (already turned).
    pub fn new(object: &ObjectCloud) -> Self {
        let axes: [Vec<f32>; 3] = std::array::from_fn(|k| object.points.iter().map(|p| p[k]).collect());
        let [x, y, z] = axes.each_ref().map(|axis| without_strays(axis.clone(), STRAY_SHARE));
        let mut cloud = Self {
            middles: Middles::new(&axes),
            bands: bands(&axes, z[0], z[1]),
            axes,
            low: [x[0], y[0], z[0]],
            high: [x[1], y[1], z[1]],
            rim: object.rim,
            reaches: [0.0; DIRECTIONS],
            beyond: [0.0; DIRECTIONS],
            completed: [[0.0; DIRECTIONS]; Guess::ALL.len()],
        };
        cloud.reaches = std::array::from_fn(|d| cloud.reach(&directions()[d].0, OutlineSource::Observed));
        cloud.beyond = std::array::from_fn(|d| cloud.rim.beyond_m(directions()[d].0.into()));
        cloud.completed = Guess::ALL.map(|guess| {
            std::array::from_fn(|d| {
                let restored = |d: usize| cloud.known_reach(d, OutlineSource::Restored);
                restored(d).max(cloud.turned_reach(&directions()[d].0.xy(), restored(half_turned(d)), guess))
            })
        });
        cloud
    }

    /// One point, seen from a metre away: the least there is to measure.
    pub(super) fn of_one_point() -> Self {
        let rim = Rim { width_m: 0.0, line_of_sight: [0.0, 1.0, 0.0] };
        Self::new(&ObjectCloud { centroid_in_viewer: Point3::origin(), points: vec![[0.0; 3]], rim })
    }

    /// How far the outline reaches in a direction, from the centroid.
    pub(super) fn reach(&self, direction: &Vector3<f32>, outline: OutlineSource) -> f32 {
        // Sixteen lanes keep the loop free of a single chain of comparisons.
        const LANES: usize = 16;
        let [x, y, z] = &self.axes;
        let mut best = [f32::NEG_INFINITY; LANES];
        let along = |i: usize| x[i] * direction.x + y[i] * direction.y + z[i] * direction.z;
        let whole = x.len() / LANES * LANES;
        for i in (0..whole).step_by(LANES) {
            for (l, best) in best.iter_mut().enumerate() {
                *best = best.max(along(i + l));
            }
        }
        let observed = (whole..x.len()).map(along).chain(best).fold(f32::NEG_INFINITY, f32::max);
        match outline {
            OutlineSource::Observed => observed,
            OutlineSource::Restored => observed + self.rim.beyond_m((*direction).into()),
            OutlineSource::Completed(guess) => {
                let turned = Vector3::new(-direction.x, -direction.y, direction.z);
                let restored = observed + self.rim.beyond_m((*direction).into());
                restored.max(self.turned_reach(&direction.xy(), self.reach(&turned, OutlineSource::Restored), guess))
            }
        }
    }

    /// How far the half turn of an outline about a guess at the middle reaches in a direction, of which the level part is given, if the
    /// outline reaches `reach_m` in the direction's own half turn.
    pub(super) fn turned_reach(&self, direction: &Vector2<f32>, reach_m: f32, guess: Guess) -> f32 {
        let [x, y] = self.middles.by(guess);
        2.0 * (x * direction.x + y * direction.y) + reach_m
    }

    /// The same in the `d`-th of [`directions`].
    pub(super) fn known_reach(&self, d: usize, outline: OutlineSource) -> f32 {
        match outline {
            OutlineSource::Observed => self.reaches[d],
            OutlineSource::Restored => self.reaches[d] + self.beyond[d],
            OutlineSource::Completed(guess) => self.completed[guess as usize][d],
        }
    }

    /// The box with the centroid at `at`.
    pub(super) fn extents(&self, at: [f32; 3]) -> ViewerExtents {
        let point = |corner: &[f32; 3]| Point3::from(std::array::from_fn::<f64, 3, _>(|k| f64::from(corner[k] + at[k])));
        let (low, high) = (point(&self.low), point(&self.high));
        ViewerExtents { low, high, center: nalgebra::center(&low, &high) }
    }

    /// How much farther the object reaches than its box along an axis.
    pub(super) fn beyond_along(&self, axis: usize) -> f32 {
        self.rim.beyond_m(std::array::from_fn(|k| if k == axis { 1.0 } else { 0.0 }))
    }
}

/// The directions tried first, each with the index of its opposite.
pub(super) fn directions() -> &'static [(Vector3<f32>, usize); DIRECTIONS] {
    static ALL: OnceLock<[(Vector3<f32>, usize); DIRECTIONS]> = OnceLock::new();
    ALL.get_or_init(|| {
        let direction = |d: usize| match d.checked_sub(AZIMUTHS * ELEVATIONS.len()) {
            Some(up) => Vector3::z() * (1.0 - 2.0 * up as f32),
            None => {
                let (sin, cos) = (std::f32::consts::TAU * (d % AZIMUTHS) as f32 / AZIMUTHS as f32).sin_cos();
                let (rise, level) = ELEVATIONS[d / AZIMUTHS].sin_cos();
                Vector3::new(level * cos, level * sin, rise)
            }
        };
        let all: [Vector3<f32>; DIRECTIONS] = std::array::from_fn(direction);
        std::array::from_fn(|d| {
            let opposite = (0..DIRECTIONS).min_by(|a, b| all[*a].dot(&all[d]).total_cmp(&all[*b].dot(&all[d])));
            (all[d], opposite.unwrap_or(d))
        })
    })
}

/// The `d`-th direction after half a turn about the vertical.
fn half_turned(d: usize) -> usize {
    if d < AZIMUTHS * ELEVATIONS.len() { d - d % AZIMUTHS + (d + AZIMUTHS / 2) % AZIMUTHS } else { d }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_direction_knows_its_opposite_and_its_half_turn() {
        for (d, (direction, opposite)) in directions().iter().enumerate() {
            assert!((directions()[*opposite].0 + direction).norm() < 1e-5);
            let turned = directions()[half_turned(d)].0;
            assert!((turned - Vector3::new(-direction.x, -direction.y, direction.z)).norm() < 1e-5);
        }
    }
}
