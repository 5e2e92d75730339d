//! Reads shards back into views.
//!
//! A [`Shard`] keeps its packed bytes and unpacks a view when asked: a hundred thousand views then fit into the memory of a training machine,
//! and unpacking one takes about a millisecond. Whatever the bytes are, reading ends in views or in an error that names the tensor.

use std::{
    io::Read,
    path::{Path, PathBuf},
};

use flate2::read::ZlibDecoder;
use nalgebra::Isometry3;
use repose_geometry::{OrientedBox, Pinhole, transform::from_row_major};
use safetensors::{Dtype, SafeTensors, tensor::Metadata};

use crate::{
    codec::{unpack_color, unpack_u16},
    json::{BoxJson, ObjectJson, RectJson, ViewJson},
    layer::Layer,
    record::{Elsewhere, FixtureRecord, ObjectRecord, RELATIONS, ViewRecord},
    writer::{FORMAT, FORMAT_KEY, VIEWS},
};

/// Most bytes that the views' JSON may unpack to; a thousand views have about 5 MB.
const MOST_JSON_BYTES: u64 = 1 << 28;
/// Most pixels that a picture may have.
const MOST_PIXELS: usize = 1 << 24;

/// Why a shard could not be read.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The file system refused.
    #[error("{path}: {source}")]
    Io {
        /// What was being read.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is a shard of another version of the format.
    #[error("{path}: expected a shard of format {FORMAT}, got {got}; generate the data again")]
    Version {
        /// The shard.
        path: PathBuf,
        /// What it says it is.
        got: String,
    },
    /// The file is not a shard, or contradicts itself.
    #[error("{path}: {field}: {reason}")]
    Malformed {
        /// The shard.
        path: PathBuf,
        /// The tensor or JSON field.
        field: String,
        /// What was expected and what came.
        reason: String,
    },
}

/// The shards of a folder in name order.
///
/// # Errors
/// [`ReadError::Io`] when the folder cannot be listed.
pub fn shard_paths(folder: &Path) -> Result<Vec<PathBuf>, ReadError> {
    let io = |source| ReadError::Io { path: folder.to_path_buf(), source };
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(io)? {
        let path = entry.map_err(io)?.path();
        if path.extension().is_some_and(|e| e == "safetensors") {
            paths.push(path);
        }
    }
    paths.sort();
    Ok(paths)
}

/// All views of a shard.
///
/// # Errors
/// [`ReadError`] when the file cannot be read or does not hold what the format says.
pub fn read_shard(path: &Path) -> Result<Vec<ViewRecord>, ReadError> {
    let shard = Shard::open(path)?;
    (0..shard.len()).map(|v| shard.view(v)).collect()
}

/// What a view says of itself without its pixels.
#[derive(Debug, Clone, Copy)]
pub struct ViewSummary<'a> {
    /// The scene's seed.
    pub scene_seed: u64,
    /// What kind of scene it is.
    pub scene_kind: &'a str,
    /// Which of the scene's views.
    pub view: u32,
    objects: &'a [ObjectJson],
}

impl ViewSummary<'_> {
    /// Per object: its id.
    pub fn ids(&self) -> impl Iterator<Item = u16> {
        self.objects.iter().map(|o| o.id)
    }

    /// Per object: its pixels in the full picture.
    pub fn visible_px(&self) -> impl Iterator<Item = u32> {
        self.objects.iter().map(|o| o.visible_px)
    }

    /// Per object: its pixels with nothing else there.
    pub fn alone_px(&self) -> impl Iterator<Item = u32> {
        self.objects.iter().map(|o| o.alone_px)
    }
}

/// A shard in memory, packed.
#[derive(Debug)]
pub struct Shard {
    path: PathBuf,
    bytes: Vec<u8>,
    /// Where the tensors' bytes begin.
    data: usize,
    tensors: Metadata,
    views: Vec<ViewJson>,
}

