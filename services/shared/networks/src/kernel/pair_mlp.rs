//! Gather, shared MLP and max in one pass: what a set abstraction spends its time on.
//!
//! For each centroid `i` with neighbours `j`: `h = relu(point_terms[j] − centroid_terms[i])` (the first linear layer, distributed over the
//! difference and computed once per point), then one or two more linear layers with ReLU between, then the largest value per output over
//! the neighbours. A centroid's pairs stay in the first-level cache from gather to max; nothing the size of all pairs is ever in memory.

use repose_simd::{Lanes, Work};

use super::{
    linear::linear,
    packed::PackedLinear,
    tile::{ROWS, product, vectors_at_once},
};
use crate::neighbours::Neighbours;

/// The inputs of one set abstraction's pair work.
#[derive(Debug, Clone, Copy)]
pub struct PairMlp<'a> {
    /// First layer's terms of the points, `[points, hidden]`, bias included.
    pub point_terms: &'a [f32],
    /// First layer's terms of the centroids, `[centroids, hidden]`.
    pub centroid_terms: &'a [f32],
    /// The layer between, if the MLP has three.
    pub middle: Option<&'a PackedLinear>,
    /// The last layer.
    pub last: &'a PackedLinear,
    /// Which points belong to which centroid.
    pub neighbours: &'a Neighbours,
}

/// [`super::Kernel::pair_mlp`], and with `WINNERS` also [`super::Kernel::pair_mlp_with_winners`].
pub(super) struct Forward<'a, const WINNERS: bool> {
    pub op: &'a PairMlp<'a>,
    pub out: &'a mut [f32],
    pub winners: &'a mut [u16],
    pub scratch: &'a mut Vec<f32>,
}

impl<const WINNERS: bool> Work for Forward<'_, WINNERS> {
    type Output = ();

    #[inline(always)]
    unsafe fn run<S: Lanes>(self) {
        // SAFETY: the instruction set is present by this function's contract.
        unsafe { forward::<S, WINNERS>(self.op, self.out, self.winners, self.scratch) }
    }
}

/// `out[i, ..]` = the largest last-layer value over centroid `i`'s neighbours, `[centroids, last.padded()]`; `winners`, when wanted, the
/// place in the neighbour list that it came from (the first among equals), same shape. `scratch` is any vector, reused between calls.
///
/// A centroid without neighbours (there is none: each is its own neighbour) would give the bias.
///
/// # Safety
/// The instruction set must be present. Lengths are asserted.
#[inline(always)]
unsafe fn forward<S: Lanes, const WINNERS: bool>(op: &PairMlp<'_>, out: &mut [f32], winners: &mut [u16], scratch: &mut Vec<f32>) {
    let hidden = op.middle.map_or(op.last.inputs(), PackedLinear::inputs);
    let padded = op.last.padded();
    let centroids = op.neighbours.centroids();
    let points = op.point_terms.len() / hidden;
    assert!(op.centroid_terms.len() >= centroids * hidden && out.len() >= centroids * padded);
    assert!(!WINNERS || winners.len() >= centroids * padded);
    assert!(hidden.is_multiple_of(S::COUNT) && op.neighbours.indices().iter().all(|j| (*j as usize) < points));
    let most = op.neighbours.most().next_multiple_of(ROWS);
    let middle_width = op.middle.map_or(0, PackedLinear::padded);
    scratch.resize(most * (hidden + middle_width), 0.0);
    let (first, second) = scratch.split_at_mut(most * hidden);
    for i in 0..centroids {
        let list = op.neighbours.of(i);
        if list.is_empty() {
            out[i * padded..(i + 1) * padded].copy_from_slice(op.last.bias());
            continue;
        }
        // Rows are padded to whole tiles by repeating the last one, which changes no maximum.
        let rows = list.len().next_multiple_of(ROWS);
        for r in 0..rows {
            let j = list[r.min(list.len() - 1)] as usize;
            // SAFETY: `hidden` is a multiple of the vector and all three rows were asserted to exist.
            unsafe {
                let (a, b) = (op.point_terms.as_ptr().add(j * hidden), op.centroid_terms.as_ptr().add(i * hidden));
                let to = first.as_mut_ptr().add(r * hidden);
                for k in (0..hidden).step_by(S::COUNT) {
                    S::store(to.add(k), S::max(S::sub(S::load(a.add(k)), S::load(b.add(k))), S::splat(0.0)));
                }
            }
        }
        let input: &[f32] = if let Some(middle) = op.middle {
            // SAFETY: the instruction set is present; `linear` asserts lengths. The middle layer's width equals the last layer's input.
            unsafe { linear::<S>(middle, first, rows, true, second) };
            second
        } else {
            first
        };
        let out = &mut out[i * padded..(i + 1) * padded];
        let winners = if WINNERS { &mut winners[i * padded..(i + 1) * padded] } else { &mut [] };
        // SAFETY: `input` has `rows` rows of the last layer's inputs, `out` and `winners` one padded row.
        unsafe { largest::<S, WINNERS>(op.last, input, rows, list.len(), out, winners) };
    }
}

