//! What is in a candidate's way, by cells: every prism of the query against the runs above the floor plan.
//!
//! Cheap enough for every candidate of a search. Completed backs of objects are in the way too.

use crate::scene::candidate::CandidatePose;
use crate::scene::prepared::PreparedScene;
use crate::scene::query::QueryObject;
use crate::settings::{ClearanceSettings, SupportSettings};

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
/// Bins; larger distances count in the last.
const BINS: usize = 64;

/// What is in the way of a candidate. `touched` objects may be touched and do not count for the clearance.
pub fn obstruction(
    prepared: &PreparedScene,
    query: &QueryObject,
    candidate: &CandidatePose,
    touched: &[u16],
    settings: &ClearanceSettings,
    support: &SupportSettings,
) -> Obstruction {
    let bottom_m = query.bottom_of(candidate.centroid_m[2]);
    // Runs that end here or lower carry the query and are not in its way.
    let floor_m = bottom_m + support.tolerance_m;
    let (mut colliding, mut near) = (0usize, [0usize; BINS]);
    let mut doubtful = 0usize;
    let carry = candidate.carrying();
    // Broad phase: over most of an open table nothing reaches up beside the query at all.
    let free = prepared.belief.columns.top_around(&carry.at, query.reach_m) <= floor_m;
    let columns = &prepared.belief.columns;
    for prism in query.prisms.iter().filter(|_| !free) {
        let (low_m, high_m) = (bottom_m + prism.low_m, bottom_m + prism.high_m);
        let lowest_m = floor_m.max(low_m);
        columns.visit(&prism.offsets, &carry, |i, _, above| {
            // Nearly always nothing reaches up so far.
            if columns.top_m(above) <= lowest_m {
                return;
            }
            let cell = &prism.cells[i];
            let mut in_way =
                columns.runs(above).iter().filter(|r| r.object != query.id && r.high_m > floor_m && r.high_m > low_m && r.low_m < high_m);
            if touched.is_empty() {
                if in_way.next().is_none() {
                    return;
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
        });
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
    let clearance_m = first.map_or(f64::from(query.ring_m), |bin| f64::from(bin as f32 * BIN_M));
    Obstruction { colliding_share: 0.0, clearance_m, doubtful_share }
}

fn count(inside_m: f32, graze_m: f32, colliding: &mut usize, near: &mut [usize; BINS]) {
    if inside_m >= graze_m {
        *colliding += 1;
    } else {
        near[(((-inside_m).max(0.0) / BIN_M) as usize).min(BINS - 1)] += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Fixed;
    use crate::tests::synthetic::{Prepared, SceneBuilder, standing_at};

    #[test]
    fn it_collides_with_a_box_and_its_hidden_back_and_is_clear_beside_it() {
        let prepared = SceneBuilder::table().object(1, [0.0, 0.1], [0.1, 0.1, 0.12]).object(2, [-0.3, -0.2], [0.06, 0.06, 0.08]).prepared();
        let fixed = Fixed::default();
        let query = QueryObject::new(&prepared, 2, 0.0, &fixed).unwrap();
        let at = |x: f32, y: f32, bottom_m: f32| standing_at(&query, x, y, bottom_m);
        let judge = |c: &CandidatePose, touched: &[u16]| obstruction(&prepared, &query, c, touched, &fixed.clearance, &fixed.support);
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
        let prepared = SceneBuilder::table().object(1, [0.0, 0.1], [0.1, 0.1, 0.12]).object(2, [-0.3, -0.2], [0.05, 0.05, 0.2]).prepared();
        let fixed = Fixed::default();
        let mut query = QueryObject::new(&prepared, 2, 0.0, &fixed).unwrap();
        let doubtful = |query: &QueryObject, y: f32| {
            obstruction(&prepared, query, &standing_at(query, 0.0, y, 0.001), &[], &fixed.clearance, &fixed.support).doubtful_share
        };
        assert_eq!(doubtful(&query, 0.0), 0.0, "its top was seen whole");
        query.shape.doubt = nalgebra::Vector2::new(0.0, 0.035);
        for (prism, slab) in query.prisms.iter_mut().zip(&query.shape.slabs) {
            let origin = query.shape.centroid.xy().cast::<f32>();
            prism.doubtful = crate::scene::query::doubt(&mut prism.cells, &slab.outline, &origin, &query.shape.doubt);
        }
        assert!(doubtful(&query, 0.0) > 0.2, "in front of the box its back may reach into it: {}", doubtful(&query, 0.0));
        assert_eq!(doubtful(&query, -0.2), 0.0, "far from it nothing is doubtful");
        assert_eq!(doubtful(&query, 0.2), 0.0, "behind the box its front is known");
    }
}
