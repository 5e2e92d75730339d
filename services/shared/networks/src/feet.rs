//! A network that looks at the picture around an object's foot.
//!
//! Boosted trees say of each level that an object may end at how likely it is the right one, from a few measures (`repose_belief::foot`). Where they are in
//! doubt, this network looks at the picture around the object ([`FootPicture`]), held against the level ([`AskedLevel`]), and corrects their word. Trained by
//! `scripts/train_feet.py` on simulated scenes, in which the foot is known, and served on the kernels:
//!
//! | what | layers |
//! |---|---|
//! | the picture, [`SIDE`] × [`SIDE`] | every second pixel 3 × 3 → 32, 3 × 3; the same → 48, → 96 |
//! | mean and maximum over it | a layer of 96 |
//! | the numbers that are told beside it, over what is usual | a layer of 96 |
//! | both | a layer of 96, and one that is added to the trees' log-odds |

use crate::feature_map::FeatureMap;
use crate::kernel::{Kernel, PackedLinear};
use crate::layer_file::LayerFile;
use crate::weights::WeightsError;

/// Pixels along each side of the picture.
pub const SIDE: usize = 56;
/// Measures of a level, in the order of `repose_belief::foot_levels::MEASURES`.
pub const MEASURES: usize = 56;
/// What is told beside the picture: the measures, the trees' log-odds, and what the picture is like.
const NUMBERS: usize = MEASURES + 5;
/// What is told of a pixel.
const CHANNELS: usize = 9;
/// Channels at half, quarter and eighth resolution.
const WIDTHS: [usize; 3] = [32, 48, 96];
/// Outputs of the layers on what the picture came to.
const HIDDEN: usize = 96;
/// The weights file that comes with the program.
pub static FILE: &[u8] = include_bytes!("../weights/feet.safetensors");
/// The format of its weights file.
const FORMAT: &str = "repose-feet-1";

/// Lengths are told as shares of these, cut at one, metres: a pixel's height over the level, fine and coarse; its depth behind the object's middle, and
/// behind where its row meets the level.
const HEIGHTS_M: [f32; 2] = [0.05, 0.012];
const DEPTH_M: f32 = 0.15;
const BEHIND_LEVEL_M: f32 = 0.05;
/// Rays that fall less than this per metre of depth count as falling so.
const LEAST_FALL: f32 = 0.05;
/// Numbers are told over what is usual, cut here.
const UNUSUAL: f32 = 4.0;
/// What is usual of pictures: a pixel's width, the depth of an object's middle and the camera's height over the foot, metres.
const USUAL_PIXEL_M: f32 = 0.004;
const USUAL_DEPTH_M: f32 = 1.0;
const USUAL_EYE_M: f32 = 0.7;
/// The trees' log-odds are told as a share of this.
const LOG_ODDS: f32 = 4.0;

/// What a pixel shows, by the number that it has in what the network is trained on.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Shown {
    /// It has no reading.
    #[default]
    Nothing = 0,
    /// The object.
    Own = 1,
    /// Another object.
    Other = 2,
    /// Furniture.
    Furniture = 3,
    /// It is beyond the picture's edge.
    Beyond = 4,
}

/// A pixel of the picture around an object; 0 without a reading.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ShownPixel {
    /// What it shows.
    pub shown: Shown,
    /// World z, metres.
    pub height_m: f32,
    /// Along the optical axis, metres.
    pub depth_m: f32,
}

/// The picture around an object's foot, upright.
#[derive(Debug, Clone, PartialEq)]
pub struct FootPicture {
    /// Row by row, `[SIDE, SIDE]`.
    pub pixels: Vec<ShownPixel>,
    /// How far the ray through the middle of each row goes up, per metre along the optical axis.
    pub rises: [f32; SIDE],
    /// The depth of the object's middle, metres.
    pub depth_m: f32,
    /// How wide a pixel is there, metres.
    pub pixel_m: f32,
    /// Where the camera is, world z, metres.
    pub eye_m: f32,
    /// Where the rule believes the object's bottom, world z, metres.
    pub rule_m: f32,
}

/// A level that an object may end at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AskedLevel<'a> {
    /// World z, metres.
    pub height_m: f32,
    /// Its measures, `[MEASURES]`.
    pub measures: &'a [f32],
    /// The trees' word.
    pub log_odds: f32,
}

/// The network with its weights.
#[derive(Debug, Clone)]
pub struct FeetNetwork {
    kernel: Kernel,
    /// With how many pixels lie from one output to the next.
    convolutions: Vec<(PackedLinear, usize)>,
    usual: Vec<f32>,
    per_unit: Vec<f32>,
    picture: PackedLinear,
    numbers: PackedLinear,
    both: PackedLinear,
    head: PackedLinear,
}

