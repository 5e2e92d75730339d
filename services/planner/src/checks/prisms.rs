//! Distances from a placed query to points and to other shapes, all of them stacks of upright prisms.

use nalgebra::{Point2, Point3, Vector3};
use repose_geometry::Aabb;

use crate::scene::candidate::CandidatePose;
use repose_belief::outlines::{outline_gap_m, to_outline_m};
use repose_belief::shape::Shape;

/// The query's prisms where a candidate puts them, world frame.
#[derive(Debug, Clone)]
pub struct PlacedPrisms {
    prisms: Vec<PlacedPrism>,
}

#[derive(Debug, Clone)]
struct PlacedPrism {
    low_m: f64,
    high_m: f64,
    /// Counter-clockwise, seen from above.
    corners: Vec<Point2<f32>>,
}

impl PlacedPrisms {
    /// The query's completed shape, moved.
    pub fn new(shape: &Shape, candidate: &CandidatePose) -> Self {
        let observed = shape.centroid.xy().cast::<f32>();
        let rise_m = f64::from(candidate.centroid_m[2] - shape.centroid_height_m() - shape.bottom_m);
        let placed = shape.slabs.iter().map(|slab| PlacedPrism {
            low_m: f64::from(slab.low_m) + rise_m,
            high_m: f64::from(slab.high_m) + rise_m,
            corners: slab.outline.corners().iter().map(|c| candidate.carry(&(c - observed))).collect(),
        });
        Self { prisms: placed.collect() }
    }

    /// The box around them.
    pub fn bounds(&self) -> Option<Aabb> {
        let corner = |p: &PlacedPrism, c: &Point2<f32>| [p.low_m, p.high_m].map(|z| Point3::new(c.x, c.y, z as f32));
        let corners: Vec<Point3<f32>> = self.prisms.iter().flat_map(|p| p.corners.iter().flat_map(move |c| corner(p, c))).collect();
        Aabb::of(&corners)
    }

    /// Distance to a point, metres; 0 inside.
    pub fn to_point_m(&self, point: &Point3<f32>) -> f32 {
        let to = |p: &PlacedPrism| {
            let vertical_m = (p.low_m as f32 - point.z).max(point.z - p.high_m as f32).max(0.0);
            vertical_m.hypot(to_outline_m(&point.xy(), &p.corners))
        };
        self.prisms.iter().map(to).fold(f32::INFINITY, f32::min)
    }

    /// Distance to a shape, metres; 0 when they overlap. Heights of a bottom and a top within `contact_m` count as the same.
    pub fn to_shape_m(&self, shape: &Shape, contact_m: f64) -> f64 {
        let mut best = f64::INFINITY;
        for placed in &self.prisms {
            for other in &shape.slabs {
                let vertical_m = (placed.low_m - f64::from(other.high_m)).max(f64::from(other.low_m) - placed.high_m).max(0.0);
                let vertical_m = if vertical_m <= contact_m { 0.0 } else { vertical_m };
                if vertical_m >= best {
                    continue;
                }
                best = best.min(vertical_m.hypot(f64::from(outline_gap_m(&placed.corners, other.outline.corners()))));
            }
        }
        best
    }
}

/// Distance from a box to a point, squared, square metres; 0 inside.
pub fn box_gap_m2(bounds: &Aabb, point: &Point3<f32>) -> f32 {
    (bounds.min - point).sup(&(point - bounds.max)).sup(&Vector3::zeros()).norm_squared()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::query::QueryObject;
    use crate::settings::Fixed;
    use crate::tests::synthetic::{Prepared, SceneBuilder, standing_at};

    #[test]
    fn distances_to_points_are_straight_also_past_corners_and_0_inside() {
        let prepared = SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.1]).object(2, [-0.3, -0.2], [0.06, 0.06, 0.08]).prepared();
        let query = QueryObject::new(&prepared, 2, 0.0, &Fixed::default()).unwrap();
        let placed = PlacedPrisms::new(&query.shape, &standing_at(&query, 0.0, 0.0, 0.0));
        let bounds = placed.bounds().unwrap();
        let (high, middle) = (bounds.max, nalgebra::center(&bounds.min, &bounds.max));
        assert_eq!(placed.to_point_m(&middle), 0.0);
        for (by, expected) in [([0.03, 0.0, 0.04], 0.05), ([0.0, 0.0, 0.02], 0.02)] {
            let by = Vector3::from(by);
            let at = Point3::new(high.x, middle.y, high.z) + by;
            assert!((placed.to_point_m(&at) - expected).abs() < 2e-3, "{by}: {}", placed.to_point_m(&at));
            assert!((box_gap_m2(&bounds, &at).sqrt() - expected).abs() < 2e-3);
        }
    }
}
