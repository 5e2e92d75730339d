//! Training: shards of simulated views in, weights out.
//!
//! ```no_run
//! use repose_training::{TrainedPart, TrainSettings, train};
//!
//! let settings = TrainSettings { data: "out/data".into(), out: "out/joint.safetensors".into(), ..TrainSettings::of_part(TrainedPart::Joint) };
//! let report = train(&settings)?;
//! println!("{} steps on {} views; validation: {}", report.steps, report.views, report.metrics);
//! # Ok::<(), repose_training::TrainError>(())
//! ```
//!
//! [`train`](fn@train) fits one [`TrainedPart`]: the encoders, relation predictor and prior jointly, the relation predictor alone on frozen encoders, the scene
//! discriminator, or the outcome network. All of them prepare views of training scenes (most as [`episode`]s, with one object as the query) and
//! measure on validation scenes; [`repose_dataset::Split`] says which is which. A run resumes from its own checkpoint, follows new shards as
//! they appear, and ends after its steps or minutes with the weights and the learning [`curve`] written. A process that trains should start
//! with [`ONE_THREAD_VARIABLES`] set to 1.

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
pub use settings::{Compute, RelationsVariant, TrainSettings, TrainedPart};
pub use train::{ONE_THREAD_VARIABLES, TrainReport, train};
