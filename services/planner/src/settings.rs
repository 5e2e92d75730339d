//! Every number that the planner can be told, with its default; and what each variant of Table 1 is made of.
//!
//! A request may change the budget, the weights, the thresholds, the separation and the clearance; the rest is fixed, so that the same
//! request gives the same answer everywhere.

pub use crate::scene_settings::{SceneSettings, ShapeSettings, StackSettings};
use repose_proto::place::{Budget, CostWeights, PlaceRequest, Rotation, Thresholds, Variant};

/// Where the candidates of iteration 0 come from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Proposals {
    /// Drawn from the learned prior.
    Prior,
    /// The means of the prior's components, without noise.
    PriorMeans,
    /// From the goal's geometry.
    Geometric,
    /// Half from the learned prior, half from the goal's geometry.
    Both,
}

/// What decides whether a goal term holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GoalBy {
    /// The relation predictor, p > ε_ρ.
    Learned,
    /// The rules on completed shapes, by a margin.
    Rule,
    /// The rules decide; the predictor's probabilities rank.
    RuleRankedByLearned,
}

/// What stands for realism.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Realism {
    /// Nothing.
    Unasked,
    /// The scene discriminator, as a constraint f > ε_f and as a cost.
    Discriminator,
    /// What boosted trees make of the outcome network's word and geometry's measures, of what geometry finds best at the end of the
    /// search: geometry constrains the search; this ranks its shortlist, as a cost, and rejects what it believes no more than ε_f.
    OutcomeRanks,
    /// −log π of the prior, as a cost only.
    PriorDensity,
}

/// What a variant is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Recipe {
    /// Where candidates come from.
    pub proposals: Proposals,
    /// What decides the goal.
    pub goal_by: GoalBy,
    /// What stands for realism.
    pub realism: Realism,
    /// Whether candidates are set down on observed supports and must pass the geometric checks of support and collision.
    pub grounded: bool,
}

impl Recipe {
    /// The recipe of a variant.
    pub fn of(variant: Variant) -> Self {
        let paper = Self { proposals: Proposals::Prior, goal_by: GoalBy::Learned, realism: Realism::Discriminator, grounded: false };
        match variant {
            Variant::Full | Variant::FullLambda1 => paper,
            Variant::NoDiscriminator => Self { realism: Realism::Unasked, ..paper },
            Variant::MeanOnly => Self { proposals: Proposals::PriorMeans, ..paper },
            Variant::MdnPrior => Self { realism: Realism::PriorDensity, ..paper },
            Variant::Geometric => {
                Self { proposals: Proposals::Geometric, goal_by: GoalBy::Rule, realism: Realism::Unasked, grounded: true }
            }
            Variant::Best => {
                Self { proposals: Proposals::Both, goal_by: GoalBy::RuleRankedByLearned, realism: Realism::OutcomeRanks, grounded: true }
            }
        }
    }
}

/// A request's settings over its variant's defaults.
#[derive(Debug, Clone, PartialEq)]
pub struct Settings {
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
    /// Everything that requests cannot change.
    pub fixed: Fixed,
}

