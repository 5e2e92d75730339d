//! Training: shards of simulated views in, weights out.
//!
//! [`train`] fits one [`Part`]: the encoders, relation predictor and prior jointly, the relation predictor alone on encoders that stay as they
//! are, the scene discriminator, or the outcome network. All prepare views (most as [`episode`]s: with one object taken as the query) from those of training scenes, and are measured on those of validation scenes
//! ([`repose_dataset::Split`] says which is which). A run takes up its own checkpoint, follows new shards as they appear, and ends after its
//! steps or its minutes with weights written, and the learning [`curve`] beside them. A process that trains should start with [`ONE_THREAD_VARIABLES`] set to 1.

pub mod adam;
mod checkpoint;
pub mod curve;
pub mod discriminator;
pub mod episode;
pub mod error;
pub mod joint;
pub mod merge;
pub mod normal;
pub mod outcome;
pub mod placement;
pub mod relations;
pub mod settings;
pub mod step;
pub mod task;
pub mod train;
pub mod views;

pub use error::TrainError;
pub use settings::{Compute, Part, RelationsVariant, TrainSettings};
pub use train::{ONE_THREAD_VARIABLES, TrainReport, train};