impl Shard {
    /// Reads a shard's file and its views' JSON, no pixels yet.
    ///
    /// # Errors
    /// [`ReadError`] when the file cannot be read, is of another version, or has no views.
    pub fn open(path: &Path) -> Result<Self, ReadError> {
        let bytes = std::fs::read(path).map_err(|source| ReadError::Io { path: path.to_path_buf(), source })?;
        let (header, tensors) = SafeTensors::read_metadata(&bytes).map_err(|e| malformed(path, "header", e.to_string()))?;
        let version = tensors.metadata().as_ref().and_then(|entries| entries.get(FORMAT_KEY));
        if version.is_none_or(|version| version != FORMAT) {
            // The first version had its name for a key.
            let mut keys: Vec<&str> = tensors.metadata().iter().flatten().map(|(key, _)| key.as_str()).collect();
            keys.sort_unstable();
            let got = version.map_or_else(|| format!("metadata {keys:?}"), Clone::clone);
            return Err(ReadError::Version { path: path.to_path_buf(), got });
        }
        let mut shard = Self { path: path.to_path_buf(), bytes, data: 8 + header, tensors, views: Vec::new() };
        let mut json = Vec::new();
        let stream = ZlibDecoder::new(shard.tensor(VIEWS, Dtype::U8)?.1).take(MOST_JSON_BYTES + 1).read_to_end(&mut json);
        stream.map_err(|e| shard.malformed(VIEWS, e.to_string()))?;
        if json.len() as u64 > MOST_JSON_BYTES {
            return Err(shard.malformed(VIEWS, format!("expected at most {MOST_JSON_BYTES} bytes of JSON")));
        }
        shard.views = serde_json::from_slice(&json).map_err(|e| shard.malformed(VIEWS, e.to_string()))?;
        Ok(shard)
    }

    /// How many views there are.
    pub fn len(&self) -> usize {
        self.views.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.views.is_empty()
    }