impl Settings {
    /// The settings of a request.
    pub fn of(request: &PlaceRequest) -> Self {
        let recipe = Recipe::of(request.variant);
        let budget = &request.budget;
        // Where networks do not judge every candidate, one costs microseconds: search widely.
        let (batch, draws) = if recipe.grounded { (200, 5) } else { (100, 3) };
        // The outcome network doubts whatever it hardly sees: where geometry has found places and it believes in none of them, most are good.
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
            fixed: Fixed::default(),
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

/// What requests cannot change.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Fixed {
    /// Ranking by networks.
    pub ranking: RankingSettings,
    /// The in-view constraint.
    pub view: ViewSettings,
    /// What is right under a candidate.
    pub support: SupportSettings,
    /// What is in a candidate's way.
    pub clearance: ClearanceSettings,
    /// Space that was not seen.
    pub unseen: UnseenSettings,
    /// Goals by rule.
    pub rules: RuleSettings,
    /// Proposals from the goal's geometry.
    pub proposals: ProposalSettings,
    /// Refitting.
    pub surrogate: SurrogateSettings,
    /// Ranking by geometry.
    pub soundness: SoundnessSettings,
}

/// Where networks only rank: what they are asked about once the search is done.
#[derive(Debug, Clone, PartialEq)]
pub struct RankingSettings {
    /// The candidates that geometry finds best, at most; levels of support take turns.
    pub candidates: usize,
    /// They are at least this far apart, metres.
    pub apart_m: f64,
    /// Each is tried again when it ends up this far off, metres …
    pub off_m: f32,
    /// … and this far turned, radians.
    pub off_rad: f32,
    /// Where those give fewer answers than asked, the networks are asked about farther ones, so many times at most.
    pub more_rounds: usize,
}

impl Default for RankingSettings {
    fn default() -> Self {
        Self { candidates: 32, apart_m: 0.012, off_m: 0.005, off_rad: 3.0_f32.to_radians(), more_rounds: 4 }
    }
}

/// Space that was not seen may hold anything.
#[derive(Debug, Clone, PartialEq)]
pub struct UnseenSettings {
    /// Largest share of the query's volume in it.
    pub max_share: f64,
    /// Distance between the places tried in the query's volume, metres.
    pub step_m: f32,
}

impl Default for UnseenSettings {
    fn default() -> Self {
        Self { max_share: 0.6, step_m: 0.015 }
    }
}

/// The in-view constraint.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewSettings {
    /// Least share of the moved points in the picture.
    pub min_in_picture: f64,
    /// Least share of the moved points that nothing hides.
    pub min_unhidden: f64,
    /// A point this far behind what was observed is not hidden yet, metres.
    pub behind_m: f32,
    /// Points of the query that are tried, at most.
    pub sample_points: usize,
}

impl Default for ViewSettings {
    fn default() -> Self {
        Self { min_in_picture: 0.9, min_unhidden: 0.3, behind_m: 0.01, sample_points: 256 }
    }
}

/// What is right under a candidate.
#[derive(Debug, Clone, PartialEq)]
pub struct SupportSettings {
    /// A top within this of the bottom carries it, metres. Covers the noise of depth and a tilt of 2° across an object.
    pub tolerance_m: f32,
    /// A place is empty when the camera saw at least this far past it, metres.
    pub through_m: f32,
    /// Share of the highest tops under the base that are taken for stray points.
    pub stray_share: f32,
    /// Tops within this of the highest belong to the same support, metres.
    pub same_support_m: f32,
    /// A support surface's own height is used where the tops agree with it to this, metres.
    pub plane_m: f32,
    /// How much above the support the bottom is put, metres. A bottom is known to a few millimetres; to fall by those is harmless, to be
    /// pressed into the support by them is not.
    pub release_m: f32,
    /// Least distance of the axis from the edge of what carries it, metres.
    pub min_margin_m: f64,
    /// Least share of the base that was seen to be carried.
    pub min_seen_share: f64,
}

impl Default for SupportSettings {
    fn default() -> Self {
        Self {
            tolerance_m: 0.008,
            through_m: 0.025,
            stray_share: 0.03,
            same_support_m: 0.012,
            plane_m: 0.008,
            release_m: 0.004,
            min_margin_m: 0.008,
            min_seen_share: 0.25,
        }
    }
}

/// What is in a candidate's way.
#[derive(Debug, Clone, PartialEq)]
pub struct ClearanceSettings {
    /// How far around the query clearance is measured during the search, metres.
    pub ring_m: f32,
    /// How far at most: wider clearances are measured by points, which takes longer.
    pub max_ring_m: f32,
    /// What reaches no deeper than this into the query's outline does not collide, metres (outlines are grown by the trim).
    pub graze_m: f32,
    /// The same for an anchor that must be touched.
    pub touch_m: f32,
    /// Up to this many cells in the way are stray points.
    pub stray_cells: usize,
    /// Or this share of the query's cells, whichever is more.
    pub stray_share: f32,
    /// Distances of answers are measured on points this far apart, metres.
    pub voxel_m: f32,
}

