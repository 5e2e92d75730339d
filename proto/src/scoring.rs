//! Asking inference: the prior, scores of candidates, and which weights are served.

use std::collections::BTreeMap;

use safetensors::Dtype;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::checks::{check_finite, check_range};
use crate::enclosed::{disclose, enclose};
use crate::place::Rotation;
use crate::{Bulk, CallError, Message, RELATION_COUNT, Scene, SceneRef, Tensor, limits};

/// Draws from the learned prior.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PriorRequest {
    /// The scene. The bulk form of the request encloses it.
    pub scene: SceneRef,
    /// The object to move.
    pub query: u16,
    /// The anchor that offsets are taken from.
    pub anchor: u16,
    /// Per relation: +1 must hold, −1 must not, 0 unspecified.
    pub goal: [i8; RELATION_COUNT],
    /// The viewer's direction, radians.
    pub view_yaw_rad: f64,
    /// Whether yaw is drawn too.
    pub rotation: Rotation,
    /// How many candidates.
    pub count: u32,
    /// The source of every random number.
    pub seed: u64,
}

impl Message for PriorRequest {
    const SCHEMA: &'static str = "PriorRequest.v1";

    fn validate(&self) -> Result<(), CallError> {
        self.scene.validate()?;
        check_finite("view_yaw_rad", &[self.view_yaw_rad])?;
        check_range("count", f64::from(self.count), 0.0..=limits::MAX_CANDIDATES as f64)?;
        match self.goal.iter().position(|g| !(-1..=1).contains(g)) {
            Some(i) => Err(CallError::invalid(format!("goal[{i}]"), format!("expected -1, 0 or 1, got {}", self.goal[i]))),
            None => Ok(()),
        }
    }
}

/// One component of the prior's mixture, over the offset δ from the anchor's centroid to the query's, in the viewer's axes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct MixtureComponent {
    /// Mixing weight; the weights sum to 1.
    pub weight: f64,
    /// Mean offset, viewer frame, metres.
    pub mean_m: [f64; 3],
    /// Standard deviation per axis, metres.
    pub sigma_m: [f64; 3],
    /// Mean yaw (von Mises), radians.
    pub yaw_mean_rad: f64,
    /// Concentration of the yaw (von Mises κ).
    pub yaw_concentration: f64,
}

impl MixtureComponent {
    /// Checks that it has a density: without a width, or with a weight below 0, every cost that is made of it would be no number.
    fn validate(&self, field: &str) -> Result<(), CallError> {
        check_range(&format!("{field}.weight"), self.weight, 0.0..=1e6)?;
        check_finite(&format!("{field}.mean_m"), &self.mean_m)?;
        for (k, sigma) in self.sigma_m.iter().enumerate() {
            check_range(&format!("{field}.sigma_m[{k}]"), *sigma, f64::MIN_POSITIVE..=1e6)?;
        }
        check_finite(&format!("{field}.yaw_mean_rad"), &[self.yaw_mean_rad])?;
        check_range(&format!("{field}.yaw_concentration"), self.yaw_concentration, 0.0..=1e6)
    }
}

/// The answer to a [`PriorRequest`]; in bulk form with `candidates` f32 `[n, 4]` and `components` u8 `[n]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct PriorReply {
    /// The mixture.
    pub mixture: Vec<MixtureComponent>,
    /// BLAKE3 of the weights.
    pub weights_hash: String,
    /// The kernel that computed it.
    pub kernel: String,
    /// World position of the object's centroid (x, y, z, metres) and yaw (radians), one row a candidate.
    #[serde(skip)]
    pub candidates: Vec<[f32; 4]>,
    /// The component that each candidate was drawn from.
    #[serde(skip)]
    pub components: Vec<u8>,
}

impl Message for PriorReply {
    const SCHEMA: &'static str = "PriorReply.v1";
}

impl PriorReply {
    /// The bulk form.
    pub fn to_bulk(&self) -> Bulk {
        let n = self.candidates.len();
        let mut bulk = Bulk::default();
        bulk.metadata.insert("reply".to_owned(), serde_json::to_string(self).unwrap_or_default());
        bulk.tensors.insert("candidates".to_owned(), Tensor::f32(&[n, 4], self.candidates.as_flattened()));
        bulk.tensors.insert("components".to_owned(), Tensor::u8(&[n], &self.components));
        bulk
    }

