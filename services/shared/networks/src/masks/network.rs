//! The network: a U-net with added skips, from features of depth to "object" and "same object".
//!
//! | pictures of | layers |
//! |---|---|
//! | ½ | four pixels' features side by side → 3 × 3 → 48, + 3 × 3 |
//! | ¼, ⅛ | every second pixel 3 × 3 → 64 and 128, each + 3 × 3 |
//! | 1/16 | every second 3 × 3 → 192, + 3 × 3, + a layer on the picture's mean, + 3 × 3 |
//! | ⅛, ¼, ½ | the coarser one narrowed and doubled, added to what was there, ReLU, + 3 × 3 |
//! | 1 | a layer whose outputs are those of four pixels |
//!
//! `+` adds a layer's output to its input. Norms are folded into the convolutions (`scripts/train_masks.py` trains and exports).

use super::inputs::{CHANNELS, MaskInputs};
use crate::feature_map::FeatureMap;
use crate::kernel::{Kernel, PackedLinear};
use crate::layer_file::LayerFile;
use crate::u_net::UNet;
use crate::weights::WeightsError;

/// The weights file that comes with the program.
pub static FILE: &[u8] = include_bytes!("../../weights/masks.safetensors");
/// The format of its weights file.
const FORMAT: &str = "repose-masks-1";
/// Channels at ½, ¼, ⅛ and 1/16 of the picture.
const WIDTHS: [usize; 4] = [48, 64, 128, 192];
/// Outputs of a pixel: object, and one for each of [`OFFSETS`].
const OUTPUTS: usize = 1 + OFFSETS.len();
/// Sides of the picture must be multiples of this; the rest is filled up with pixels without readings.
const MULTIPLE: usize = 16;

/// Columns to the right and rows down from a pixel to the one that it is compared with; the first two are its neighbours.
pub const OFFSETS: [[isize; 2]; 10] = [[1, 0], [0, 1], [4, 0], [0, 4], [4, 4], [-4, 4], [12, 0], [0, 12], [12, 12], [-12, 12]];

/// What the network says of a picture, as logits: above 0 is more likely than not.
#[derive(Debug, Clone, PartialEq)]
pub struct MaskLogits {
    /// Columns of the picture.
    pub width: usize,
    /// Rows of the picture.
    pub height: usize,
    /// Of each pixel, row by row: whether it shows a movable object, then for each of [`OFFSETS`] whether the pixel there shows the same one.
    pub pixels: Vec<[f32; OUTPUTS]>,
}

/// The network with its weights.
#[derive(Debug, Clone)]
pub struct MaskNetwork {
    kernel: Kernel,
    body: UNet,
    head: PackedLinear,
}

impl MaskNetwork {
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
        let body = UNet::load(&file, "masks", 4 * CHANNELS, WIDTHS, kernel)?;
        Ok(Self { kernel, body, head: file.layer("masks/head", &[4 * OUTPUTS, 1, 1, WIDTHS[0]])? })
    }

    /// What the network says of a picture. The same inputs give the same bits on any number of threads.
    pub fn logits(&self, inputs: &MaskInputs) -> MaskLogits {
        unfolded(&self.body.features(&folded(inputs)).projected(self.kernel, &self.head), inputs)
    }
}

/// The inputs with four pixels' features in each, those of one channel side by side, filled up to whole multiples.
fn folded(inputs: &MaskInputs) -> FeatureMap {
    let (rows, columns) = (inputs.height.next_multiple_of(MULTIPLE) / 2, inputs.width.next_multiple_of(MULTIPLE) / 2);
    let mut map = FeatureMap::zeros(rows, columns, 4 * CHANNELS);
    for (v, row) in inputs.pixels.chunks_exact(inputs.width.max(1)).enumerate() {
        let out = map.inside_mut(v / 2);
        for (u, pixel) in row.iter().enumerate() {
            let corner = 2 * (v % 2) + u % 2;
            let out = &mut out[u / 2 * 4 * CHANNELS..][..4 * CHANNELS];
            out.iter_mut().skip(corner).step_by(4).zip(pixel).for_each(|(out, x)| *out = *x);
        }
    }
    map
}

/// Each pixel's own outputs, from those of four pixels.
fn unfolded(map: &FeatureMap, inputs: &MaskInputs) -> MaskLogits {
    let mut pixels = vec![[0.0; OUTPUTS]; inputs.width * inputs.height];
    for (v, row) in pixels.chunks_exact_mut(inputs.width.max(1)).enumerate() {
        let from = map.inside(v / 2);
        for (u, pixel) in row.iter_mut().enumerate() {
            let corner = 2 * (v % 2) + u % 2;
            let from = from[u / 2 * map.channels..].iter().skip(corner).step_by(4);
            pixel.iter_mut().zip(from).for_each(|(x, from)| *x = *from);
        }
    }
    MaskLogits { width: inputs.width, height: inputs.height, pixels }
}
