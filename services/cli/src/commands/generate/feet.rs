//! Shards that the network which looks at feet is trained on, by `scripts/train_feet.py`.

use std::collections::HashMap;
use std::path::Path;

use repose_belief::foot::Foot;
use repose_evaluation::scenes::foot_samples::{DoubtfulSample, FIRST_SEED, doubtful_samples};
use repose_networks::feet::{MEASURES, SIDE};
use safetensors::SafeTensorError;
use safetensors::tensor::{Dtype, TensorView};

use super::shards::{ShardPlan, Shards};
use crate::commands::train::made_with::of_beliefs;
use crate::failure::Failure;

/// The network that is trained on the shards, by its name among what comes with the program; their names begin with it.
const FEET: &str = "feet";
/// Heights and depths are written in steps of this, metres.
const STEP_M: f32 = 0.0005;

/// What is to be made in a folder for so many scenes from one on.
pub fn plan_feet(folder: &Path, first: u64, scenes: u64) -> Result<ShardPlan, Failure> {
    let shards = Shards { name: FEET, first_seed: FIRST_SEED, made_with: of_beliefs(&[FEET]) };
    let plan = shards.plan(folder, first, scenes)?;
    if let Some(caution) = caution(first, Foot::own().fitted_on().scenes as u64) {
        tracing::warn!("{caution}");
    }
    Ok(plan)
}

/// What is said where the trees have learned some of the scenes. It is no error: how many they have learned does not say which.
fn caution(first: u64, learned: u64) -> Option<String> {
    (first < learned).then(|| {
        format!(
            "the trees that come with the program were fitted on {learned} of these scenes: their word on the scenes before number {learned} is surer than \
             on new ones, and the network would learn to trust it too much; new ones are taken with --first {learned}"
        )
    })
}

/// Writes the shards that are missing; how many objects are in them.
pub fn write_feet(plan: &ShardPlan) -> Result<usize, Failure> {
    plan.write(doubtful_samples, shard_of)
}

/// The bytes of a shard. Of each object: `heights` (over the rule's level) and `depths` (behind its middle), in steps, what each pixel has `shown`, how each
/// row `rises`, and in `objects` the middle's depth, a pixel's width and the camera's height over the rule's level. Of each level: which object it is
/// (`object_of`), in `levels` how high it is over the rule's, the trees' log-odds and the measures, and whether it is `right`.
fn shard_of(samples: &[DoubtfulSample], metadata: HashMap<String, String>) -> Result<Vec<u8>, SafeTensorError> {
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
    safetensors::serialize(tensors, Some(metadata))
}

#[cfg(test)]
mod tests {
    use std::array::from_fn;

    use repose_belief::foot_levels::Level;
    use repose_belief::foot_picture::DoubtfulFoot;
    use repose_networks::feet::{FootPicture, Shown, ShownPixel};
    use safetensors::SafeTensors;

    use super::*;

    /// The script that reads shards.
    static SCRIPT: &str = include_str!("../../../../../scripts/train_feet.py");

    #[test]
    fn a_shard_has_the_pictures_of_objects_and_their_levels() {
        let folder = tempfile::tempdir().unwrap();
        let objects = write_feet(&plan_feet(folder.path(), 3600, 9).unwrap()).unwrap();
        assert!(objects > 3, "{objects}");
        let bytes = std::fs::read(folder.path().join("feet-0003600-0003609.safetensors")).unwrap();
        let shard = SafeTensors::deserialize(&bytes).unwrap();
        let [pictures, levels, of, right] = ["shown", "levels", "object_of", "right"].map(|name| shard.tensor(name).unwrap());
        assert_eq!(pictures.shape(), [objects, SIDE, SIDE]);
        assert_eq!(levels.shape(), [right.shape()[0], 2 + MEASURES]);
        let of: Vec<i32> = of.data().chunks_exact(4).map(|bytes| i32::from_le_bytes(bytes.try_into().unwrap())).collect();
        assert!(of.is_sorted() && of[0] == 0 && *of.last().unwrap() as usize == objects - 1, "every object has levels, side by side");
        let own = pictures.data().chunks_exact(SIDE * SIDE).all(|picture| picture.contains(&1) && picture.iter().all(|shown| *shown < 5));
        assert!(own, "the object is in its picture");
        assert!(right.data().contains(&1) && right.data().contains(&0));
        let (_, header) = SafeTensors::read_metadata(&bytes).unwrap();
        assert_eq!(header.metadata().as_ref().unwrap()["made_with"], of_beliefs(&[FEET]));
        assert_ne!(of_beliefs(&[FEET]), of_beliefs(&[]), "what is trained on the shards is left out");
    }

