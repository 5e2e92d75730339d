//! Asking for a placement, and the answer.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::checks::{check_finite, check_range};
use crate::keys::validate_chunk;
use crate::relation::validate_goal;
use crate::{CallError, GoalTerm, Message, RigidTransform, SceneRef, limits};

/// Which method plans.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Variant {
    /// Whatever has the best joint rate on validation scenes.
    #[default]
    Best,
    /// The paper's full model, λ_f = 100.
    Full,
    /// The paper's full model with λ_f = 1.
    #[serde(rename = "full_lambda_1")]
    FullLambda1,
    /// λ_f = 0.
    NoDiscriminator,
    /// The prior's component means only, no noise.
    MeanOnly,
    /// −log π in place of the realism term.
    MdnPrior,
    /// No networks: support and clearance on the observed cloud, relations by rule.
    Geometric,
}

impl Variant {
    /// All variants.
    pub const ALL: [Self; 7] =
        [Self::Best, Self::Full, Self::FullLambda1, Self::NoDiscriminator, Self::MeanOnly, Self::MdnPrior, Self::Geometric];

    /// The name on the wire and on the command line.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Best => "best",
            Self::Full => "full",
            Self::FullLambda1 => "full_lambda_1",
            Self::NoDiscriminator => "no_discriminator",
            Self::MeanOnly => "mean_only",
            Self::MdnPrior => "mdn_prior",
            Self::Geometric => "geometric",
        }
    }
}

impl std::fmt::Display for Variant {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.as_str())
    }
}

/// Whether the object may be turned.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Rotation {
    /// Translation only.
    #[default]
    Fixed,
    /// Translation and a turn about world z.
    Yaw,
    /// The same, and where that gives too few answers the object may be set on another side of its believed shape that carries it.
    Stable,
}

/// A box in the world that the placed centroid must stay inside or out of.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RegionBox {
    /// Lowest corner, world frame, metres.
    pub min_m: [f64; 3],
    /// Highest corner, world frame, metres.
    pub max_m: [f64; 3],
    /// Whether to stay inside (`true`) or out.
    pub inside: bool,
}

/// Search effort, each over the variant's default, which is the paper's but for `best` (3 iterations), `mean_only` (1 iteration, whatever
/// is asked) and both `best` and `geometric` (a batch of 200, 5 times).
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Budget {
    /// Iterations of the cross-entropy method (5).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub iterations: Option<u32>,
    /// Accepted candidates wanted per iteration (100). A later iteration shares them among the places that are searched apart.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub batch: Option<u32>,
    /// Candidates that the next iteration is fitted to (20).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub elites: Option<u32>,
    /// At most this many times `batch` candidates are drawn per iteration (3); of the learned prior at most 4096.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub draws_per_batch: Option<u32>,
    /// Time after which the best so far is returned as `partial`, milliseconds. Results then depend on the machine.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time_ms: Option<u64>,
}

/// Weights of the cost, each over the variant's default. Echoed whether the variant reads them or not.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CostWeights {
    /// λ_f (100; 1 for `best`, `full_lambda_1` and `geometric`), of what stands for realism: the discriminator; for `best` the probability
    /// that it stays and how soundly it stands; for `geometric` the latter; for `mdn_prior` −log π. `no_discriminator` (0) does not read it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub realism: Option<f64>,
    /// λ_ρ (1).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub relations: Option<f64>,
}

/// Least probabilities, each over the variant's default. Echoed whether the variant reads them or not.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct Thresholds {
    /// ε_f (0.5; 0.05 for `best`). Read by `best`, `full`, `full_lambda_1` and `mean_only`; the others do not constrain realism.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub realism: Option<f64>,
    /// ε_ρ (0.5). Not read by `best` and `geometric`, where the goal must hold by rule.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub relations: Option<f64>,
}

/// The robot that is to carry a placement out: an arm whose hand must be able to get there.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ReachingRobot {
    /// Its name in the cell.
    pub name: String,
    /// Pose of its base. Where absent the planner takes what its configuration says of a robot of that name, or refuses with
    /// `failed_precondition`; the result says what was used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub world_from_base: Option<RigidTransform>,
}

