//! The scene discriminator `f(x, Z)` (paper, section 2.1 and appendix A.2), for training: does this look like objects at rest?

use candle_core::{Result, Tensor};

use crate::{
    config::{NetworksConfig, SetAbstractionConfig},
    crops::Grouped,
    layers::{Linear, Mode},
    parameters::Builder,
    set_abstraction::{Path, PointNet},
};

/// Four set abstractions on points labelled query or scene, then one linear layer.
#[derive(Debug, Clone)]
pub struct Discriminator {
    points: PointNet,
    out: Linear,
}

impl Discriminator {
    /// Parameters under `name`: `discriminator`, or `outcome` for the one that learned from releases.
    ///
    /// # Errors
    /// When stored weights do not fit.
    pub fn new(builder: &mut Builder<'_>, name: &str, config: &NetworksConfig) -> Result<Self> {
        builder.within(name, |b| {
            let width = config.discriminator_levels.last().map_or(0, SetAbstractionConfig::outputs);
            Ok(Self { points: PointNet::new(b, &config.discriminator_levels)?, out: Linear::new(b, "out", width, 1)? })
        })
    }

    /// A batch of candidates → logits `[samples]`; their sigmoid is the realism.
    ///
    /// # Errors
    /// When the shapes do not fit.
    pub fn logits(&self, candidates: &Grouped, mode: &Mode, path: Path) -> Result<Tensor> {
        self.out.forward(&self.points.forward(candidates, mode, path)?)?.squeeze(1)
    }
}