    /// Reads the bulk form.
    ///
    /// # Errors
    /// `invalid_argument` that names the field.
    pub fn from_bulk(bulk: &Bulk) -> Result<Self, CallError> {
        let mut reply: Self = crate::message::from_json(bulk.text("reply")?.as_bytes())?;
        reply.mixture.iter().enumerate().try_for_each(|(i, component)| component.validate(&format!("mixture[{i}]")))?;
        reply.candidates = bulk.finite_rows::<4>("candidates")?;
        let n = reply.candidates.len();
        reply.components = bulk.values::<u8>("components", Dtype::U8, &format!("[{n}]"), |s| s == [n])?.1;
        Ok(reply)
    }
}

/// Which network says how realistic a candidate is.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum RealismBy {
    /// The paper's scene discriminator: does this look like objects at rest?
    #[default]
    Discriminator,
    /// The outcome network: does the object stay where it is released? It learned from simulated releases. Where the weights served have none,
    /// the call is refused with `failed_precondition`.
    Outcome,
}

impl RealismBy {
    /// Left out on the wire, so that such requests are the same as before there was a choice.
    fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// Scores candidates; always in bulk form, with `candidates` f32 `[n, 4]` (position, yaw) or `[n, 7]` (position, quaternion x, y, z, w) beside the
/// JSON. The networks know turns about the vertical only: a quaternion that tips the object is refused.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ScoreRequest {
    /// The scene. The bulk form may enclose it.
    pub scene: SceneRef,
    /// The object to move.
    pub query: u16,
    /// The anchors whose relations are asked.
    pub anchors: Vec<u16>,
    /// The viewer's direction, radians.
    pub view_yaw_rad: f64,
    /// Whether realism is asked (the costly part).
    pub realism: bool,
    /// Who answers for realism.
    #[serde(default, skip_serializing_if = "RealismBy::is_default")]
    pub realism_by: RealismBy,
    /// Whether relations are asked.
    pub relations: bool,
    /// World position of the object's centroid (x, y, z, metres) and yaw (radians), one row a candidate.
    #[serde(skip)]
    pub candidates: Vec<[f32; 4]>,
}

impl Message for ScoreRequest {
    const SCHEMA: &'static str = "ScoreRequest.v1";

    fn validate(&self) -> Result<(), CallError> {
        self.scene.validate()?;
        check_finite("view_yaw_rad", &[self.view_yaw_rad])?;
        check_range("anchors", self.anchors.len() as f64, 0.0..=limits::MAX_GOAL_TERMS as f64)?;
        check_range("candidates", self.candidates.len() as f64, 0.0..=limits::MAX_CANDIDATES as f64)?;
        self.candidates.iter().enumerate().try_for_each(|(i, [x, y, z, _])| check_place(&format!("candidates[{i}]"), &[*x, *y, *z]))
    }
}

/// Refuses a candidate's place, metres, so far away that the networks' numbers overflow: what they answered would be no number.
///
/// # Errors
/// `invalid_argument` that names `field`.
pub fn check_place(field: &str, place: &[f32; 3]) -> Result<(), CallError> {
    let most_m = limits::MAX_CANDIDATE_COORDINATE_M;
    if place.iter().all(|v| v.abs() <= most_m) {
        return Ok(());
    }
    Err(CallError::invalid(field, format!("expected a place within {most_m} m of the origin, got {place:?}")))
}

impl ScoreRequest {
    /// The bulk form, with the scene enclosed if given.
    pub fn to_bulk(&self, scene: Option<&Scene>) -> Bulk {
        let mut bulk = enclose(self, scene);
        let shape = [self.candidates.len(), 4];
        bulk.tensors.insert("candidates".to_owned(), Tensor::f32(&shape, self.candidates.as_flattened()));
        bulk
    }

    /// Reads the bulk form: the request and the scene that it encloses, if any.
    ///
    /// # Errors
    /// `invalid_argument` that names the field.
    pub fn from_bulk(bulk: &Bulk) -> Result<(Self, Option<Scene>), CallError> {
        let (mut request, scene) = disclose::<Self>(bulk)?;
        let columns = bulk.tensors.get("candidates").and_then(|tensor| tensor.shape.get(1).copied());
        request.candidates = match columns {
            Some(7) => bulk.finite_rows::<7>("candidates")?.iter().enumerate().map(upright).collect::<Result<_, CallError>>()?,
            _ => bulk.finite_rows::<4>("candidates")?,
        };
        request.validate()?;
        Ok((request, scene))
    }
}

