//! The ten spatial relations as geometric rules: the labels of the training data, the paper's model-based baseline, and what the
//! planner's own check of its answers is made of.
//!
//! Source: the paper's appendix, "Directional Predicate Implementation" and "Other Predicates". The same rules serve ground truth
//! ([`truth`]: object-oriented boxes and meshes) and observed clouds ([`observed`]: 1–99 % boxes and nearest points); only where the
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
pub use truth::{TrueObject, ground_truth, ground_truth_margins};
