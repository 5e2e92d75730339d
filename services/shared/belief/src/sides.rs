//! The sides on which an object could stand: faces of the convex hull of its believed surface that hold its centre of mass.
//!
//! A face counts where the centre of mass is well inside it, so that neither the errors of the shape nor those of a pose tip the object over it,
//! and where it is flat: a ball and the round of a tube have hull faces too, but the surface over them is crowned.

use nalgebra::{Point3, Unit, UnitQuaternion, Vector3};
use repose_geometry::{Footprint, sampling};

use crate::crown::is_crowned;
use crate::settings::{CrownSettings, SideSettings};
use crate::solid::CompletedSurface;

/// A side on which an object could stand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Side {
    /// The turn, the smallest one, after which it stands on this side.
    pub standing_from_observed: UnitQuaternion<f64>,
    /// How far inside the side's outline its centre of mass is, seen from above, metres.
    pub margin_m: f64,
}

/// All sides, that on which it stands as observed among them; the one with the widest margin first.
pub fn sides(solid: &CompletedSurface, settings: &SideSettings, crown: &CrownSettings) -> Vec<Side> {
    let mut found: Vec<(Vector3<f64>, Side)> = Vec::new();
    for down in hull_normals(&extreme_points(solid, settings.directions), settings) {
        let Some(side) = side(solid, &down, settings, crown) else { continue };
        found.push((down, side));
    }
    found.sort_by(|a, b| b.1.margin_m.total_cmp(&a.1.margin_m));
    let mut kept: Vec<(Vector3<f64>, Side)> = Vec::new();
    for (down, side) in found {
        if kept.iter().all(|(other, _)| other.angle(&down) > settings.same_rad) {
            kept.push((down, side));
        }
    }
    kept.into_iter().map(|(_, side)| side).collect()
}

/// The side that faces `down`, if the object could stand on it.
fn side(solid: &CompletedSurface, down: &Vector3<f64>, settings: &SideSettings, crown: &CrownSettings) -> Option<Side> {
    // Half a turn, where there is no smallest one, is about x.
    let half_turn = || UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let standing_from_observed = UnitQuaternion::rotation_between(down, &-Vector3::z()).unwrap_or_else(half_turn);
    let standing = solid.turned(&standing_from_observed);
    let low_m = standing.points.iter().map(|p| p.z).fold(f32::INFINITY, f32::min);
    let support = Footprint::of(standing.points.iter().filter(|p| p.z <= low_m + settings.contact_m))?;
    let margin_m = f64::from(support.margin(&standing.center_of_mass.xy()));
    let wanted_m = settings.min_margin_m.max(f64::from(standing.center_of_mass.z - low_m) * settings.min_tip_rad.tan());
    let upside_down: Vec<Point3<f32>> = standing.points.iter().map(|p| Point3::new(p.x, -p.y, -p.z)).collect();
    (margin_m >= wanted_m && !is_crowned(&upside_down, crown)).then_some(Side { standing_from_observed, margin_m })
}

/// The points that reach farthest in directions spread evenly over the sphere.
fn extreme_points(solid: &CompletedSurface, directions: usize) -> Vec<Point3<f64>> {
    let farthest = |along: Vector3<f64>| {
        let reach = |i: usize| solid.points[i].coords.dot(&along.cast::<f32>());
        (0..solid.points.len()).max_by(|a, b| reach(*a).total_cmp(&reach(*b)))
    };
    let mut indices: Vec<usize> = sampling::directions(directions).filter_map(farthest).collect();
    indices.sort_unstable();
    indices.dedup();
    indices.into_iter().map(|i| solid.points[i].cast::<f64>()).collect()
}

