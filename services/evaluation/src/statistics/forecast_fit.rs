//! The fit of a forecast: boosted trees on what was measured of places, for what became of them.

use forust_ml::gradientbooster::GrowPolicy;
use forust_ml::objective::ObjectiveType;
use forust_ml::sampler::SampleMethod;
use forust_ml::tree::Tree as FittedTree;
use forust_ml::{GradientBooster, Matrix};
use repose_belief::boosted_trees::{BoostedTrees, Branch, DecisionTree, TreeSplit};
use repose_planner::learned::forecast::{Forecast, ForecastFitData};

/// One training sample of a forecast.
#[derive(Debug, Clone, PartialEq)]
pub struct FitSample {
    /// What was measured before it was let go, in the order of the forecast's names.
    pub measures: Vec<f32>,
    /// Whether it came true.
    pub came_true: bool,
}

/// How trees are fitted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FitSettings {
    /// Trees.
    pub trees: usize,
    /// Leaves of a tree.
    pub leaves: usize,
    /// Share of what a tree would say that it says.
    pub learning_rate: f32,
    /// Ridge on what leaves say.
    pub ridge: f32,
    /// The least curvature of the likelihood that a leaf must have: a release adds a quarter at most.
    pub least_curvature: f32,
    /// Share of the releases, and of the measures, that a tree sees.
    pub releases_share: f32,
    /// See `releases_share`.
    pub measures_share: f64,
    /// Seed of what each tree sees.
    pub seed: u64,
}

impl Default for FitSettings {
    fn default() -> Self {
        Self {
            trees: 250,
            leaves: 64,
            learning_rate: 0.04,
            ridge: 5.0,
            least_curvature: 5.0,
            releases_share: 0.5,
            measures_share: 0.5,
            seed: 1,
        }
    }
}

impl FitSettings {
    /// For ten thousand objects and more, each seen more than once: between the two others. Chosen on training scenes held out.
    pub fn of_objects(seed: u64) -> Self {
        Self { trees: 400, leaves: 12, learning_rate: 0.05, releases_share: 0.6, seed, ..Self::default() }
    }

    /// For some hundred thousand levels of some ten thousand objects: of what was tried, the fewest wrong objects held out for trees that are quick.
    pub fn of_levels(seed: u64) -> Self {
        Self { trees: 250, leaves: 32, learning_rate: 0.15, releases_share: 0.7, measures_share: 0.8, seed, ..Self::default() }
    }

    /// For some hundred thousand ends of ten thousand objects and more, each asked at several steps.
    pub fn of_steps(seed: u64) -> Self {
        Self {
            trees: 240,
            leaves: 24,
            learning_rate: 0.12,
            least_curvature: 20.0,
            releases_share: 0.6,
            measures_share: 0.6,
            seed,
            ..Self::default()
        }
    }

    /// For lengths of ten thousand objects: of what was tried, the least error on training scenes held out.
    pub fn of_lengths(seed: u64) -> Self {
        Self { trees: 160, leaves: 12, learning_rate: 0.07, least_curvature: 20.0, releases_share: 0.7, seed, ..Self::default() }
    }

    /// For ten thousand answers and more, several of one scene: small trees that say little each. So many that they say as much as came true on
    /// training scenes held out: half as many stop half way, between what they know and what all answers come to.
    pub fn of_few(seed: u64) -> Self {
        Self {
            trees: 1000,
            leaves: 6,
            learning_rate: 0.05,
            ridge: 10.0,
            least_curvature: 8.0,
            releases_share: 0.6,
            seed,
            ..Self::default()
        }
    }
}

/// Why there is no fit.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct NoFit(String);

/// Fits what came true by the largest likelihood. The same samples in the same order give the same bits.
///
/// # Errors
/// When there is nothing to learn from: fewer samples than leaves of a tree, or all came to the same.
pub fn fit_forecast(names: &[&str], samples: &[FitSample], fitted_on: ForecastFitData, settings: &FitSettings) -> Result<Forecast, NoFit> {
    Forecast::new(names, fit_log_odds(samples, settings)?, fitted_on).map_err(|e| NoFit(e.to_string()))
}

/// Fits the logarithm of the odds that a sample comes true, by the largest likelihood. The same samples in the same order give the same bits.
///
/// # Errors
/// As [`fit_forecast`].
pub fn fit_log_odds(samples: &[FitSample], settings: &FitSettings) -> Result<BoostedTrees, NoFit> {
    let came_true = samples.iter().filter(|s| s.came_true).count();
    if samples.len() < settings.leaves || came_true == 0 || came_true == samples.len() {
        return Err(NoFit(format!(
            "expected at least {} samples, some that came true and some that did not; got {}, of which {came_true} did",
            settings.leaves,
            samples.len()
        )));
    }
    let booster = boosted_likelihood(samples[0].measures.len(), samples, settings).map_err(|e| NoFit(e.to_string()))?;
    let trees = booster.trees.iter().map(served).collect::<Result<_, NoFit>>()?;
    Ok(BoostedTrees { bias: booster.base_score, trees })
}

