//! The gradient of [`super::pair_mlp`], routed by the winners of the forward pass.
//!
//! A maximum sends its gradient to one neighbour only, so the last layer's backward pass touches one row per output instead of all
//! neighbours: a sixty-fourth of a dense one. (candle's own `max` sends it in full to every tied element.)

use repose_simd::{Lanes, Work};

use super::{
    linear::linear,
    packed::PackedLinear,
    pair_mlp::PairMlp,
    tile::{ROWS, product},
};

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

/// [`super::Kernel::pair_mlp_backward`].
pub(super) struct Backward<'a> {
    pub op: &'a PairMlp<'a>,
    pub raw: &'a RawLayers<'a>,
    pub winners: &'a [u16],
    pub grad_out: &'a [f32],
}

impl Work for Backward<'_> {
    type Output = PairMlpGradients;

    #[inline(always)]
    unsafe fn run<S: Lanes>(self) -> PairMlpGradients {
        // SAFETY: the instruction set is present by this function's contract.
        unsafe { backward::<S>(self.op, self.raw, self.winners, self.grad_out) }
    }
}

/// Gradients from `grad_out` `[centroids, outputs]` and the forward pass's `winners` `[centroids, padded outputs]`.
///
/// The last layer and the gather are plain slices, vectorised as the caller's `#[target_feature]` allows; the middle layer, whose gradient
/// is dense, runs on the forward pass's tiles.
///
/// # Safety
/// The instruction set must be present.
#[inline(always)]
unsafe fn backward<S: Lanes>(op: &PairMlp<'_>, raw: &RawLayers<'_>, winners: &[u16], grad_out: &[f32]) -> PairMlpGradients {
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
    let most = op.neighbours.most().next_multiple_of(ROWS);
    let mut first = vec![0.0f32; most * hidden];
    let mut grad_first = vec![0.0f32; most * hidden];
    let mut middle = raw.middle.zip(op.middle).map(|(weight, packed)| Middle::new(weight, packed, most));
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
        if let Some(middle) = &mut middle {
            let n = list.len();
            // SAFETY: the instruction set is present by this function's contract; `linear` asserts lengths.
            unsafe { linear::<S>(middle.packed, &first, n, true, &mut middle.rows) };
            middle.grad[..n * inputs].fill(0.0);
            last_layer(raw.last, inputs, grad, winners, &middle.rows, &mut middle.grad, &mut grads);
            // SAFETY: as above.
            unsafe { middle.backward::<S>(&first, n, &mut grad_first, &mut grads) };
        } else {
            grad_first[..list.len() * hidden].fill(0.0);
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

/// The layer between: its rows, recomputed rather than kept from the forward pass, and their gradient.
struct Middle<'a> {
    packed: &'a PackedLinear,
    /// The same weights the other way round, `[hidden outputs, middle inputs]`.
    transposed: PackedLinear,
    /// `[neighbours, width]`, after ReLU.
    rows: Vec<f32>,
    /// `[neighbours, width]`.
    grad: Vec<f32>,
    /// `[width, neighbours]`.
    grad_by_output: Vec<f32>,
}

impl<'a> Middle<'a> {
    fn new(weight: &[f32], packed: &'a PackedLinear, most: usize) -> Self {
        let (inputs, outputs) = (packed.inputs(), packed.outputs());
        let columns: Vec<f32> = (0..inputs).flat_map(|k| (0..outputs).map(move |o| weight[o * inputs + k])).collect();
        let buffer = || vec![0.0; most * outputs];
        Self {
            packed,
            transposed: PackedLinear::new(outputs, inputs, &columns, &vec![0.0; inputs]),
            rows: buffer(),
            grad: buffer(),
            grad_by_output: buffer(),
        }
    }

    /// From the gradient of the rows to those of their inputs (`grad_first`, overwritten) and of the layer (added).
    #[inline(always)]
    unsafe fn backward<S: Lanes>(&mut self, first: &[f32], count: usize, grad_first: &mut [f32], grads: &mut PairMlpGradients) {
        let (inputs, outputs) = (self.packed.inputs(), self.packed.outputs());
        assert!(outputs.is_multiple_of(4) && inputs.is_multiple_of(2 * S::COUNT) && outputs == self.packed.padded());
        for r in 0..count {
            for c in 0..outputs {
                let at = r * outputs + c;
                let g = if self.rows[at] > 0.0 { self.grad[at] } else { 0.0 };
                self.grad[at] = g;
                self.grad_by_output[c * count + r] = g;
                grads.middle_bias[c] += g;
            }
        }
        // SAFETY: the instruction set is present by the caller's contract. `linear` asserts lengths; the products below read
        // `outputs` (a multiple of 4) rows of `count` and `count` rows of `inputs` (a multiple of two vectors), both asserted.
        unsafe {
            linear::<S>(&self.transposed, &self.grad, count, false, grad_first);
            for c in (0..outputs).step_by(4) {
                let rows = self.grad_by_output.as_ptr().add(c * count);
                for k in (0..inputs).step_by(2 * S::COUNT) {
                    let sums = product::<S, 4, 2>(rows, count, count, first.as_ptr().add(k), inputs);
                    for (r, sums) in sums.iter().enumerate() {
                        for (v, sum) in sums.iter().enumerate() {
                            let to = grads.middle_weight.as_mut_ptr().add((c + r) * inputs + k + v * S::COUNT);
                            S::store(to, S::add(S::load(to), *sum));
                        }
                    }
                }
            }
        }
    }
}

#[inline(always)]
fn last_layer(
    weight: &[f32],
    inputs: usize,
    grad: &[f32],
    winners: &[u16],
    rows: &[f32],
    grad_rows: &mut [f32],
    grads: &mut PairMlpGradients,
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
