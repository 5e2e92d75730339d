//! A network that completes the shape of an object of which one camera saw a side.
//!
//! It reads a grid over the object, seen from above and cut into slabs ([`SIDE`], [`SLABS`]), and says of each cell how likely the object fills it. Trained
//! by `scripts/train_completion.py` on simulated scenes, in which that is known; who lays the grid and reads the answer is `repose_belief`. A U-net with
//! added skips, like that for masks ([`crate::masks`]), served on the kernels:
//!
//! | cells | layers |
//! |---|---|
//! | all | 3 × 3 → 32, + 3 × 3 |
//! | ½, ¼ | every second cell 3 × 3 → 64 and 96, each + 3 × 3 |
//! | ¼ | + a layer on the grid's mean, + 3 × 3 |
//! | ½, all | the coarser one narrowed and doubled, added to what was there, ReLU, + 3 × 3 |
//! | all | a layer whose outputs are the slabs' |
//!
//! `+` adds a layer's output to its input.

use crate::feature_map::FeatureMap;
use crate::kernel::{Kernel, PackedLinear};
use crate::layer_file::LayerFile;
use crate::weights::WeightsError;

/// Cells along each side of the grid.
pub const SIDE: usize = 24;
/// Slabs from the object's bottom to its top.
pub const SLABS: usize = 8;
/// What is told of a cell: six numbers of each slab, slab by slab, and five of the whole object.
pub const CHANNELS: usize = 6 * SLABS + 5;
/// The format of its weights file.
const FORMAT: &str = "repose-completion-1";
/// Channels at whole, half and quarter resolution.
const WIDTHS: [usize; 3] = [32, 64, 96];

/// The network with its weights.
#[derive(Debug, Clone)]
pub struct CompletionNetwork {
    kernel: Kernel,
    stem: PackedLinear,
    same: [PackedLinear; 3],
    down: [PackedLinear; 2],
    whole: PackedLinear,
    same_again: PackedLinear,
    /// From the next coarser grid's channels to those of all cells and of ½.
    narrow: [PackedLinear; 2],
    join: [PackedLinear; 2],
    head: PackedLinear,
}

impl CompletionNetwork {
    /// The weights that come with the program.
    ///
    /// # Errors
    /// Never: a test reads them.
    pub fn embedded() -> Result<Self, WeightsError> {
        Self::load(include_bytes!("../weights/completion.safetensors"), Kernel::detect())
    }

    /// From a weights file's bytes (half precision), on a kernel of [`Kernel::available`].
    ///
    /// # Errors
    /// [`WeightsError::Malformed`] when the file is of another format, a tensor is missing or of another shape, or a value is not finite.
    pub fn load(bytes: &[u8], kernel: Kernel) -> Result<Self, WeightsError> {
        let file = LayerFile::read(bytes, FORMAT)?;
        let layer = |name: &str, shape: &[usize]| file.layer(&format!("completion/{name}"), shape);
        let [a, b, c] = WIDTHS;
        let square = |name: &str, inputs: usize, outputs: usize| layer(name, &[outputs, 3, 3, inputs]);
        Ok(Self {
            kernel,
            stem: square("stem", CHANNELS, a)?,
            same: [square("same0", a, a)?, square("same1", b, b)?, square("same2", c, c)?],
            down: [square("down1", a, b)?, square("down2", b, c)?],
            whole: layer("whole", &[c, c])?,
            same_again: square("same2b", c, c)?,
            narrow: [layer("narrow0", &[a, 1, 1, b])?, layer("narrow1", &[b, 1, 1, c])?],
            join: [square("join0", a, a)?, square("join1", b, b)?],
            head: layer("head", &[SLABS, 1, 1, a])?,
        })
    }

    /// How likely each cell is filled, `[SIDE · SIDE]` of each slab, by what was seen of the cells, `[SIDE, SIDE]` row by row. The same input gives the same
    /// bits on any number of threads.
    pub fn filled(&self, cells: &[[f32; CHANNELS]]) -> Vec<[f32; SLABS]> {
        assert_eq!(cells.len(), SIDE * SIDE, "a grid of {SIDE} by {SIDE} cells");
        let kernel = self.kernel;
        let plus_own = |x: FeatureMap, layer: &PackedLinear| {
            let more = x.convolved(kernel, layer, 1);
            x.plus(&more)
        };
        let mut seen = FeatureMap::zeros(SIDE, SIDE, CHANNELS);
        for (row, cells) in cells.chunks_exact(SIDE).enumerate() {
            seen.inside_mut(row).copy_from_slice(cells.as_flattened());
        }
        let mut x = plus_own(seen.convolved(kernel, &self.stem, 1), &self.same[0]);
        let mut finer = Vec::with_capacity(self.down.len());
        for (down, same) in self.down.iter().zip(&self.same[1..]) {
            let half = plus_own(x.convolved(kernel, down, 2), same);
            finer.push(std::mem::replace(&mut x, half));
        }
        let mut whole = vec![0.0; self.whole.padded()];
        kernel.linear(&self.whole, &x.mean(), 1, true, &mut whole);
        x = plus_own(x.plus_everywhere(&whole), &self.same_again);
        for ((finer, narrow), join) in finer.into_iter().zip(&self.narrow).zip(&self.join).rev() {
            x = plus_own(finer.plus_twice_as_large(&x.projected(kernel, narrow)), join);
        }
        let logits = x.projected(kernel, &self.head);
        let likely = |cell: &[f32]| std::array::from_fn(|slab| 1.0 / (1.0 + (-cell[slab]).exp()));
        (0..SIDE).flat_map(|row| logits.inside(row).chunks_exact(logits.channels).map(likely).collect::<Vec<_>>()).collect()
    }
}
