//! The pose prior `π` (paper, section 2.1 and appendix A.2), for training: a mixture density network over offset and yaw.
//!
//! Each component has a weight, a diagonal Gaussian over the offset δ of the query's centroid from the anchor's (viewer's axes) whose σ is
//! 5 mm + softplus, and, ours, a von Mises over the yaw. The loss is the negative log-likelihood by log-sum-exp.

use candle_core::{CpuStorage, CustomOp1, D, Device, Layout, Result, Shape, Tensor};
use candle_nn::ops::log_softmax;

use crate::{
    config::{GOAL_RELATIONS, NetworksConfig},
    layers::{BatchNorm, Linear, Mode},
    parameters::Builder,
};

/// The smallest σ of an offset, metres.
pub const SIGMA_FLOOR_M: f32 = 0.005;
/// What the network's means and (softplus) sigmas are in, metres, so that its outputs are of size one.
pub const OFFSET_UNIT_M: f32 = 0.1;
/// The largest concentration of a yaw: about 6°.
pub const KAPPA_MAX: f32 = 100.0;
/// Outputs per component: weight logit, three means, three raw sigmas, two for the direction of the mean yaw, one raw concentration.
pub(crate) const PER_COMPONENT: usize = 10;

/// `[h_Z, h_i, h_j, goal]` → 128 with batch norm → mixture.
#[derive(Debug, Clone)]
pub struct Prior {
    hidden: Linear,
    norm: BatchNorm,
    out: Linear,
    components: usize,
}

/// Parameters of a batch of mixtures.
#[derive(Debug, Clone)]
pub struct MixtureTensors {
    /// `[rows, K]`, log of the weights.
    pub log_weights: Tensor,
    /// `[rows, K, 3]`, metres.
    pub means_m: Tensor,
    /// `[rows, K, 3]`, metres.
    pub sigmas_m: Tensor,
    /// `[rows, K, 2]`, cosine and sine of the mean yaw.
    pub yaw_direction: Tensor,
    /// `[rows, K]`.
    pub kappa: Tensor,
}

impl Prior {
    /// Parameters under `prior`.
    ///
    /// # Errors
    /// When stored weights do not fit.
    pub fn new(builder: &mut Builder<'_>, config: &NetworksConfig) -> Result<Self> {
        builder.within("prior", |b| {
            Ok(Self {
                hidden: Linear::new(b, "hidden", 3 * config.code + GOAL_RELATIONS, config.hidden[1])?,
                norm: BatchNorm::new(b, "norm", config.hidden[1])?,
                out: Linear::new(b, "out", config.hidden[1], config.components * PER_COMPONENT)?,
                components: config.components,
            })
        })
    }

    /// Codes `[rows, 128]` of scene, query (centre zero) and anchor, goals `[rows, 10]` of −1, 0, +1 → mixtures.
    ///
    /// # Errors
    /// When the shapes do not fit.
    pub fn forward(&self, scene: &Tensor, query: &Tensor, anchor: &Tensor, goal: &Tensor, mode: &Mode) -> Result<MixtureTensors> {
        let hidden = self.hidden.forward(&Tensor::cat(&[scene, query, anchor, goal], 1)?)?;
        let hidden = self.norm.forward(&hidden, mode)?.relu()?;
        let raw = self.out.forward(&hidden)?.reshape(((), self.components, PER_COMPONENT))?;
        let part = |from: usize, n: usize| raw.narrow(2, from, n)?.contiguous();
        let log_weights = log_softmax(&part(0, 1)?.squeeze(2)?, D::Minus1)?;
        let means_m = (part(1, 3)? * f64::from(OFFSET_UNIT_M))?;
        let sigmas_m = ((softplus(&part(4, 3)?)? * f64::from(OFFSET_UNIT_M))? + f64::from(SIGMA_FLOOR_M))?;
        let direction = part(7, 2)?;
        let length = (direction.sqr()?.sum_keepdim(D::Minus1)? + 1e-6)?.sqrt()?;
        let yaw_direction = direction.broadcast_div(&length)?;
        let kappa = softplus(&part(9, 1)?.squeeze(2)?)?.clamp(0f32, KAPPA_MAX)?;
        Ok(MixtureTensors { log_weights, means_m, sigmas_m, yaw_direction, kappa })
    }
}

impl MixtureTensors {
    /// The mean negative log-likelihood of offsets `[rows, 3]` (metres) and yaws `[rows]` (radians).
    ///
    /// # Errors
    /// When the shapes do not fit.
    pub fn negative_log_likelihood(&self, offsets_m: &Tensor, yaws_rad: &Tensor) -> Result<Tensor> {
        let z = offsets_m.unsqueeze(1)?.broadcast_sub(&self.means_m)?.div(&self.sigmas_m)?;
        let gaussian = ((z.sqr()? * -0.5)? - self.sigmas_m.log()?)?.sum(D::Minus1)?;
        let yaw = Tensor::stack(&[yaws_rad.cos()?, yaws_rad.sin()?], 1)?.unsqueeze(1)?;
        let cosine = self.yaw_direction.broadcast_mul(&yaw)?.sum(D::Minus1)?;
        let von_mises = self.kappa.mul(&cosine)?.sub(&log_bessel0(&self.kappa)?)?;
        let constant = -1.5 * std::f64::consts::TAU.ln() - std::f64::consts::TAU.ln();
        let per_component = self.log_weights.add(&gaussian)?.add(&von_mises)?;
        (per_component.log_sum_exp(D::Minus1)? + constant)?.neg()?.mean_all()
    }
}

