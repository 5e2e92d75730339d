//! Shards that the network which looks at feet is trained on, by `scripts/train_feet.py`.

use std::collections::HashMap;
use std::path::Path;

use repose_evaluation::scenes::foot_samples::{DoubtfulSample, FIRST_SEED, doubtful_samples};
use repose_networks::feet::{MEASURES, SIDE};
use safetensors::SafeTensorError;
use safetensors::tensor::{Dtype, TensorView};

use super::shards::Shards;
use crate::failure::Failure;

/// Heights and depths are written in steps of this, metres.
const STEP_M: f32 = 0.0005;

/// Writes the shards that are missing; how many objects are in them.
pub fn write_feet(folder: &Path, first: u64, scenes: u64) -> Result<usize, Failure> {
    let shards = Shards { name: "feet", first_seed: FIRST_SEED };
    shards.write(folder, shards.scenes(first, scenes)?, doubtful_samples, shard_of)
}

/// The bytes of a shard. Of each object: `heights` (over the rule's level) and `depths` (behind its middle), in steps, what each pixel has `shown`, how each
/// row `rises`, and in `objects` the middle's depth, a pixel's width and the camera's height over the rule's level. Of each level: which object it is
/// (`object_of`), in `levels` how high it is over the rule's, the trees' log-odds and the measures, and whether it is `right`.
fn shard_of(samples: &[DoubtfulSample]) -> Result<Vec<u8>, SafeTensorError> {
    let in_steps = |length_m: f32| ((length_m / STEP_M).round() as i16).to_le_bytes();
    let floats = |values: &[f32]| values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>();
    let [mut heights, mut depths, mut shown, mut rises, mut objects, mut object_of, mut levels, mut right] =
        [const { Vec::<u8>::new() }; 8];
    for (index, DoubtfulSample { foot, right: is_right }) in samples.iter().enumerate() {
        let picture = &foot.picture;
        heights.extend(picture.pixels.iter().flat_map(|pixel| in_steps(pixel.height_m - picture.rule_m)));
        depths.extend(picture.pixels.iter().flat_map(|pixel| in_steps(pixel.depth_m - picture.depth_m)));
        shown.extend(picture.pixels.iter().map(|pixel| pixel.shown as u8));
        rises.extend(floats(&picture.rises));
        objects.extend(floats(&[picture.depth_m, picture.pixel_m, picture.eye_m - picture.rule_m]));
        for ((level, log_odds), is_right) in foot.levels.iter().zip(is_right) {
            object_of.extend((index as i32).to_le_bytes());
            levels.extend(floats(&[level.height_m - picture.rule_m, *log_odds as f32]));
            levels.extend(floats(&level.measures));
            right.push(u8::from(*is_right));
        }
    }
    let (count, asked) = (samples.len(), right.len());
    let picture = || vec![count, SIDE, SIDE];
    let tensors = [
        ("heights", TensorView::new(Dtype::I16, picture(), &heights)?),
        ("depths", TensorView::new(Dtype::I16, picture(), &depths)?),
        ("shown", TensorView::new(Dtype::U8, picture(), &shown)?),
        ("rises", TensorView::new(Dtype::F32, vec![count, SIDE], &rises)?),
        ("objects", TensorView::new(Dtype::F32, vec![count, 3], &objects)?),
        ("object_of", TensorView::new(Dtype::I32, vec![asked], &object_of)?),
        ("levels", TensorView::new(Dtype::F32, vec![asked, 2 + MEASURES], &levels)?),
        ("right", TensorView::new(Dtype::U8, vec![asked], &right)?),
    ];
    safetensors::serialize(tensors, None::<HashMap<String, String>>)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shard_has_the_pictures_of_objects_and_their_levels() {
        let folder = tempfile::tempdir().unwrap();
        let objects = write_feet(folder.path(), 3600, 9).unwrap();
        assert!(objects > 3, "{objects}");
        let shard = std::fs::read(folder.path().join("feet-0003600-0003609.safetensors")).unwrap();
        let shard = safetensors::SafeTensors::deserialize(&shard).unwrap();
        let [pictures, levels, of, right] = ["shown", "levels", "object_of", "right"].map(|name| shard.tensor(name).unwrap());
        assert_eq!(pictures.shape(), [objects, SIDE, SIDE]);
        assert_eq!(levels.shape(), [right.shape()[0], 2 + MEASURES]);
        let of: Vec<i32> = of.data().chunks_exact(4).map(|bytes| i32::from_le_bytes(bytes.try_into().unwrap())).collect();
        assert!(of.is_sorted() && of[0] == 0 && *of.last().unwrap() as usize == objects - 1, "every object has levels, side by side");
        let own = pictures.data().chunks_exact(SIDE * SIDE).all(|picture| picture.contains(&1) && picture.iter().all(|shown| *shown < 5));
        assert!(own, "the object is in its picture");
        assert!(right.data().contains(&1) && right.data().contains(&0));
    }
}
