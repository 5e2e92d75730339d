//! The network for masks computes what PyTorch computes with the same weights, on every kernel and any number of threads.

use nalgebra::Vector3;
use repose_geometry::Pinhole;
use repose_networks::Kernel;
use repose_networks::masks::{MaskInputs, MaskLogits, MaskNetwork};
use serde::Deserialize;

const WEIGHTS: &[u8] = include_bytes!("../weights/masks.safetensors");
/// Written by `scripts/train_masks.py --export … --golden …`.
const GOLDEN: &str = include_str!("masks_golden.json");
const CAMERA: Pinhole = Pinhole { width: 64, height: 48, fx: 60.0, fy: 60.0, cx: 31.5, cy: 23.5 };

/// Of every seventh pixel, by channel.
#[derive(Deserialize)]
struct Golden {
    inputs: Vec<Vec<f32>>,
    logits: Vec<Vec<f32>>,
}

/// `golden_scene` of the script: a table with a box on it and a corner without readings.
fn inputs() -> MaskInputs {
    let depth = |i: usize| {
        let (u, v) = (i % 64, i / 64);
        let table = 0.7 / (0.6 + 0.8 * (v as f32 - 23.5) / 60.0);
        let on_box = (20..40).contains(&u) && (16..30).contains(&v);
        if u >= 50 && v < 8 { 0.0 } else { table - if on_box { 0.05 } else { 0.0 } }
    };
    let depth: Vec<f32> = (0..64 * 48).map(depth).collect();
    MaskInputs::new(&depth, &CAMERA, &Vector3::new(0.0, -0.8, -0.6))
}

fn logits(kernel: Kernel) -> MaskLogits {
    MaskNetwork::load(WEIGHTS, kernel).unwrap().logits(&inputs())
}

#[test]
fn inputs_and_logits_are_those_of_pytorch() {
    let golden: Golden = serde_json::from_str(GOLDEN).unwrap();
    let ours = inputs();
    for (channel, expected) in golden.inputs.iter().enumerate() {
        assert_eq!(expected.len(), ours.pixels.len().div_ceil(7));
        for (pixel, expected) in ours.pixels.iter().step_by(7).zip(expected) {
            assert!((pixel[channel] - expected).abs() < 2e-3, "channel {channel}: {} instead of {expected}", pixel[channel]);
        }
    }
    for kernel in Kernel::available() {
        let ours = logits(kernel);
        for (channel, expected) in golden.logits.iter().enumerate() {
            for (k, (pixel, expected)) in ours.pixels.iter().step_by(7).zip(expected).enumerate() {
                let off = (pixel[channel] - expected).abs();
                assert!(off < 0.02 + 0.005 * expected.abs(), "{kernel:?}, pixel {}, {channel}: {} not {expected}", 7 * k, pixel[channel]);
            }
        }
    }
}

#[test]
fn a_picture_of_any_size_gets_logits_of_its_size_and_the_same_ones_again() {
    let network = MaskNetwork::embedded().unwrap();
    for (width, height) in [(64, 48), (33, 17), (1, 1)] {
        let camera = Pinhole { width, height, ..CAMERA };
        let inputs = MaskInputs::new(&vec![0.8; width * height], &camera, &Vector3::new(0.0, -0.8, -0.6));
        let first = network.logits(&inputs);
        assert_eq!((first.width, first.height, first.pixels.len()), (width, height, width * height));
        assert!(first.pixels.as_flattened().iter().all(|x| x.is_finite()));
        assert_eq!(first, network.logits(&inputs));
    }
}

#[test]
fn what_are_no_weights_is_refused_with_the_field_named() {
    let refused = |bytes: &[u8]| MaskNetwork::load(bytes, Kernel::detect()).unwrap_err().to_string();
    assert!(refused(b"nothing").contains("header"));
    assert!(refused(include_bytes!("../weights/default.safetensors")).contains("format"));
    assert!(refused(&WEIGHTS[..WEIGHTS.len() - 2]).starts_with("weights:"));
}
