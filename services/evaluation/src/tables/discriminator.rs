//! The discriminator against physics (paper, section 3 and its figure of the simulation results): realism against what a release does.
//!
//! In kitchens never trained on, an object is put where the learned prior says at random, and where the planner chose, and let go for
//! 500 physics steps in the true world. Ground truth: masks, gravity, meshes, and what physics does. Observed: depth with the sensor
//! model. Correlations leave out movements of half a metre and more, as the paper does (thrown out of what it was put into); shares, the
//! area under the curve and calibration leave out nothing. The scenes with an answer are the "confident" ones: a placement was returned.

use std::sync::Arc;

use nalgebra::Point3;
use repose_dataset::Split;
use repose_geometry::transform::from_row_major;
use repose_inference::Engine;
use repose_networks::serving::spread;
use repose_planner::scene::candidate::CandidatePose;
use repose_planner::{Forecasts, PlacementModels, PreparedScene, plan};
use repose_proto::place::{Rotation, Variant};
use repose_proto::scoring::RealismBy;
use repose_proto::{CallError, ErrorCode, PlaceRequest};
use repose_simulator::release::ReleaseSettings;
use repose_simulator::scene::{SceneKind, SceneSettings};
use serde::Serialize;

use crate::scenes::held_scenes::forecasts_of;
use crate::scenes::one_scene::OneScene;
use crate::scenes::outcome::{Judged, judge};
use crate::scenes::problem::{Problem, ProblemSettings};
use crate::scenes::proposals::{motion_to, prior_draws};
use crate::scenes::stability_samples::{measured, said_of};
use crate::statistics::calibration::Calibration;
use crate::statistics::correlation::{area_under_curve, pearson_p, pearson_r};
use crate::statistics::rate::Rate;
use crate::statistics::resample::interval;

/// Movements from here on are left out of correlations, metres (the paper's outliers).
pub const OUTLIER_M: f64 = 0.5;
/// Seeds without a problem in a row after which the search for more ends.
const MOST_EMPTY: u64 = 200;

/// What is tried.
#[derive(Debug, Clone)]
pub struct DiscriminatorSettings {
    /// Where problems come from; kitchens by default, as in the paper.
    pub problem: ProblemSettings,
    /// The first scene, counted from the split's first seed.
    pub first: u64,
    /// Random prior samples of each problem. The paper has one; more make the figures of all of them more certain.
    pub samples: u32,
    /// Distinct placements asked of the planner; the first is its answer, all of them are looked at for calibration.
    pub placements: u32,
    /// The planner's variants; the first is the one that the table's main figures are of.
    pub variants: Vec<Variant>,
    /// How a release is simulated.
    pub release: ReleaseSettings,
    /// Threads to work with; the table does not depend on it.
    pub threads: usize,
}

impl Default for DiscriminatorSettings {
    fn default() -> Self {
        let problem = ProblemSettings { scene: SceneSettings::only(SceneKind::Kitchen), ..ProblemSettings::default() };
        let variants = vec![Variant::Best, Variant::Full];
        Self { problem, first: 0, samples: 8, placements: 3, variants, release: ReleaseSettings::default(), threads: 2 }
    }
}

/// A simulated release of an object, and its scores.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct ReleaseTrial {
    /// The scene's seed.
    pub seed: u64,
    /// Which variant chose it; `None` for a random prior sample.
    pub variant: Option<Variant>,
    /// Its rank among the scene's samples, or among the placements of the answer, from 0.
    pub rank: usize,
    /// What the discriminator said; what the answer said, for a placement: none where its variant asks no network.
    pub realism: Option<f64>,
    /// What the outcome network said of a random prior sample.
    pub outcome: Option<f64>,
    /// What `best` makes of that with what geometry measures; none where the planner does not take the query.
    pub best: Option<f64>,
    /// Its outcome.
    pub judged: Judged,
}

