//! Distances of convex outlines seen from above, their corners counter-clockwise.

use nalgebra::{Point2, Vector2};
use repose_geometry::Footprint;

/// The centroid of a convex polygon's area.
pub fn area_centroid(outline: &Footprint) -> Point2<f32> {
    let corners = outline.corners();
    let (mut weighted, mut total) = (Vector2::zeros(), 0.0);
    for pair in corners[1..].windows(2) {
        let twice_area = (pair[0] - corners[0]).perp(&(pair[1] - corners[0]));
        weighted += (corners[0].coords + pair[0].coords + pair[1].coords) * (twice_area / 3.0);
        total += twice_area;
    }
    if total > 1e-12 { Point2::from(weighted / total) } else { corners[0] }
}

/// Distance between two convex polygons, 0 when they overlap, metres.
pub fn outline_gap_m(a: &[Point2<f32>], b: &[Point2<f32>]) -> f32 {
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

/// Room for rounding where boxes tell of outlines, metres.
const ROUNDING_M: f32 = 0.001;

/// Of an edge between corners that are no farther apart, rounding decides which way it faces, if it faces any, metres.
const SHORTEST_M: f32 = 1e-6;

/// Whether the boxes around two outlines say at little cost that the outlines are farther apart than so much, metres.
pub fn are_clearly_apart(a: &Footprint, b: &Footprint, by_m: f32) -> bool {
    bounds_gap_m(a, b) > by_m + ROUNDING_M
}

/// How far apart the boxes around two outlines are along x or y, whichever is more, metres: the outlines are no nearer. Not positive where they overlap.
fn bounds_gap_m(a: &Footprint, b: &Footprint) -> f32 {
    let ((min, max), (other_min, other_max)) = (a.bounds(), b.bounds());
    (min - other_max).sup(&(other_min - max)).max()
}

/// The largest gap between two convex polygons along any edge's normal: not positive when they overlap. Two corners are the straight line between them.
pub fn separating_gap_m(a: &[Point2<f32>], b: &[Point2<f32>]) -> f32 {
    let along = |one: &[Point2<f32>], other: &[Point2<f32>]| {
        let gap = |(p, q): (&Point2<f32>, &Point2<f32>)| {
            let outward = Vector2::new(q.y - p.y, p.x - q.x).try_normalize(SHORTEST_M)?;
            Some(other.iter().map(|c| (c - p).dot(&outward)).fold(f32::INFINITY, f32::min))
        };
        edges(one).filter_map(gap).fold(f32::NEG_INFINITY, f32::max)
    };
    along(a, b).max(along(b, a))
}

/// Distance from a point to a convex polygon, counter-clockwise; 0 inside, metres.
pub fn to_outline_m(p: &Point2<f32>, corners: &[Point2<f32>]) -> f32 {
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

#[cfg(test)]
mod tests {
    use nalgebra::Point3;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;

    #[test]
    fn an_outline_with_a_corner_twice_overlaps_what_it_overlaps() {
        let square = |x: f32| [[x, 0.0], [x + 1.0, 0.0], [x + 1.0, 1.0], [x, 1.0]].map(Point2::from);
        // The second time where it is, and where rounding has put it on either side along the edges that meet there.
        for [x, y] in [[1.0, 1.0], [1.0, 1.0f32.next_down()], [1.0f32.next_up(), 1.0], [1.0f32.next_down(), 1.0]] {
            let [a, b, c, d] = square(0.0);
            let doubled = [a, b, c, Point2::new(x, y), d];
            for beside in [-0.5, 0.5] {
                assert!((separating_gap_m(&doubled, &square(beside)) + 0.5).abs() < 1e-5, "{x} {y}");
                assert_eq!(outline_gap_m(&square(beside), &doubled), 0.0, "{x} {y}");
            }
            assert!((outline_gap_m(&doubled, &square(1.25)) - 0.25).abs() < 1e-5, "{x} {y}");
        }
    }

    #[test]
    fn a_straight_line_meets_an_outline_that_it_enters_or_leaves_and_none_beside_or_behind_it() {
        let square = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0f32]].map(Point2::from);
        let meets = |to: [f32; 2]| separating_gap_m(&[Point2::new(0.5, -2.0), Point2::from(to)], &square) <= 0.0;
        assert!([[0.5, 0.5], [0.5, 3.0], [0.9, 1.5], [0.1, 0.01]].into_iter().all(meets));
        assert!(![[0.5, -0.1], [1.1, 0.0], [1.4, 0.5], [-0.8, 3.0]].into_iter().any(meets));
    }

    #[test]
    fn outlines_are_no_nearer_to_each_other_than_the_boxes_around_them() {
        let mut rng = Pcg64::seed_from_u64(7);
        for _ in 0..500 {
            let mut outline = || {
                let middle = [(); 2].map(|()| rng.random_range(-0.2..0.2f32));
                let mut corner =
                    || Point3::new(middle[0] + rng.random_range(-0.1..0.1f32), middle[1] + rng.random_range(-0.1..0.1f32), 0.0);
                Footprint::of(&[(); 6].map(|()| corner())).expect("it has an area")
            };
            let (a, b) = (outline(), outline());
            let (apart_m, of_boxes_m) = (outline_gap_m(a.corners(), b.corners()), bounds_gap_m(&a, &b));
            assert!(of_boxes_m <= apart_m + 1e-6, "{of_boxes_m} {apart_m}");
            assert_eq!(of_boxes_m, bounds_gap_m(&b, &a));
        }
    }
}