/// The row x, y, z, yaw of a pose that turns about the vertical only.
fn upright((i, [x, y, z, quaternion @ ..]): (usize, &[f32; 7])) -> Result<[f32; 4], CallError> {
    /// How far a quaternion's length may be from 1, and its axis from the vertical.
    const TOLERANCE: f32 = 1e-3;
    let [qx, qy, qz, qw] = *quaternion;
    let refused = |message: &str| Err(CallError::invalid(format!("candidates[{i}]"), message));
    if ((qx * qx + qy * qy + qz * qz + qw * qw).sqrt() - 1.0).abs() > TOLERANCE {
        return refused("expected a quaternion of length 1 (x, y, z, w) after the position");
    }
    if qx.hypot(qy) > TOLERANCE {
        return refused("only turns about the vertical can be scored, and this one tips the object");
    }
    // A quaternion and its negative are the same turn.
    let sign = if qw < 0.0 { -1.0 } else { 1.0 };
    Ok([*x, *y, *z, 2.0 * (sign * qz).atan2(sign * qw)])
}

/// The answer to a [`ScoreRequest`]; always in bulk form, with `realism` f32 `[n]` and `relations` f32 `[n, anchors, 10]` as asked.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ScoreReply {
    /// BLAKE3 of the weights.
    pub weights_hash: String,
    /// The kernel that computed it.
    pub kernel: String,
    /// Probability that the scene with the object there is realistic, one a candidate; empty when not asked.
    #[serde(skip)]
    pub realism: Vec<f32>,
    /// Probability of each relation, candidate by candidate, anchor by anchor; empty when not asked.
    #[serde(skip)]
    pub relations: Vec<[f32; RELATION_COUNT]>,
    /// How many anchors `relations` has per candidate.
    pub anchors: usize,
}

impl Message for ScoreReply {
    const SCHEMA: &'static str = "ScoreReply.v1";
}

impl ScoreReply {
    /// The bulk form.
    pub fn to_bulk(&self) -> Bulk {
        let mut bulk = Bulk::default();
        bulk.metadata.insert("reply".to_owned(), serde_json::to_string(self).unwrap_or_default());
        bulk.tensors.insert("realism".to_owned(), Tensor::f32(&[self.realism.len()], &self.realism));
        let n = self.relations.len() / self.anchors.max(1);
        let shape = [n, self.anchors, RELATION_COUNT];
        bulk.tensors.insert("relations".to_owned(), Tensor::f32(&shape, self.relations.as_flattened()));
        bulk
    }

    /// Reads the bulk form.
    ///
    /// # Errors
    /// `invalid_argument` that names the field.
    pub fn from_bulk(bulk: &Bulk) -> Result<Self, CallError> {
        let mut reply: Self = crate::message::from_json(bulk.text("reply")?.as_bytes())?;
        reply.realism = bulk.finite::<1>("realism", "[n]", |s| s.len() == 1)?.into_flattened();
        let anchors = reply.anchors;
        let fits = |s: &[usize]| matches!(s, [_, a, RELATION_COUNT] if *a == anchors);
        reply.relations = bulk.finite("relations", &format!("[n, {anchors}, {RELATION_COUNT}]"), fits)?;
        Ok(reply)
    }
}

/// Asks which weights are served.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ModelsRequest {}

impl Message for ModelsRequest {
    const SCHEMA: &'static str = "ModelsRequest.v1";
}

/// One set of weights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModelInfo {
    /// The network's name.
    pub name: String,
    /// BLAKE3 of its file.
    pub hash: String,
    /// How it was trained: recipe, data seed.
    pub recipe: serde_json::Value,
    /// What it measured on validation data.
    pub metrics: serde_json::Value,
}

/// The weights served.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ModelsReply {
    /// BLAKE3 over all of them: what `load` and results carry.
    pub weights_hash: String,
    /// The kernel in use.
    pub kernel: String,
    /// Each file.
    pub models: Vec<ModelInfo>,
}

impl Message for ModelsReply {
    const SCHEMA: &'static str = "ModelsReply.v1";
}

/// Asks for what was learned beside the networks.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ForecastsRequest {}

impl Message for ForecastsRequest {
    const SCHEMA: &'static str = "ForecastsRequest.v1";
}

/// What was learned beside the networks: part of the weights.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ForecastsReply {
    /// BLAKE3 of the weights that they are part of.
    pub weights_hash: String,
    /// Forecasts by name, in the form of the planner that reads them.
    pub forecasts: BTreeMap<String, serde_json::Value>,
}

impl Message for ForecastsReply {
    const SCHEMA: &'static str = "ForecastsReply.v1";
}
