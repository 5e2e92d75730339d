//! The paper's figures, to print beside ours (its Tables 1 and 2 with the appendix, and section 3).

use repose_proto::place::Variant;
use serde::Serialize;

/// Examples in the paper's Table 2.
pub const RELATION_EXAMPLES: usize = 2696;

/// One relation of the paper's Table 2 and its appendix. Shares are 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PaperRelation {
    /// Learned.
    pub f1: f64,
    /// Learned.
    pub sensitivity: f64,
    /// Learned.
    pub specificity: f64,
    /// Model-based.
    pub baseline_f1: f64,
    /// Model-based.
    pub baseline_sensitivity: f64,
    /// Model-based.
    pub baseline_specificity: f64,
    /// How often it holds, percent.
    pub true_percent: f64,
}

const fn row(learned: [f64; 3], baseline: [f64; 3], true_percent: f64) -> PaperRelation {
    let [f1, specificity, sensitivity] = learned;
    let [baseline_f1, baseline_specificity, baseline_sensitivity] = baseline;
    PaperRelation { f1, sensitivity, specificity, baseline_f1, baseline_sensitivity, baseline_specificity, true_percent }
}

/// In wire order; `aligned` is not in the paper's tables.
pub const RELATIONS: [Option<PaperRelation>; 10] = [
    Some(row([0.911, 0.973, 0.856], [0.914, 0.988, 0.851], 13.9)),
    Some(row([0.929, 0.969, 0.893], [0.885, 0.990, 0.800], 14.0)),
    Some(row([0.759, 0.970, 0.623], [0.660, 0.919, 0.514], 4.6)),
    Some(row([0.653, 0.978, 0.490], [0.852, 0.869, 0.834], 5.0)),
    Some(row([0.867, 0.995, 0.767], [0.784, 0.984, 0.651], 4.3)),
    Some(row([0.822, 0.994, 0.700], [0.756, 0.981, 0.615], 4.3)),
    Some(row([0.869, 0.937, 0.810], [0.825, 0.984, 0.711], 29.0)),
    Some(row([0.923, 0.979, 0.885], [0.418, 0.992, 0.265], 12.7)),
    Some(row([0.659, 0.976, 0.497], [0.035, 1.000, 0.018], 5.6)),
    None,
];

/// Stable placements of confident scenes, percent.
pub const STABLE_PERCENT: f64 = 95.0;
/// Stable placements with the goal, percent.
pub const STABLE_WITH_GOAL_PERCENT: f64 = 90.0;
/// Realism against distance moved, one random prior sample a scene: r and p.
pub const RANDOM_R: (f64, f64) = (-0.147, 0.161);
/// The same of the planner's placements.
pub const PLANNED_R: (f64, f64) = (-0.278, 0.006);

/// One row of the paper's Table 1, percent of 100 kitchen scenes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PaperVariant {
    /// Which variant.
    pub variant: Variant,
    /// Found predicates.
    pub predicates: f64,
    /// Found realistic.
    pub realistic: f64,
    /// Both.
    pub successful: f64,
    /// Stable pose.
    pub stable: f64,
}

const fn variant(variant: Variant, [predicates, realistic, successful, stable]: [f64; 4]) -> PaperVariant {
    PaperVariant { variant, predicates, realistic, successful, stable }
}

/// The paper's Table 1.
pub const VARIANTS: [PaperVariant; 5] = [
    variant(Variant::Full, [93.0, 87.0, 84.0, 71.0]),
    variant(Variant::FullLambda1, [94.0, 81.0, 78.0, 67.0]),
    variant(Variant::NoDiscriminator, [100.0, 3.0, 3.0, 25.0]),
    variant(Variant::MeanOnly, [96.0, 27.0, 27.0, 39.0]),
    variant(Variant::MdnPrior, [99.0, 6.0, 6.0, 42.0]),
];
