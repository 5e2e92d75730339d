//! The training data's file format: what the simulator writes and training reads.
//!
//! A data set is a folder of shards (`shard_00000.safetensors`, …), each with a bounded number of views. A view holds no finished picture
//! but **layers**: the background (tables, shelves, walls: everything that is not a movable object), and each object rendered *alone*, so
//! that the picture with or without any object is composed by the nearest depth per pixel ([`compose`]). Depth is clean (no noise, no
//! border cleaning): training applies the sensor model and the cleaning that perception applies.
//!
//! ```text
//! metadata  "repose-views-1"             JSON list, one entry per view: seed, split, camera, view_yaw_rad, background, objects (see `record`)
//! tensors   "{v:04}/background"            u16 [h,w]    depth in units of 0.1 mm, 0 = nothing; the rectangle's corner (x0, y0) is in the JSON
//!           "{v:04}/object_{k}/alone"      u16 [h,w]    object k alone, where it stands
//!           "{v:04}/object_{k}/elsewhere"  u16 [h,w]    optional: object k alone, somewhere else and turned about z, same camera
//!           "{v:04}/relations"             u8  [n,n,10] query × anchor × relation in wire order, from ground truth; the diagonal is 0
//!           "{v:04}/gap_m"                 f32 [n,n]    distance between the meshes, metres
//! ```
//!
//! From Python: `f = safetensors.safe_open(path, "np"); views = json.loads(f.metadata()["repose-views-1"]); f.get_tensor("0000/background") * 1e-4`.
//!
//! Layers are cropped to the rectangle that they fill. At 320 × 240 a view is about 100 to 200 kB.

pub mod compose;
pub mod reader;
pub mod record;
pub mod split;
pub mod writer;

pub use compose::Composite;
pub use reader::{ReadError, read_shard, shard_paths};
pub use record::{DEPTH_UNIT_M, Elsewhere, Layer, ObjectRecord, RELATIONS, ViewRecord};
pub use split::Split;
pub use writer::{ShardWriter, WriteError};
