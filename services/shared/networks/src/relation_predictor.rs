//! The relation predictor `p_ρ` (paper, section 2.1 and appendix A.2), for training: two codes to nine logits.

use candle_core::{Result, Tensor};

use crate::{
    config::{NetworksConfig, PREDICTED_RELATIONS},
    layers::Linear,
    pair_measures::PAIR_MEASURES,
    parameters::Builder,
};

/// `[h_i, h_j]` → 128 → 9 logits. The `measured` variant (ours) encodes [`crate::pair_measures`] by two layers beside the codes: 146 → 128 →
/// 128, and `[h_i, h_j, m]` → 256 → 9 logits.
#[derive(Debug, Clone)]
pub struct RelationPredictor {
    measures: Option<[Linear; 2]>,
    hidden: Linear,
    out: Linear,
}

impl RelationPredictor {
    /// Parameters under `relations`.
    ///
    /// # Errors
    /// When stored weights do not fit.
    pub fn new(builder: &mut Builder<'_>, config: &NetworksConfig) -> Result<Self> {
        builder.within("relations", |b| {
            let measures = match config.measures_code {
                Some(width) => Some([Linear::new(b, "measures", PAIR_MEASURES, width)?, Linear::new(b, "measures2", width, width)?]),
                None => None,
            };
            let hidden = config.relations_hidden();
            Ok(Self {
                measures,
                hidden: Linear::new(b, "hidden", 2 * config.code + config.measures_code.unwrap_or(0), hidden)?,
                out: Linear::new(b, "out", hidden, PREDICTED_RELATIONS)?,
            })
        })
    }

    /// Codes of queries (with their centres relative to the anchors) and of anchors, `[pairs, 128]` each, and their measures
    /// `[pairs, 146]`, which the paper's variant does not read → logits `[pairs, 9]`.
    ///
    /// # Errors
    /// When the shapes do not fit.
    pub fn logits(&self, queries: &Tensor, anchors: &Tensor, measures: &Tensor) -> Result<Tensor> {
        let input = match &self.measures {
            Some([first, second]) => {
                let measures = second.forward(&first.forward(measures)?.relu()?)?.relu()?;
                Tensor::cat(&[queries, anchors, &measures], 1)?
            }
            None => Tensor::cat(&[queries, anchors], 1)?,
        };
        self.out.forward(&self.hidden.forward(&input)?.relu()?)
    }
}

/// Mean binary cross-entropy of logits against 0/1 labels of the same shape, in the form that does not overflow.
///
/// # Errors
/// When the shapes differ.
pub fn binary_cross_entropy(logits: &Tensor, labels: &Tensor) -> Result<Tensor> {
    // max(x, 0) − x y + log(1 + exp(−|x|))
    let softplus = (logits.abs()?.neg()?.exp()? + 1.0)?.log()?;
    logits.relu()?.sub(&logits.mul(labels)?)?.add(&softplus)?.mean_all()
}
