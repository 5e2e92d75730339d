//! The gradient of [`super::pair_mlp`], routed by the winners of the forward pass.
//!
//! A maximum sends its gradient to one neighbour only, so the last layer's backward pass touches one row per output instead of all
//! neighbours: a sixty-fourth of a dense one. (candle's own `max` sends it in full to every tied element.)

use super::pair_mlp::PairMlp;

/// Row-major weights of the layers after the first, as the optimiser holds them.
#[derive(Debug, Clone, Copy)]
pub struct RawLayers<'a> {
    /// The layer between, `[middle outputs, hidden]`, if there is one.
    pub middle: Option<&'a [f32]>,
    /// The last layer, `[outputs, inputs]`.
    pub last: &'a [f32],
}

/// Gradients of a scalar with respect to everything that [`PairMlp`] read. All start as zeros.
#[derive(Debug, Clone)]
pub struct PairMlpGradients {
    /// `[points, hidden]`.
    pub point_terms: Vec<f32>,
    /// `[centroids, hidden]`.
    pub centroid_terms: Vec<f32>,
    /// `[middle outputs, hidden]`; empty without a middle layer.
    pub middle_weight: Vec<f32>,
    /// `[middle outputs]`.
    pub middle_bias: Vec<f32>,
    /// `[outputs, inputs]`.
    pub last_weight: Vec<f32>,
    /// `[outputs]`.
    pub last_bias: Vec<f32>,
}

/// Gradients from `grad_out` `[centroids, outputs]` and the forward pass's `winners` `[centroids, padded outputs]`.
///
/// Plain slices: the caller's `#[target_feature]` decides how they are vectorised.
#[inline(always)]
pub(crate) fn backward(op: &PairMlp<'_>, raw: &RawLayers<'_>, winners: &[u16], grad_out: &[f32]) -> PairMlpGradients {
    let hidden = op.middle.map_or(op.last.inputs(), |m| m.inputs());
    let (inputs, outputs, padded) = (op.last.inputs(), op.last.outputs(), op.last.padded());
    let mut grads = PairMlpGradients {
        point_terms: vec![0.0; op.point_terms.len()],
        centroid_terms: vec![0.0; op.centroid_terms.len()],
        middle_weight: vec![0.0; raw.middle.map_or(0, <[f32]>::len)],
        middle_bias: vec![0.0; raw.middle.map_or(0, |_| inputs)],
        last_weight: vec![0.0; raw.last.len()],
        last_bias: vec![0.0; outputs],
    };
    let most = op.neighbours.most();
    let mut first = vec![0.0f32; most * hidden];
    let mut second = vec![0.0f32; if raw.middle.is_some() { most * inputs } else { 0 }];
    let mut grad_first = vec![0.0f32; most * hidden];
    let mut grad_second = vec![0.0f32; second.len()];
    for i in 0..op.neighbours.centroids() {
        let list = op.neighbours.of(i);
        let grad = &grad_out[i * outputs..(i + 1) * outputs];
        let winners = &winners[i * padded..(i + 1) * padded];
        let b = &op.centroid_terms[i * hidden..(i + 1) * hidden];
        for (h, j) in first.chunks_exact_mut(hidden).zip(list) {
            let a = &op.point_terms[*j as usize * hidden..(*j as usize + 1) * hidden];
            for k in 0..hidden {
                h[k] = (a[k] - b[k]).max(0.0);
            }
        }
        grad_first[..list.len() * hidden].fill(0.0);
        if let (Some(weight), Some(packed)) = (raw.middle, op.middle) {
            middle_rows(packed.bias(), weight, &first, hidden, list.len(), inputs, &mut second);
            grad_second[..list.len() * inputs].fill(0.0);
            last_layer(raw.last, inputs, grad, winners, &second, &mut grad_second, &mut grads);
            for r in 0..list.len() {
                let (h2, g2) = (&second[r * inputs..(r + 1) * inputs], &grad_second[r * inputs..(r + 1) * inputs]);
                let (h1, g1) = (&first[r * hidden..(r + 1) * hidden], &mut grad_first[r * hidden..(r + 1) * hidden]);
                for c in 0..inputs {
                    if h2[c] > 0.0 && g2[c] != 0.0 {
                        grads.middle_bias[c] += g2[c];
                        axpy(g2[c], h1, &mut grads.middle_weight[c * hidden..(c + 1) * hidden]);
                        axpy(g2[c], &weight[c * hidden..(c + 1) * hidden], g1);
                    }
                }
            }
        } else {
            last_layer(raw.last, inputs, grad, winners, &first, &mut grad_first, &mut grads);
        }
        let grad_b = &mut grads.centroid_terms[i * hidden..(i + 1) * hidden];
        for (r, j) in list.iter().enumerate() {
            let (h, g) = (&first[r * hidden..(r + 1) * hidden], &grad_first[r * hidden..(r + 1) * hidden]);
            let grad_a = &mut grads.point_terms[*j as usize * hidden..(*j as usize + 1) * hidden];
            for k in 0..hidden {
                let g = if h[k] > 0.0 { g[k] } else { 0.0 };
                grad_a[k] += g;
                grad_b[k] -= g;
            }
        }
    }
    grads
}

/// `second = relu(first · weightᵀ + bias)`, recomputed rather than kept from the forward pass.
#[inline(always)]
fn middle_rows(bias: &[f32], weight: &[f32], first: &[f32], hidden: usize, count: usize, width: usize, second: &mut [f32]) {
    for r in 0..count {
        let h = &first[r * hidden..(r + 1) * hidden];
        for c in 0..width {
            let w = &weight[c * hidden..(c + 1) * hidden];
            // Sixteen partial sums, so that the compiler may use whole vectors.
            let mut sums = [0.0f32; 16];
            for (h, w) in h.chunks_exact(16).zip(w.chunks_exact(16)) {
                for l in 0..16 {
                    sums[l] += h[l] * w[l];
                }
            }
            second[r * width + c] = (sums.iter().sum::<f32>() + bias[c]).max(0.0);
        }
    }
}

#[inline(always)]
fn last_layer(
    weight: &[f32], inputs: usize, grad: &[f32], winners: &[u16], rows: &[f32], grad_rows: &mut [f32], grads: &mut PairMlpGradients,
) {
    for (c, g) in grad.iter().enumerate() {
        if *g != 0.0 {
            let r = usize::from(winners[c]);
            grads.last_bias[c] += g;
            axpy(*g, &rows[r * inputs..(r + 1) * inputs], &mut grads.last_weight[c * inputs..(c + 1) * inputs]);
            axpy(*g, &weight[c * inputs..(c + 1) * inputs], &mut grad_rows[r * inputs..(r + 1) * inputs]);
        }
    }
}

/// `y += a · x`.
#[inline(always)]
fn axpy(a: f32, x: &[f32], y: &mut [f32]) {
    for (y, x) in y.iter_mut().zip(x) {
        *y += a * x;
    }
}