    /// Each view without its pixels.
    pub fn summaries(&self) -> impl Iterator<Item = ViewSummary<'_>> {
        self.views.iter().map(|v| ViewSummary { scene_seed: v.scene_seed, scene_kind: &v.scene_kind, view: v.view, objects: &v.objects })
    }

    /// View number `v`, unpacked.
    ///
    /// # Errors
    /// [`ReadError::Malformed`] when there is no such view, or it is broken.
    pub fn view(&self, v: usize) -> Result<ViewRecord, ReadError> {
        let json =
            self.views.get(v).ok_or_else(|| self.malformed(VIEWS, format!("expected a view below {}, got {v}", self.views.len())))?;
        let (n, camera) = (json.objects.len(), &json.camera);
        if camera.width.checked_mul(camera.height).is_none_or(|pixels| pixels > MOST_PIXELS) {
            let reason = format!("expected at most {MOST_PIXELS} pixels, got {} x {}", camera.width, camera.height);
            return Err(self.malformed(&format!("{VIEWS}[{v}].camera"), reason));
        }
        if let Some(reason) = camera.fault() {
            return Err(self.malformed(&format!("{VIEWS}[{v}].camera"), reason));
        }
        let relations = self.shaped(&format!("{v:04}/relations"), Dtype::U8, &[n, n, RELATIONS])?;
        let gap_m = self.shaped(&format!("{v:04}/gap_m"), Dtype::F32, &[n, n])?;
        let fixture = |(k, f): (usize, &crate::json::FixtureJson)| {
            Ok(FixtureRecord { name: f.name.clone(), bounds: self.bounds(&format!("{VIEWS}[{v}].fixtures[{k}].box"), &f.bounds)? })
        };
        Ok(ViewRecord {
            scene_seed: json.scene_seed,
            scene_kind: json.scene_kind.clone(),
            view: json.view,
            camera: Pinhole { width: camera.width, height: camera.height, fx: camera.fx, fy: camera.fy, cx: camera.cx, cy: camera.cy },
            viewpoint: json.viewpoint.clone(),
            world_from_camera: self.pose(&format!("{VIEWS}[{v}].camera.world_from_camera"), &camera.world_from_camera)?,
            view_yaw_rad: json.view_yaw_rad,
            background: self.layer(json, &format!("{v:04}/background"), &json.background)?,
            fixtures: json.fixtures.iter().enumerate().map(fixture).collect::<Result<_, ReadError>>()?,
            objects: json.objects.iter().enumerate().map(|(k, o)| self.object(json, v, k, o)).collect::<Result<_, _>>()?,
            relations: relations.chunks_exact(RELATIONS).map(|row| std::array::from_fn(|r| row[r] != 0)).collect(),
            gap_m: gap_m.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect(),
        })
    }

    fn object(&self, view: &ViewJson, v: usize, k: usize, json: &ObjectJson) -> Result<ObjectRecord, ReadError> {
        let (tensor, field) = (format!("{v:04}/object_{k}"), format!("{VIEWS}[{v}].objects[{k}]"));
        let elsewhere = json.elsewhere.as_ref().map(|e| {
            Ok::<_, ReadError>(Elsewhere {
                layer: self.layer(view, &format!("{tensor}/elsewhere"), &e.rect)?,
                placed_from_elsewhere: self.pose(&format!("{field}.elsewhere.placed_from_elsewhere"), &e.placed_from_elsewhere)?,
            })
        });
        Ok(ObjectRecord {
            id: json.id,
            name: json.name.clone(),
            mass_kg: json.mass_kg,
            world_from_object: self.pose(&format!("{field}.world_from_object"), &json.world_from_object)?,
            bounds: self.bounds(&format!("{field}.box"), &json.bounds)?,
            visible_px: json.visible_px,
            alone_px: json.alone_px,
            alone: self.layer(view, &format!("{tensor}/alone"), &json.alone)?,
            elsewhere: elsewhere.transpose()?,
        })
    }

    fn layer(&self, view: &ViewJson, name: &str, rect: &RectJson) -> Result<Layer, ReadError> {
        let area = rect.area_within(&view.camera).ok_or_else(|| {
            let (width, height) = (view.camera.width, view.camera.height);
            self.malformed(name, format!("expected a rectangle inside {width} x {height}, got {rect:?}"))
        })?;
        let packed = |name: &str| self.tensor(name, Dtype::U8).map(|(_, bytes)| bytes);
        let inverse_depth = unpack_u16(packed(name)?, area).map_err(|e| self.malformed(name, e.to_string()))?;
        let mut color = Vec::new();
        if view.color {
            let name = format!("{name}/color");
            color = unpack_color(packed(&name)?, area).map_err(|e| self.malformed(&name, e.to_string()))?;
        }
        Ok(Layer { x0: rect.x0, y0: rect.y0, width: rect.width, height: rect.height, inverse_depth, color })
    }

    /// A tensor's shape and bytes.
    fn tensor(&self, name: &str, dtype: Dtype) -> Result<(&[usize], &[u8]), ReadError> {
        let info = self.tensors.info(name).ok_or_else(|| self.malformed(name, "expected this tensor, which is missing".to_owned()))?;
        if info.dtype != dtype {
            return Err(self.malformed(name, format!("expected {dtype:?}, got {:?}", info.dtype)));
        }
        let (start, end) = info.data_offsets;
        // The container's reader has checked that offsets are in order and end with the file.
        let bytes = self.bytes.get(self.data + start..self.data + end);
        Ok((&info.shape, bytes.ok_or_else(|| self.malformed(name, "lies outside the file".to_owned()))?))
    }

    fn shaped(&self, name: &str, dtype: Dtype, expected: &[usize]) -> Result<&[u8], ReadError> {
        let (shape, bytes) = self.tensor(name, dtype)?;
        if shape == expected { Ok(bytes) } else { Err(self.malformed(name, format!("expected the shape {expected:?}, got {shape:?}"))) }
    }

    fn pose(&self, field: &str, entries: &[f64; 16]) -> Result<Isometry3<f64>, ReadError> {
        from_row_major(entries).map_err(|e| self.malformed(field, e.to_string()))
    }

    fn bounds(&self, field: &str, json: &BoxJson) -> Result<OrientedBox, ReadError> {
        json.bounds().map_err(|e| self.malformed(field, e.to_string()))
    }

    fn malformed(&self, field: &str, reason: String) -> ReadError {
        malformed(&self.path, field, reason)
    }
}

fn malformed(path: &Path, field: &str, reason: String) -> ReadError {
    ReadError::Malformed { path: path.to_path_buf(), field: field.to_owned(), reason }
}
