//! The network that completes shapes computes what PyTorch computes with the same weights, on every kernel.

use repose_networks::Kernel;
use repose_networks::completion::{CHANNELS, CompletionNetwork, SIDE, SLABS};

const WEIGHTS: &[u8] = include_bytes!("../weights/completion.safetensors");
/// Written by `scripts/train_completion.py --weights … --golden …`: of every seventh cell, by slab.
const GOLDEN: &str = include_str!("completion_golden.json");

/// `by_formula` of the script.
fn cells() -> Vec<[f32; CHANNELS]> {
    let told = |index: usize, c: usize| ((7 * (index / SIDE) + 3 * (index % SIDE) + 5 * c) % 11) as f32 / 11.0 - 0.3;
    (0..SIDE * SIDE).map(|index| std::array::from_fn(|c| told(index, c))).collect()
}

#[test]
fn what_is_likely_filled_is_what_pytorch_says() {
    let golden: Vec<Vec<f32>> = serde_json::from_str(GOLDEN).unwrap();
    assert_eq!(golden.len(), SLABS);
    for kernel in Kernel::available() {
        let ours = CompletionNetwork::load(WEIGHTS, kernel).unwrap().filled(&cells());
        for (slab, expected) in golden.iter().enumerate() {
            assert_eq!(expected.len(), (SIDE * SIDE).div_ceil(7));
            for (k, (cell, expected)) in ours.iter().step_by(7).zip(expected).enumerate() {
                assert!((cell[slab] - expected).abs() < 2e-3, "{kernel:?}, cell {}, {slab}: {} not {expected}", 7 * k, cell[slab]);
            }
        }
    }
}

#[test]
fn the_same_cells_give_the_same_bits_on_any_number_of_threads() {
    let network = CompletionNetwork::embedded().unwrap();
    let on = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| network.filled(&cells()));
    assert_eq!(on(1), on(3));
}

#[test]
fn what_are_no_weights_is_refused_with_the_field_named() {
    let refused = |bytes: &[u8]| CompletionNetwork::load(bytes, Kernel::detect()).unwrap_err().to_string();
    assert!(refused(b"nothing").contains("header"));
    assert!(refused(include_bytes!("../weights/masks.safetensors")).contains("format"));
    assert!(refused(&WEIGHTS[..WEIGHTS.len() - 2]).starts_with("weights:"));
}
