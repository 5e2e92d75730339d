//! The layers that the networks share, for training: linear, batch norm, layer norm.
//!
//! candle's own `LayerNorm` has no gradient on a CPU and does not say so; these are made of differentiable operations.

use std::{collections::BTreeMap, sync::Mutex};

use candle_core::{D, Module, Result, Tensor};

use crate::parameters::{Builder, Init};

/// Added to variances before the root.
pub(crate) const NORM_EPSILON: f64 = 1e-5;

/// candle's `y = x Wᵀ + b` on rows, with parameters from a [`Builder`].
#[derive(Debug, Clone)]
pub struct Linear(candle_nn::Linear);

impl Linear {
    /// He initialisation (uniform), for layers that a ReLU follows.
    ///
    /// # Errors
    /// When stored weights do not fit.
    pub fn new(builder: &mut Builder<'_>, name: &str, inputs: usize, outputs: usize) -> Result<Self> {
        builder.within(name, |b| {
            let weight = b.trainable("weight", &[outputs, inputs], Init::Uniform((6.0 / inputs as f32).sqrt()))?;
            let bias = b.trainable("bias", &[outputs], Init::Uniform((1.0 / inputs as f32).sqrt()))?;
            Ok(Self(candle_nn::Linear::new(weight, Some(bias))))
        })
    }

    /// `[outputs, inputs]`.
    pub fn weight(&self) -> &Tensor {
        self.0.weight()
    }

    /// Weight and bias one after another in one row, as the fused operation takes them.
    ///
    /// # Errors
    /// When the device fails.
    pub(crate) fn flat(&self) -> Result<Tensor> {
        let parts: Vec<Tensor> =
            [Some(self.weight()), self.0.bias()].into_iter().flatten().map(Tensor::flatten_all).collect::<Result<_>>()?;
        Tensor::cat(&parts, 0)
    }

    /// `[rows, inputs]` → `[rows, outputs]`.
    ///
    /// # Errors
    /// When the shapes do not fit.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        // A product with a transposed view of a non-contiguous batch gives wrong numbers silently.
        self.0.forward(&x.contiguous()?)
    }
}

/// Whether a network is being fitted; if so, where batch norms report their statistics.
#[derive(Debug)]
pub enum Mode {
    /// Batch statistics are used and reported.
    Training(BatchStatistics),
    /// Running statistics are used.
    Serving,
}

/// Means and variances by statistic name, in the order of the names.
#[derive(Debug, Default)]
pub struct BatchStatistics(Mutex<BTreeMap<String, Vec<f32>>>);

impl BatchStatistics {
    fn report(&self, name: &str, value: &Tensor) -> Result<()> {
        let values = value.flatten_all()?.to_vec1::<f32>()?;
        self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner).insert(name.to_string(), values);
        Ok(())
    }

    /// The reported statistics.
    pub fn into_inner(self) -> BTreeMap<String, Vec<f32>> {
        self.0.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner)
    }
}

/// Batch norm over rows, per column.
#[derive(Debug, Clone)]
pub struct BatchNorm {
    scale: Tensor,
    shift: Tensor,
    mean: (String, Tensor),
    variance: (String, Tensor),
}

impl BatchNorm {
    /// Scale 1, shift 0.
    ///
    /// # Errors
    /// When stored weights do not fit.
    pub fn new(builder: &mut Builder<'_>, name: &str, width: usize) -> Result<Self> {
        builder.within(name, |b| {
            Ok(Self {
                scale: b.trainable("scale", &[width], Init::Constant(1.0))?,
                shift: b.trainable("shift", &[width], Init::Constant(0.0))?,
                mean: b.statistic("mean", &[width], 0.0)?,
                variance: b.statistic("variance", &[width], 1.0)?,
            })
        })
    }

    /// `[rows, width]` → `[rows, width]`. The batch's variance is the biased one.
    ///
    /// # Errors
    /// When the shapes do not fit.
    pub fn forward(&self, x: &Tensor, mode: &Mode) -> Result<Tensor> {
        let (mean, variance) = match mode {
            Mode::Training(statistics) => {
                let mean = x.mean(0)?;
                let variance = x.sqr()?.mean(0)?.sub(&mean.sqr()?)?.relu()?;
                statistics.report(&self.mean.0, &mean)?;
                statistics.report(&self.variance.0, &variance)?;
                (mean, variance)
            }
            Mode::Serving => (self.mean.1.clone(), self.variance.1.clone()),
        };
        let factor = self.scale.div(&(variance + NORM_EPSILON)?.sqrt()?)?;
        let offset = self.shift.sub(&mean.mul(&factor)?)?;
        x.broadcast_mul(&factor)?.broadcast_add(&offset)
    }
}

/// Layer norm over each row.
#[derive(Debug, Clone)]
pub struct LayerNorm {
    scale: Tensor,
    shift: Tensor,
}

impl LayerNorm {
    /// Scale 1, shift 0.
    ///
    /// # Errors
    /// When stored weights do not fit.
    pub fn new(builder: &mut Builder<'_>, name: &str, width: usize) -> Result<Self> {
        builder.within(name, |b| {
            Ok(Self {
                scale: b.trainable("scale", &[width], Init::Constant(1.0))?,
                shift: b.trainable("shift", &[width], Init::Constant(0.0))?,
            })
        })
    }

    /// `[rows, width]` → `[rows, width]`.
    ///
    /// # Errors
    /// When the shapes do not fit.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let centered = x.broadcast_sub(&x.mean_keepdim(D::Minus1)?)?;
        let deviation = (centered.sqr()?.mean_keepdim(D::Minus1)? + NORM_EPSILON)?.sqrt()?;
        centered.broadcast_div(&deviation)?.broadcast_mul(&self.scale)?.broadcast_add(&self.shift)
    }
}
