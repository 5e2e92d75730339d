//! How far apart two objects are, or how deep they are in each other, by their convex parts.

use nalgebra::{Isometry3, Point3};
use parry3d::query;
use parry3d::shape::SharedShape;
use rapier3d::math::Pose;
use repose_geometry::Aabb;

use crate::convert;

/// Beyond this, distances between objects are not told apart: twice what `near` asks.
pub const FAR_M: f32 = 0.1;

/// A convex part in the world, with the box around it.
type Part = (Pose, SharedShape, Aabb);

/// An object's parts in the world, with their boxes.
#[derive(Debug, Clone)]
pub struct PlacedParts {
    parts: Vec<Part>,
    bounds: Aabb,
}

impl PlacedParts {
    /// The parts (pose in the object's frame, and shape) of an object at `world_from_object`; `None` without parts.
    pub fn new(parts: &[(Pose, SharedShape)], world_from_object: &Isometry3<f64>) -> Option<Self> {
        let world_from_object = convert::pose(world_from_object);
        let parts: Vec<Part> = parts
            .iter()
            .map(|(object_from_part, shape)| {
                let world_from_part = world_from_object * *object_from_part;
                let aabb = shape.compute_aabb(&world_from_part);
                let corner = |v: rapier3d::math::Vector| Point3::new(v.x, v.y, v.z);
                (world_from_part, shape.clone(), Aabb { min: corner(aabb.mins), max: corner(aabb.maxs) })
            })
            .collect();
        let bounds = parts.iter().map(|p| p.2).reduce(|a, b| Aabb { min: a.min.inf(&b.min), max: a.max.sup(&b.max) })?;
        Some(Self { parts, bounds })
    }

    /// The box around everything, in the world.
    pub fn bounds(&self) -> &Aabb {
        &self.bounds
    }

    /// Whether a place in the world is inside.
    pub fn contains(&self, place: &Point3<f32>) -> bool {
        let at = convert::vector(place);
        self.parts.iter().any(|(pose, shape, bounds)| bounds.contains(place) && shape.contains_point(pose, at))
    }

    /// The smallest distance to another object, metres: 0 when they overlap, at most [`FAR_M`].
    pub fn distance_m(&self, other: &Self) -> f32 {
        let mut best = FAR_M;
        self.visit_pairs(other, FAR_M, |a, b, boxes_m| {
            if boxes_m < best
                && let Ok(found) = query::distance(&a.0, a.1.as_ref(), &b.0, b.1.as_ref())
            {
                best = best.min(found.distance);
            }
            best
        });
        best
    }

    /// Whether another object is at most `margin_m` away; cheaper than the distance.
    pub fn is_within(&self, other: &Self, margin_m: f32) -> bool {
        let mut within = false;
        self.visit_pairs(other, margin_m, |a, b, _| {
            within = within || query::distance(&a.0, a.1.as_ref(), &b.0, b.1.as_ref()).is_ok_and(|found| found.distance <= margin_m);
            if within { f32::NEG_INFINITY } else { margin_m }
        });
        within
    }

    /// How deep the two are in each other, metres: 0 when they do not overlap.
    pub fn penetration_m(&self, other: &Self) -> f32 {
        let mut deepest = 0.0f32;
        self.visit_pairs(other, 0.0, |a, b, boxes_m| {
            if boxes_m <= 0.0
                && let Ok(Some(contact)) = query::contact(&a.0, a.1.as_ref(), &b.0, b.1.as_ref(), 0.0)
            {
                deepest = deepest.max(-contact.dist);
            }
            0.0
        });
        deepest
    }

    /// Visits pairs of parts whose boxes are within what the last visit returned of each other; the first, within `limit_m`.
    fn visit_pairs(&self, other: &Self, limit_m: f32, mut visit: impl FnMut(&Part, &Part, f32) -> f32) {
        let mut limit_m = limit_m;
        if self.bounds.distance(&other.bounds) > limit_m {
            return;
        }
        for a in &self.parts {
            if a.2.distance(&other.bounds) > limit_m {
                continue;
            }
            for b in &other.parts {
                let boxes_m = a.2.distance(&b.2);
                if boxes_m <= limit_m {
                    limit_m = visit(a, b, boxes_m);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Isometry3;
    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    use super::*;
    use crate::objects::Family;

    #[test]
    fn boxes_side_by_side_have_their_gap_and_overlapping_ones_their_depth() {
        let parts = [(Pose::IDENTITY, SharedShape::cuboid(0.05, 0.05, 0.05))];
        let at = |x: f64| PlacedParts::new(&parts, &Isometry3::translation(x, 0.0, 0.0)).expect("one part");
        assert!((at(0.0).distance_m(&at(0.103)) - 0.003).abs() < 1e-5);
        assert_eq!(at(0.0).distance_m(&at(0.7)), FAR_M);
        assert!((at(0.0).penetration_m(&at(0.098)) - 0.002).abs() < 1e-4);
        assert_eq!(at(0.0).penetration_m(&at(0.103)), 0.0);
        assert!(at(0.0).is_within(&at(0.103), 0.004) && !at(0.0).is_within(&at(0.103), 0.002));
    }

    #[test]
    fn what_stands_inside_a_bowl_does_not_touch_its_wall() {
        let mut rng = Pcg64::seed_from_u64(1);
        let pot = Family::Pot.sample(1.0, &mut rng);
        let ball = [(Pose::IDENTITY, SharedShape::ball(0.005))];
        let inside = PlacedParts::new(&ball, &Isometry3::identity()).expect("one part");
        let around = PlacedParts::new(&pot.parts, &Isometry3::identity()).expect("parts");
        assert!(around.distance_m(&inside) > 0.01);
    }
}