/// One centroid's rows through the last layer, and the largest of each output.
#[inline(always)]
unsafe fn largest<S: Lanes, const WINNERS: bool>(
    layer: &PackedLinear,
    rows: &[f32],
    count: usize,
    real: usize,
    out: &mut [f32],
    winners: &mut [u16],
) {
    for (start, width, panel) in layer.panels() {
        let mut column = 0;
        while column < width {
            let vectors = ((width - column) / S::COUNT).min(vectors_at_once::<S>());
            let at = start + column;
            let winners = if WINNERS { &mut winners[at..] } else { &mut [] };
            let (bias, out, panel) = (&layer.bias()[at..], &mut out[at..], &panel[column..]);
            // SAFETY: as this function's caller promised, with whole vectors in the panel.
            unsafe {
                match vectors {
                    4.. => strip::<S, 4, WINNERS>(rows, layer.inputs(), count, real, panel, width, bias, out, winners),
                    3 => strip::<S, 3, WINNERS>(rows, layer.inputs(), count, real, panel, width, bias, out, winners),
                    2 => strip::<S, 2, WINNERS>(rows, layer.inputs(), count, real, panel, width, bias, out, winners),
                    _ => strip::<S, 1, WINNERS>(rows, layer.inputs(), count, real, panel, width, bias, out, winners),
                }
            }
            column += vectors.clamp(1, 4) * S::COUNT;
        }
    }
}

#[inline(always)]
#[allow(clippy::too_many_arguments, reason = "the inner loop's operands, named one by one so that they stay in registers")]
unsafe fn strip<S: Lanes, const C: usize, const WINNERS: bool>(
    rows: &[f32],
    inputs: usize,
    count: usize,
    real: usize,
    panel: &[f32],
    width: usize,
    bias: &[f32],
    out: &mut [f32],
    winners: &mut [u16],
) {
    // SAFETY: the caller's slices cover `count` rows and `C` vectors of the panel, the bias and the outputs.
    unsafe {
        let mut best = [S::splat(f32::NEG_INFINITY); C];
        let mut best_row = [S::splat(0.0); C];
        for block in (0..count).step_by(ROWS) {
            let acc = product::<S, ROWS, C>(rows.as_ptr().add(block * inputs), inputs, inputs, panel.as_ptr(), width);
            for (r, acc) in acc.iter().enumerate() {
                if WINNERS {
                    let row = S::splat((block + r) as f32);
                    for ((value, best), best_row) in acc.iter().zip(&mut best).zip(&mut best_row) {
                        (*best, *best_row) = S::larger(*value, *best, row, *best_row);
                    }
                } else {
                    for (value, best) in acc.iter().zip(&mut best) {
                        *best = S::max(*value, *best);
                    }
                }
            }
        }
        #[allow(clippy::needless_range_loop, reason = "indexed over several arrays at once, which vectorises")]
        for c in 0..C {
            S::store(out.as_mut_ptr().add(c * S::COUNT), S::add(best[c], S::load(bias.as_ptr().add(c * S::COUNT))));
        }
        if WINNERS {
            let mut lanes = [0.0f32; 16];
            for (c, best_row) in best_row.iter().enumerate() {
                S::store(lanes.as_mut_ptr(), *best_row);
                for (l, lane) in lanes[..S::COUNT].iter().enumerate() {
                    winners[c * S::COUNT + l] = (*lane as usize).min(real - 1) as u16;
                }
            }
        }
    }
}
