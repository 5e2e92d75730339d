//! Every number that the planner can be told, with its default; and what each variant is made of.
//!
//! A request may change the budget, the weights, the thresholds, the separation and the clearance; the rest is fixed, so that the same
//! request gives the same answer everywhere.

pub mod fixed;
pub mod recipe;

use nalgebra::Isometry3;
use repose_geometry::transform::from_row_major;
use repose_proto::place::{Budget, CostWeights, PlaceRequest, Rotation, Thresholds, Variant};

pub use fixed::*;
pub use recipe::*;

/// A request's settings over its variant's defaults.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanSettings {
    /// The variant asked for.
    pub variant: Variant,
    /// What it is made of.
    pub recipe: Recipe,
    /// Whether yaw is searched.
    pub rotation: Rotation,
    /// Iterations, N.
    pub iterations: u32,
    /// Accepted candidates wanted per iteration, B.
    pub batch: usize,
    /// Candidates that the next iteration is fitted to.
    pub elites: usize,
    /// At most this many times `batch` are drawn per iteration.
    pub draws_per_batch: usize,
    /// Time after which the best so far is returned, milliseconds.
    pub time_ms: Option<u64>,
    /// λ_f.
    pub realism_weight: f64,
    /// λ_ρ.
    pub relations_weight: f64,
    /// ε_f.
    pub realism_threshold: f64,
    /// ε_ρ.
    pub relations_threshold: f64,
    /// Least distance between two answers, metres.
    pub min_separation_m: f64,
    /// Least distance from everything but the support, metres.
    pub min_clearance_m: f64,
    /// Least probability of success, where the weights in service say it.
    pub min_success: Option<f64>,
    /// Where the robot that carries a placement out has its base.
    pub world_from_base: Option<Isometry3<f64>>,
    /// Everything that requests cannot change.
    pub fixed: Fixed,
}

impl PlanSettings {
    /// The settings of a request.
    pub fn of(request: &PlaceRequest) -> Self {
        let (recipe, fixed) = (Recipe::of(request.variant), Fixed::default());
        let budget = &request.budget;
        // Other variants refuse to be asked for more than 0.
        let says_how_sure = recipe.realism == Realism::OutcomeRanks;
        // Without networks a candidate costs microseconds: search widely.
        let (batch, draws) = if recipe.grounded { (200, 5) } else { (100, 3) };
        // The outcome network doubts hardly seen places: where it doubts all places that geometry found, most are good all the same.
        let realism_threshold = if request.variant == Variant::Best { 0.05 } else { 0.5 };
        let (realism_weight, iterations) = match request.variant {
            Variant::FullLambda1 => (1.0, 5),
            Variant::NoDiscriminator => (0.0, 5),
            Variant::MeanOnly => (100.0, 1),
            Variant::Geometric => (1.0, 5),
            Variant::Best => (1.0, 3),
            Variant::Full | Variant::MdnPrior => (100.0, 5),
        };
        Self {
            variant: request.variant,
            recipe,
            rotation: request.rotation,
            // The means are there once: a second iteration would draw noise around them.
            iterations: if recipe.proposals == Proposals::PriorMeans { 1 } else { budget.iterations.unwrap_or(iterations) },
            batch: budget.batch.unwrap_or(batch) as usize,
            elites: budget.elites.unwrap_or(20) as usize,
            draws_per_batch: budget.draws_per_batch.unwrap_or(draws) as usize,
            time_ms: budget.time_ms,
            realism_weight: request.cost_weights.realism.unwrap_or(realism_weight),
            relations_weight: request.cost_weights.relations.unwrap_or(1.0),
            realism_threshold: request.thresholds.realism.unwrap_or(realism_threshold),
            relations_threshold: request.thresholds.relations.unwrap_or(0.5),
            min_separation_m: request.min_separation_m.unwrap_or(0.03),
            min_clearance_m: request.min_clearance_m.unwrap_or(0.0),
            min_success: says_how_sure.then(|| request.min_success.unwrap_or(fixed.ranking.min_success)),
            // A request without a pose is refused before, and one that is not rigid by its validation.
            world_from_base: request.robot.as_ref().and_then(|r| r.world_from_base).and_then(|pose| from_row_major(&pose.0).ok()),
            fixed,
        }
    }

    /// The budget to echo.
    pub fn budget(&self) -> Budget {
        Budget {
            iterations: Some(self.iterations),
            batch: Some(self.batch as u32),
            elites: Some(self.elites as u32),
            draws_per_batch: Some(self.draws_per_batch as u32),
            time_ms: self.time_ms,
        }
    }

    /// The weights to echo.
    pub fn cost_weights(&self) -> CostWeights {
        CostWeights { realism: Some(self.realism_weight), relations: Some(self.relations_weight) }
    }

    /// The thresholds to echo.
    pub fn thresholds(&self) -> Thresholds {
        Thresholds { realism: Some(self.realism_threshold), relations: Some(self.relations_threshold) }
    }
}
