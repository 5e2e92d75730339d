//! The ten spatial relations as geometric rules: the labels of the training data, the paper's model-based baseline, and the rules of
//! the planner's own check of its answers.
//!
//! ```
//! use nalgebra::{Isometry3, Vector3};
//! use repose_geometry::{OrientedBox, ViewerFrame};
//! use repose_relations::{TrueBounds, ground_truth, index};
//!
//! // Two cubes of 10 cm on a table, 20 cm apart along the world's x axis.
//! let cube = |x: f64| {
//!     let world_from_box = Isometry3::translation(x, 0.0, 0.05);
//!     TrueBounds { bounds: OrientedBox { world_from_box, half_extents: Vector3::repeat(0.05) } }
//! };
//! // A viewer at yaw 0 looks along +y, so that +x is to the right.
//! let holds = ground_truth(&cube(-0.1), &cube(0.1), 0.1, &ViewerFrame::from_yaw(0.0));
//! assert!(holds[index::LEFT_OF] && holds[index::ALIGNED] && !holds[index::NEAR]);
//! ```
//!
//! Source: the paper's appendix, "Directional Predicate Implementation" and "Other Predicates". The same rules serve ground truth
//! ([`truth`]: object-oriented boxes and meshes) and observed clouds ([`mod@observed`]: 1–99 % boxes and nearest points); only where the
//! extents and distances come from differs. Everything is judged in the viewer's frame: x right, y away, z up, level.
//! Pure: no I/O, no async, no global state.

pub mod confusion;
pub mod directional;
pub mod margins;
pub mod observed;
pub mod rectangle;
pub mod truth;

pub use confusion::Confusion;
pub use directional::ViewerExtents;
pub use margins::{Margins, RELATIONS, index};
pub use observed::{ObservedObject, observed, observed_margins};
pub use truth::{TrueBounds, ground_truth, ground_truth_margins};
