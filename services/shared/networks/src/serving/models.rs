//! The networks as a service uses them: prior, relations, realism.

use std::sync::Arc;

use crate::{
    config::{GOAL_RELATIONS, NetworksConfig, PREDICTED_RELATIONS},
    crops,
    kernel::{Kernel, PackedLinear},
    pair_measures::{MeasuredCloud, PAIR_MEASURES, pair_measures},
    points::ObjectCloud,
    prior::{KAPPA_MAX, OFFSET_UNIT_M, PER_COMPONENT, SIGMA_FLOOR_M},
    weights::{Weights, WeightsError, WeightsInfo},
};

use super::{
    context::{Candidate, InputError, SceneContext},
    pairs::{Anchor, Oriented, Pairs, PriorCodes},
    point_net::{Affine, PackedCodeHead, PackedPointNet, Scratch, Stored, row},
    shared::SceneFeatures,
    spread::spread,
};

/// The weights that come with the program.
pub(crate) const EMBEDDED: &[u8] = include_bytes!("../../weights/default.safetensors");

/// The prior's answer: a mixture over offset and yaw.
#[derive(Debug, Clone, PartialEq)]
pub struct Mixture {
    /// `[K]`, sum 1.
    pub weights: Vec<f32>,
    /// `[K][3]`: mean offset of the query's centroid from the anchor's, viewer's axes (x right, y away, z up), metres.
    pub means_in_viewer_m: Vec<[f32; 3]>,
    /// `[K][3]`: diagonal standard deviations, metres, at least 5 mm.
    pub sigmas_m: Vec<[f32; 3]>,
    /// `[K]`: mean turn about z, radians.
    pub yaw_mean_rad: Vec<f32>,
    /// `[K]`: von Mises concentration of the turn; 0 is uniform.
    pub kappa: Vec<f32>,
}

/// All networks with their weights, ready to score. Shared between threads by reference; never changes.
#[derive(Debug, Clone)]
pub struct Models {
    kernel: Kernel,
    config: NetworksConfig,
    object: PackedPointNet,
    object_head: PackedCodeHead,
    scene: PackedPointNet,
    scene_head: PackedCodeHead,
    relation_measures: Option<[PackedLinear; 2]>,
    relation_hidden: PackedLinear,
    relation_out: PackedLinear,
    prior_hidden: PackedLinear,
    prior_norm: Affine,
    prior_out: PackedLinear,
    discriminator: PackedPointNet,
    discriminator_out: PackedLinear,
    outcome: Option<(PackedPointNet, PackedLinear)>,
    info: WeightsInfo,
    hash: String,
    outcome_hash: String,
}

impl Models {
    /// From a weights file's bytes, on the fastest kernel of this machine.
    ///
    /// # Errors
    /// [`WeightsError`] when the bytes are not weights or do not fit the networks.
    pub fn load(bytes: &[u8]) -> Result<Self, WeightsError> {
        Self::load_for(bytes, Kernel::detect())
    }

    /// The weights that come with the program.
    ///
    /// # Errors
    /// None unless the program was built with a broken file.
    pub fn embedded() -> Result<Self, WeightsError> {
        Self::load(EMBEDDED)
    }

