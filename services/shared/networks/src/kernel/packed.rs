//! A linear layer's weights in the order in which the kernels read them.
//!
//! Columns (outputs) are cut into panels of up to [`PANEL`] floats; a panel holds, input after input, the weights of its outputs side by
//! side, so that the inner loop reads memory straight through. The last panel is padded with zeros to a multiple of [`ALIGN`].

/// Outputs in a full panel: four AVX-512 registers, eight AVX2 ones.
pub(crate) const PANEL: usize = 64;
/// Panel widths are multiples of this: one AVX-512 register.
pub(crate) const ALIGN: usize = 16;

/// `y = W x + b`, `W` of shape `[outputs, inputs]`, packed.
#[derive(Debug, Clone)]
pub struct PackedLinear {
    inputs: usize,
    outputs: usize,
    /// Panels one after another, each `[inputs, width]`.
    weights: Vec<f32>,
    /// `[padded outputs]`, zeros in the padding.
    bias: Vec<f32>,
}

impl PackedLinear {
    /// Packs row-major `weight` `[outputs, inputs]` and `bias` `[outputs]`.
    ///
    /// # Panics
    /// When the lengths do not fit: a program error, loaded weights are checked before.
    pub fn new(inputs: usize, outputs: usize, weight: &[f32], bias: &[f32]) -> Self {
        assert_eq!((weight.len(), bias.len()), (inputs * outputs, outputs), "weight [{outputs}, {inputs}] and bias [{outputs}]");
        let padded = outputs.next_multiple_of(ALIGN);
        let mut weights = Vec::with_capacity(inputs * padded);
        let mut start = 0;
        while start < padded {
            let width = PANEL.min(padded - start);
            for k in 0..inputs {
                weights.extend((start..start + width).map(|o| if o < outputs { weight[o * inputs + k] } else { 0.0 }));
            }
            start += width;
        }
        let mut bias = bias.to_vec();
        bias.resize(padded, 0.0);
        Self { inputs, outputs, weights, bias }
    }

    /// Width of an input row.
    pub fn inputs(&self) -> usize {
        self.inputs
    }

    /// Width of an output row without padding.
    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// Width of an output row in memory.
    pub(crate) fn padded(&self) -> usize {
        self.bias.len()
    }

    /// The padded bias.
    pub(crate) fn bias(&self) -> &[f32] {
        &self.bias
    }

    /// Panels as (first output, width, weights `[inputs, width]`).
    #[inline(always)]
    pub(crate) fn panels(&self) -> impl Iterator<Item = (usize, usize, &[f32])> {
        let padded = self.padded();
        (0..padded.div_ceil(PANEL)).map(move |p| {
            let start = p * PANEL;
            let width = PANEL.min(padded - start);
            (start, width, &self.weights[start * self.inputs..][..self.inputs * width])
        })
    }
}
