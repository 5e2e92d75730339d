//! The networks of Repose (paper, section 2.1 and appendix A.2): trained on candle, served on fused kernels of our own.
//!
//! ```
//! use nalgebra::Point3;
//! use repose_networks::{Candidate, Models, SceneContext, points::Observer};
//!
//! let models = Models::embedded()?; // or Models::load(&std::fs::read(path)?)
//! // A table (label 0) with two blocks on it, as world points.
//! let table = (0..2500).map(|i| (Point3::new((i % 50) as f32 * 0.02 - 0.5, (i / 50) as f32 * 0.02 - 0.5, 0.0), 0));
//! let block = |x: f32, label| (0..100).map(move |i| (Point3::new(x + (i % 10) as f32 * 0.005, (i / 10) as f32 * 0.005, 0.05), label));
//! let (points, labels): (Vec<_>, Vec<_>) = table.chain(block(0.0, 2)).chain(block(0.2, 3)).unzip();
//! let observer = Observer { eye: Point3::new(0.0, -0.8, 0.6), pixel_rad: 0.002 };
//! // Once per scene.
//! let scene = SceneContext::new(&points, &labels, 0.0, &observer, &models.config().cloud)?;
//!
//! let goal = [1, 0, 0, 0, 0, 0, 0, 0, 0, 0]; // left_of must hold
//! let mixture = models.prior(&scene, 2, 3, goal)?; // query 2, anchor 3
//! assert!(mixture.means_in_viewer_m.iter().any(|mean| mean[0] < 0.0), "some offset is to the left: {mixture:?}");
//! let candidates = [Candidate { position_in_world: [0.1, 0.2, 0.05], yaw_rad: 0.0 }];
//! let realism: Vec<f32> = models.realism(&scene, 2, &candidates, 2)?; // on two threads
//! let relations = models.relations(&scene, 2, &[3], &candidates, 2)?; // [candidates][anchors][9]
//! assert!(relations[0][0][3] > relations[0][0][2], "behind rather than in front: {relations:?}");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! - [`points`] and [`crops`] are the one place where clouds become network inputs, in training as in serving.
//! - [`serving`] scores, and knows nothing of candle; a candidate's bytes depend on weights and [`Kernel`], not on its batch or the number of
//!   threads.
//! - [`masks`] tells objects from furniture and from each other in depth pictures; it is trained apart, in Python.
//! - [`networks`] puts the trainable networks together; [`set_abstraction`] explains the choices where the paper leaves room.
//! - [`weights`] reads and writes the file; [`Weights::initial`] makes an untrained one from a seed.

mod ball_query;
pub mod completion;
pub mod config;
pub mod crops;
pub mod digest;
pub mod discriminator;
mod feature_map;
pub mod feet;
mod fused;
pub mod kernel;
mod layer_file;
pub mod layers;
pub mod masks;
pub mod neighbours;
pub mod networks;
pub mod object_encoder;
pub mod pair_measures;
pub mod parameters;
pub mod points;
pub mod prior;
pub mod relation_predictor;
pub mod sampling;
pub mod scene_encoder;
pub mod serving;
pub mod set_abstraction;
pub mod shared_scene;
mod u_net;
pub mod weights;

pub use config::{GOAL_RELATIONS, NetworksConfig, PREDICTED_RELATIONS};
pub use kernel::Kernel;
pub use networks::Networks;
pub use serving::{Candidate, InputError, Mixture, Models, SceneContext};
pub use weights::{Weights, WeightsError, WeightsInfo};
