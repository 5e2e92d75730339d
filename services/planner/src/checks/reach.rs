//! Whether a robot's hand can get to where it would let go of the object: a cheap test, necessary but not sufficient.
//!
//! The hand holds the object somewhere at its upper half, from above or leaning outwards, and comes down to the place from a standoff above it. Where
//! no posture within the joint limits has it at both, no motion leads there. Grasps, obstacles, the arm's
//! own body and the pick are motion's to judge.

use nalgebra::{Isometry3, Point3, Rotation3, Unit, Vector3};
use repose_panda::{InverseSettings, inverse_sweep};

use crate::checks::MISS_PER_METRE;
use crate::scene::candidate::CandidatePose;
use crate::scene::query::QueryObject;
use crate::settings::ReachSettings;

/// Height of the shoulder over the base, metres.
const SHOULDER_M: f64 = 0.333;

/// The reach of one robot.
#[derive(Debug, Clone)]
pub struct Reach<'a> {
    base_from_world: Isometry3<f64>,
    settings: &'a ReachSettings,
    inverse: InverseSettings,
}

impl<'a> Reach<'a> {
    /// Of a robot by the pose of its base.
    pub fn new(world_from_base: &Isometry3<f64>, settings: &'a ReachSettings) -> Self {
        let inverse = InverseSettings { sweep: settings.sweep, ..InverseSettings::default() };
        Self { base_from_world: world_from_base.inverse(), settings, inverse }
    }

    /// By how much the pose in which the object is let go is out of reach; none when it is not.
    pub fn miss(&self, query: &QueryObject, let_go: &CandidatePose) -> Option<f64> {
        let held = self.base_from_world * held_at(query, let_go);
        let far_m = (held - Point3::new(0.0, 0.0, SHOULDER_M)).norm() - self.settings.max_m;
        if far_m > 0.0 {
            return Some((far_m + self.settings.max_m) * MISS_PER_METRE);
        }
        let raised = held + self.base_from_world * Vector3::z() * self.settings.standoff_m;
        let reachable = self.attitudes(&held).any(|hand| [raised, held].iter().all(|place| self.is_reached(place, &hand)));
        // Nearer to the middle of the reach is less amiss.
        (!reachable).then(|| (held.coords.xy().norm() - self.settings.middle_m).abs().max(0.01) * MISS_PER_METRE)
    }

    fn is_reached(&self, place: &Point3<f64>, hand: &Rotation3<f64>) -> bool {
        let base_from_tcp = Isometry3::from_parts((*place).into(), (*hand).into());
        !inverse_sweep(&base_from_tcp, &self.inverse).is_empty()
    }

    /// The hand straight down and leaning away from the base, closing in several directions.
    fn attitudes(&self, held: &Point3<f64>) -> impl Iterator<Item = Rotation3<f64>> + use<> {
        let up = self.base_from_world * Vector3::z();
        let outwards = held.coords - up * held.coords.dot(&up);
        let side = Unit::try_new(up.cross(&outwards), 1e-6).unwrap_or_else(Vector3::x_axis);
        // The hand's z points where it reaches.
        let down = Rotation3::rotation_between(&Vector3::z(), &-up)
            .unwrap_or_else(|| Rotation3::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI));
        let (leans, turns) = (self.settings.leans, self.settings.turns);
        let step_rad = self.settings.lean_step_rad;
        (0..leans).flat_map(move |lean| {
            let leaning = Rotation3::from_axis_angle(&side, -step_rad * lean as f64) * down;
            (0..turns).map(move |turn| {
                leaning * Rotation3::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI * turn as f64 / turns as f64)
            })
        })
    }
}

/// Where the hand holds the object as it lets go of it: over its axis, at three quarters of its height.
fn held_at(query: &QueryObject, let_go: &CandidatePose) -> Point3<f64> {
    let axis = let_go.carry(&query.shape.axis_offset());
    let height_m = query.bottom_of(let_go.centroid_m[2]) + 0.75 * (query.shape.top_m - query.shape.bottom_m);
    Point3::new(axis.x, axis.y, height_m).cast()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Fixed;
    use crate::tests::synthetic::{Prepared, SceneBuilder, standing_at};

    #[test]
    fn places_before_the_arm_are_in_reach_and_far_or_low_ones_are_not() {
        let prepared = SceneBuilder::table().object(1, [0.0, 0.1], [0.1, 0.1, 0.12]).object(2, [-0.3, -0.2], [0.06, 0.06, 0.08]).prepared();
        let fixed = Fixed::default();
        let query = QueryObject::new(&prepared, 2, 0.0, &fixed).unwrap();
        // The base stands at (−0.6, 0, 0) and looks along +x.
        let reach = Reach::new(&Isometry3::translation(-0.6, 0.0, 0.0), &fixed.reach);
        let miss = |x: f32, y: f32, z: f32| reach.miss(&query, &standing_at(&query, x, y, z));
        for [x, y] in [[-0.1, 0.0], [0.0, 0.3], [0.05, -0.2]] {
            assert_eq!(miss(x, y, 0.004), None, "{x} {y}");
        }
        for [x, y, z] in [[0.6, 0.0, 0.0], [0.45, 0.4, 0.0], [-0.1, 0.0, -0.9]] {
            assert!(miss(x, y, z).is_some(), "{x} {y} {z}");
        }
        assert!(miss(1.6, 0.0, 0.0) > miss(0.9, 0.0, 0.0), "farther is worse");
        // Turned by half a turn, the same base reaches the same places.
        let turned = Reach::new(&Isometry3::new(Vector3::new(-0.6, 0.0, 0.0), Vector3::z() * std::f64::consts::PI), &fixed.reach);
        assert_eq!(turned.miss(&query, &standing_at(&query, -0.1, 0.0, 0.004)), None);
    }
}
