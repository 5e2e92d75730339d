//! All networks together, for training.

use candle_core::{Device, Result};
use rand_pcg::Pcg64;

use crate::{
    config::NetworksConfig,
    discriminator::Discriminator,
    object_encoder::ObjectEncoder,
    parameters::{Builder, Parameters, WeightMap},
    prior::Prior,
    relation_predictor::RelationPredictor,
    scene_encoder::SceneEncoder,
};

/// The paper's five networks and ours. Encoders, relation predictor and prior are trained jointly, the discriminator and the outcome network
/// separately.
#[derive(Debug, Clone)]
pub struct Networks {
    /// `e`.
    pub object: ObjectEncoder,
    /// `e_Z`.
    pub scene: SceneEncoder,
    /// `p_ρ`.
    pub relations: RelationPredictor,
    /// `π`.
    pub prior: Prior,
    /// `f`.
    pub discriminator: Discriminator,
    /// The discriminator's layers, trained on the outcomes of simulated releases (ours).
    pub outcome: Option<Discriminator>,
    /// Where the parameters are and the computation runs.
    pub device: Device,
}

impl Networks {
    /// New networks with weights from a generator, and their parameters.
    ///
    /// # Errors
    /// None on a CPU; elsewhere when the device fails.
    pub fn seeded(config: &NetworksConfig, rng: &mut Pcg64, device: &Device) -> Result<(Self, Parameters)> {
        Self::build(Builder::seeded(rng, device), config)
    }

    /// Networks with stored weights, and their parameters.
    ///
    /// # Errors
    /// When a tensor is missing or has another shape; the message names it.
    pub fn stored(config: &NetworksConfig, weights: &WeightMap, device: &Device) -> Result<(Self, Parameters)> {
        Self::build(Builder::stored(weights, device), config)
    }

    /// Networks with stored weights where they fit, and new ones elsewhere, so that training can continue with other parts.
    ///
    /// # Errors
    /// None on a CPU; elsewhere when the device fails.
    pub fn started(config: &NetworksConfig, weights: &WeightMap, rng: &mut Pcg64, device: &Device) -> Result<(Self, Parameters)> {
        Self::build(Builder::started(weights, rng, device), config)
    }

    fn build(mut builder: Builder<'_>, config: &NetworksConfig) -> Result<(Self, Parameters)> {
        let networks = Self {
            object: ObjectEncoder::new(&mut builder, config)?,
            scene: SceneEncoder::new(&mut builder, config)?,
            relations: RelationPredictor::new(&mut builder, config)?,
            prior: Prior::new(&mut builder, config)?,
            discriminator: Discriminator::new(&mut builder, "discriminator", config)?,
            outcome: if config.outcome { Some(Discriminator::new(&mut builder, "outcome", config)?) } else { None },
            device: builder.device().clone(),
        };
        Ok((networks, builder.finish()))
    }
}
