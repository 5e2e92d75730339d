//! What is in a candidate's way, and how far it keeps from everything.
//!
//! During the search by cells: every prism of the query against the runs above the floor plan, completed backs of objects included.
//! Where a wider clearance is asked than the cells reach, by points on completed shapes as well: what must be kept is the same, so that
//! asking for more is never easier. Beside answers stands what was observed: the least distance from the placed cloud to anything that
//! is not beneath it.

use nalgebra::{Point3, Vector3};
use repose_geometry::{Aabb, cloud};

use crate::candidate::Candidate;
use crate::prepared::Prepared;
use crate::query::Query;
use crate::settings::{ClearanceSettings, SupportSettings};
use crate::shape::Shape;

/// What the cells say.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Obstruction {
    /// Share of the query's cells that something else fills, strays left out.
    pub colliding_share: f64,
    /// Distance to the nearest obstacle, metres, up to the width of the clearance ring; 0 in collision.
    pub clearance_m: f64,
    /// Share of the cells where the query's unseen back may reach that something else fills.
    pub doubtful_share: f64,
}

/// Width of a bin that distances are counted in, metres.
const BIN_M: f32 = 0.005;
/// Bins; what is farther counts in the last.
const BINS: usize = 64;

/// What is in the way of a candidate. `touched` objects may be touched, and do not count for the clearance.
pub fn obstruction(
    prepared: &Prepared,
    query: &Query,
    candidate: &Candidate,
    touched: &[u16],
    settings: &ClearanceSettings,
    support: &SupportSettings,
) -> Obstruction {
    let bottom_m = query.bottom_of(candidate.centroid_m[2]);
    // What ends here or lower carries the query and is not in its way.
    let floor_m = bottom_m + support.tolerance_m;
    let (mut colliding, mut near) = (0usize, [0usize; BINS]);
    let (mut farthest_m, mut doubtful) = (0.0f32, 0usize);
    for prism in &query.prisms {
        let (low_m, high_m) = (bottom_m + prism.low_m, bottom_m + prism.high_m);
        for cell in &prism.cells {
            farthest_m = farthest_m.max(-cell.inside_m);
            let runs = prepared.columns.at(&candidate.carry(&cell.offset)).iter();
            let mut in_way = runs.filter(|r| r.object != query.id && r.high_m > floor_m && r.high_m > low_m && r.low_m < high_m);
            if touched.is_empty() {
                if in_way.next().is_none() {
                    continue;
                }
                doubtful += usize::from(cell.doubtful);
                count(cell.inside_m, settings.graze_m, &mut colliding, &mut near);
            } else {
                for run in in_way {
                    match touched.contains(&run.object) {
                        true if cell.inside_m >= settings.touch_m => colliding += 1,
                        true => {}
                        false => {
                            doubtful += usize::from(cell.doubtful);
                            count(cell.inside_m, settings.graze_m, &mut colliding, &mut near);
                        }
                    }
                }
            }
        }
    }
    let cells = query.prisms.iter().map(|p| p.inside).sum::<usize>().max(1);
    let doubtful_share = doubtful as f64 / query.prisms.iter().map(|p| p.doubtful).sum::<usize>().max(1) as f64;
    let strays = settings.stray_cells.max((settings.stray_share * cells as f32) as usize);
    if colliding > strays {
        return Obstruction { colliding_share: colliding as f64 / cells as f64, clearance_m: 0.0, doubtful_share };
    }
    let mut found = 0;
    let first = near.iter().position(|n| {
        found += n;
        found > settings.stray_cells
    });
    let clearance_m = first.map_or(f64::from(farthest_m), |bin| f64::from(bin as f32 * BIN_M));
    Obstruction { colliding_share: 0.0, clearance_m, doubtful_share }
}

fn count(inside_m: f32, graze_m: f32, colliding: &mut usize, near: &mut [usize; BINS]) {
    if inside_m >= graze_m {
        *colliding += 1;
    } else {
        near[(((-inside_m).max(0.0) / BIN_M) as usize).min(BINS - 1)] += 1;
    }
}

