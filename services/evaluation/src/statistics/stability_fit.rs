//! The fit of `best`'s stability: boosted trees on what was measured of places, for what became of them.

use forust_ml::gradientbooster::GrowPolicy;
use forust_ml::objective::ObjectiveType;
use forust_ml::sampler::SampleMethod;
use forust_ml::tree::Tree as FittedTree;
use forust_ml::{GradientBooster, Matrix};
use repose_planner::learned::boosted_trees::{BoostedTrees, Branch, DecisionTree, TreeSplit};
use repose_planner::learned::stability::{COUNT, FittedOn, ReleaseSample, Stability};

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

/// Why there is no fit.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct NoFit(String);

/// Fits releases by the largest likelihood. The same samples in the same order give the same bits.
///
/// # Errors
/// When there is nothing to learn from: fewer releases than leaves of a tree, or all came to the same.
pub fn fit_stability(samples: &[ReleaseSample], fitted_on: FittedOn, settings: &FitSettings) -> Result<Stability, NoFit> {
    let stable = samples.iter().filter(|s| s.stable).count();
    if samples.len() < settings.leaves || stable == 0 || stable == samples.len() {
        return Err(NoFit(format!(
            "expected at least {} releases, some stable and some not; got {}, {stable} of them stable",
            settings.leaves,
            samples.len()
        )));
    }
    let booster = boosted(samples, settings).map_err(|e| NoFit(e.to_string()))?;
    let trees = booster.trees.iter().map(served).collect::<Result<_, NoFit>>()?;
    Stability::new(BoostedTrees { bias: booster.base_score, trees }, fitted_on).map_err(|e| NoFit(e.to_string()))
}

/// What was measured, one measure of all samples after the other.
fn columns(samples: &[ReleaseSample]) -> Vec<f64> {
    (0..COUNT).flat_map(|k| samples.iter().map(move |s| f64::from(s.measures[k]))).collect()
}

fn boosted(samples: &[ReleaseSample], settings: &FitSettings) -> Result<GradientBooster, forust_ml::errors::ForustError> {
    let measured = columns(samples);
    let stable: Vec<f64> = samples.iter().map(|s| f64::from(u8::from(s.stable))).collect();
    let mut booster = GradientBooster::default()
        .set_objective_type(ObjectiveType::LogLoss)
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
    booster.fit_unweighted(&Matrix::new(&measured, samples.len(), COUNT), &stable, None)?;
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

    fn probability(m: &[f32; COUNT]) -> f64 {
        let logit = f64::from(2.0 * m[0] - 3.0 * m[7] * m[9] + if m[3] > 0.2 { 1.5 } else { -0.5 });
        1.0 / (1.0 + (-logit).exp())
    }

    fn samples(count: usize, seed: u64) -> Vec<ReleaseSample> {
        let mut rng = Pcg64::seed_from_u64(seed);
        let mut draw = || {
            let measures = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
            ReleaseSample { stable: rng.random_bool(probability(&measures)), measures }
        };
        (0..count).map(|_| draw()).collect()
    }

    #[test]
    fn a_fit_finds_the_probabilities_that_made_the_releases() {
        let fit = fit_stability(&samples(8000, 4), FittedOn::default(), &FitSettings::default()).unwrap();
        let new = samples(2000, 5);
        let off = |of: &dyn Fn(&ReleaseSample) -> f64| new.iter().map(|s| (of(s) - probability(&s.measures)).abs()).sum::<f64>() / 2000.0;
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
        let booster = boosted(&samples, &settings).unwrap();
        let logits = booster.predict(&Matrix::new(&columns(&samples), samples.len(), COUNT), false);
        let served = fit_stability(&samples, FittedOn::default(), &settings).unwrap();
        for (sample, logit) in samples.iter().zip(logits) {
            let expected = 1.0 / (1.0 + (-logit).exp());
            assert!((served.of(&sample.measures) - expected).abs() < 1e-6, "{} instead of {expected}", served.of(&sample.measures));
        }
        assert_eq!(fit_stability(&samples, FittedOn::default(), &settings).unwrap(), served);
    }

    #[test]
    fn the_stability_that_comes_with_the_program_is_of_the_weights_that_do() {
        let weights = repose_networks::Models::embedded().unwrap();
        assert_eq!(Stability::embedded().fitted_on().weights_hash, weights.hash());
    }

    #[test]
    fn nothing_is_learned_from_too_little_or_from_what_is_all_the_same() {
        let refused =
            |samples: &[ReleaseSample]| fit_stability(samples, FittedOn::default(), &FitSettings::default()).unwrap_err().to_string();
        assert!(refused(&samples(50, 1)).contains("got 50"));
        let falls: Vec<ReleaseSample> = samples(200, 1).into_iter().map(|s| ReleaseSample { stable: false, ..s }).collect();
        assert!(refused(&falls).contains("0 of them stable"));
    }
}
