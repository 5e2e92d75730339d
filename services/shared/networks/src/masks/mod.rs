//! A network for masks of objects that it has never seen, in depth.
//!
//! For each pixel it says whether it shows a movable object rather than furniture, and for pixels at some offsets whether they show the same
//! one ([`OFFSETS`]): who groups pixels by that (`services/perception`, a mutex watershed) needs neither centers nor a number of objects.
//! Affinities at several distances are from Wolf et al. ("The Mutex Watershed", ECCV 2018) and Lee et al. ("Superhuman accuracy on the SNEMI3D
//! connectomics challenge", 2017); that depth alone carries over from simulated to real pictures is what UOIS-Net (Xie et al., "Unseen Object
//! Instance Segmentation for Robotic Environments", T-RO 2021) showed. Trained by `scripts/train_masks.py`, served on the kernels.

mod inputs;
mod network;

pub use inputs::MaskInputs;
pub use network::{FILE, MaskLogits, MaskNetwork, OFFSETS};
