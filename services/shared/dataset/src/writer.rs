//! Writes views into shards.

use std::{
    borrow::Cow,
    collections::HashMap,
    io::Write,
    path::{Path, PathBuf},
};

use flate2::{Compression, write::ZlibEncoder};
use safetensors::{Dtype, View};

use crate::{
    codec::Packer,
    json::ViewJson,
    layer::Layer,
    record::{RELATIONS, ViewRecord},
    whole::write_whole,
};

/// The metadata's only key (a hash map of several would be written in any order, and the same views would give other bytes).
pub(crate) const FORMAT_KEY: &str = "format";
/// Its value: this version of the format.
pub const FORMAT: &str = "repose-views-2";
/// The tensor with the views' JSON.
pub(crate) const VIEWS: &str = "views";

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

/// Collects views and writes a shard whenever enough are there. Call [`ShardWriter::finish`] at the end.
///
/// Views are packed as they come, so that what waits is small. Files appear under their name only when complete (written beside, then
/// renamed), so a reader never sees half a shard.
#[derive(Debug)]
pub struct ShardWriter {
    folder: PathBuf,
    views_per_shard: usize,
    next_shard: usize,
    suffix: String,
    packer: Packer,
    views: Vec<ViewJson>,
    tensors: Vec<(String, Bytes)>,
    bytes_written: u64,
}

impl ShardWriter {
    /// A writer into `folder` (created if absent), with `views_per_shard` views a file (80 make files of about 2 MB) and the first file
    /// numbered `first_shard` (so that several writers can share a folder).
    ///
    /// # Errors
    /// [`WriteError::Io`] when the folder cannot be made.
    pub fn new(folder: &Path, views_per_shard: usize, first_shard: usize) -> Result<Self, WriteError> {
        std::fs::create_dir_all(folder).map_err(|source| WriteError::Io { path: folder.to_path_buf(), source })?;
        Ok(Self {
            folder: folder.to_path_buf(),
            views_per_shard: views_per_shard.max(1),
            next_shard: first_shard,
            suffix: String::new(),
            packer: Packer::default(),
            views: Vec::new(),
            tensors: Vec::new(),
            bytes_written: 0,
        })
    }

    /// The same writer with `suffix` after the numbers in its files' names.
    #[must_use]
    pub fn with_suffix(mut self, suffix: &str) -> Self {
        suffix.clone_into(&mut self.suffix);
        self
    }

    /// The path of shard `number` in `folder`.
    pub fn shard_path(folder: &Path, number: usize, suffix: &str) -> PathBuf {
        folder.join(format!("shard_{number:05}{suffix}.safetensors"))
    }

    /// Adds a view; writes a shard when it is full.
    ///
    /// # Errors
    /// [`WriteError::Shape`] when the view contradicts itself, [`WriteError::Io`] when a shard cannot be written.
    pub fn push(&mut self, view: &ViewRecord) -> Result<(), WriteError> {
        check(view)?;
        self.pack(view);
        self.views.push(ViewJson::of(view));
        if self.views.len() >= self.views_per_shard { self.flush() } else { Ok(()) }
    }

    /// Writes what is left; says how many bytes all shards have.
    ///
    /// # Errors
    /// [`WriteError::Io`] when the shard cannot be written.
    pub fn finish(mut self) -> Result<u64, WriteError> {
        self.flush()?;
        Ok(self.bytes_written)
    }

    fn pack(&mut self, view: &ViewRecord) {
        let v = self.views.len();
        let n = view.objects.len();
        let has_color = view.has_color();
        self.pack_layer(format!("{v:04}/background"), &view.background, has_color);
        for (k, object) in view.objects.iter().enumerate() {
            self.pack_layer(format!("{v:04}/object_{k}/alone"), &object.alone, has_color);
            if let Some(elsewhere) = &object.elsewhere {
                self.pack_layer(format!("{v:04}/object_{k}/elsewhere"), &elsewhere.layer, has_color);
            }
        }
        let relations = view.relations.iter().flat_map(|r| r.iter().map(|holds| u8::from(*holds))).collect();
        self.tensors.push((format!("{v:04}/relations"), Bytes { dtype: Dtype::U8, shape: vec![n, n, RELATIONS], bytes: relations }));
        let gap_m = view.gap_m.iter().flat_map(|gap| gap.to_le_bytes()).collect();
        self.tensors.push((format!("{v:04}/gap_m"), Bytes { dtype: Dtype::F32, shape: vec![n, n], bytes: gap_m }));
    }

