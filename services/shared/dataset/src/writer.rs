//! Writes views into shards.

use std::{
    collections::HashMap,
    path::{Path, PathBuf},
};

use safetensors::{Dtype, tensor::TensorView};
use serde::{Deserialize, Serialize};

use crate::{Layer, ObjectRecord, RELATIONS, Split, ViewRecord};
use repose_geometry::{OrientedBox, Pinhole, transform::to_row_major};

/// The metadata's only key (a hash map of several would be written in any order, and the same views would give other bytes).
pub(crate) const METADATA: &str = "repose-views-1";

/// Why a shard could not be written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The file system refused.
    #[error("{path}: {source}")]
    Io {
        /// What was being written.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A view contradicts itself.
    #[error("scene {scene_seed} view {view}: {field} has {got} entries, expected {expected}")]
    Shape {
        /// The scene's seed.
        scene_seed: u64,
        /// The view's number.
        view: u32,
        /// The field that is wrong.
        field: &'static str,
        /// How many entries it should have.
        expected: usize,
        /// How many it has.
        got: usize,
    },
    /// The container could not be built.
    #[error("shard: {0}")]
    Container(String),
}

/// The camera's intrinsics and pose in a shard's JSON.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct CameraJson {
    pub width: usize,
    pub height: usize,
    pub fx: f64,
    pub fy: f64,
    pub cx: f64,
    pub cy: f64,
    pub world_from_camera: [f64; 16],
}

/// Where a layer's rectangle sits.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(crate) struct CornerJson {
    pub x0: u32,
    pub y0: u32,
}

/// An object in a shard's JSON.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct ObjectJson {
    pub id: u16,
    pub name: String,
    pub world_from_object: [f64; 16],
    pub world_from_box: [f64; 16],
    pub box_half_extents_m: [f64; 3],
    pub alone: CornerJson,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub elsewhere: Option<CornerJson>,
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub placed_from_elsewhere: Option<[f64; 16]>,
}

/// A view in a shard's JSON.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct ViewJson {
    pub scene_seed: u64,
    pub view: u32,
    pub split: Option<Split>,
    pub camera: CameraJson,
    pub view_yaw_rad: f64,
    pub background: CornerJson,
    pub objects: Vec<ObjectJson>,
}

/// Collects views and writes a shard whenever enough are there. Call [`ShardWriter::finish`] at the end.
///
/// Files appear under their name only when complete (written beside, then renamed), so a reader never sees half a shard.
#[derive(Debug)]
pub struct ShardWriter {
    folder: PathBuf,
    views_per_shard: usize,
    next_shard: usize,
    pending: Vec<ViewRecord>,
}

impl ShardWriter {
    /// A writer into `folder` (created if absent), with `views_per_shard` views a file (64 makes files of about 10 MB) and the first file
    /// numbered `first_shard` (so that several writers can share a folder).
    ///
    /// # Errors
    /// [`WriteError::Io`] when the folder cannot be made.
    pub fn new(folder: &Path, views_per_shard: usize, first_shard: usize) -> Result<Self, WriteError> {
        std::fs::create_dir_all(folder).map_err(|source| WriteError::Io { path: folder.to_path_buf(), source })?;
        Ok(Self { folder: folder.to_path_buf(), views_per_shard: views_per_shard.max(1), next_shard: first_shard, pending: Vec::new() })
    }

    /// Adds a view; writes a shard when it is full.
    ///
    /// # Errors
    /// [`WriteError::Shape`] when the view contradicts itself, [`WriteError::Io`] when a shard cannot be written.
    pub fn push(&mut self, view: ViewRecord) -> Result<(), WriteError> {
        check(&view)?;
        self.pending.push(view);
        if self.pending.len() >= self.views_per_shard { self.flush() } else { Ok(()) }
    }

    /// Writes what is left.
    ///
    /// # Errors
    /// [`WriteError::Io`] when the shard cannot be written.
    pub fn finish(mut self) -> Result<(), WriteError> {
        self.flush()
    }

    fn flush(&mut self) -> Result<(), WriteError> {
        if self.pending.is_empty() {
            return Ok(());
        }
        let path = self.folder.join(format!("shard_{:05}.safetensors", self.next_shard));
        let bytes = serialize(&self.pending)?;
        let beside = path.with_extension("tmp");
        std::fs::write(&beside, bytes).and_then(|()| std::fs::rename(&beside, &path)).map_err(|source| WriteError::Io { path, source })?;
        self.pending.clear();
        self.next_shard += 1;
        Ok(())
    }
}

