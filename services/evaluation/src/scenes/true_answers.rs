//! Whether a problem has an answer at all, and on what: a search with the whole truth in hand.
//!
//! Every level that could carry the object (furniture and the tops of objects) is searched apart. Positions are drawn over the level,
//! the object is lowered there until it meets something, and what meets the goal by rule in the camera's view without overlap is let go:
//! a short fall first, the full release then. An answer that succeeds proves that there is one. That there is none is not proven by a
//! search that finds none: tables that count such scenes say how often a planner found one all the same.

use nalgebra::{Isometry3, Point2, Point3, Vector3};
use rand::RngExt;
use rand_pcg::Pcg64;
use repose_geometry::{Aabb, Footprint};
use repose_proto::Relation;
use repose_relations::ViewerExtents;
use repose_relations::directional::directional_margins;
use repose_simulator::release::{ReleaseSettings, Surroundings, Thing, released};
use repose_simulator::render::picture;

use crate::scenes::outcome::{OTHERS_MOVED_M, PENETRATION_M, TILT_RAD, judge};
use crate::scenes::problem::Problem;
use crate::scenes::true_objects::{CELL_M, cells};

/// How hard the truth is searched.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TruthSettings {
    /// Positions drawn on each level.
    pub draws: usize,
    /// Share of them drawn within `near_m` of the anchor, where answers are likeliest.
    pub near_share: f64,
    /// How far from the anchor's centre the near ones are drawn, metres.
    pub near_m: f64,
    /// Releases tried on each level, at most.
    pub releases: usize,
    /// Releases on one level are tried at least this far apart, metres.
    pub apart_m: f64,
    /// How far below a level's height the object is lowered until it meets something, metres: into a bowl, onto a tilted top.
    pub lowered_m: f64,
    /// Steps of the short fall that most bad places do not survive.
    pub short_steps: usize,
    /// How far the object may move in it, metres.
    pub short_moved_m: f64,
    /// Least share of the moved points that fall in the picture, as the planner asks.
    pub min_in_picture: f64,
    /// Least share of the moved points that nothing hides, as the planner asks.
    pub min_unhidden: f64,
    /// From this share on a base is carried as a whole, as the planner asks of furniture.
    pub whole_base_share: f64,
}

impl Default for TruthSettings {
    fn default() -> Self {
        Self {
            draws: 1500,
            near_share: 0.6,
            near_m: 0.35,
            releases: 40,
            apart_m: 0.015,
            lowered_m: 0.08,
            short_steps: 72,
            short_moved_m: 0.03,
            min_in_picture: 0.9,
            min_unhidden: 0.3,
            whole_base_share: 0.9,
        }
    }
}

/// What something stands on: the same surface where the thing is the same and the height is, to two centimetres.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Support {
    /// What carries it.
    pub thing: Thing,
    /// Height of the bottom above the main surface, in steps of two centimetres.
    pub level: i64,
}

/// A placement that succeeds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrueAnswer {
    /// The motion of world space that carries the object there.
    pub placed_from_observed: Isometry3<f64>,
    /// What it stands on.
    pub support: Support,
}

/// The ground truth of a problem, prepared for judging many placements.
pub struct PreparedTruth<'a> {
    problem: &'a Problem,
    query: usize,
    around: Surroundings,
    anchor: ViewerExtents,
    /// True depth without the object, metres; 0 where nothing is.
    depth_m: repose_geometry::Image<f32>,
    /// Observed points of the object, thinned out, world frame.
    points: Vec<Point3<f64>>,
    /// Lowest point of the object where it stands, world z, metres.
    bottom_m: f64,
}

impl<'a> PreparedTruth<'a> {
    /// Prepares a problem; `None` when its scene lacks the object or its anchor.
    pub fn new(problem: &'a Problem) -> Option<Self> {
        const POINTS: usize = 200;
        let (query, anchor) = (problem.index_of(problem.query)?, problem.index_of(problem.goal.anchor)?);
        let scene = &problem.truth;
        let others: Vec<_> = scene.drawables().into_iter().filter(|d| d.label != problem.query).collect();
        let depth_m = picture(&problem.camera, &problem.world_from_camera, &others).depth_m;
        let all: Vec<Point3<f64>> = problem.observed.points_of(problem.query).map(|p| Point3::from(p).cast()).collect();
        let fixed = &scene.objects[anchor];
        Some(Self {
            problem,
            query,
            around: Surroundings::of(scene, query)?,
            anchor: ViewerExtents::of_box(&fixed.shape.bounds(&fixed.world_from_object), &problem.viewer),
            depth_m,
            points: all.iter().step_by(all.len().div_ceil(POINTS).max(1)).copied().collect(),
            bottom_m: bottom_m(problem, query),
        })
    }