/// A correlation with its p-value and interval.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Correlation {
    /// Pairs, outliers left out.
    pub n: usize,
    /// Pairs left out.
    pub outliers: usize,
    /// Pearson's coefficient; `None` where it is not defined.
    pub r: Option<f64>,
    /// Its two-sided p-value, as if pairs of one scene were independent.
    pub p: Option<f64>,
    /// 95 % interval of `r` over scenes.
    pub interval: Option<[f64; 2]>,
}

/// What is said of one variant's placements.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct VariantRow {
    /// Which.
    pub variant: Variant,
    /// Scenes with an answer, of all.
    pub confident: Rate,
    /// The answer moved less than 5 cm, of confident scenes.
    pub stable: Rate,
    /// The answer moved less than 5 cm and the goal held after settling, of confident scenes.
    pub stable_with_goal: Rate,
    /// Realism of answers against distance moved.
    pub correlation: Correlation,
    /// Realism of all placements returned against whether they moved less than 5 cm.
    pub calibration: Calibration,
}

/// Who says how realistic a random prior sample is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Forecaster {
    /// The paper's network: what `full` goes by.
    Discriminator,
    /// The outcome network by itself.
    Outcome,
    /// The outcome network with what geometry measures: what `best` goes by, and says.
    Best,
}

impl Forecaster {
    /// All, in the order of the table.
    pub const ALL: [Self; 3] = [Self::Discriminator, Self::Outcome, Self::Best];

    /// What a variant goes by.
    pub fn of(variant: Variant) -> Self {
        if variant == Variant::Best { Self::Best } else { Self::Discriminator }
    }

    /// What it says of a random prior sample; none where it says nothing.
    pub fn said(self, trial: &ReleaseTrial) -> Option<f64> {
        match self {
            Self::Discriminator => trial.realism,
            Self::Outcome => trial.outcome,
            Self::Best => trial.best,
        }
    }
}

/// What is said of random prior samples by one forecaster.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RandomRow {
    /// Which.
    pub by: Forecaster,
    /// What it says against the distance moved, all samples.
    pub all: Correlation,
    /// The first sample of each scene: the paper's figure.
    pub one_a_scene: Correlation,
    /// Area under the curve of what it says for moving less than 5 cm, on all samples; `None` where all or none did.
    pub auc: Option<f64>,
    /// Its 95 % interval over scenes.
    pub auc_interval: Option<[f64; 2]>,
}

/// The table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DiscriminatorTable {
    /// Scenes tried.
    pub scenes: usize,
    /// Random prior samples: how many moved less than 5 cm.
    pub random_stable: Rate,
    /// Random prior samples by each network that says something of them.
    pub random: Vec<RandomRow>,
    /// The planner's variants.
    pub rows: Vec<VariantRow>,
    /// Everything that was let go.
    pub trials: Vec<ReleaseTrial>,
}

/// Tries the first `scenes` problems of a split; `seen` is told how many are done.
///
/// The engine is asked from several threads at once, so it should have one of its own.
///
/// # Errors
/// The planner's or the engine's, on a problem that they should have been able to take.
pub fn evaluate_discriminator(
    split: Split,
    scenes: usize,
    engine: &Engine,
    settings: &DiscriminatorSettings,
    mut seen: impl FnMut(usize),
) -> Result<DiscriminatorTable, CallError> {
    let forecasts = forecasts_of(engine)?;
    let mut tried: Vec<Vec<ReleaseTrial>> = Vec::with_capacity(scenes);
    let (mut next, mut empty) = (settings.first, 0);
    // As many at once as keep the threads busy; the table does not depend on it.
    let at_once = settings.threads.max(1) as u64;
    while tried.len() < scenes && empty < MOST_EMPTY {
        let batch = spread(
            at_once as usize,
            settings.threads,
            || (),
            |(), k| {
                let problem = Problem::of_split(split, next + k as u64, &settings.problem)?;
                Some(trials_of(&problem, engine, &forecasts, settings))
            },
        );
        next += at_once;
        for trials in batch {
            empty = if trials.is_some() { 0 } else { empty + 1 };
            if let Some(trials) = trials.filter(|_| tried.len() < scenes) {
                tried.push(trials?);
            }
        }
        seen(tried.len());
    }
    Ok(table_of(&tried, &settings.variants))
}