impl ReachingRobot {
    /// Checks the name and the pose.
    ///
    /// # Errors
    /// `invalid_argument` that names the field below `field`.
    pub fn validate(&self, field: &str) -> Result<(), CallError> {
        validate_chunk(&format!("{field}.name"), &self.name)?;
        self.world_from_base.as_ref().map_or(Ok(()), |pose| pose.validate(&format!("{field}.world_from_base")))
    }
}

fn one() -> u32 {
    1
}

/// Where can `query` be set down so that `goal` holds and it stays?
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PlaceRequest {
    /// The scene. The bulk form of the request encloses it.
    pub scene: SceneRef,
    /// The object to move.
    pub query: u16,
    /// What must hold, all of it.
    pub goal: Vec<GoalTerm>,
    /// The viewer's direction; the camera's where absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub view_yaw_rad: Option<f64>,
    /// How many distinct placements are wanted.
    #[serde(default = "one")]
    pub count: u32,
    /// How far apart the centroids of two answers must be, metres (0.03).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub min_separation_m: Option<f64>,
    /// Whether the object may be turned.
    #[serde(default)]
    pub rotation: Rotation,
    /// Boxes to stay inside or out of, 64 at most.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub region: Vec<RegionBox>,
    /// Least [`Placement::clearance_m`], metres, 1 at most: farther than that around an object, a view seldom shows what is there.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub min_clearance_m: Option<f64>,
    /// Least [`Placement::success`], 0 to 1: where nothing is as sure as that, the answer is "none". Default of `best`: 0.5; 0 takes
    /// whatever there is. More than 0 is refused for variants that do not say how sure they are (`failed_precondition`).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub min_success: Option<f64>,
    /// Who carries the placement out: places beyond this robot's reach are no answers.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot: Option<ReachingRobot>,
    /// The source of every random number.
    #[serde(default)]
    pub seed: u64,
    /// Which method plans.
    #[serde(default)]
    pub variant: Variant,
    /// Search effort.
    #[serde(default)]
    pub budget: Budget,
    /// Weights of the cost.
    #[serde(default)]
    pub cost_weights: CostWeights,
    /// Least probabilities.
    #[serde(default)]
    pub thresholds: Thresholds,
}

impl PlaceRequest {
    /// A request with every default.
    pub fn new(scene_id: String, query: u16, goal: Vec<GoalTerm>) -> Self {
        Self {
            scene: SceneRef { scene_id },
            query,
            goal,
            view_yaw_rad: None,
            count: 1,
            min_separation_m: None,
            rotation: Rotation::Fixed,
            region: Vec::new(),
            min_clearance_m: None,
            min_success: None,
            robot: None,
            seed: 0,
            variant: Variant::Best,
            budget: Budget::default(),
            cost_weights: CostWeights::default(),
            thresholds: Thresholds::default(),
        }
    }

    /// The anchor that offsets are taken from: that of the first positive term.
    pub fn main_anchor(&self) -> Option<u16> {
        self.goal.iter().find(|t| t.holds).map(|t| t.anchor)
    }
}

impl Message for PlaceRequest {
    const SCHEMA: &'static str = "PlaceRequest.v1";

    fn validate(&self) -> Result<(), CallError> {
        self.scene.validate()?;
        if self.query == 0 {
            return Err(CallError::invalid("query", "0 is the background, not an object"));
        }
        validate_goal(&self.goal, self.query)?;
        check_finite("view_yaw_rad", self.view_yaw_rad.as_slice())?;
        check_range("count", f64::from(self.count), 1.0..=limits::MAX_PLACEMENTS as f64)?;
        self.min_separation_m.map_or(Ok(()), |v| check_range("min_separation_m", v, 0.0..=limits::MAX_SEPARATION_M))?;
        self.min_clearance_m.map_or(Ok(()), |v| check_range("min_clearance_m", v, 0.0..=limits::MAX_CLEARANCE_M))?;
        self.min_success.map_or(Ok(()), |v| check_range("min_success", v, 0.0..=1.0))?;
        self.robot.as_ref().map_or(Ok(()), |robot| robot.validate("robot"))?;
        check_range("region", self.region.len() as f64, 0.0..=limits::MAX_REGIONS as f64)?;
        for (i, region) in self.region.iter().enumerate() {
            check_finite(&format!("region[{i}].min_m"), &region.min_m)?;
            check_finite(&format!("region[{i}].max_m"), &region.max_m)?;
            if (0..3).any(|k| region.min_m[k] > region.max_m[k]) {
                return Err(CallError::invalid(format!("region[{i}]"), "min_m must not exceed max_m"));
            }
        }
        let counts = [
            ("budget.iterations", self.budget.iterations, 100.0),
            ("budget.batch", self.budget.batch, 1000.0),
            ("budget.elites", self.budget.elites, 1000.0),
            ("budget.draws_per_batch", self.budget.draws_per_batch, 100.0),
        ];
        for (field, value, most) in counts {
            value.map_or(Ok(()), |v| check_range(field, f64::from(v), 1.0..=most))?;
        }
        self.budget.time_ms.map_or(Ok(()), |v| check_range("budget.time_ms", v as f64, 1.0..=limits::MAX_REMAINING_MS as f64))?;
        let weights = [("cost_weights.realism", self.cost_weights.realism), ("cost_weights.relations", self.cost_weights.relations)];
        for (field, value) in weights {
            value.map_or(Ok(()), |v| check_range(field, v, 0.0..=1e6))?;
        }
        for (field, value) in [("thresholds.realism", self.thresholds.realism), ("thresholds.relations", self.thresholds.relations)] {
            value.map_or(Ok(()), |v| check_range(field, v, 0.0..=1.0))?;
        }
        Ok(())
    }
}