/// `log(1 + eˣ)`.
fn softplus(x: &Tensor) -> Result<Tensor> {
    x.relu()?.add(&(x.abs()?.neg()?.exp()? + 1.0)?.log()?)
}

/// `log I₀(κ)`, κ ≥ 0, element by element: on the CPU, wherever κ is (a few numbers a row).
fn log_bessel0(kappa: &Tensor) -> Result<Tensor> {
    kappa.to_device(&Device::Cpu)?.contiguous()?.apply_op1(LogBessel0)?.to_device(kappa.device())
}

/// `log I₀(κ)`, κ ≥ 0; its derivative is `I₁(κ) / I₀(κ)`.
struct LogBessel0;

impl CustomOp1 for LogBessel0 {
    fn name(&self) -> &'static str {
        "log-bessel-0"
    }

    fn cpu_fwd(&self, storage: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let Some((start, end)) = layout.contiguous_offsets() else { candle_core::bail!("log-bessel-0 needs a contiguous input") };
        let out = storage.as_slice::<f32>()?[start..end].iter().map(|k| log_bessel0_and_slope(f64::from(*k)).0 as f32).collect();
        Ok((CpuStorage::F32(out), layout.shape().clone()))
    }

    fn bwd(&self, arg: &Tensor, _res: &Tensor, grad_res: &Tensor) -> Result<Option<Tensor>> {
        let slopes: Vec<f32> = arg.flatten_all()?.to_vec1::<f32>()?.iter().map(|k| log_bessel0_and_slope(f64::from(*k)).1 as f32).collect();
        Ok(Some(Tensor::from_vec(slopes, arg.shape(), arg.device())?.mul(grad_res)?))
    }
}

/// `log I₀` and `I₁/I₀`: the power series below 30, the asymptotic one above, both to better than 1e-7.
pub(crate) fn log_bessel0_and_slope(kappa: f64) -> (f64, f64) {
    if kappa < 30.0 {
        let (quarter, mut term, mut i0, mut i1) = (kappa * kappa / 4.0, 1.0, 1.0, 0.5 * kappa);
        let mut k = 1.0;
        while term > 1e-16 * i0 {
            term *= quarter / (k * k);
            i0 += term;
            i1 += term * kappa / (2.0 * (k + 1.0));
            k += 1.0;
        }
        (i0.ln(), i1 / i0)
    } else {
        let t = 1.0 / (8.0 * kappa);
        let i0 = 1.0 + t * (1.0 + t * (4.5 + t * 37.5));
        let i1 = 1.0 - t * (3.0 + t * (7.5 + t * 52.5));
        (kappa - 0.5 * (std::f64::consts::TAU * kappa).ln() + i0.ln(), i1 / i0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bessel_ratio_is_the_slope_of_the_logarithm() {
        for kappa in [0.0f64, 0.1, 1.0, 5.0, 29.9, 30.1, 80.0] {
            let step = 1e-5;
            let (low, high) = (log_bessel0_and_slope((kappa - step).abs()).0, log_bessel0_and_slope(kappa + step).0);
            let slope = if kappa == 0.0 { 0.0 } else { (high - low) / (2.0 * step) };
            assert!((log_bessel0_and_slope(kappa).1 - slope).abs() < 1e-5, "κ = {kappa}");
        }
        assert!((log_bessel0_and_slope(30.0 - 1e-9).0 - log_bessel0_and_slope(30.0 + 1e-9).0).abs() < 1e-6);
    }

    #[test]
    fn the_likelihood_of_one_component_is_a_gaussian_times_a_von_mises() {
        let t = |v: &[f32], shape: &[usize]| Tensor::from_slice(v, shape, &Device::Cpu).unwrap();
        let mixture = MixtureTensors {
            log_weights: t(&[0.0], &[1, 1]),
            means_m: t(&[0.1, 0.0, 0.0], &[1, 1, 3]),
            sigmas_m: t(&[0.02, 0.05, 0.1], &[1, 1, 3]),
            yaw_direction: t(&[0.0, 1.0], &[1, 1, 2]),
            kappa: t(&[2.0], &[1, 1]),
        };
        let nll = mixture.negative_log_likelihood(&t(&[0.12, 0.0, 0.1], &[1, 3]), &t(&[0.5], &[1])).unwrap().to_scalar::<f32>().unwrap();
        let gaussian = -0.5 * (1.0 + 1.0) - (0.02f64 * 0.05 * 0.1).ln() - 1.5 * std::f64::consts::TAU.ln();
        let von_mises = 2.0 * 0.5f64.sin() - std::f64::consts::TAU.ln() - log_bessel0_and_slope(2.0).0;
        assert!((f64::from(nll) + gaussian + von_mises).abs() < 1e-4);
    }
}