/// Everything that is let go in one scene.
fn trials_of(
    problem: &Problem,
    engine: &Engine,
    forecasts: &Arc<Forecasts>,
    settings: &DiscriminatorSettings,
) -> Result<Vec<ReleaseTrial>, CallError> {
    let scene = Arc::new(problem.observed.clone());
    let models = OneScene::new(engine, scene.clone()).with_forecasts(forecasts);
    let prepared = PreparedScene::with_id(scene, models.scene_id().to_owned());
    let mut trials = random_trials(problem, &models, &prepared, settings)?;
    for &variant in &settings.variants {
        let goal = vec![problem.goal];
        let request = PlaceRequest {
            variant,
            count: settings.placements.max(1),
            seed: problem.seed,
            ..PlaceRequest::new(models.scene_id().to_owned(), problem.query, goal)
        };
        let result = match plan(&prepared, &request, &models, &mut |_| std::ops::ControlFlow::Continue(())) {
            // It is believed to carry another object: no answer.
            Err(error) if error.code == ErrorCode::FailedPrecondition => continue,
            answered => answered?,
        };
        for (rank, placement) in result.placements.iter().enumerate() {
            let Ok(placed_from_observed) = from_row_major(&placement.placed_from_observed.0) else { continue };
            let Some(judged) = judge(problem, &placed_from_observed, &settings.release) else { continue };
            trials.push(ReleaseTrial {
                seed: problem.seed,
                variant: Some(variant),
                rank,
                realism: placement.realism,
                outcome: None,
                best: None,
                judged,
            });
        }
    }
    Ok(trials)
}

fn random_trials(
    problem: &Problem,
    models: &OneScene<'_>,
    prepared: &PreparedScene,
    settings: &DiscriminatorSettings,
) -> Result<Vec<ReleaseTrial>, CallError> {
    let Some(object) = models.scene().object(problem.query) else { return Ok(Vec::new()) };
    let draws = prior_draws(problem, models, Rotation::Fixed, settings.samples)?;
    let realism = said_of(problem, models, RealismBy::Discriminator, draws.clone())?;
    let outcomes = said_of(problem, models, RealismBy::Outcome, draws.clone())?;
    let (measured, forecasts) = (measured(problem, prepared), models.forecasts()?);
    let centroid = Point3::from(object.centroid_m);
    let trial = |(rank, draw): (usize, &[f32; 4])| {
        let judged = judge(problem, &motion_to(&centroid, draw), &settings.release)?;
        let best = measured.as_ref().map(|of| forecasts.stability.of(&of(&CandidatePose::from_row(*draw), outcomes[rank])));
        let (realism, outcome) = (Some(f64::from(realism[rank])), Some(f64::from(outcomes[rank])));
        Some(ReleaseTrial { seed: problem.seed, variant: None, rank, realism, outcome, best, judged })
    };
    Ok(draws.iter().enumerate().filter_map(trial).collect())
}

fn table_of(scenes: &[Vec<ReleaseTrial>], variants: &[Variant]) -> DiscriminatorTable {
    let of = |keep: &dyn Fn(&ReleaseTrial) -> bool| -> Vec<Vec<ReleaseTrial>> {
        scenes.iter().map(|trials| trials.iter().copied().filter(|t| keep(t)).collect()).collect()
    };
    let random = of(&|t| t.variant.is_none());
    let mut random_stable = Rate::default();
    random.iter().flatten().for_each(|t| random_stable.count(t.judged.stable));
    DiscriminatorTable {
        scenes: scenes.len(),
        random_stable,
        random: Forecaster::ALL.map(|by| random_row(by, &random)).to_vec(),
        rows: variants.iter().map(|v| row(*v, &of(&|t| t.variant == Some(*v)))).collect(),
        trials: scenes.iter().flatten().copied().collect(),
    }
}

