//! What is believed of objects against what they are, over many scenes.

use std::sync::atomic::{AtomicUsize, Ordering};

use repose_belief::BeliefSettings;
use repose_belief::foot_levels::RIGHT_M;
use repose_dataset::Split;
use repose_networks::serving::spread;
use repose_simulator::scene::{KindWeights, SceneKind};
use serde::Serialize;

use crate::scenes::believed::{BeliefDeviation, BelievedScene, DOUBT_SLACK_M, believed_objects};
use crate::scenes::loads::LoadBelief;
use crate::scenes::problem::ProblemSettings;
use crate::statistics::quantile::Sorted;
use crate::statistics::rate::Rate;

/// Which scenes.
#[derive(Debug, Clone)]
pub struct BeliefTableSettings {
    /// How scenes are made and seen; the kinds below take turns.
    pub problem: ProblemSettings,
    /// The kinds.
    pub kinds: Vec<SceneKind>,
    /// Whose seeds.
    pub split: Split,
    /// The first scene of each kind, counted from the split's first seed.
    pub first: u64,
    /// Scenes of each kind.
    pub scenes: usize,
    /// Whether masks are found by perception, not given.
    pub masks_found: bool,
    /// How objects are believed.
    pub belief: BeliefSettings,
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
    /// Of the objects, those whose bottom is as high as is believed, within 8 mm.
    pub foot_right: Rate,
    /// Of where the far side ends.
    pub far_mm: ErrorSpread,
    /// Of where the near side ends.
    pub near_mm: ErrorSpread,
    /// Of the centre of mass, away from the camera.
    pub axis_away_mm: ErrorSpread,
    /// Of the centre of mass, across.
    pub axis_across_mm: ErrorSpread,
    /// Share of the objects that do not reach farther than their doubt says, 5 mm aside.
    pub within_doubt: f64,
    /// The overlap of bases, on average.
    pub base_overlap: f64,
    /// The overlap of outlines, on average.
    pub outline_overlap: f64,
    /// The overlap of prisms, on average.
    pub prism_overlap: f64,
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

/// What is believed to lie on some objects, against what does.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct LoadRow {
    /// Objects.
    pub objects: usize,
    /// Of the objects on which something lies, those that are believed to bear something: recall.
    pub bearers_told: Rate,
    /// Of the objects that are believed to bear something, those on which something lies: precision.
    pub bearers_right: Rate,
    /// Recall of pairs: of an object and what lies on it.
    pub pairs_told: Rate,
    /// Precision of pairs.
    pub pairs_right: Rate,
}

/// The table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BeliefTable {
    /// By kind of scene, and of all kinds last.
    pub rows: Vec<(String, BeliefRow)>,
    /// What lies on what, likewise.
    pub loads: Vec<(String, LoadRow)>,
    /// Time to believe a scene, median, milliseconds.
    pub ms: f64,
    /// Every object.
    #[serde(skip)]
    pub objects: Vec<BeliefDeviation>,
    /// Every object, with what lies on it.
    #[serde(skip)]
    pub bearers: Vec<LoadBelief>,
}

/// Believes the scenes; `progress` is told how many are done. Times aside, the table does not depend on the number of threads.
pub fn belief_table(settings: &BeliefTableSettings, progress: impl Fn(usize) + Sync) -> BeliefTable {
    let done = AtomicUsize::new(0);
    let of = |index: usize| {
        let mut problem = settings.problem.clone();
        problem.scene.kinds = KindWeights::only(settings.kinds[index / settings.scenes]);
        let seed = settings.first.checked_add((index % settings.scenes) as u64).and_then(|scene| settings.split.seed(scene));
        let believed = seed.and_then(|seed| believed_objects(seed, &problem, settings.masks_found, &settings.belief));
        progress(done.fetch_add(1, Ordering::Relaxed) + 1);
        believed
    };
    let believed = spread(settings.kinds.len() * settings.scenes, settings.threads, || (), |(), index| of(index));
    let scenes: Vec<BelievedScene> = believed.into_iter().flatten().collect();
    let objects: Vec<BeliefDeviation> = scenes.iter().flat_map(|scene| scene.shapes.iter().copied()).collect();
    let bearers: Vec<LoadBelief> = scenes.iter().flat_map(|scene| scene.loads.iter().cloned()).collect();
    let rows = by_kind(&settings.kinds, &objects, |o| o.kind, BeliefRow::of);
    let loads = by_kind(&settings.kinds, &bearers, |b| b.kind, LoadRow::of);
    let ms: Sorted = scenes.iter().map(|scene| scene.took.as_secs_f64() * 1e3).collect();
    BeliefTable { rows, loads, ms: ms.at_or_nan(0.5), objects, bearers }
}

/// A row of the items of each kind that has any, and one of all.
fn by_kind<T, R>(kinds: &[SceneKind], items: &[T], kind_of: fn(&T) -> SceneKind, row: fn(&[&T]) -> R) -> Vec<(String, R)> {
    let of = |name: &str, keep: &dyn Fn(&T) -> bool| {
        let kept: Vec<&T> = items.iter().filter(|item| keep(item)).collect();
        (!kept.is_empty()).then(|| (name.to_owned(), row(&kept)))
    };
    kinds.iter().filter_map(|kind| of(kind.name(), &|item| kind_of(item) == *kind)).chain(of("all", &|_| true)).collect()
}

impl BeliefRow {
    fn of(objects: &[&BeliefDeviation]) -> Self {
        let errors = |of: fn(&BeliefDeviation) -> f32| ErrorSpread::of(objects.iter().map(|o| f64::from(of(o)) * 1e3).collect());
        let mean = |of: fn(&BeliefDeviation) -> f32| objects.iter().map(|o| f64::from(of(o))).sum::<f64>() / objects.len() as f64;
        Self {
            objects: objects.len(),
            bottom_mm: errors(|o| o.bottom_m),
            foot_right: objects.iter().map(|o| o.bottom_m.abs() <= RIGHT_M).collect(),
            far_mm: errors(|o| o.far_m),
            near_mm: errors(|o| o.near_m),
            axis_away_mm: errors(|o| o.axis_away_m),
            axis_across_mm: errors(|o| o.axis_across_m),
            within_doubt: mean(|o| f32::from(u8::from(o.far_m + o.doubt_m >= -DOUBT_SLACK_M))),
            base_overlap: mean(|o| o.base_overlap),
            outline_overlap: mean(|o| o.outline_overlap),
            prism_overlap: mean(|o| o.prism_overlap),
            volume_overlap: mean(|o| o.volume_overlap),
        }
    }
}

impl LoadRow {
    fn of(bearers: &[&LoadBelief]) -> Self {
        let mut row = Self { objects: bearers.len(), ..Self::default() };
        for LoadBelief { borne, told, .. } in bearers {
            if !borne.is_empty() {
                row.bearers_told.count(!told.is_empty());
            }
            if !told.is_empty() {
                row.bearers_right.count(!borne.is_empty());
            }
            borne.iter().for_each(|load| row.pairs_told.count(told.contains(load)));
            told.iter().for_each(|load| row.pairs_right.count(borne.contains(load)));
        }
        row
    }
}

impl ErrorSpread {
    fn of(errors: Vec<f64>) -> Self {
        let sizes: Sorted = errors.iter().map(|e| e.abs()).collect();
        Self { middle: Sorted::new(errors).at_or_nan(0.5), p50: sizes.at_or_nan(0.5), p90: sizes.at_or_nan(0.9) }
    }
}
