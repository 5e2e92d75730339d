//! The networks of Repose (paper, section 2.1 and appendix A.2): for training on candle, for serving on own fused kernels.
//!
//! Serving, which knows nothing of candle:
//!
//! ```no_run
//! # use repose_networks::{Candidate, Models, SceneContext, points::Sight};
//! # fn f(points: &[nalgebra::Point3<f32>], labels: &[u16], sight: &Sight) -> Result<(), Box<dyn std::error::Error>> {
//! let models = Models::embedded()?; // or Models::load(&std::fs::read(path)?)
//! // Once per scene: world points, 0 = not an object; where the camera was, and how fine its pixels are.
//! let scene = SceneContext::new(points, labels, 0.0, sight, &models.config().cloud)?;
//! let goal = [1, 0, 0, 0, 0, 0, 0, 0, 0, 0]; // left_of holds
//! let mixture = models.prior(&scene, 2, 3, goal)?; // query 2, anchor 3: offsets in the viewer's axes
//! let candidates = [Candidate { position_in_world: [0.1, 0.2, 0.05], yaw_rad: 0.0 }];
//! let realism: Vec<f32> = models.realism(&scene, 2, &candidates, 2)?; // on two threads
//! let relations = models.relations(&scene, 2, &[3], &candidates, 2)?; // [candidates][anchors][9]
//! # Ok(()) }
//! ```
//!
//! - [`points`] and [`crops`] are the one place where clouds become network inputs, in training as in serving.
//! - [`serving`] scores; a candidate's bytes depend on weights and [`Kernel`], not on its batch or the number of threads.
//! - [`networks`] puts the trainable networks together; [`set_abstraction`] explains what was chosen where the paper leaves room.
//! - [`weights`] reads and writes the file; [`Weights::initial`] makes an untrained one from a seed.

pub mod config;
pub mod crops;
pub mod discriminator;
mod fused;
pub mod kernel;
pub mod layers;
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
pub mod weights;

pub use config::{GOAL_RELATIONS, NetworksConfig, PREDICTED_RELATIONS};
pub use kernel::Kernel;
pub use networks::Networks;
pub use serving::{Candidate, InputError, Mixture, Models, SceneContext};
pub use weights::{Weights, WeightsError, WeightsInfo};
