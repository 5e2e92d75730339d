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
use crate::u_net::UNet;
use crate::weights::WeightsError;

/// Cells along each side of the grid.
pub const SIDE: usize = 24;
/// Slabs from the object's bottom to its top.
pub const SLABS: usize = 8;
/// Numbers that are told of each slab of a cell.
pub const OF_SLAB: usize = 6;
/// Numbers that are told of the object as a whole.
pub const OF_OBJECT: usize = 5;
/// What is told of a cell: that of each slab, slab by slab, and that of the whole object.
pub const CHANNELS: usize = OF_SLAB * SLABS + OF_OBJECT;
/// The weights file that comes with the program.
pub static FILE: &[u8] = include_bytes!("../weights/completion.safetensors");
/// The format of its weights file.
const FORMAT: &str = "repose-completion-1";
/// Channels at whole, half and quarter resolution.
const WIDTHS: [usize; 3] = [32, 64, 96];

/// The network with its weights.
#[derive(Debug, Clone)]
pub struct CompletionNetwork {
    kernel: Kernel,
    body: UNet,
    head: PackedLinear,
}

impl CompletionNetwork {
    /// The weights that come with the program.
    ///
    /// # Errors
    /// Never: a test reads them.
    pub fn embedded() -> Result<Self, WeightsError> {
        Self::load(FILE, Kernel::detect())
    }

    /// From a weights file's bytes (half precision), on a kernel of [`Kernel::available`].
    ///
    /// # Errors
    /// [`WeightsError::Malformed`] when the file is of another format, a tensor is missing or of another shape, or a value is not finite.
    pub fn load(bytes: &[u8], kernel: Kernel) -> Result<Self, WeightsError> {
        let file = LayerFile::read(bytes, FORMAT)?;
        let body = UNet::load(&file, "completion", CHANNELS, WIDTHS, kernel)?;
        Ok(Self { kernel, body, head: file.layer("completion/head", &[SLABS, 1, 1, WIDTHS[0]])? })
    }

    /// The kernel's id, which travels with results.
    pub fn kernel_id(&self) -> &'static str {
        self.kernel.id()
    }

    /// How likely each cell is filled, `[SIDE · SIDE]` of each slab, by what was seen of the cells, `[SIDE, SIDE]` row by row. The same input gives the same
    /// bits on any number of threads.
    pub fn filled(&self, cells: &[[f32; CHANNELS]]) -> Vec<[f32; SLABS]> {
        assert_eq!(cells.len(), SIDE * SIDE, "a grid of {SIDE} by {SIDE} cells");
        let mut seen = FeatureMap::zeros(SIDE, SIDE, CHANNELS);
        for (row, cells) in cells.chunks_exact(SIDE).enumerate() {
            seen.inside_mut(row).copy_from_slice(cells.as_flattened());
        }
        let logits = self.body.features(&seen).projected(self.kernel, &self.head);
        let likely = |cell: &[f32]| std::array::from_fn(|slab| 1.0 / (1.0 + (-cell[slab]).exp()));
        (0..SIDE).flat_map(|row| logits.inside(row).chunks_exact(logits.channels).map(likely).collect::<Vec<_>>()).collect()
    }
}
