//! The fused pair work of a set abstraction as a candle operation with a gradient.
//!
//! Candle's element-wise operations run on one thread and pass through memory each time; gathering 32,768 pairs that way costs more than
//! the products. Here the gather, the shared MLP and the max run in cache ([`crate::kernel`]), and the gradient follows the winners.

use std::sync::{Arc, Mutex};

use candle_core::{CpuStorage, CustomOp3, Layout, Result, Shape, Tensor};

use crate::{
    kernel::{Kernel, PackedLinear, PairMlp, RawLayers},
    neighbours::Neighbours,
};

/// The operation: (point terms `[points, hidden]`, centroid terms `[centroids, hidden]`, the other layers' weights and biases in one row)
/// → `[centroids, outputs]`.
pub(crate) struct FusedPairMlp {
    pub kernel: Kernel,
    pub neighbours: Arc<Neighbours>,
    /// Hidden, middle if any, outputs.
    pub widths: Vec<usize>,
    /// The forward pass's winners, for the backward pass.
    pub winners: Mutex<Vec<u16>>,
}

/// The layers after the first, cut out of the flat row: (weight, bias) per layer.
fn layers<'a>(widths: &[usize], flat: &'a [f32]) -> Vec<(&'a [f32], &'a [f32])> {
    let mut at = 0;
    let pairs = widths.windows(2).map(|w| {
        let weight = &flat[at..at + w[0] * w[1]];
        let bias = &flat[at + w[0] * w[1]..at + w[0] * w[1] + w[1]];
        at += w[0] * w[1] + w[1];
        (weight, bias)
    });
    pairs.collect()
}

fn packed(widths: &[usize], flat: &[f32]) -> Vec<PackedLinear> {
    let layers = layers(widths, flat);
    widths.windows(2).zip(layers).map(|(w, (weight, bias))| PackedLinear::new(w[0], w[1], weight, bias)).collect()
}

fn contiguous<'a>(storage: &'a CpuStorage, layout: &Layout, name: &str) -> Result<&'a [f32]> {
    match layout.contiguous_offsets() {
        Some((start, end)) => Ok(&storage.as_slice::<f32>()?[start..end]),
        None => candle_core::bail!("{name} must be contiguous"),
    }
}

impl FusedPairMlp {
    fn op<'a>(&'a self, points: &'a [f32], centroids: &'a [f32], packed: &'a [PackedLinear]) -> PairMlp<'a> {
        PairMlp {
            point_terms: points,
            centroid_terms: centroids,
            middle: (packed.len() == 2).then(|| &packed[0]),
            last: &packed[packed.len() - 1],
            neighbours: &self.neighbours,
        }
    }
}

impl CustomOp3 for FusedPairMlp {
    fn name(&self) -> &'static str {
        "fused-pair-mlp"
    }

    fn cpu_fwd(
        &self,
        s1: &CpuStorage,
        l1: &Layout,
        s2: &CpuStorage,
        l2: &Layout,
        s3: &CpuStorage,
        l3: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let packed = packed(&self.widths, contiguous(s3, l3, "weights")?);
        let op = self.op(contiguous(s1, l1, "point terms")?, contiguous(s2, l2, "centroid terms")?, &packed);
        let (rows, outputs, padded) = (self.neighbours.centroids(), op.last.outputs(), op.last.padded());
        if outputs != padded {
            candle_core::bail!("a set abstraction's width must be a multiple of 16, got {outputs}");
        }
        let mut out = vec![0.0; rows * padded];
        let mut winners = vec![0; rows * padded];
        self.kernel.pair_mlp_with_winners(&op, &mut out, &mut winners, &mut Vec::new());
        *self.winners.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = winners;
        Ok((CpuStorage::F32(out), Shape::from((rows, outputs))))
    }

    fn bwd(
        &self,
        points: &Tensor,
        centroids: &Tensor,
        weights: &Tensor,
        _res: &Tensor,
        grad_res: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let values = |t: &Tensor| t.flatten_all()?.to_vec1::<f32>();
        let (p, c, flat, grad_out) = (values(points)?, values(centroids)?, values(weights)?, values(grad_res)?);
        let packed = packed(&self.widths, &flat);
        let layers = layers(&self.widths, &flat);
        let raw = RawLayers { middle: (layers.len() == 2).then(|| layers[0].0), last: layers[layers.len() - 1].0 };
        let winners = self.winners.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let grads = self.kernel.pair_mlp_backward(&self.op(&p, &c, &packed), &raw, &winners, &grad_out);
        let mut flat = grads.middle_weight;
        flat.extend(grads.middle_bias);
        flat.extend(grads.last_weight);
        flat.extend(grads.last_bias);
        let device = points.device();
        Ok((
            Some(Tensor::from_vec(grads.point_terms, points.shape(), device)?),
            Some(Tensor::from_vec(grads.centroid_terms, centroids.shape(), device)?),
            Some(Tensor::from_vec(flat, weights.shape(), device)?),
        ))
    }
}
