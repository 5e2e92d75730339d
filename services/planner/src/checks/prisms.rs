//! Distances from a placed query to points and to other shapes, all of them stacks of upright prisms.

use nalgebra::{Point2, Point3, Vector2, Vector3};
use repose_geometry::Aabb;

use crate::belief::shape::Shape;
use crate::scene::candidate::CandidatePose;
use crate::scene::query::QueryObject;

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
    pub fn new(query: &QueryObject, candidate: &CandidatePose) -> Self {
        let observed = query.shape.centroid.xy().cast::<f32>();
        let rise_m = f64::from(query.bottom_of(candidate.centroid_m[2]) - query.shape.bottom_m);
        let placed = query.shape.slabs.iter().map(|slab| PlacedPrism {
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

/// Distance between two convex polygons, 0 when they overlap, metres.
fn outline_gap_m(a: &[Point2<f32>], b: &[Point2<f32>]) -> f32 {
    if separating_gap_m(a, b) <= 0.0 {
        return 0.0;
    }
    let from = |points: &[Point2<f32>], polygon: &[Point2<f32>]| {
        points
            .iter()
            .map(|p| edges(polygon).map(|(a, b)| to_segment_m(p, a, b)).fold(f32::INFINITY, f32::min))
            .fold(f32::INFINITY, f32::min)
    };
    from(a, b).min(from(b, a))
}

/// The largest gap between two convex polygons along any edge's normal: not positive when they overlap.
fn separating_gap_m(a: &[Point2<f32>], b: &[Point2<f32>]) -> f32 {
    let along = |one: &[Point2<f32>], other: &[Point2<f32>]| {
        let gap = |(p, q): (&Point2<f32>, &Point2<f32>)| {
            let outward = Vector2::new(q.y - p.y, p.x - q.x).normalize();
            other.iter().map(|c| (c - p).dot(&outward)).fold(f32::INFINITY, f32::min)
        };
        edges(one).map(gap).fold(f32::NEG_INFINITY, f32::max)
    };
    along(a, b).max(along(b, a))
}

/// Distance from a point to a convex polygon, counter-clockwise; 0 inside, metres.
fn to_outline_m(p: &Point2<f32>, corners: &[Point2<f32>]) -> f32 {
    if edges(corners).all(|(a, b)| (b - a).perp(&(p - a)) >= 0.0) {
        return 0.0;
    }
    edges(corners).map(|(a, b)| to_segment_m(p, a, b)).fold(f32::INFINITY, f32::min)
}

fn edges(corners: &[Point2<f32>]) -> impl Iterator<Item = (&Point2<f32>, &Point2<f32>)> {
    corners.iter().zip(corners.iter().cycle().skip(1))
}

fn to_segment_m(p: &Point2<f32>, a: &Point2<f32>, b: &Point2<f32>) -> f32 {
    let along = b - a;
    let t = ((p - a).dot(&along) / along.norm_squared().max(1e-12)).clamp(0.0, 1.0);
    (a + along * t - p).norm()
}

/// Distance from a box to a point, squared, square metres; 0 inside.
pub fn box_gap_m2(bounds: &Aabb, point: &Point3<f32>) -> f32 {
    (bounds.min - point).sup(&(point - bounds.max)).sup(&Vector3::zeros()).norm_squared()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Fixed;
    use crate::tests::synthetic::{SceneBuilder, standing_at};

    #[test]
    fn distances_to_points_are_straight_also_past_corners_and_0_inside() {
        let prepared = SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.1]).object(2, [-0.3, -0.2], [0.06, 0.06, 0.08]).prepared();
        let query = QueryObject::new(&prepared, 2, 0.0, &Fixed::default()).unwrap();
        let placed = PlacedPrisms::new(&query, &standing_at(&query, 0.0, 0.0, 0.0));
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