    /// From a weights file's bytes, on a given kernel of [`Kernel::available`].
    ///
    /// # Errors
    /// As [`Models::load`].
    pub fn load_for(bytes: &[u8], kernel: Kernel) -> Result<Self, WeightsError> {
        let weights = Weights::from_bytes(bytes)?;
        let config = NetworksConfig::of_weights(&weights.values);
        let stored = Stored { weights: &weights.values };
        let width = |levels: &[crate::config::SetAbstractionConfig]| levels.last().map_or(0, |l| l.outputs());
        let (code, hidden) = (config.code, config.hidden[1]);
        Ok(Self {
            kernel,
            object: PackedPointNet::new(&stored, "object", &config.object_levels)?,
            object_head: PackedCodeHead::new(&stored, "object", &config, width(&config.object_levels))?,
            scene: PackedPointNet::new(&stored, "scene", &config.scene_levels)?,
            scene_head: PackedCodeHead::new(&stored, "scene", &config, width(&config.scene_levels))?,
            relation_measures: match config.measures_code {
                Some(width) => {
                    Some([stored.linear("relations/measures", PAIR_MEASURES, width)?, stored.linear("relations/measures2", width, width)?])
                }
                None => None,
            },
            relation_hidden: {
                let inputs = 2 * code + config.measures_code.unwrap_or(0);
                stored.linear("relations/hidden", inputs, config.relations_hidden())?
            },
            relation_out: stored.linear("relations/out", config.relations_hidden(), PREDICTED_RELATIONS)?,
            prior_hidden: stored.linear("prior/hidden", 3 * code + GOAL_RELATIONS, hidden)?,
            prior_norm: stored.batch_norm("prior/norm", hidden)?,
            prior_out: stored.linear("prior/out", hidden, config.components * PER_COMPONENT)?,
            discriminator: PackedPointNet::new(&stored, "discriminator", &config.discriminator_levels)?,
            discriminator_out: stored.linear("discriminator/out", width(&config.discriminator_levels), 1)?,
            outcome: if config.outcome {
                let points = PackedPointNet::new(&stored, "outcome", &config.discriminator_levels)?;
                Some((points, stored.linear("outcome/out", width(&config.discriminator_levels), 1)?))
            } else {
                None
            },
            outcome_hash: weights.outcome_hash(),
            info: weights.info,
            hash: weights.hash,
            config,
        })
    }

    /// BLAKE3 of the weights file, hexadecimal.
    pub fn hash(&self) -> &str {
        &self.hash
    }

    /// BLAKE3 of the outcome network's parameters ([`Weights::outcome_hash`]).
    pub fn outcome_hash(&self) -> &str {
        &self.outcome_hash
    }

    /// The forecasts among the weights that were fitted with another outcome network, by name.
    pub fn misfit_forecasts(&self) -> Vec<String> {
        let fits = |value: &serde_json::Value| value["fitted_on"]["outcome_hash"].as_str() == Some(self.outcome_hash.as_str());
        self.info.forecasts.iter().filter(|(_, value)| !fits(value)).map(|(name, _)| name.clone()).collect()
    }

    /// The origin of the weights.
    pub fn info(&self) -> &WeightsInfo {
        &self.info
    }

