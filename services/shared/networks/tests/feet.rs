//! The network that looks at feet computes what PyTorch computes with the same weights, on every kernel.

use repose_networks::Kernel;
use repose_networks::feet::{AskedLevel, FeetNetwork, FootPicture, MEASURES, SIDE, Shown, ShownPixel};

const WEIGHTS: &[u8] = include_bytes!("../weights/feet.safetensors");
/// Written by `scripts/train_feet.py --weights … --golden …`: the log-odds of five levels.
const GOLDEN: &str = include_str!("feet_golden.json");
/// The rule's level and the depth of the object's middle, metres.
const RULE_M: f32 = 0.1;
const MIDDLE_M: f32 = 0.9;

/// `by_formula` of the script.
fn picture() -> FootPicture {
    let pixel = |index: usize| {
        let (row, column) = (index / SIDE, index % SIDE);
        let shown = [Shown::Nothing, Shown::Own, Shown::Other, Shown::Furniture, Shown::Beyond][(row + 2 * column) % 5];
        ShownPixel {
            shown,
            height_m: RULE_M + ((7 * row + 3 * column) % 23) as f32 * 0.005 - 0.03,
            depth_m: MIDDLE_M + ((5 * row + 2 * column) % 19) as f32 * 0.01 - 0.1,
        }
    };
    FootPicture {
        pixels: (0..SIDE * SIDE).map(pixel).collect(),
        rises: std::array::from_fn(|row| -0.2 - row as f32 * 0.01),
        depth_m: MIDDLE_M,
        pixel_m: 0.003,
        eye_m: RULE_M + 0.6,
        rule_m: RULE_M,
    }
}

fn log_odds(network: &FeetNetwork) -> [f32; 5] {
    let measures: Vec<f32> = (0..MEASURES).map(|k| (k % 7) as f32 / 7.0 - 0.3).collect();
    std::array::from_fn(|k| {
        let over_m = k as f32 * 0.01 - 0.02;
        network.log_odds(&picture(), &AskedLevel { height_m: RULE_M + over_m, measures: &measures, log_odds: over_m * 40.0 })
    })
}

#[test]
fn how_likely_a_level_is_is_what_pytorch_says() {
    let golden: [f32; 5] = serde_json::from_str(GOLDEN).unwrap();
    assert!(golden.windows(2).any(|two| (two[1] - two[0] - 0.4).abs() > 0.05), "more than the trees' word");
    for kernel in Kernel::available() {
        let ours = log_odds(&FeetNetwork::load(WEIGHTS, kernel).unwrap());
        for (is, expected) in ours.iter().zip(golden) {
            assert!((is - expected).abs() < 5e-3, "{kernel:?}: {ours:?} not {golden:?}");
        }
    }
}

#[test]
fn the_same_picture_gives_the_same_bits_on_any_number_of_threads() {
    let network = FeetNetwork::embedded().unwrap();
    let on =
        |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| log_odds(&network).map(f32::to_bits));
    assert_eq!(on(1), on(3));
}

#[test]
fn what_are_no_weights_is_refused_with_the_field_named() {
    let refused = |bytes: &[u8]| FeetNetwork::load(bytes, Kernel::detect()).unwrap_err().to_string();
    assert!(refused(b"nothing").contains("header"));
    assert!(refused(include_bytes!("../weights/completion.safetensors")).contains("format"));
    assert!(refused(&WEIGHTS[..WEIGHTS.len() - 2]).starts_with("weights:"));
}