/// How a search ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// The whole budget was spent and there is at least one placement.
    Found,
    /// The whole budget was spent and nothing passed.
    None,
    /// Time ended after at least one iteration; the placements, if any, are the best so far.
    Partial,
}

/// What rejected a candidate: the first constraint that failed, in the order in which they are tried.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Rejection {
    /// It leans on something, and would tip wherever it is set down as it lies; another side may carry it (`rotation`: `stable`).
    Tips,
    /// Something rests against it, and would come down when it is taken away.
    Unsettles,
    /// Outside an asked region, or inside a forbidden one.
    Region,
    /// Not enough of it would be seen: outside the picture, or behind something.
    OutOfView,
    /// It would run into something.
    Collision,
    /// Nearer to something than the asked clearance.
    Clearance,
    /// Nothing under it, or too little.
    Unsupported,
    /// Beyond the reach of the robot that the request names.
    OutOfReach,
    /// A goal term would not hold.
    Goal,
    /// The discriminator does not believe it; for `best`, of its shortlist only: it is not likely enough to stay.
    Unrealistic,
    /// Of the shortlist of `best` only: its success is less likely than the request demands.
    Unsure,
}

impl Rejection {
    /// All reasons, in their order.
    pub const ALL: [Self; 11] = [
        Self::Tips,
        Self::Unsettles,
        Self::Region,
        Self::OutOfView,
        Self::Collision,
        Self::Clearance,
        Self::Unsupported,
        Self::OutOfReach,
        Self::Goal,
        Self::Unrealistic,
        Self::Unsure,
    ];
}

/// A goal term by rule on shapes completed from the observed clouds, independent of any network.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct GeometricCheck {
    /// Whether the term (negation included) holds.
    pub holds: bool,
    /// By how much, metres (radians for `aligned`): positive when it holds.
    pub margin_m: f64,
}

/// One answer. Numbers that nobody evaluated are null.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Placement {
    /// The motion of world space that carries the object's observed points to the placed ones.
    pub placed_from_observed: RigidTransform,
    /// The cost that ranked it.
    pub cost: f64,
    /// The discriminator's probability; for `best` the probability of moving less than 5 cm when released, by boosted trees on the outcome
    /// network and geometry. Null where neither was asked.
    pub realism: Option<f64>,
    /// The probability that it succeeds: the object stays where it is let go and does not tip, every goal term holds afterwards by the true
    /// shapes, nothing else is moved, and it is not put into anything. Calibrated on releases in scenes that nothing else was fitted on.
    /// Absent where nobody evaluated it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub success: Option<f64>,
    /// Probability of each goal term as asked (a negated term: of not holding); by rule 0 or 1 for `geometric`.
    pub relations: Vec<f64>,
    /// The same terms by rule.
    pub geometric: Vec<GeometricCheck>,
    /// How far inside the outline of the carried part of its base the axis is in which its centre of mass is believed to be, metres;
    /// negative: beyond its edge. Null when nothing carries it.
    pub support_m: Option<f64>,
    /// Least distance to everything but what carries it and what a goal term asks to touch, metres, hidden backs of objects included; 0 in
    /// contact or overlap. Furniture below its bottom counts as what carries it, other objects count at any height. Null when nothing else
    /// was seen.
    pub clearance_m: Option<f64>,
}