    /// One placement that succeeds for every support on which the search finds one, in the order of the scene's surfaces and objects.
    pub fn answers(&self, settings: &TruthSettings, release: &ReleaseSettings) -> Vec<TrueAnswer> {
        self.answers_among(settings, release, usize::MAX, &|_| true)
    }

    /// The same among the placements that are allowed, at most so many.
    pub fn answers_among(
        &self,
        settings: &TruthSettings,
        release: &ReleaseSettings,
        at_most: usize,
        is_allowed: &dyn Fn(&Isometry3<f64>) -> bool,
    ) -> Vec<TrueAnswer> {
        let mut rng = Pcg64::new(u128::from(self.problem.seed), 0xfea5);
        let mut found: Vec<TrueAnswer> = Vec::new();
        for level in self.levels() {
            if found.len() == at_most {
                break;
            }
            let candidates = self.candidates(&level, settings, &mut rng);
            let mut tried: Vec<Isometry3<f64>> = Vec::new();
            for candidate in candidates.into_iter().filter(is_allowed) {
                let near = |t: &Isometry3<f64>| (t.translation.vector - candidate.translation.vector).norm() < settings.apart_m;
                if tried.iter().any(near) {
                    continue;
                }
                if tried.len() == settings.releases {
                    break;
                }
                tried.push(candidate);
                let Some(support) = self.support_of(&candidate).filter(|s| found.iter().all(|f| f.support != *s)) else { continue };
                if self.survives(&candidate, settings, release) && judge(self.problem, &candidate, release).is_some_and(|j| j.joint()) {
                    found.push(TrueAnswer { placed_from_observed: candidate, support });
                    break;
                }
            }
        }
        found
    }

    /// Whether some placement succeeds whose whole base is carried, as a planner that sets nothing over an edge must find it: one of `answers`, those
    /// of this search, or where they all hang over edges, another.
    pub fn has_whole_based(&self, answers: &[TrueAnswer], settings: &TruthSettings, release: &ReleaseSettings) -> bool {
        let base = self.base_cells();
        let is_whole = |placed: &Isometry3<f64>| self.carried_share(&base, placed) >= settings.whole_base_share;
        let is_among = answers.iter().any(|answer| is_whole(&answer.placed_from_observed));
        // Without any answer there is no other.
        is_among || (!answers.is_empty() && !self.answers_among(settings, release, 1, &is_whole).is_empty())
    }

    /// Places all over what the object stands on where it was seen, world frame.
    fn base_cells(&self) -> Vec<Point3<f32>> {
        const BASE_M: f64 = 0.006;
        let object = &self.problem.truth.objects[self.query];
        let corners = object.shape.mesh.vertices.iter().map(|v| object.world_from_object * v.cast::<f64>());
        let low = corners.filter(|c| c.z <= self.bottom_m + BASE_M).map(|c| c.cast::<f32>());
        let Some(base) = Footprint::of(&low.collect::<Vec<_>>()) else { return Vec::new() };
        let (min, max) = base.bounds();
        let flat = Aabb { min: Point3::new(min.x, min.y, 0.0), max: Point3::new(max.x, max.y, CELL_M) };
        cells(&flat).filter(|cell| base.contains(&cell.xy())).map(|cell| Point3::new(cell.x, cell.y, self.bottom_m as f32)).collect()
    }

    /// Share of a base, moved, with something right under it.
    fn carried_share(&self, base: &[Point3<f32>], placed_from_observed: &Isometry3<f64>) -> f64 {
        const UNDER_M: [f32; 3] = [0.002, 0.005, 0.008];
        let is_carried = |cell: &&Point3<f32>| {
            let at = (placed_from_observed * cell.cast::<f64>()).cast::<f32>();
            UNDER_M.iter().any(|under_m| self.around.fills(&Point3::new(at.x, at.y, at.z - under_m)))
        };
        base.iter().filter(is_carried).count() as f64 / base.len().max(1) as f64
    }

    /// What a placement stands on, if on anything within a centimetre.
    pub fn support_of(&self, placed_from_observed: &Isometry3<f64>) -> Option<Support> {
        const REACH_M: f64 = 0.01;
        const LEVEL_M: f64 = 0.02;
        let placed = self.placed(placed_from_observed);
        let thing = self.around.carrier(&placed, REACH_M)?;
        // Placements turn about the vertical only: the lowest point stays the lowest.
        let bottom_m = self.bottom_m + placed_from_observed.translation.z;
        Some(Support { thing, level: (bottom_m / LEVEL_M).round() as i64 })
    }