    /// The kernel's id, which travels with results.
    pub fn kernel_id(&self) -> &'static str {
        self.kernel.id()
    }

    /// Shapes and cloud preparation; [`SceneContext::new`] takes `config().cloud`.
    pub fn config(&self) -> &NetworksConfig {
        &self.config
    }

    /// Where the query could go to make the goal hold: `goal[r]` is +1 (must hold), −1 (must not hold) or 0 (unspecified) per relation in wire
    /// order, all relative to one anchor.
    ///
    /// # Errors
    /// [`InputError`] for unknown objects.
    pub fn prior(&self, scene: &SceneContext, query: u16, anchor: u16, goal: [i8; GOAL_RELATIONS]) -> Result<Mixture, InputError> {
        let codes = scene.prior_codes.of((self.hash.clone(), query, anchor), || self.prior_codes(scene, query, anchor))?;
        let goal = goal.map(|g| f32::from(g.signum()));
        let mut hidden = row(self.kernel, &self.prior_hidden, &[&codes.0[..], &goal].concat(), false);
        self.prior_norm.relu(&mut hidden);
        Ok(mixture(&row(self.kernel, &self.prior_out, &hidden, false)))
    }

    /// What the prior reads whatever the goal.
    fn prior_codes(&self, scene: &SceneContext, query: u16, anchor: u16) -> Result<PriorCodes, InputError> {
        let (query_cloud, anchor_cloud) = pair(scene, query, anchor)?;
        let scratch = &mut Scratch::default();
        let crop = crops::scene_input(self.kernel, &self.config, &scene.scene.without(query), anchor_cloud.centroid_in_viewer.into());
        let scene_code = self.scene_head.forward(self.kernel, &self.scene.forward(self.kernel, &crop, scratch), [0.0; 3]);
        let query_code = self.code(&self.shape(query_cloud, scratch), [0.0; 3]);
        let anchor_code = self.code(&self.shape(anchor_cloud, scratch), [0.0; 3]);
        Ok(PriorCodes([scene_code, query_code, anchor_code].concat()))
    }

    /// Probabilities of the nine predicted relations for every candidate and anchor, `[candidates][anchors][9]`, on up to `threads` threads.
    ///
    /// # Errors
    /// [`InputError`] for unknown objects and numbers that are not finite.
    pub fn relations(
        &self,
        scene: &SceneContext,
        query: u16,
        anchors: &[u16],
        candidates: &[Candidate],
        threads: usize,
    ) -> Result<Vec<Vec<[f32; PREDICTED_RELATIONS]>>, InputError> {
        self.relations_of(scene, &*self.pairs(scene, query, anchors)?, candidates, threads)
    }

    /// What all candidates of a query share, kept for the last few queries.
    ///
    /// # Errors
    /// [`InputError`] for unknown objects.
    pub fn pairs(&self, scene: &SceneContext, query: u16, anchors: &[u16]) -> Result<Arc<Pairs>, InputError> {
        scene.pairs.of((self.hash.clone(), query, anchors.to_vec()), || self.new_pairs(scene, query, anchors))
    }

    fn new_pairs(&self, scene: &SceneContext, query: u16, anchors: &[u16]) -> Result<Pairs, InputError> {
        let scratch = &mut Scratch::default();
        let query_cloud = scene.object("query", query)?;
        let of_anchor = |anchor: &u16| {
            let (_, cloud) = pair(scene, query, *anchor)?;
            let code = self.code(&self.shape(cloud, scratch), [0.0; 3]);
            Ok(Anchor { code, measured: self.measured(cloud), centroid_in_viewer: cloud.centroid_in_viewer })
        };
        let anchors = anchors.iter().map(of_anchor).collect::<Result<_, InputError>>()?;
        Ok(Pairs { query: query_cloud.clone(), observed: self.oriented(query_cloud, scratch), anchors })
    }

    /// [`Models::relations`] of prepared pairs.
    ///
    /// # Errors
    /// [`InputError`] for numbers that are not finite.
    pub fn relations_of(
        &self,
        scene: &SceneContext,
        pairs: &Pairs,
        candidates: &[Candidate],
        threads: usize,
    ) -> Result<Vec<Vec<[f32; PREDICTED_RELATIONS]>>, InputError> {
        let placed = scene.in_viewer(candidates)?;
        Ok(spread(placed.len(), threads, Scratch::default, |scratch, i| {
            let (position, yaw_rad) = placed[i];
            // A translation changes only the centre's encoding; a turn changes the shape's too.
            let turned = (yaw_rad != 0.0).then(|| self.oriented(&pairs.query.turned(yaw_rad), scratch));
            let (shape, measured) = turned.as_ref().unwrap_or(&pairs.observed);
            let of_anchor = |anchor: &Anchor| {
                let offset = std::array::from_fn(|k| position[k] - anchor.centroid_in_viewer[k]);
                let mut input = self.code(shape, offset);
                input.extend_from_slice(&anchor.code);
                if let (Some([first, second]), Some(query), Some(anchor)) = (&self.relation_measures, measured, &anchor.measured) {
                    let measures = row(self.kernel, first, &pair_measures(query, anchor, offset), true);
                    input.extend(row(self.kernel, second, &measures, true));
                }
                let hidden = row(self.kernel, &self.relation_hidden, &input, true);
                let logits = row(self.kernel, &self.relation_out, &hidden, false);
                std::array::from_fn(|r| sigmoid(logits[r]))
            };
            pairs.anchors.iter().map(of_anchor).collect()
        }))
    }

    /// The probability that each candidate looks like an object at rest (paper), 0 to 1, `[candidates]`, on up to `threads` threads.
    ///
    /// # Errors
    /// [`InputError`] for an unknown query and numbers that are not finite.
    pub fn realism(&self, scene: &SceneContext, query: u16, candidates: &[Candidate], threads: usize) -> Result<Vec<f32>, InputError> {
        let placed = scene.in_viewer(candidates)?;
        let query_cloud = scene.object("query", query)?;
        let without_query = scene.scene.without(query);
        Ok(spread(placed.len(), threads, Scratch::default, |scratch, i| {
            let (position, yaw_rad) = placed[i];
            let crop = crops::discriminator_input(self.kernel, &self.config, &without_query, &query_cloud.turned(yaw_rad), position);
            let features = self.discriminator.forward(self.kernel, &crop, scratch);
            sigmoid(row(self.kernel, &self.discriminator_out, &features, false)[0])
        }))
    }

    /// The probability that each candidate stays where it is released (ours: learned from simulated releases), 0 to 1, `[candidates]`, on up
    /// to `threads` threads.
    ///
    /// # Errors
    /// As [`Models::realism`]; [`InputError::NoOutcomeNetwork`] where the weights have no such network.
    pub fn outcome(&self, scene: &SceneContext, query: u16, candidates: &[Candidate], threads: usize) -> Result<Vec<f32>, InputError> {
        let (points, out) = self.outcome.as_ref().ok_or(InputError::NoOutcomeNetwork)?;
        let placed = scene.in_viewer(candidates)?;
        let query_cloud = scene.object("query", query)?;
        let features = scene
            .features_without(query, &self.hash, || SceneFeatures::new(self.kernel, &self.config, points, &scene.scene.without(query)));
        Ok(spread(placed.len(), threads, Scratch::default, |scratch, i| {
            let (position, yaw_rad) = placed[i];
            let query = query_cloud.turned(yaw_rad);
            let candidate = features.of_candidate(self.kernel, &self.config, points, &query, position, scratch);
            sigmoid(row(self.kernel, out, &candidate, false)[0])
        }))
    }

    /// The object prepared for measuring, if the predictor reads measures.
    fn measured(&self, object: &ObjectCloud) -> Option<MeasuredCloud> {
        self.relation_measures.as_ref().map(|_| MeasuredCloud::new(object))
    }

    fn oriented(&self, query: &ObjectCloud, scratch: &mut Scratch) -> Oriented {
        (self.shape(query, scratch), self.measured(query))
    }

    fn shape(&self, object: &ObjectCloud, scratch: &mut Scratch) -> Vec<f32> {
        self.object.forward(self.kernel, &crops::object_input(self.kernel, &self.config, object), scratch)
    }

    fn code(&self, shape: &[f32], center_m: [f32; 3]) -> Vec<f32> {
        self.object_head.forward(self.kernel, shape, center_m)
    }
}