impl Default for ClearanceSettings {
    fn default() -> Self {
        Self { ring_m: 0.04, max_ring_m: 0.12, graze_m: 0.002, touch_m: 0.009, stray_cells: 2, stray_share: 0.01, voxel_m: 0.008 }
    }
}

/// Goals by rule.
#[derive(Debug, Clone, PartialEq)]
pub struct RuleSettings {
    /// Least margin by which a direction must hold (or not hold), metres: the pose will not be exact to the millimetre.
    pub min_margin_m: f64,
    /// A direction is as good as certain from this margin on, metres.
    pub comfort_m: f64,
    /// Heights of a bottom and a top this close are in contact, metres.
    pub contact_m: f64,
}

impl Default for RuleSettings {
    fn default() -> Self {
        Self { min_margin_m: 0.003, comfort_m: 0.06, contact_m: 0.009 }
    }
}

/// Proposals from the goal's geometry.
#[derive(Debug, Clone, PartialEq)]
pub struct ProposalSettings {
    /// Farthest gap between query and anchor along the asked direction, metres.
    pub reach_m: f64,
    /// Share of the proposals that come from anywhere on the observed surfaces (or in the asked regions) instead.
    pub anywhere_share: f64,
    /// Share of the proposals that are lowered from above everything; the others from just above a support surface.
    pub from_above_share: f64,
    /// A candidate is lowered from this far above where it was drawn, metres.
    pub lowered_m: f32,
}

impl Default for ProposalSettings {
    fn default() -> Self {
        Self { reach_m: 0.3, anywhere_share: 0.15, from_above_share: 0.5, lowered_m: 0.04 }
    }
}

/// Refitting the surrogate.
#[derive(Debug, Clone, PartialEq)]
pub struct SurrogateSettings {
    /// How far the sample covariance is drawn towards its diagonal.
    pub shrinkage: f64,
    /// Standard deviations added on top: x, y, z in metres, yaw in radians.
    pub floor: [f64; 4],
    /// With fewer feasible candidates than this, elites are chosen by least violation.
    pub min_feasible: usize,
    /// Most modes that are searched apart.
    pub max_modes: usize,
    /// Heights of one mode are at most this far apart, metres.
    pub level_gap_m: f32,
    /// Elites farther than this from their mode's best belong to another place, metres.
    pub reach_m: f64,
}

impl Default for SurrogateSettings {
    fn default() -> Self {
        Self {
            shrinkage: 0.3,
            floor: [0.005, 0.005, 0.002, 3.0_f64.to_radians()],
            min_feasible: 4,
            max_modes: 5,
            level_gap_m: 0.025,
            reach_m: 0.15,
        }
    }
}

/// Ranking by geometry: shortfalls from what would be comfortable, each 0 to 1, weighted.
#[derive(Debug, Clone, PartialEq)]
pub struct SoundnessSettings {
    /// Distance of the axis from the edge of its support that is comfortable, metres, or …
    pub support_m: f64,
    /// … this share of what the base allows at most, whichever is less.
    pub support_share: f64,
    /// Clearance that is comfortable, metres.
    pub clearance_m: f64,
    /// Width of the band around the base that should be carried too, metres.
    pub rim_m: f32,
    /// Weights: distance from the support's edge, base not seen to be carried, clearance, hidden share, band not carried, carried by
    /// an object that no term asks for, in space that was not seen, small errors of the pose that would not do, something where its unseen back may reach.
    pub weights: [f64; 9],
    /// Cost per metre of distance from the main anchor.
    pub distance_per_m: f64,
}

impl Default for SoundnessSettings {
    fn default() -> Self {
        Self {
            support_m: 0.03,
            support_share: 0.8,
            clearance_m: 0.03,
            rim_m: 0.02,
            weights: [0.5, 0.35, 0.35, 0.1, 0.3, 0.25, 0.3, 0.5, 0.3],
            distance_per_m: 0.3,
        }
    }
}