fn random_row(by: Forecaster, samples: &[Vec<ReleaseTrial>]) -> RandomRow {
    // What it said stands for realism from here on.
    let said = |t: &ReleaseTrial| Some(ReleaseTrial { realism: Some(by.said(t)?), ..*t });
    let samples: Vec<Vec<ReleaseTrial>> = samples.iter().map(|scene| scene.iter().filter_map(said).collect()).collect();
    let first: Vec<Vec<ReleaseTrial>> = samples.iter().map(|scene| scene.iter().copied().filter(|t| t.rank == 0).collect()).collect();
    let area = |groups: &[&Vec<ReleaseTrial>]| {
        area_under_curve(&groups.iter().flat_map(|g| g.iter()).filter_map(|t| Some((t.realism?, t.judged.stable))).collect::<Vec<_>>())
    };
    RandomRow {
        by,
        all: correlation(&samples),
        one_a_scene: correlation(&first),
        auc: area(&samples.iter().collect::<Vec<_>>()),
        auc_interval: interval(&samples, 1, area),
    }
}

fn row(variant: Variant, scenes: &[Vec<ReleaseTrial>]) -> VariantRow {
    let (mut confident, mut stable, mut stable_with_goal) = (Rate::default(), Rate::default(), Rate::default());
    for trials in scenes {
        confident.count(!trials.is_empty());
        if let Some(answer) = trials.iter().find(|t| t.rank == 0) {
            stable.count(answer.judged.stable);
            stable_with_goal.count(answer.judged.stable && answer.judged.goal);
        }
    }
    let answers: Vec<Vec<ReleaseTrial>> = scenes.iter().map(|s| s.iter().copied().filter(|t| t.rank == 0).collect()).collect();
    let forecasts: Vec<(f64, bool)> = scenes.iter().flatten().filter_map(|t| Some((t.realism?, t.judged.stable))).collect();
    let calibration = Calibration::of(&forecasts, 1);
    VariantRow { variant, confident, stable, stable_with_goal, correlation: correlation(&answers), calibration }
}

/// Realism against distance moved, outliers left out.
fn correlation(scenes: &[Vec<ReleaseTrial>]) -> Correlation {
    let pairs = |trials: &mut dyn Iterator<Item = &ReleaseTrial>| -> Vec<(f64, f64)> {
        let within = trials.filter(|t| t.judged.moved_m < OUTLIER_M);
        within.filter_map(|t| Some((t.realism?, t.judged.moved_m))).collect()
    };
    let all = pairs(&mut scenes.iter().flatten());
    let r = pearson_r(&all);
    let interval = interval(scenes, 2, |groups| pearson_r(&pairs(&mut groups.iter().flat_map(|g| g.iter()))));
    // What nothing is said of is no pair to be left out.
    let outliers = scenes.iter().flatten().filter(|t| t.realism.is_some() && t.judged.moved_m >= OUTLIER_M).count();
    Correlation { n: all.len(), outliers, r, p: r.and_then(|r| pearson_p(r, all.len())), interval }
}

#[cfg(test)]
mod tests {
    use super::*;
    use repose_belief::boosted_trees::BoostedTrees;
    use repose_networks::Models as Networks;
    use repose_networks::Weights;
    use repose_planner::learned::forecast::{Forecast, ForecastFitData, STABILITY};
    use repose_planner::learned::stability::names;

    fn trial(variant: Option<Variant>, rank: usize, realism: f64, moved_m: f64) -> ReleaseTrial {
        let judged = Judged { moved_m, stable: moved_m < 0.05, goal: true, clean: true };
        ReleaseTrial {
            seed: 1,
            variant,
            rank,
            realism: Some(realism),
            outcome: variant.is_none().then_some(1.0 - realism),
            best: None,
            judged,
        }
    }