/// Fits numbers by least squares, from measures of the same length. The same samples in the same order give the same bits.
///
/// # Errors
/// When there is nothing to learn from: fewer samples than leaves of a tree.
pub fn fit_lengths(samples: &[(Vec<f32>, f64)], settings: &FitSettings) -> Result<BoostedTrees, NoFit> {
    let Some((first, _)) = samples.first().filter(|_| samples.len() >= settings.leaves) else {
        return Err(NoFit(format!("expected at least {} objects, got {}", settings.leaves, samples.len())));
    };
    let rows: Vec<&[f32]> = samples.iter().map(|(measures, _)| measures.as_slice()).collect();
    let wanted: Vec<f64> = samples.iter().map(|(_, value)| *value).collect();
    let booster = boosted(first.len(), &rows, &wanted, ObjectiveType::SquaredLoss, settings).map_err(|e| NoFit(e.to_string()))?;
    let trees = booster.trees.iter().map(served).collect::<Result<_, NoFit>>()?;
    Ok(BoostedTrees { bias: booster.base_score, trees })
}

/// What was measured, one measure of all samples after the other.
fn columns(count: usize, rows: &[&[f32]]) -> Vec<f64> {
    (0..count).flat_map(|k| rows.iter().map(move |row| f64::from(row[k]))).collect()
}

fn boosted_likelihood(
    count: usize,
    samples: &[FitSample],
    settings: &FitSettings,
) -> Result<GradientBooster, forust_ml::errors::ForustError> {
    let rows: Vec<&[f32]> = samples.iter().map(|s| s.measures.as_slice()).collect();
    let came_true: Vec<f64> = samples.iter().map(|s| f64::from(u8::from(s.came_true))).collect();
    boosted(count, &rows, &came_true, ObjectiveType::LogLoss, settings)
}

fn boosted(
    count: usize,
    rows: &[&[f32]],
    wanted: &[f64],
    objective: ObjectiveType,
    settings: &FitSettings,
) -> Result<GradientBooster, forust_ml::errors::ForustError> {
    let measured = columns(count, rows);
    let mut booster = GradientBooster::default()
        .set_objective_type(objective)
        .set_initialize_base_score(true)
        .set_iterations(settings.trees)
        .set_max_leaves(settings.leaves)
        .set_max_depth(settings.leaves)
        .set_learning_rate(settings.learning_rate)
        .set_l2(settings.ridge)
        .set_min_leaf_weight(settings.least_curvature)
        .set_sample_method(SampleMethod::Random)
        .set_subsample(settings.releases_share)
        .set_colsample_bytree(settings.measures_share)
        .set_seed(settings.seed)
        // Sums must not depend on how many threads share them.
        .set_parallel(false);
    booster.grow_policy = GrowPolicy::LossGuide;
    booster.fit_unweighted(&Matrix::new(&measured, rows.len(), count), wanted, None)?;
    Ok(booster)
}

/// A fitted tree as it is served: splits and leaves apart, splits in the order in which they are reached from the root.
fn served(fitted: &FittedTree) -> Result<DecisionTree, NoFit> {
    let mut tree = DecisionTree::default();
    add(&mut tree, fitted, 0)?;
    Ok(tree)
}

