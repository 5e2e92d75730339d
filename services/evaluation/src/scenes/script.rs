//! The bar to clear: the script that an engineer writes first, with boxes, planes and random draws.
//!
//! It shares nothing with the planner but the frame's segmentation: every object is the 1–99 % box of its points in the viewer's axes,
//! furniture's planes are all that can carry, and what was not seen is free. It cannot stack, for tops of objects are no furniture.

use nalgebra::{Isometry3, Point3, Translation3, Vector3};
use rand::RngExt;
use rand::SeedableRng;
use rand_pcg::Pcg64;
use repose_geometry::Footprint;
use repose_relations::directional::directional_margins;
use repose_relations::{ObservedObject, ViewerExtents};

use crate::scenes::problem::Problem;

/// Positions drawn, from a disc about the anchor of this radius, metres.
const DRAWS: usize = 6000;
const REACH_M: f64 = 0.4;
/// Kept free around the object, and above the surface where its points scatter, metres.
const CLEARANCE_M: f64 = 0.005;
const SURFACE_M: f64 = 0.01;
/// Free above the object too, metres: what is lower than the top of furniture is inside of it.
const HEADROOM_M: f64 = 0.15;
/// A foot is at most this far below the points that show it, metres; furniture's plane under it otherwise.
const HIDDEN_M: f64 = 0.03;
/// The object is let go this far above the surface, metres.
const LET_GO_M: f64 = 0.003;
/// Draws whose goal holds by more than this, so far from all other boxes, are as good as each other: the nearest to the anchor is taken, metres.
const COMFORT_M: f64 = 0.03;

/// Where the script puts the query of a problem, which carries its observed points there; `None` where no draw is free and meets the goal.
pub fn script_placement(problem: &Problem) -> Option<Isometry3<f64>> {
    let scene = &problem.observed;
    let to_viewer = problem.viewer.viewer_from_world();
    let box_of = |id: u16| {
        let points: Vec<Point3<f32>> = scene.points_of(id).map(Point3::from).collect();
        ObservedObject::new(&points, &problem.viewer).map(|object| *object.extents())
    };
    let (mut query, anchor) = (box_of(problem.query)?, box_of(problem.goal.anchor)?);
    let others: Vec<ViewerExtents> = scene.meta.objects.iter().map(|o| o.id).filter(|id| *id != problem.query).filter_map(box_of).collect();
    let rest = scene.points.iter().zip(&scene.labels).filter(|(_, label)| **label != problem.query);
    let rest: Vec<Point3<f64>> = rest.map(|(p, _)| to_viewer * Point3::from(*p).cast::<f64>()).collect();
    let furniture = scene.meta.surfaces.iter().filter(|s| s.object.is_none());
    let surfaces: Vec<(f64, Footprint)> = furniture.filter_map(|s| Some((s.height_m, Footprint::of_outline(&s.outline_m)?))).collect();
    if surfaces.is_empty() {
        return None;
    }
    // Points end above the foot: it is on the highest plane below them.
    let middle = (to_viewer.inverse() * query.center).xy().cast();
    let below = surfaces.iter().filter(|(height_m, outline)| *height_m < query.low.z + SURFACE_M && outline.margin(&middle) >= 0.0);
    query.low.z = below.map(|(height_m, _)| *height_m).fold(f64::NEG_INFINITY, f64::max).max(query.low.z - HIDDEN_M);
    let mut rng = Pcg64::seed_from_u64(problem.seed);
    let mut best: Option<(f64, f64, Vector3<f64>)> = None;
    for _ in 0..DRAWS {
        let (height_m, outline) = &surfaces[rng.random_range(0..surfaces.len())];
        let [dx, dy] = [(); 2].map(|()| rng.random_range(-REACH_M..REACH_M));
        let move_by =
            Vector3::new(anchor.center.x + dx - query.center.x, anchor.center.y + dy - query.center.y, height_m + LET_GO_M - query.low.z);
        let there = ViewerExtents { low: query.low + move_by, high: query.high + move_by, center: query.center + move_by };
        let holds_m = directional_margins(&there, &anchor)[problem.goal.relation.index()] * if problem.goal.holds { 1.0 } else { -1.0 };
        let clear_m = others.iter().map(|other| other.distance_m(&there)).fold(COMFORT_M, f64::min);
        let (comfort_m, distance_m) = (holds_m.min(clear_m), dx.hypot(dy));
        let is_better = best.as_ref().is_none_or(|(c, d, _)| (comfort_m, -distance_m) > (*c, -*d));
        if holds_m <= 0.0 || clear_m < CLEARANCE_M || distance_m > REACH_M || !is_better {
            continue;
        }
        let corners = [(there.low.x, there.low.y), (there.low.x, there.high.y), (there.high.x, there.low.y), (there.high.x, there.high.y)];
        let carried = corners.iter().all(|(x, y)| {
            let corner = to_viewer.inverse() * Point3::new(*x, *y, 0.0);
            outline.margin(&corner.xy().cast()) >= 0.0
        });
        let free = !rest.iter().any(|p| is_inside(p, &there));
        let in_camera = problem.world_from_camera.inverse_transform_point(&(to_viewer.inverse() * there.center));
        if carried && free && problem.camera.pixel_of(&in_camera).is_some() {
            best = Some((comfort_m, distance_m, move_by));
        }
    }
    best.map(|(.., move_by)| Isometry3::from_parts(Translation3::from(to_viewer.inverse() * move_by), Default::default()))
}

/// Whether a point is in a box with its clearance, above the scatter of the surface that it stands on.
fn is_inside(p: &Point3<f64>, there: &ViewerExtents) -> bool {
    let beside = |k: usize| p[k] > there.low[k] - CLEARANCE_M && p[k] < there.high[k] + CLEARANCE_M;
    beside(0) && beside(1) && p.z > there.low.z + SURFACE_M && p.z < there.high.z + HEADROOM_M
}

#[cfg(test)]
mod tests {
    use repose_dataset::Split;
    use repose_simulator::release::ReleaseSettings;
    use repose_simulator::scene::{KindWeights, SceneKind};

    use super::*;
    use crate::scenes::outcome::judge;
    use crate::scenes::problem::ProblemSettings;

    #[test]
    fn on_open_tables_it_mostly_succeeds_and_never_turns_the_object() {
        let mut settings = ProblemSettings::default();
        settings.scene.kinds = KindWeights::only(SceneKind::OpenTable);
        let problems = (0..6).filter_map(|i| Problem::of_split(Split::Train, i, &settings));
        let placed: Vec<(Problem, Isometry3<f64>)> = problems.filter_map(|p| script_placement(&p).map(|placed| (p, placed))).collect();
        let good = placed.iter().filter(|(p, placed)| judge(p, placed, &ReleaseSettings::default()).is_some_and(|j| j.joint()));
        assert!(placed.iter().all(|(_, placed)| placed.rotation.angle() == 0.0));
        let (good, of) = (good.count(), placed.len());
        assert!(of >= 3 && 2 * good > of, "{good} of {of}");
    }
}
