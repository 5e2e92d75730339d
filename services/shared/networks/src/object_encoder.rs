//! The object encoder `e(x) → h` (paper, appendix A.2), for training.
//!
//! A point network about the object's own centroid, beside a small network on where that centroid is; two layers make the code of both.
//! The centre is `o_i − o_j` for the relation predictor and zero for the query in the prior, which otherwise would read its own answer.

use candle_core::{Result, Tensor};

use crate::{
    config::NetworksConfig,
    crops::Grouped,
    layers::{LayerNorm, Linear, Mode},
    parameters::Builder,
    set_abstraction::{Path, PointNet},
};

/// Centres are given to the network in these, so that a few centimetres are not lost beside features of size one.
pub const CENTER_UNIT_M: f32 = 0.1;

/// Shape and centre to code.
#[derive(Debug, Clone)]
pub struct ObjectEncoder {
    shape: PointNet,
    head: CodeHead,
}

impl ObjectEncoder {
    /// Parameters under `object`.
    ///
    /// # Errors
    /// When stored weights do not fit.
    pub fn new(builder: &mut Builder<'_>, config: &NetworksConfig) -> Result<Self> {
        builder.within("object", |b| {
            let width = config.object_levels.last().map_or(0, crate::config::SetAbstractionConfig::outputs);
            Ok(Self { shape: PointNet::new(b, &config.object_levels)?, head: CodeHead::new(b, config, width)? })
        })
    }

    /// Shapes of a batch of objects → `[objects, 256]`. Does not depend on where the objects are.
    ///
    /// # Errors
    /// When the shapes do not fit.
    pub fn shapes(&self, objects: &Grouped, mode: &Mode, path: Path) -> Result<Tensor> {
        self.shape.forward(objects, mode, path)
    }

    /// Shapes `[rows, 256]` and centres `[rows, 3]` (metres) → codes `[rows, 128]`.
    ///
    /// # Errors
    /// When the shapes do not fit.
    pub fn codes(&self, shapes: &Tensor, centers_m: &Tensor) -> Result<Tensor> {
        self.head.forward(shapes, centers_m)
    }
}

/// (features, centre) → code; the scene encoder ends in one too.
#[derive(Debug, Clone)]
pub(crate) struct CodeHead {
    center1: Linear,
    center2: Linear,
    hidden: Linear,
    norm: LayerNorm,
    code: Linear,
}

impl CodeHead {
    pub(crate) fn new(b: &mut Builder<'_>, config: &NetworksConfig, features: usize) -> Result<Self> {
        Ok(Self {
            center1: Linear::new(b, "center1", 3, config.center_code)?,
            center2: Linear::new(b, "center2", config.center_code, config.center_code)?,
            hidden: Linear::new(b, "hidden", features + config.center_code, config.hidden[0])?,
            norm: LayerNorm::new(b, "hidden_norm", config.hidden[0])?,
            code: Linear::new(b, "code", config.hidden[0], config.code)?,
        })
    }

    pub(crate) fn forward(&self, features: &Tensor, centers_m: &Tensor) -> Result<Tensor> {
        let centers = (centers_m / f64::from(CENTER_UNIT_M))?;
        let centers = self.center2.forward(&self.center1.forward(&centers)?.relu()?)?;
        let hidden = self.hidden.forward(&Tensor::cat(&[features, &centers], 1)?)?.relu()?;
        self.code.forward(&self.norm.forward(&hidden)?)
    }
}