/// The outward normals of the planes through three of the points that have all others on one side, those of the largest triangles first; one of
/// several that are nearly the same.
fn hull_normals(points: &[Point3<f64>], settings: &SideSettings) -> Vec<Vector3<f64>> {
    let mut planes: Vec<(f64, Vector3<f64>)> = Vec::new();
    for (i, a) in points.iter().enumerate() {
        for (j, b) in points.iter().enumerate().skip(i + 1) {
            for c in &points[j + 1..] {
                let across = (b - a).cross(&(c - a));
                let Some(normal) = Unit::try_new(across, settings.min_area_m2) else { continue };
                for outward in [normal.into_inner(), -normal.into_inner()] {
                    if points.iter().all(|p| (p - a).dot(&outward) <= settings.slack_m) {
                        planes.push((across.norm(), outward));
                    }
                }
            }
        }
    }
    planes.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut kept: Vec<Vector3<f64>> = Vec::new();
    for (_, normal) in planes {
        if kept.iter().all(|other| other.angle(&normal) > settings.same_rad / 2.0) {
            kept.push(normal);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points every 4 mm on the six faces of a box around the origin, as seen by nobody: all of them.
    fn box_points(size: [f32; 3]) -> Vec<Point3<f32>> {
        let steps = size.map(|s| (s / 0.004).round() as i32);
        let at = |i: i32, k: usize| size[k] * (i as f32 / steps[k] as f32 - 0.5);
        let mut points = Vec::new();
        for (u, v, w) in [(0, 1, 2), (1, 2, 0), (2, 0, 1)] {
            for (i, j) in (0..=steps[u]).flat_map(|i| (0..=steps[v]).map(move |j| (i, j))) {
                for end in [-0.5, 0.5] {
                    let mut p = [0.0; 3];
                    (p[u], p[v], p[w]) = (at(i, u), at(j, v), end * size[w]);
                    points.push(Point3::from(p));
                }
            }
        }
        points
    }

    fn found(points: Vec<Point3<f32>>) -> Vec<Side> {
        sides(
            &CompletedSurface { seen: points.len(), points, center_of_mass: Point3::origin() },
            &SideSettings::default(),
            &CrownSettings::default(),
        )
    }

    #[test]
    fn a_box_has_six_sides_whatever_its_attitude_and_a_flat_one_those_that_are_wide_enough() {
        let turns = [[0.0, 0.0, 0.0], [0.3, -0.8, 0.2], [1.2, 0.4, -2.0]];
        for turn in turns.map(|[r, p, y]: [f32; 3]| nalgebra::Rotation3::from_euler_angles(r, p, y)) {
            let turned = |size: [f32; 3]| found(box_points(size).iter().map(|p| turn * p).collect());
            let block = turned([0.16, 0.06, 0.09]);
            assert_eq!(block.len(), 6, "{block:?}");
            assert!((block[0].margin_m - 0.045).abs() < 0.002, "the widest first: {block:?}");
            // Each sets some of its edges upright.
            for side in &block {
                let height = |edge: Vector3<f32>| (side.standing_from_observed.cast::<f32>() * (turn * edge)).z.abs();
                assert!([Vector3::x(), Vector3::y(), Vector3::z()].into_iter().any(|edge| height(edge) > 0.999), "{side:?}");
            }
            assert_eq!(turned([0.16, 0.01, 0.12]).len(), 2, "a board does not stand on its edges");
        }
    }

    #[test]
    fn a_ball_has_no_side_and_a_can_two() {
        let spread = |k: usize, of: usize| {
            let (turn, z) = (k as f32 * 2.399_963, 1.0 - (2 * k + 1) as f32 / of as f32);
            ((1.0 - z * z).sqrt() * turn.cos(), (1.0 - z * z).sqrt() * turn.sin(), z)
        };
        let ball = (0..2500).map(|k| spread(k, 2500)).map(|(x, y, z)| Point3::new(x, y, z) * 0.04).collect();
        assert_eq!(found(ball), []);
        let around = |k: i32| (k as f32 * 0.1).sin_cos();
        let round = (0..63).flat_map(|k| (-15..=15).map(move |j| (k, j))).map(|(k, j)| {
            let (s, c) = around(k);
            Point3::new(0.033 * c, 0.033 * s, j as f32 * 0.004)
        });
        let lids = (0..63).flat_map(|k| (0..8).map(move |j| (k, j))).flat_map(|(k, j)| {
            let (s, c) = around(k);
            [-0.06, 0.06].map(|z| Point3::new(0.0044 * j as f32 * c, 0.0044 * j as f32 * s, z))
        });
        assert_eq!(found(round.chain(lids).collect()).len(), 2);
    }
}