fn pair(scene: &SceneContext, query: u16, anchor: u16) -> Result<(&ObjectCloud, &ObjectCloud), InputError> {
    let clouds = (scene.object("query", query)?, scene.object("anchors", anchor)?);
    if query == anchor { Err(InputError::AnchorIsQuery { label: anchor }) } else { Ok(clouds) }
}

fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

fn softplus(x: f32) -> f32 {
    x.max(0.0) + (-x.abs()).exp().ln_1p()
}

/// The network's last row `[K · 10]` as a mixture.
fn mixture(raw: &[f32]) -> Mixture {
    let components: Vec<&[f32]> = raw.chunks_exact(PER_COMPONENT).collect();
    let largest = components.iter().map(|c| c[0]).fold(f32::NEG_INFINITY, f32::max);
    let total: f32 = components.iter().map(|c| (c[0] - largest).exp()).sum();
    Mixture {
        weights: components.iter().map(|c| (c[0] - largest).exp() / total).collect(),
        means_in_viewer_m: components.iter().map(|c| std::array::from_fn(|k| c[1 + k] * OFFSET_UNIT_M)).collect(),
        sigmas_m: components.iter().map(|c| std::array::from_fn(|k| softplus(c[4 + k]) * OFFSET_UNIT_M + SIGMA_FLOOR_M)).collect(),
        yaw_mean_rad: components.iter().map(|c| c[8].atan2(c[7])).collect(),
        kappa: components.iter().map(|c| softplus(c[9]).clamp(0.0, KAPPA_MAX)).collect(),
    }
}