/// The scene's points without the query's (world frame), one per voxel.
pub fn obstacles(prepared: &Prepared, query: &Query, voxel_m: f32) -> Vec<Point3<f32>> {
    let scene = &prepared.scene;
    let others = scene.points.iter().zip(&scene.labels).filter(|(_, label)| **label != query.id);
    let points: Vec<Point3<f32>> = others.map(|(p, _)| Point3::from(*p)).collect();
    cloud::voxel_downsampled(&points, voxel_m)
}

/// The least distance from the placed query's observed points to what is not beneath it, metres, 1 at most.
///
/// `obstacles` are the scene's points without the query's, thinned out; what is less than `same_support_m` above the query's bottom
/// counts as its support.
pub fn exact_clearance_m(query: &Query, candidate: &Candidate, obstacles: &[Point3<f32>], support: &SupportSettings) -> f64 {
    let floor_m = query.bottom_of(candidate.centroid_m[2]) + support.same_support_m;
    least_distance_m(&placed(&query.cloud, query, candidate), obstacles, floor_m, 1.0)
}

/// What clearances wider than the cells around the query reach are measured with: completed shapes as points, world frame.
#[derive(Debug, Clone)]
pub struct WideClearance {
    /// The query where it was observed.
    query: Vec<Point3<f32>>,
    /// Everything else but what may be touched.
    obstacles: Vec<Point3<f32>>,
}

impl WideClearance {
    /// Points `voxel_m` apart. As for the cells, `touched` objects do not count.
    pub fn new(prepared: &Prepared, query: &Query, touched: &[u16], voxel_m: f32) -> Self {
        let counts = |id: u16| id != query.id && !touched.contains(&id);
        let seen = prepared.scene.points.iter().zip(&prepared.scene.labels).filter(|(_, label)| counts(**label));
        let shapes = prepared.objects.iter().filter(|(id, _)| counts(**id)).filter_map(|(_, object)| object.shape.as_ref());
        let obstacles: Vec<Point3<f32>> = seen.map(|(p, _)| Point3::from(*p)).chain(shapes.flat_map(|s| sides(s, voxel_m))).collect();
        Self {
            query: query.cloud.iter().copied().chain(sides(&query.shape, voxel_m)).collect(),
            obstacles: cloud::voxel_downsampled(&obstacles, voxel_m),
        }
    }

    /// The least distance from the placed query to what does not carry it, metres, `most_m` at most.
    pub fn of(&self, query: &Query, candidate: &Candidate, support: &SupportSettings, most_m: f64) -> f64 {
        let floor_m = query.bottom_of(candidate.centroid_m[2]) + support.tolerance_m;
        least_distance_m(&placed(&self.query, query, candidate), &self.obstacles, floor_m, most_m)
    }
}

/// Points over the sides of a completed shape, at most `step_m` apart, world frame.
fn sides(shape: &Shape, step_m: f32) -> Vec<Point3<f32>> {
    let mut points = Vec::new();
    for slab in &shape.slabs {
        let rises = ((slab.high_m - slab.low_m) / step_m).ceil().max(1.0);
        let corners = slab.outline.corners();
        for (a, b) in corners.iter().zip(corners.iter().cycle().skip(1)) {
            let steps = ((b - a).norm() / step_m).ceil().max(1.0);
            for (step, rise) in (0..steps as usize).flat_map(|s| (0..=rises as usize).map(move |r| (s as f32, r as f32))) {
                let at = a + (b - a) * (step / steps);
                points.push(Point3::new(at.x, at.y, slab.low_m + (slab.high_m - slab.low_m) * (rise / rises)));
            }
        }
    }
    points
}

/// Points of the query where a candidate puts them.
fn placed(observed: &[Point3<f32>], query: &Query, candidate: &Candidate) -> Vec<Point3<f32>> {
    let placed_from_observed = candidate.placed_from_observed(&query.shape.centroid).cast::<f32>();
    observed.iter().map(|p| placed_from_observed * p).collect()
}