fn add(tree: &mut DecisionTree, fitted: &FittedTree, node: usize) -> Result<Branch, NoFit> {
    let node = fitted.nodes.get(node).ok_or_else(|| NoFit("a tree lacks a node".to_owned()))?;
    let index = |length: usize| u16::try_from(length).map_err(|_| NoFit("a tree has more than 65,536 leaves".to_owned()));
    if node.is_leaf {
        let leaf = Branch::Leaf(index(tree.leaves.len())?);
        tree.leaves.push(node.weight_value);
        return Ok(leaf);
    }
    let at = tree.splits.len();
    let split = Branch::Split(index(at)?);
    // Measures are of single precision, and the trees were cut at such.
    tree.splits.push(TreeSplit(node.split_feature as u8, node.split_value as f32, [split; 2]));
    for (k, child) in [node.left_child, node.right_child].into_iter().enumerate() {
        tree.splits[at].2[k] = add(tree, fitted, child)?;
    }
    Ok(split)
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;

    use super::*;

    const COUNT: usize = 12;

    fn names() -> Vec<&'static str> {
        vec!["a", "b", "c", "d", "e", "f", "g", "h", "i", "j", "k", "l"]
    }

    fn probability(m: &[f32]) -> f64 {
        let logit = f64::from(2.0 * m[0] - 3.0 * m[7] * m[9] + if m[3] > 0.2 { 1.5 } else { -0.5 });
        1.0 / (1.0 + (-logit).exp())
    }

    fn samples(count: usize, seed: u64) -> Vec<FitSample> {
        let mut rng = Pcg64::seed_from_u64(seed);
        let mut draw = || {
            let measures: Vec<f32> = (0..COUNT).map(|_| rng.random_range(-1.0..1.0)).collect();
            FitSample { came_true: rng.random_bool(probability(&measures)), measures }
        };
        (0..count).map(|_| draw()).collect()
    }

    fn fitted(samples: &[FitSample], settings: &FitSettings) -> Result<Forecast, NoFit> {
        fit_forecast(&names(), samples, ForecastFitData::default(), settings)
    }

    #[test]
    fn a_fit_finds_the_probabilities_that_made_the_releases() {
        let fit = fitted(&samples(8000, 4), &FitSettings::default()).unwrap();
        let new = samples(2000, 5);
        let off = |of: &dyn Fn(&FitSample) -> f64| new.iter().map(|s| (of(s) - probability(&s.measures)).abs()).sum::<f64>() / 2000.0;
        let (fitted, nothing) = (off(&|s| fit.of(&s.measures)), off(&|_| 0.5));
        assert!(fitted < 0.12 && fitted < 0.45 * nothing, "off by {fitted}, knowing nothing by {nothing}");
        let said = new.iter().map(|s| fit.of(&s.measures)).sum::<f64>();
        let expected = new.iter().map(|s| probability(&s.measures)).sum::<f64>();
        assert!((said - expected).abs() < 40.0, "it says as many as come true: {said}, {expected}");
    }

    #[test]
    fn what_is_served_says_what_was_fitted() {
        let samples = samples(3000, 6);
        let settings = FitSettings { trees: 40, ..FitSettings::default() };
        let booster = boosted_likelihood(COUNT, &samples, &settings).unwrap();
        let rows: Vec<&[f32]> = samples.iter().map(|s| s.measures.as_slice()).collect();
        let logits = booster.predict(&Matrix::new(&columns(COUNT, &rows), samples.len(), COUNT), false);
        let served = fitted(&samples, &settings).unwrap();
        for (sample, logit) in samples.iter().zip(logits) {
            let expected = 1.0 / (1.0 + (-logit).exp());
            assert!((served.of(&sample.measures) - expected).abs() < 1e-6, "{} instead of {expected}", served.of(&sample.measures));
        }
        assert_eq!(fitted(&samples, &settings).unwrap(), served);
    }

    #[test]
    fn a_fit_finds_the_lengths() {
        let length = |m: &[f32]| f64::from(0.5 * m[0] + if m[3] > 0.2 { 1.0 } else { 0.0 });
        let of = |seed: u64| samples(4000, seed).into_iter().map(|s| (s.measures.clone(), length(&s.measures))).collect::<Vec<_>>();
        let trees = fit_lengths(&of(7), &FitSettings::of_lengths(1)).unwrap();
        let off = of(8).iter().map(|(measures, value)| (trees.of(measures) - value).abs()).sum::<f64>() / 4000.0;
        assert!(off < 0.06, "off by {off}");
        assert!(fit_lengths(&of(7)[..5], &FitSettings::of_lengths(1)).unwrap_err().to_string().contains("got 5"));
    }

    #[test]
    fn the_forecasts_that_come_with_the_program_are_of_its_outcome_network() {
        let weights = repose_networks::Weights::embedded().unwrap();
        let forecasts = repose_planner::Forecasts::read(&weights.info.forecasts).unwrap();
        let own = weights.outcome_hash();
        assert_eq!(forecasts.stability.fitted_on().outcome_hash, own);
        assert!(forecasts.success.is_none_or(|success| success.fitted_on().outcome_hash == own));
    }

    #[test]
    fn nothing_is_learned_from_too_little_or_from_what_is_all_the_same() {
        let refused = |samples: &[FitSample]| fitted(samples, &FitSettings::default()).unwrap_err().to_string();
        assert!(refused(&samples(50, 1)).contains("got 50"));
        let falls: Vec<FitSample> = samples(200, 1).into_iter().map(|s| FitSample { came_true: false, ..s }).collect();
        assert!(refused(&falls).contains("of which 0 did"));
    }
}