    /// The levels to search: each surface of the furniture, and each other object.
    fn levels(&self) -> Vec<Level> {
        let scene = &self.problem.truth;
        let surfaces = scene.surfaces.iter().map(|s| Level { world_from_middle: s.world_from_surface, half_m: s.half_extents_m.into() });
        let objects = scene.objects.iter().filter(|o| o.id != self.problem.query).map(|o| {
            let corners: Vec<Point3<f64>> = o.shape.mesh.vertices.iter().map(|v| o.world_from_object * v.cast::<f64>()).collect();
            let first = corners.first().copied().unwrap_or_else(Point3::origin);
            let (low, high) = corners.iter().fold((first, first), |(low, high), c| (low.inf(c), high.sup(c)));
            let middle = nalgebra::center(&low, &high);
            let half_m = [(high.x - low.x) / 2.0, (high.y - low.y) / 2.0];
            Level { world_from_middle: Isometry3::translation(middle.x, middle.y, high.z), half_m }
        });
        surfaces.chain(objects).collect()
    }

    /// Places on a level that meet the goal by rule, in view, free and carried; the surest goals first.
    fn candidates(&self, level: &Level, settings: &TruthSettings, rng: &mut Pcg64) -> Vec<Isometry3<f64>> {
        let moved = &self.problem.truth.objects[self.query];
        let bounds = moved.shape.bounds(&moved.world_from_object);
        let anchor = self.problem.viewer.world_from_viewer() * self.anchor.center;
        let rise_m = level.world_from_middle.translation.z - self.bottom_m;
        let mut kept: Vec<(bool, Isometry3<f64>)> = Vec::new();
        for _ in 0..settings.draws {
            let mut even = |half: f64| rng.random_range(-1.0..=1.0) * half;
            let anywhere = level.world_from_middle * Point3::new(even(level.half_m[0]), even(level.half_m[1]), 0.0);
            let beside = anchor + Vector3::new(even(settings.near_m), even(settings.near_m), 0.0);
            let target: Point2<f64> = if rng.random_range(0.0..1.0) < settings.near_share { beside.xy() } else { anywhere.xy() };
            if !level.is_under(&target) {
                continue;
            }
            let shift = target - bounds.center().xy();
            let above = Isometry3::translation(shift.x, shift.y, rise_m);
            let Some(margin_m) = self.goal_margin_m(&above).filter(|m| *m > 0.0) else { continue };
            let Some(resting) = self.lowered(&above, settings) else { continue };
            if self.is_in_view(&resting, settings) {
                kept.push((margin_m < 0.01, resting));
            }
        }
        // Stable: in the order drawn among equals.
        kept.sort_by_key(|(barely, _)| *barely);
        kept.into_iter().map(|(_, placed)| placed).collect()
    }

    /// By how much the goal holds there by the rule of its direction, metres; `None` for relations that have none.
    fn goal_margin_m(&self, placed_from_observed: &Isometry3<f64>) -> Option<f64> {
        let goal = self.problem.goal;
        let moved = &self.problem.truth.objects[self.query];
        let there = moved.shape.bounds(&(placed_from_observed * moved.world_from_object));
        let margin_m = (goal.relation.index() <= Relation::Below.index())
            .then(|| directional_margins(&ViewerExtents::of_box(&there, &self.problem.viewer), &self.anchor)[goal.relation.index()])?;
        Some(if goal.holds { margin_m } else { -margin_m })
    }

    /// The object let down from a level's height until it meets something, a millimetre above that; `None` where it meets something at
    /// once or nothing within reach.
    fn lowered(&self, placed_from_observed: &Isometry3<f64>, settings: &TruthSettings) -> Option<Isometry3<f64>> {
        const AIR_M: f64 = 0.001;
        let at = |drop_m: f64| {
            let mut placed = *placed_from_observed;
            placed.translation.z += AIR_M - drop_m;
            placed
        };
        let is_free =
            |drop_m: f64| self.around.deepest(&self.placed(&at(drop_m))).is_none_or(|(_, depth_m)| depth_m < PENETRATION_M / 10.0);
        if !is_free(0.0) {
            return None;
        }
        let steps = [0.003, 0.006, 0.012, 0.025, 0.05, settings.lowered_m];
        let first_blocked = steps.iter().position(|drop_m| !is_free(*drop_m))?;
        let mut free_m = if first_blocked == 0 { 0.0 } else { steps[first_blocked - 1] };
        let mut blocked_m = steps[first_blocked];
        while blocked_m - free_m > 0.001 {
            let middle_m = (free_m + blocked_m) / 2.0;
            if is_free(middle_m) { free_m = middle_m } else { blocked_m = middle_m }
        }
        Some(at(free_m))
    }