/// The term whose removal would have admitted the most candidates; never the only one that must hold.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Relaxation {
    /// The goal term to give up.
    pub term: GoalTerm,
    /// How many of the candidates drawn would have passed without it; where networks decide that, an estimate from an even sample.
    pub admits: u64,
}

/// Why there are fewer placements than were asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ShortfallReason {
    /// Every other candidate that passed is closer than `min_separation_m` to a placement.
    Separation,
    /// Of the candidates that are far enough apart, no other passed: see the rejections.
    Constraints,
    /// Time ended, or the limit of questions to the networks was reached, before all candidates that are far enough apart were asked about.
    Budget,
}

/// Fewer placements than were asked for, and why.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Shortfall {
    /// What limited the number of placements.
    pub reason: ShortfallReason,
    /// Candidates that passed every constraint.
    pub passed: u64,
    /// Of those, candidates closer than `min_separation_m` to a placement that they do not stand for.
    pub too_close: u64,
}

/// The answer to a [`PlaceRequest`]: identical bytes for the same request, weights and kernel, unless time ended it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PlaceResult {
    /// How the search ended.
    pub outcome: Outcome,
    /// The answers, best first; may be empty. Where the candidates that `best` ranks are too close together to give `count`, farther ones
    /// that were ranked to make up for that come last, best first too.
    pub placements: Vec<Placement>,
    /// Candidates rejected, by reason.
    pub rejections: BTreeMap<Rejection, u64>,
    /// Where there is no placement: where rejected candidates' centroids were, world frame, metres; an even sample of at most 48 by reason.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub rejected_at_m: BTreeMap<Rejection, Vec<[f32; 3]>>,
    /// The smallest relaxation that would have helped.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub relaxation: Option<Relaxation>,
    /// Why there is a placement but fewer than `count`; absent otherwise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shortfall: Option<Shortfall>,
    /// Iterations done.
    pub iterations: u32,
    /// Candidates drawn.
    pub evaluated: u64,
    /// BLAKE3 of the weights; empty for `geometric`.
    pub weights_hash: String,
    /// BLAKE3 of everything learned that the answers rest on: the weights with their forecasts, where they were asked, and what comes with the planner
    /// to complete shapes and to tell what bears what.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub models_hash: String,
    /// The kernels that the answers were computed with: the one that scored, where one did, and the planner's own, by which shapes are completed,
    /// where that is another (`avx2-1+plain-1`).
    pub kernel: String,
    /// The request's seed.
    pub seed: u64,
    /// The scene planned on.
    pub scene_id: String,
    /// The camera's pose in the world frame that placements are given in; estimated where the frame had none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub world_from_camera: Option<RigidTransform>,
    /// The object to move.
    pub query: u16,
    /// The goal.
    pub goal: Vec<GoalTerm>,
    /// The variant used, as it was asked for.
    pub variant: Variant,
    /// The rotation mode used.
    pub rotation: Rotation,
    /// The viewer used.
    pub view_yaw_rad: f64,
    /// Distinct placements wanted.
    pub count: u32,
    /// The separation used, metres.
    pub min_separation_m: f64,
    /// The clearance used, metres.
    pub min_clearance_m: f64,
    /// The least success used; none for variants that do not say how sure they are.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub min_success: Option<f64>,
    /// The robot whose reach was a constraint, with the pose of its base that was used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub robot: Option<ReachingRobot>,
    /// The budget used.
    pub budget: Budget,
    /// The weights, asked for or the variant's default.
    pub cost_weights: CostWeights,
    /// The thresholds, asked for or the variant's default.
    pub thresholds: Thresholds,
}

impl Message for PlaceResult {
    const SCHEMA: &'static str = "PlaceResult.v1";
}

/// Progress of a search, sent after every iteration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PlaceProgress {
    /// Iterations done.
    pub iterations: u32,
    /// Candidates drawn.
    pub evaluated: u64,
    /// The best so far.
    pub best: Option<Placement>,
}

impl Message for PlaceProgress {
    const SCHEMA: &'static str = "PlaceProgress.v1";
}
