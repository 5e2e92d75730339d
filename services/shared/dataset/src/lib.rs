//! The training data's file format: what the simulator writes and training reads.
//!
//! A data set is a folder of shards (`shard_00000.safetensors`, …) beside a `dataset.json` that says how they were made ([`manifest`]). A view
//! holds no finished picture but **layers**: the background (everything that is not a movable object), and each object rendered *alone*, so
//! that the picture with or without any object is composed by the nearest depth per pixel ([`compose`]). Depth is clean (no noise, no
//! border cleaning): training applies the sensor model and the cleaning that perception applies. At 320 × 240 a view is about 20 kB.
//!
//! ```text
//! metadata  "repose-views-2"             JSON list, one entry per view ([`json`] has the fields)
//! tensors   "{v:04}/background"            u8 [bytes]   a depth layer, packed; its rectangle (x0, y0, width, height) is in the JSON
//!           "{v:04}/object_{k}/alone"      u8 [bytes]   object k alone, where it stands
//!           "{v:04}/object_{k}/elsewhere"  u8 [bytes]   optional: object k alone, somewhere else and turned about z, same camera
//!           "{v:04}/…/color"               u8 [bytes]   optional, beside each of the layers above: its color, packed
//!           "{v:04}/relations"             u8  [n,n,10] query × anchor × relation in wire order, from ground truth; the diagonal is 0
//!           "{v:04}/gap_m"                 f32 [n,n]    distance between the meshes, metres
//! ```
//!
//! A packed layer is a zlib stream of `2 · height · width` bytes: first the low bytes, then the high bytes of `r[0], r[1], …` (u16). `(r >> 1) ^ −(r & 1)` are the
//! differences between one pixel and the next, row by row; their running sum (modulo 2¹⁶) is inverse depth in steps of 1e-4 1/m, 0 = nothing.
//! Inverse depth, because that of a plane is linear in the picture, so that its differences repeat and deflate to almost nothing; a step is
//! 0.1 mm at 1 m and 0.4 mm at 2 m. A packed color layer is a zlib stream of `3 · height · width` bytes: red, green, blue, each the
//! differences (modulo 256) along the rectangle.
//!
//! ```no_run
//! use repose_dataset::{Composite, Split, read_shard, shard_paths};
//!
//! for path in shard_paths("out/data/train".as_ref())? {
//!     for view in read_shard(&path)?.iter().filter(|view| Split::of_seed(view.scene_seed) == Some(Split::Train)) {
//!         // The picture without its second object, as a cloud with labels.
//!         let (points, labels) = Composite::of(view, |object| object != 1).points_in_world(view);
//!     }
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! `scripts/read_views.py` reads it all in ten lines of Python.

pub mod codec;
pub mod compose;
pub mod json;
pub mod layer;
pub mod manifest;
pub mod reader;
pub mod record;
pub mod releases;
pub mod split;
pub mod whole;
pub mod writer;

pub use compose::Composite;
pub use layer::{INVERSE_DEPTH_STEP, Layer};
pub use manifest::{Manifest, ManifestError};
pub use reader::{ReadError, Shard, ViewSummary, read_shard, shard_paths};
pub use record::{Elsewhere, FixtureRecord, ObjectRecord, RELATIONS, ViewRecord};
pub use releases::{ReleaseRecord, proposals_path, read_proposals, read_releases, releases_are_there, releases_path, write_releases};
pub use split::Split;
pub use whole::write_whole;
pub use writer::{ShardWriter, WriteError};