    #[test]
    fn outliers_leave_the_correlation_but_not_the_area() {
        let scenes = vec![
            vec![trial(None, 0, 0.9, 0.0), trial(None, 1, 0.1, 0.8), trial(Some(Variant::Best), 0, 0.8, 0.01)],
            vec![trial(None, 0, 0.5, 0.2), trial(None, 1, 0.7, 0.1)],
        ];
        let table = table_of(&scenes, &[Variant::Best, Variant::Full]);
        let [discriminator, outcome, best] = &table.random[..] else { panic!("three forecasters") };
        assert_eq!((best.all.n, best.auc), (0, None), "it said nothing");
        assert_eq!((table.scenes, discriminator.all.n, discriminator.all.outliers, table.trials.len()), (2, 3, 1, 5));
        // (0.9, 0), (0.5, 0.2), (0.7, 0.1) lie on a falling line.
        assert!((discriminator.all.r.expect("defined") + 1.0).abs() < 1e-9);
        assert!((outcome.all.r.expect("defined") - 1.0).abs() < 1e-9);
        assert_eq!((discriminator.one_a_scene.n, discriminator.one_a_scene.p), (2, None));
        assert_eq!((discriminator.auc, outcome.auc, table.random_stable), (Some(1.0), Some(0.0), Rate { of: 1, n: 4 }));
        let [best, full] = &table.rows[..] else { panic!("two variants") };
        assert_eq!(
            (best.confident, best.stable, best.stable_with_goal),
            (Rate { of: 1, n: 2 }, Rate { of: 1, n: 1 }, Rate { of: 1, n: 1 })
        );
        assert!((best.calibration.error.expect("one forecast") - 0.2).abs() < 1e-9);
        assert_eq!((full.confident, full.stable, full.calibration.error), (Rate { of: 0, n: 2 }, Rate::default(), None));
    }

    #[test]
    fn placements_of_a_variant_that_asks_no_network_are_no_pairs_left_out() {
        let unsaid = ReleaseTrial { realism: None, ..trial(Some(Variant::Geometric), 0, 0.0, 0.9) };
        let table = table_of(&[vec![unsaid], vec![unsaid]], &[Variant::Geometric]);
        let geometric = &table.rows[0];
        assert_eq!((geometric.confident, geometric.correlation.n, geometric.correlation.outliers), (Rate { of: 2, n: 2 }, 0, 0));
    }

    #[test]
    fn two_scenes_give_a_table_within_its_bounds() {
        // Weights of one's own, whose stability says the same of everything.
        let stability = Forecast::new(&names(), BoostedTrees { bias: 0.0, trees: Vec::new() }, ForecastFitData::default()).expect("sound");
        let mut weights = Weights::embedded().expect("embedded weights");
        weights.info.forecasts.insert(STABILITY.to_owned(), serde_json::to_value(stability).expect("JSON"));
        let bytes = Weights::to_bytes(&weights.values, &weights.info).expect("weights");
        let engine = Engine::new(Networks::load(&bytes).expect("weights"), 1);
        let variants = vec![Variant::Geometric, Variant::Best];
        let settings = DiscriminatorSettings { samples: 3, variants, ..DiscriminatorSettings::default() };
        let mut told = 0;
        let table = evaluate_discriminator(Split::Validation, 2, &engine, &settings, |n| told = n).expect("a table");
        assert_eq!((table.scenes, told, table.random_stable.n), (2, 2, 6));
        assert!(
            table.trials.iter().all(|t| t.realism.is_none_or(|said| (0.0..=1.0).contains(&said)) && t.judged.moved_m >= 0.0),
            "{table:?}"
        );
        assert_eq!(table.rows[0].confident.n, 2);
        let of_best = |t: &&ReleaseTrial| t.variant == Some(Variant::Best);
        assert!(table.trials.iter().filter(of_best).all(|t| t.realism == Some(0.5)), "best goes by the stability given: {table:?}");
        assert!(table.trials.iter().filter(|t| t.variant.is_none()).all(|t| t.best.is_none_or(|said| said == 0.5)), "{table:?}");
        assert!(table.random.iter().all(|row| row.auc.is_none_or(|a| (0.0..=1.0).contains(&a))));
    }
}
