//! What is believed of objects against what they are, over many scenes.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;

use repose_networks::serving::spread;
use repose_simulator::scene::{KindWeights, SceneKind};
use serde::Serialize;

use crate::scenes::believed::{BeliefDeviation, DOUBT_SLACK_M, believed_objects};
use crate::scenes::problem::ProblemSettings;
use crate::statistics::quantile::Sorted;

/// Which scenes.
#[derive(Debug, Clone)]
pub struct BeliefTableSettings {
    /// How scenes are made and seen; the kinds below take turns.
    pub problem: ProblemSettings,
    /// The kinds.
    pub kinds: Vec<SceneKind>,
    /// The seed of the first scene of each kind.
    pub first_seed: u64,
    /// Scenes of each kind.
    pub scenes: usize,
    /// Threads.
    pub threads: usize,
}

/// The errors of some objects.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct BeliefRow {
    /// Objects.
    pub objects: usize,
    /// Of the bottom's height.
    pub bottom_mm: ErrorSpread,
    /// Of where the far side ends.
    pub far_mm: ErrorSpread,
    /// Of where the near side ends.
    pub near_mm: ErrorSpread,
    /// Of the axis, away from the camera.
    pub axis_away_mm: ErrorSpread,
    /// Of the axis, across.
    pub axis_across_mm: ErrorSpread,
    /// Share of the objects that do not reach farther than their doubt says, 5 mm aside.
    pub within_doubt: f64,
    /// The overlap of outlines, on average.
    pub outline_overlap: f64,
    /// The overlap of volumes, on average.
    pub volume_overlap: f64,
}

/// An error with its sign in the middle, and without it, millimetres.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ErrorSpread {
    /// The median of the errors, believed less true.
    pub middle: f64,
    /// The median of the errors' sizes.
    pub p50: f64,
    /// Their 90th percentile.
    pub p90: f64,
}

/// The table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BeliefTable {
    /// By kind of scene, and of all kinds last.
    pub rows: Vec<(String, BeliefRow)>,
    /// Time to believe a scene, median, milliseconds.
    pub ms: f64,
    /// Every object.
    #[serde(skip)]
    pub objects: Vec<BeliefDeviation>,
}

/// Believes the scenes; `progress` is told how many are done. Times aside, the table does not depend on the number of threads.
pub fn belief_table(settings: &BeliefTableSettings, progress: impl Fn(usize) + Sync) -> BeliefTable {
    let done = AtomicUsize::new(0);
    let of = |index: usize| {
        let mut problem = settings.problem.clone();
        problem.scene.kinds = KindWeights::only(settings.kinds[index / settings.scenes]);
        let believed = believed_objects(settings.first_seed + (index % settings.scenes) as u64, &problem);
        progress(done.fetch_add(1, Ordering::Relaxed) + 1);
        believed
    };
    let believed = spread(settings.kinds.len() * settings.scenes, settings.threads, || (), |(), index| of(index));
    let (objects, times): (Vec<Vec<BeliefDeviation>>, Vec<Duration>) = believed.into_iter().flatten().unzip();
    let objects: Vec<BeliefDeviation> = objects.into_iter().flatten().collect();
    let row = |name: &str, keep: &dyn Fn(&BeliefDeviation) -> bool| {
        let kept: Vec<&BeliefDeviation> = objects.iter().filter(|o| keep(o)).collect();
        (!kept.is_empty()).then(|| (name.to_owned(), BeliefRow::of(&kept)))
    };
    let kinds = settings.kinds.iter().filter_map(|kind| row(kind.name(), &|o| o.kind == *kind));
    let rows = kinds.chain(row("all", &|_| true)).collect();
    let ms: Sorted = times.iter().map(|t| t.as_secs_f64() * 1e3).collect();
    BeliefTable { rows, ms: ms.at_or_nan(0.5), objects }
}

impl BeliefRow {
    fn of(objects: &[&BeliefDeviation]) -> Self {
        let errors = |of: fn(&BeliefDeviation) -> f32| ErrorSpread::of(objects.iter().map(|o| f64::from(of(o)) * 1e3).collect());
        let mean = |of: fn(&BeliefDeviation) -> f32| objects.iter().map(|o| f64::from(of(o))).sum::<f64>() / objects.len() as f64;
        Self {
            objects: objects.len(),
            bottom_mm: errors(|o| o.bottom_m),
            far_mm: errors(|o| o.far_m),
            near_mm: errors(|o| o.near_m),
            axis_away_mm: errors(|o| o.axis_away_m),
            axis_across_mm: errors(|o| o.axis_across_m),
            within_doubt: mean(|o| f32::from(u8::from(o.far_m + o.doubt_m >= -DOUBT_SLACK_M))),
            outline_overlap: mean(|o| o.outline_overlap),
            volume_overlap: mean(|o| o.volume_overlap),
        }
    }
}

impl ErrorSpread {
    fn of(errors: Vec<f64>) -> Self {
        let sizes: Sorted = errors.iter().map(|e| e.abs()).collect();
        Self { middle: Sorted::new(errors).at_or_nan(0.5), p50: sizes.at_or_nan(0.5), p90: sizes.at_or_nan(0.9) }
    }
}
