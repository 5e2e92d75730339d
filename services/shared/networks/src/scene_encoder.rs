//! The scene encoder `e_Z(x_Z) → h_Z` (paper, section 2.1), for training: the scene without the query, about the anchor's centroid.

use candle_core::{Result, Tensor};

use crate::{
    config::{NetworksConfig, SetAbstractionConfig},
    crops::Grouped,
    layers::Mode,
    object_encoder::CodeHead,
    parameters::Builder,
    set_abstraction::{Path, PointNet},
};

/// The object encoder's kind with wider neighbourhoods, its centre always zero.
#[derive(Debug, Clone)]
pub struct SceneEncoder {
    points: PointNet,
    head: CodeHead,
}

impl SceneEncoder {
    /// Parameters under `scene`.
    ///
    /// # Errors
    /// When stored weights do not fit.
    pub fn new(builder: &mut Builder<'_>, config: &NetworksConfig) -> Result<Self> {
        builder.within("scene", |b| {
            let width = config.scene_levels.last().map_or(0, SetAbstractionConfig::outputs);
            Ok(Self { points: PointNet::new(b, &config.scene_levels)?, head: CodeHead::new(b, config, width)? })
        })
    }

    /// A batch of scene crops → codes `[samples, 128]`.
    ///
    /// # Errors
    /// When the shapes do not fit.
    pub fn forward(&self, scenes: &Grouped, mode: &Mode, path: Path) -> Result<Tensor> {
        let features = self.points.forward(scenes, mode, path)?;
        let centers = Tensor::zeros((features.dim(0)?, 3), features.dtype(), features.device())?;
        self.head.forward(&features, &centers)
    }
}