impl FeetNetwork {
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
        let mut convolutions = Vec::new();
        let mut inputs = CHANNELS;
        for (k, width) in WIDTHS.into_iter().enumerate() {
            convolutions.push((file.layer(&format!("feet/down{k}"), &[width, 3, 3, inputs])?, 2));
            convolutions.push((file.layer(&format!("feet/same{k}"), &[width, 3, 3, width])?, 1));
            inputs = width;
        }
        Ok(Self {
            kernel,
            convolutions,
            usual: file.values("feet/usual", "mean", &[NUMBERS])?,
            per_unit: file.values("feet/usual", "per_unit", &[NUMBERS])?,
            picture: file.layer("feet/picture", &[HIDDEN, 2 * inputs])?,
            numbers: file.layer("feet/numbers", &[HIDDEN, NUMBERS])?,
            both: file.layer("feet/both", &[HIDDEN, 2 * HIDDEN])?,
            head: file.layer("feet/head", &[1, HIDDEN])?,
        })
    }

    /// The log-odds that an object ends at a level, by its picture and the trees' word. The same input gives the same bits on any number of threads.
    pub fn log_odds(&self, picture: &FootPicture, level: &AskedLevel<'_>) -> f32 {
        let mut map = held_against(picture, level.height_m);
        for (layer, stride) in &self.convolutions {
            map = map.convolved(self.kernel, layer, *stride);
        }
        let seen = self.layer(&self.picture, &[map.mean(), map.most()].concat(), true);
        let told = self.layer(&self.numbers, &self.over_usual(&numbers(picture, level)), true);
        let both = self.layer(&self.both, &[seen, told].concat(), true);
        level.log_odds + self.layer(&self.head, &both, false)[0]
    }

    fn over_usual(&self, numbers: &[f32]) -> Vec<f32> {
        let usual = self.usual.iter().zip(&self.per_unit);
        numbers.iter().zip(usual).map(|(x, (mean, per_unit))| ((x - mean) * per_unit).clamp(-UNUSUAL, UNUSUAL)).collect()
    }

    fn layer(&self, layer: &PackedLinear, inputs: &[f32], relu: bool) -> Vec<f32> {
        let mut out = vec![0.0; layer.padded()];
        self.kernel.linear(layer, inputs, 1, relu, &mut out);
        out.truncate(layer.outputs());
        out
    }
}

/// The picture held against a level: `[SIDE, SIDE, CHANNELS]`.
fn held_against(picture: &FootPicture, level_m: f32) -> FeatureMap {
    assert_eq!(picture.pixels.len(), SIDE * SIDE, "a picture of {SIDE} by {SIDE} pixels");
    let mut map = FeatureMap::zeros(SIDE, SIDE, CHANNELS);
    let share = |length_m: f32, of_m: f32| (length_m / of_m).clamp(-1.0, 1.0);
    let flag = |is: bool| f32::from(u8::from(is));
    for (row, (pixels, rise)) in picture.pixels.chunks_exact(SIDE).zip(&picture.rises).enumerate() {
        // Where a ray of this row meets the level, behind the object's middle.
        let meets_m = (level_m - picture.eye_m) / rise.min(-LEAST_FALL) - picture.depth_m;
        for (told, pixel) in map.inside_mut(row).chunks_exact_mut(CHANNELS).zip(pixels) {
            let is = |shown: Shown| pixel.shown == shown;
            let read = flag(is(Shown::Own) || is(Shown::Other) || is(Shown::Furniture));
            let (over_m, behind_m) = (pixel.height_m - level_m, pixel.depth_m - picture.depth_m);
            told.copy_from_slice(&[
                read * share(over_m, HEIGHTS_M[0]),
                read * share(over_m, HEIGHTS_M[1]),
                read * share(behind_m, DEPTH_M),
                flag(is(Shown::Own)),
                flag(is(Shown::Other)),
                flag(is(Shown::Furniture)),
                flag(is(Shown::Beyond)),
                share(meets_m, DEPTH_M),
                read * share(behind_m - meets_m, BEHIND_LEVEL_M),
            ]);
        }
    }
    map
}

/// What is told beside the picture.
fn numbers(picture: &FootPicture, level: &AskedLevel<'_>) -> Vec<f32> {
    assert_eq!(level.measures.len(), MEASURES, "the measures of a level");
    let of_picture = [
        level.log_odds / LOG_ODDS,
        (picture.pixel_m / USUAL_PIXEL_M).ln(),
        picture.rises[SIDE / 2],
        picture.depth_m - USUAL_DEPTH_M,
        picture.eye_m - picture.rule_m - USUAL_EYE_M,
    ];
    [level.measures, &of_picture].concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pixel_is_told_by_how_far_it_is_from_the_level_and_whose_it_is() {
        let mut picture = FootPicture {
            pixels: vec![ShownPixel::default(); SIDE * SIDE],
            rises: [-0.5; SIDE],
            depth_m: 1.0,
            pixel_m: 0.004,
            eye_m: 0.5,
            rule_m: 0.0,
        };
        picture.pixels[0] = ShownPixel { shown: Shown::Own, height_m: 0.006, depth_m: 1.03 };
        picture.pixels[1] = ShownPixel { shown: Shown::Beyond, ..ShownPixel::default() };
        let map = held_against(&picture, 0.0);
        let told = |pixel: usize| &map.inside(0)[pixel * CHANNELS..][..CHANNELS];
        // A ray that falls by half a metre per metre meets the level one metre away: at the object's middle.
        for (is, expected) in told(0).iter().zip([0.12, 0.5, 0.2, 1.0, 0.0, 0.0, 0.0, 0.0, 0.6]) {
            assert!((is - expected).abs() < 1e-5, "{:?}", told(0));
        }
        assert_eq!(told(1), [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
        assert_eq!(told(2), [0.0; CHANNELS]);
        // Held against a lower level it is higher, and rays go on further.
        let lower = held_against(&picture, -0.05);
        assert!(lower.inside(0)[0] > told(0)[0] && lower.inside(0)[7] > 0.5);
    }
}