    /// The planner's own constraint of view, with the true depth in place of the observed.
    fn is_in_view(&self, placed_from_observed: &Isometry3<f64>, settings: &TruthSettings) -> bool {
        const BEHIND_M: f64 = 0.01;
        let camera_from_world = self.problem.world_from_camera.inverse();
        let (mut inside, mut unhidden) = (0usize, 0usize);
        for p in &self.points {
            let in_camera = camera_from_world * (placed_from_observed * p);
            let Some(at) = self.problem.camera.pixel_of(&in_camera) else { continue };
            inside += 1;
            let depth_m = f64::from(self.depth_m[at]);
            unhidden += usize::from(depth_m == 0.0 || in_camera.z <= depth_m + BEHIND_M);
        }
        let share = |count: usize| count as f64 / self.points.len().max(1) as f64;
        share(inside) >= settings.min_in_picture && share(unhidden) >= settings.min_unhidden
    }

    /// Whether a short fall leaves everything about where it is.
    fn survives(&self, placed_from_observed: &Isometry3<f64>, settings: &TruthSettings, release: &ReleaseSettings) -> bool {
        let short = ReleaseSettings { steps: settings.short_steps.min(release.steps), ..*release };
        released(&self.problem.truth, self.query, &self.placed(placed_from_observed), &short).is_some_and(|fell| {
            fell.moved_m <= settings.short_moved_m && fell.tilt_rad <= TILT_RAD && fell.others_moved_m <= OTHERS_MOVED_M
        })
    }

    fn placed(&self, placed_from_observed: &Isometry3<f64>) -> Isometry3<f64> {
        placed_from_observed * self.problem.truth.objects[self.query].world_from_object
    }
}

/// A level rectangle that could carry the object, its frame in the middle.
struct Level {
    world_from_middle: Isometry3<f64>,
    half_m: [f64; 2],
}

impl Level {
    /// Whether a place, seen from above, lies on it.
    fn is_under(&self, place: &Point2<f64>) -> bool {
        let at = self.world_from_middle.inverse_transform_point(&Point3::new(place.x, place.y, 0.0));
        at.x.abs() <= self.half_m[0] && at.y.abs() <= self.half_m[1]
    }
}

/// Lowest point of an object's mesh in the world, metres.
fn bottom_m(problem: &Problem, index: usize) -> f64 {
    let object = &problem.truth.objects[index];
    object.shape.mesh.vertices.iter().map(|v| (object.world_from_object * v.cast::<f64>()).z).fold(f64::INFINITY, f64::min)
}

#[cfg(test)]
mod tests {
    use repose_dataset::Split;
    use repose_simulator::scene::{SceneKind, SceneSettings};

    use super::*;
    use crate::scenes::problem::ProblemSettings;

    #[test]
    fn what_the_search_finds_succeeds_and_stands_on_different_things() {
        let settings = ProblemSettings { scene: SceneSettings::only(SceneKind::LargeBox), ..ProblemSettings::default() };
        let release = ReleaseSettings::default();
        let mut supports = 0;
        for index in 0..4 {
            let Some(problem) = Problem::of_split(Split::Validation, index, &settings) else { continue };
            let truth = PreparedTruth::new(&problem).expect("query and anchor are in the scene");
            let answers = truth.answers(&TruthSettings::default(), &release);
            for (i, answer) in answers.iter().enumerate() {
                assert!(judge(&problem, &answer.placed_from_observed, &release).is_some_and(|j| j.joint()));
                assert!(answers[..i].iter().all(|other| other.support != answer.support));
            }
            supports += answers.len();
        }
        assert!(supports >= 4, "{supports} supports in four scenes with a large box");
    }

    #[test]
    fn where_nothing_meets_the_goal_nothing_is_found() {
        let settings = ProblemSettings::default();
        let mut problem = (0..).find_map(|i| Problem::of_split(Split::Validation, i, &settings)).expect("a problem");
        // A camera that looks away sees no placement.
        problem.world_from_camera.append_rotation_wrt_center_mut(&nalgebra::UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 3.0));
        let truth = PreparedTruth::new(&problem).expect("query and anchor are in the scene");
        assert_eq!(truth.answers(&TruthSettings::default(), &ReleaseSettings::default()), Vec::new());
    }
}
