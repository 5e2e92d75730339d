//! Table 1's figures in small: each variant on the same problems, judged by releasing the object in the true world.
//!
//! Ground truth: masks, gravity, meshes. Observed: depth with the sensor model. `joint` counts a scene when a placement was returned,
//! the object stayed within 5 cm, the goal held after settling, and nothing else was disturbed; `returned_stayed_goal` leaves the last
//! condition out. Rates are of the scenes that have an answer; "none" is right where there is none.

use std::sync::Arc;

use nalgebra::Isometry3;
use repose_dataset::Split;
use repose_geometry::transform::from_row_major;
use repose_planner::{Models, Prepared, plan};
use repose_proto::place::Variant;
use repose_proto::{CallError, PlaceRequest, PlaceResult};
use repose_simulator::release::ReleaseSettings;
use serde::Serialize;

use crate::feasible::{FeasibleSettings, true_answer};
use crate::outcome::{Judged, judge};
use crate::{Problem, ProblemSettings, Rate};

/// What came of one variant on one problem.
#[derive(Debug, Clone, Serialize)]
pub struct Trial {
    /// The scene's seed.
    pub seed: u64,
    /// The variant.
    pub variant: Variant,
    /// Whether a ground-truth search found an answer.
    pub feasible: bool,
    /// Whether a placement was returned.
    pub returned: bool,
    /// What came of it.
    pub judged: Option<Judged>,
    /// Wall-clock time of the search, milliseconds.
    pub plan_ms: f64,
}

/// A variant's figures.
#[derive(Debug, Clone, Serialize)]
pub struct PlannerRow {
    /// The variant.
    pub variant: Variant,
    /// A placement was returned, of feasible scenes.
    pub returned: Rate,
    /// The object stayed within 5 cm, of feasible scenes.
    pub stable: Rate,
    /// The goal held after settling, of feasible scenes.
    pub goal: Rate,
    /// Returned, stayed and goal true, of feasible scenes.
    pub returned_stayed_goal: Rate,
    /// The same of all scenes, with an answer or not: the ground-truth search may miss one.
    pub returned_stayed_goal_of_all: Rate,
    /// The same as `returned_stayed_goal` and nothing else disturbed, of feasible scenes.
    pub joint: Rate,
    /// Of the scenes answered with "none", those without an answer.
    pub none_precision: Rate,
    /// Of the scenes without an answer, those answered with "none".
    pub none_recall: Rate,
    /// Median time of a search, milliseconds.
    pub p50_ms: f64,
}

/// All of the table.
#[derive(Debug, Clone, Serialize)]
pub struct PlannerTable {
    /// Scenes tried.
    pub scenes: usize,
    /// Scenes with an answer.
    pub feasible: usize,
    /// One row a variant.
    pub rows: Vec<PlannerRow>,
    /// Everything, scene by scene.
    pub trials: Vec<Trial>,
}

/// Runs each variant on the first `scenes` problems of a split; `seen` is told of every trial as it ends.
///
/// # Errors
/// The planner's, on a problem that it should have been able to try.
pub fn evaluate_planner(
    split: Split,
    scenes: usize,
    variants: &[Variant],
    models: &dyn Models,
    mut seen: impl FnMut(&Problem, &PlaceResult, &Trial),
) -> Result<PlannerTable, CallError> {
    let release = ReleaseSettings::default();
    let settings = ProblemSettings::default();
    let mut trials = Vec::new();
    let mut done = 0;
    for index in 0.. {
        if done == scenes {
            break;
        }
        let Some(problem) = Problem::of_split(split, index, &settings) else { continue };
        done += 1;
        let feasible = true_answer(&problem, &FeasibleSettings::default(), &release).is_some();
        let scene = Arc::new(problem.observed.clone());
        let scene_id = scene.id();
        let prepared = Prepared::new(scene);
        for &variant in variants {
            let request =
                PlaceRequest { variant, seed: problem.seed, ..PlaceRequest::new(scene_id.clone(), problem.query, vec![problem.goal]) };
            let started = std::time::Instant::now();
            let result = plan(&prepared, &request, models, &mut |_| std::ops::ControlFlow::Continue(()))?;
            let plan_ms = started.elapsed().as_secs_f64() * 1e3;
            let best: Option<Isometry3<f64>> = result.placements.first().and_then(|p| from_row_major(&p.placed_from_observed.0).ok());
            let judged = best.and_then(|placed_from_observed| judge(&problem, &placed_from_observed, &release));
            let trial = Trial { seed: problem.seed, variant, feasible, returned: best.is_some(), judged, plan_ms };
            seen(&problem, &result, &trial);
            trials.push(trial);
        }
    }
    let rows = variants.iter().map(|variant| row(*variant, &trials)).collect();
    let feasible = trials.iter().filter(|t| t.feasible && Some(t.variant) == variants.first().copied()).count();
    Ok(PlannerTable { scenes: done, feasible, rows, trials })
}

fn row(variant: Variant, trials: &[Trial]) -> PlannerRow {
    let mut row = PlannerRow {
        variant,
        returned: Rate::default(),
        stable: Rate::default(),
        goal: Rate::default(),
        returned_stayed_goal: Rate::default(),
        returned_stayed_goal_of_all: Rate::default(),
        joint: Rate::default(),
        none_precision: Rate::default(),
        none_recall: Rate::default(),
        p50_ms: 0.0,
    };
    let mut times = Vec::new();
    for trial in trials.iter().filter(|t| t.variant == variant) {
        times.push(trial.plan_ms);
        row.returned_stayed_goal_of_all.count(trial.judged.is_some_and(|j| j.stable && j.goal));
        if trial.feasible {
            let is = |f: fn(&Judged) -> bool| trial.judged.as_ref().is_some_and(f);
            row.returned.count(trial.returned);
            row.stable.count(is(|j| j.stable));
            row.goal.count(is(|j| j.goal));
            row.returned_stayed_goal.count(is(|j| j.stable && j.goal));
            row.joint.count(is(Judged::joint));
        } else {
            row.none_recall.count(!trial.returned);
        }
        if !trial.returned {
            row.none_precision.count(!trial.feasible);
        }
    }
    times.sort_by(f64::total_cmp);
    row.p50_ms = times.get(times.len() / 2).copied().unwrap_or(0.0);
    row
}