    fn pack_layer(&mut self, name: String, layer: &Layer, with_color: bool) {
        let depth = self.packer.pack_u16(&layer.inverse_depth);
        if with_color {
            self.tensors.push((format!("{name}/color"), Bytes::flat(self.packer.pack_color(&layer.color))));
        }
        self.tensors.push((name, Bytes::flat(depth)));
    }

    fn flush(&mut self) -> Result<(), WriteError> {
        if self.views.is_empty() {
            return Ok(());
        }
        let path = Self::shard_path(&self.folder, self.next_shard, &self.suffix);
        let bytes = self.serialize()?;
        write_whole(&path, &bytes).map_err(|source| WriteError::Io { path, source })?;
        self.bytes_written += bytes.len() as u64;
        self.next_shard += 1;
        Ok(())
    }

    /// The bytes of the shard that waits, which is then empty.
    fn serialize(&mut self) -> Result<Vec<u8>, WriteError> {
        let container = |e: &dyn std::fmt::Display| WriteError::Container(e.to_string());
        let mut json = ZlibEncoder::new(Vec::new(), Compression::new(6));
        let views = std::mem::take(&mut self.views);
        json.write_all(&serde_json::to_vec(&views).map_err(|e| container(&e))?).map_err(|e| container(&e))?;
        let mut tensors = std::mem::take(&mut self.tensors);
        tensors.push((VIEWS.to_owned(), Bytes::flat(json.finish().map_err(|e| container(&e))?)));
        let metadata = HashMap::from([(FORMAT_KEY.to_owned(), FORMAT.to_owned())]);
        safetensors::serialize(tensors, Some(metadata)).map_err(|e| container(&e))
    }
}

/// A tensor's bytes with their shape.
#[derive(Debug)]
struct Bytes {
    dtype: Dtype,
    shape: Vec<usize>,
    bytes: Vec<u8>,
}

impl Bytes {
    fn flat(bytes: Vec<u8>) -> Self {
        Self { dtype: Dtype::U8, shape: vec![bytes.len()], bytes }
    }
}

impl View for Bytes {
    fn dtype(&self) -> Dtype {
        self.dtype
    }

    fn shape(&self) -> &[usize] {
        &self.shape
    }

    fn data(&self) -> Cow<'_, [u8]> {
        Cow::Borrowed(&self.bytes)
    }

    fn data_len(&self) -> usize {
        self.bytes.len()
    }
}

fn check(view: &ViewRecord) -> Result<(), WriteError> {
    let shape = |field, expected, got| WriteError::Shape { scene_seed: view.scene_seed, view: view.view, field, expected, got };
    let same = |field, expected: usize, got: usize| if expected == got { Ok(()) } else { Err(shape(field, expected, got)) };
    let pairs = view.objects.len() * view.objects.len();
    same("relations", pairs, view.relations.len())?;
    same("gap_m", pairs, view.gap_m.len())?;
    let has_color = view.has_color();
    let layer = |layer: &Layer, depth: &'static str, color: &'static str| {
        same(depth, layer.area(), layer.inverse_depth.len())?;
        same(color, if has_color { layer.area() } else { 0 }, layer.color.len())
    };
    layer(&view.background, "background.inverse_depth", "background.color")?;
    for object in &view.objects {
        layer(&object.alone, "alone.inverse_depth", "alone.color")?;
        if let Some(elsewhere) = &object.elsewhere {
            layer(&elsewhere.layer, "elsewhere.inverse_depth", "elsewhere.color")?;
        }
    }
    Ok(())
}