fn check(view: &ViewRecord) -> Result<(), WriteError> {
    let pairs = view.objects.len() * view.objects.len();
    let shape = |field, expected, got| WriteError::Shape { scene_seed: view.scene_seed, view: view.view, field, expected, got };
    let same = |field, expected: usize, got: usize| if expected == got { Ok(()) } else { Err(shape(field, expected, got)) };
    same("relations", pairs, view.relations.len())?;
    same("gap_m", pairs, view.gap_m.len())?;
    same("background.depth", (view.background.width * view.background.height) as usize, view.background.depth.len())?;
    for object in &view.objects {
        same("alone.depth", (object.alone.width * object.alone.height) as usize, object.alone.depth.len())?;
        if let Some(elsewhere) = &object.elsewhere {
            same("elsewhere.depth", (elsewhere.layer.width * elsewhere.layer.height) as usize, elsewhere.layer.depth.len())?;
        }
    }
    Ok(())
}

/// A shard's bytes.
fn serialize(views: &[ViewRecord]) -> Result<Vec<u8>, WriteError> {
    let container = |e: &dyn std::fmt::Display| WriteError::Container(e.to_string());
    let relations: Vec<Vec<u8>> = views.iter().map(|v| v.relations.iter().flat_map(|r| r.iter().map(|b| u8::from(*b))).collect()).collect();
    let mut tensors: Vec<(String, TensorView<'_>)> = Vec::new();
    let mut add = |name: String, dtype, shape: Vec<usize>, bytes| {
        tensors.push((name, TensorView::new(dtype, shape, bytes).map_err(|e| container(&e))?));
        Ok::<(), WriteError>(())
    };
    for (v, view) in views.iter().enumerate() {
        let n = view.objects.len();
        let shape = |layer: &Layer| vec![layer.height as usize, layer.width as usize];
        add(format!("{v:04}/background"), Dtype::U16, shape(&view.background), bytemuck::cast_slice(&view.background.depth))?;
        for (k, object) in view.objects.iter().enumerate() {
            add(format!("{v:04}/object_{k}/alone"), Dtype::U16, shape(&object.alone), bytemuck::cast_slice(&object.alone.depth))?;
            if let Some(e) = &object.elsewhere {
                add(format!("{v:04}/object_{k}/elsewhere"), Dtype::U16, shape(&e.layer), bytemuck::cast_slice(&e.layer.depth))?;
            }
        }
        add(format!("{v:04}/relations"), Dtype::U8, vec![n, n, RELATIONS], &relations[v])?;
        add(format!("{v:04}/gap_m"), Dtype::F32, vec![n, n], bytemuck::cast_slice(&view.gap_m))?;
    }
    let json: Vec<ViewJson> = views.iter().map(view_json).collect();
    let metadata = HashMap::from([(METADATA.to_string(), serde_json::to_string(&json).map_err(|e| container(&e))?)]);
    safetensors::serialize(tensors, Some(metadata)).map_err(|e| container(&e))
}

fn view_json(view: &ViewRecord) -> ViewJson {
    let Pinhole { width, height, fx, fy, cx, cy } = view.camera;
    ViewJson {
        scene_seed: view.scene_seed,
        view: view.view,
        split: Split::of_seed(view.scene_seed),
        camera: CameraJson { width, height, fx, fy, cx, cy, world_from_camera: to_row_major(&view.world_from_camera) },
        view_yaw_rad: view.view_yaw_rad,
        background: corner(&view.background),
        objects: view.objects.iter().map(object_json).collect(),
    }
}

fn object_json(object: &ObjectRecord) -> ObjectJson {
    let OrientedBox { world_from_box, half_extents } = &object.bounds;
    ObjectJson {
        id: object.id,
        name: object.name.clone(),
        world_from_object: to_row_major(&object.world_from_object),
        world_from_box: to_row_major(world_from_box),
        box_half_extents_m: [half_extents.x, half_extents.y, half_extents.z],
        alone: corner(&object.alone),
        elsewhere: object.elsewhere.as_ref().map(|e| corner(&e.layer)),
        placed_from_elsewhere: object.elsewhere.as_ref().map(|e| to_row_major(&e.placed_from_elsewhere)),
    }
}

fn corner(layer: &Layer) -> CornerJson {
    CornerJson { x0: layer.x0, y0: layer.y0 }
}