/// The least distance from a point of `placed` to an obstacle above a height, metres, `most_m` at most.
fn least_distance_m(placed: &[Point3<f32>], obstacles: &[Point3<f32>], floor_m: f32, most_m: f64) -> f64 {
    let Some(bounds) = Aabb::of(placed) else { return most_m };
    let most = most_m as f32;
    let mut best = most;
    for obstacle in obstacles.iter().filter(|p| p.z > floor_m) {
        let gap = (bounds.min - obstacle).sup(&(obstacle - bounds.max)).sup(&Vector3::zeros());
        if gap.norm_squared() >= best * best {
            continue;
        }
        let nearest = placed.iter().map(|p| (p - obstacle).norm_squared()).fold(f32::INFINITY, f32::min);
        best = best.min(nearest.sqrt());
    }
    if best < most { f64::from(best) } else { most_m }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Fixed;
    use crate::synthetic::{Builder, standing_at};

    #[test]
    fn it_collides_with_a_box_and_its_hidden_back_and_is_clear_beside_it() {
        let prepared = Builder::table().object(1, [0.0, 0.1], [0.1, 0.1, 0.12]).object(2, [-0.3, -0.2], [0.06, 0.06, 0.08]).prepared();
        let fixed = Fixed::default();
        let query = Query::new(&prepared, 2, 0.0, &fixed).unwrap();
        let at = |x: f32, y: f32, bottom_m: f32| standing_at(&query, x, y, bottom_m);
        let judge = |c: &Candidate, touched: &[u16]| obstruction(&prepared, &query, c, touched, &fixed.clearance, &fixed.support);
        assert!(judge(&at(0.0, 0.1, 0.001), &[]).colliding_share > 0.1, "inside the box");
        assert!(judge(&at(0.0, 0.17, 0.001), &[]).colliding_share > 0.05, "in its hidden back");
        let on_top = judge(&at(0.0, 0.1, 0.121), &[]);
        assert!(on_top.colliding_share == 0.0 && on_top.clearance_m > 0.035, "{on_top:?}");
        let beside = judge(&at(0.105, 0.1, 0.001), &[]);
        assert!(beside.colliding_share == 0.0 && (0.01..0.03).contains(&beside.clearance_m), "{beside:?}");
        let touching = at(0.082, 0.1, 0.001);
        assert!(judge(&touching, &[1]).colliding_share == 0.0 && judge(&touching, &[1]).clearance_m > 0.03);
    }

    #[test]
    fn where_an_unseen_back_may_reach_something_is_doubtful() {
        // Taller than wide, its top hardly seen from the side: it may be deeper than it is wide, away from the camera at −y.
        let prepared = Builder::table().object(1, [0.0, 0.1], [0.1, 0.1, 0.12]).object(2, [-0.3, -0.2], [0.05, 0.05, 0.2]).prepared();
        let fixed = Fixed::default();
        let mut query = Query::new(&prepared, 2, 0.0, &fixed).unwrap();
        let doubtful = |query: &Query, y: f32| {
            obstruction(&prepared, query, &standing_at(query, 0.0, y, 0.001), &[], &fixed.clearance, &fixed.support).doubtful_share
        };
        assert_eq!(doubtful(&query, 0.0), 0.0, "its top was seen whole");
        query.shape.doubt = nalgebra::Vector2::new(0.0, 0.035);
        for (prism, slab) in query.prisms.iter_mut().zip(&query.shape.slabs) {
            let origin = query.shape.centroid.xy().cast::<f32>();
            prism.doubtful = crate::query::doubt(&mut prism.cells, &slab.outline, &origin, &query.shape.doubt);
        }
        assert!(doubtful(&query, 0.0) > 0.2, "in front of the box its back may reach into it: {}", doubtful(&query, 0.0));
        assert_eq!(doubtful(&query, -0.2), 0.0, "far from it nothing is doubtful");
        assert_eq!(doubtful(&query, 0.2), 0.0, "behind the box its front is known");
    }

    #[test]
    fn the_clearance_of_an_answer_is_the_gap_to_the_next_thing() {
        let prepared = Builder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.12]).object(2, [-0.3, -0.2], [0.06, 0.06, 0.08]).prepared();
        let fixed = Fixed::default();
        let query = Query::new(&prepared, 2, 0.0, &fixed).unwrap();
        let candidate = standing_at(&query, 0.13, 0.0, 0.0);
        let clearance_m = exact_clearance_m(&query, &candidate, &obstacles(&prepared, &query, 0.004), &fixed.support);
        assert!((clearance_m - 0.05).abs() < 0.006, "{clearance_m}");
    }
}