    /// An object with a pixel of each kind and one level for each of `right`, of numbers that a shard holds exactly.
    fn known(right: &[bool]) -> DoubtfulSample {
        let shown = |shown, height_m, depth_m| ShownPixel { shown, height_m, depth_m };
        let mut pixels = vec![shown(Shown::Other, 0.128, 1.5); SIDE * SIDE];
        pixels[..4].copy_from_slice(&[
            shown(Shown::Own, 0.131, 1.525),
            shown(Shown::Furniture, 0.1, 1.25),
            shown(Shown::Beyond, 0.0, 0.0),
            ShownPixel::default(),
        ]);
        let rises = from_fn(|row| -0.5 - row as f32 / 64.0);
        let picture = FootPicture { pixels, rises, depth_m: 1.5, pixel_m: 0.25, eye_m: 0.75, rule_m: 0.125 };
        let level = |k: usize| {
            let measures = (0..MEASURES).map(|measure| (100 * k + measure) as f32).collect();
            (Level { height_m: 0.125 + k as f32 / 16.0, measures }, -0.5 - k as f64)
        };
        DoubtfulSample { foot: DoubtfulFoot { picture, levels: (0..right.len()).map(level).collect() }, right: right.to_vec() }
    }

    #[test]
    fn a_shard_holds_what_is_known_of_an_object_in_the_columns_that_the_script_reads() {
        let bytes = shard_of(&[known(&[false, true]), known(&[true])], HashMap::new()).unwrap();
        let shard = SafeTensors::deserialize(&bytes).unwrap();
        let data = |name: &str, dtype: Dtype, shape: &[usize]| {
            let tensor = shard.tensor(name).unwrap();
            assert_eq!((tensor.dtype(), tensor.shape()), (dtype, shape), "{name}");
            tensor.data()
        };
        let steps = |name: &str| -> Vec<i16> {
            data(name, Dtype::I16, &[2, SIDE, SIDE]).chunks_exact(2).map(|bytes| i16::from_le_bytes(bytes.try_into().unwrap())).collect()
        };
        let floats = |name: &str, shape: &[usize]| -> Vec<f32> {
            data(name, Dtype::F32, shape).chunks_exact(4).map(|bytes| f32::from_le_bytes(bytes.try_into().unwrap())).collect()
        };
        // Half millimetres over the rule's level, and behind the object's middle.
        let (heights, depths, shown) = (steps("heights"), steps("depths"), data("shown", Dtype::U8, &[2, SIDE, SIDE]));
        for picture in [0, SIDE * SIDE] {
            assert_eq!(heights[picture..][..5], [12, -50, -250, -250, 6]);
            assert_eq!(depths[picture..][..5], [50, -500, -3000, -3000, 0]);
            assert_eq!(shown[picture..][..5], [1, 3, 4, 0, 2]);
        }
        let rises: [f32; SIDE] = from_fn(|row| -0.5 - row as f32 / 64.0);
        assert_eq!(floats("rises", &[2, SIDE]), [rises, rises].concat());
        assert_eq!(floats("objects", &[2, 3]), [1.5f32, 0.25, 0.625].repeat(2), "depth, a pixel's width, the camera over the rule's level");
        // How high over the rule's level, the trees' word, the measures.
        let measures = |from: usize| (from..from + MEASURES).map(|measure| measure as f32).collect::<Vec<_>>();
        let [first, second] = [[vec![0.0, -0.5], measures(0)].concat(), [vec![0.0625, -1.5], measures(100)].concat()];
        assert_eq!(floats("levels", &[3, 2 + MEASURES]), [first.clone(), second, first].concat());
        assert_eq!(data("right", Dtype::U8, &[3]), [0, 1, 1]);
        assert_eq!(data("object_of", Dtype::I32, &[3]), [0i32, 0, 1].map(i32::to_le_bytes).as_flattened());
    }

    #[test]
    fn the_script_reads_the_numbers_and_columns_that_shards_are_written_with() {
        let shown = [Shown::Nothing, Shown::Own, Shown::Other, Shown::Furniture, Shown::Beyond];
        assert_eq!(shown.map(|shown| shown as u8), [0, 1, 2, 3, 4]);
        let read = [
            "NOTHING, OWN, OTHER, FURNITURE, BEYOND = range(5)".to_owned(),
            format!("STEP_M = {STEP_M} "),
            format!("SIDE, MEASURES = {SIDE}, {MEASURES}\n"),
            "depth, pixel, eye = torch.from_numpy(self.objects[of]).unbind(1)".to_owned(),
            "depth, eye, told[:, 0])".to_owned(),
            "[told[:, 1] / LOG_ODDS, ".to_owned(),
            "torch.cat([told[:, 2:], ".to_owned(),
        ];
        for line in read {
            assert!(SCRIPT.contains(&line), "{line}");
        }
    }

    #[test]
    fn scenes_that_the_trees_have_learned_are_cautioned_against() {
        assert!(caution(3599, 3600).is_some_and(|said| said.contains("--first 3600")) && caution(3600, 3600).is_none());
        let learned = Foot::own().fitted_on().scenes as u64;
        assert!(caution(0, learned).is_some() && caution(learned, learned).is_none());
    }
}
