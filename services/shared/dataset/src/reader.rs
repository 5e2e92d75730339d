//! Reads shards back into views.

use std::path::{Path, PathBuf};

use nalgebra::{Isometry3, Vector3};
use repose_geometry::{OrientedBox, Pinhole, transform::from_row_major};
use safetensors::{Dtype, SafeTensors};

use crate::{
    Elsewhere, Layer, ObjectRecord, RELATIONS, ViewRecord,
    writer::{CornerJson, METADATA, ObjectJson, ViewJson},
};

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
    /// The file is not a shard of this format, or contradicts itself.
    #[error("{path}: {field}: {reason}")]
    Malformed {
        /// The shard.
        path: PathBuf,
        /// The tensor or metadata entry.
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
    let bytes = std::fs::read(path).map_err(|source| ReadError::Io { path: path.to_path_buf(), source })?;
    let malformed = |field: &str, reason: String| ReadError::Malformed { path: path.to_path_buf(), field: field.to_string(), reason };
    let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|e| malformed("header", e.to_string()))?;
    let views = header.metadata().as_ref().and_then(|entries| entries.get(METADATA));
    let views = views.ok_or_else(|| malformed("metadata", format!("expected the key {METADATA}, which is missing")))?;
    let views: Vec<ViewJson> = serde_json::from_str(views).map_err(|e| malformed(METADATA, e.to_string()))?;
    let tensors = SafeTensors::deserialize(&bytes).map_err(|e| malformed("tensors", e.to_string()))?;
    let shard = Shard { path, tensors };
    views.iter().enumerate().map(|(v, json)| shard.view(v, json)).collect()
}

/// An opened shard: tensors by name, errors with the path.
struct Shard<'a> {
    path: &'a Path,
    tensors: SafeTensors<'a>,
}

impl Shard<'_> {
    fn malformed(&self, field: &str, reason: String) -> ReadError {
        ReadError::Malformed { path: self.path.to_path_buf(), field: field.to_string(), reason }
    }

    /// A tensor's shape and values, copied out (the container does not align them).
    fn tensor<T: bytemuck::Pod>(&self, name: &str, dtype: Dtype) -> Result<(Vec<usize>, Vec<T>), ReadError> {
        let view = self.tensors.tensor(name).map_err(|e| self.malformed(name, e.to_string()))?;
        if view.dtype() != dtype {
            return Err(self.malformed(name, format!("expected {dtype:?}, got {:?}", view.dtype())));
        }
        let mut values = vec![T::zeroed(); view.data().len() / size_of::<T>()];
        bytemuck::cast_slice_mut(&mut values).copy_from_slice(view.data());
        Ok((view.shape().to_vec(), values))
    }

    fn layer(&self, name: &str, corner: CornerJson) -> Result<Layer, ReadError> {
        let (shape, depth) = self.tensor::<u16>(name, Dtype::U16)?;
        let &[height, width] = &shape[..] else {
            return Err(self.malformed(name, format!("expected two axes [h,w], got {shape:?}")));
        };
        Ok(Layer { x0: corner.x0, y0: corner.y0, width: width as u32, height: height as u32, depth })
    }

    fn pose(&self, name: &str, entries: &[f64; 16]) -> Result<Isometry3<f64>, ReadError> {
        from_row_major(entries).map_err(|e| self.malformed(name, e.to_string()))
    }

    fn view(&self, v: usize, json: &ViewJson) -> Result<ViewRecord, ReadError> {
        let n = json.objects.len();
        let camera = &json.camera;
        let (shape, relations) = self.tensor::<u8>(&format!("{v:04}/relations"), Dtype::U8)?;
        if shape != [n, n, RELATIONS] {
            return Err(self.malformed("relations", format!("expected [{n},{n},{RELATIONS}], got {shape:?}")));
        }
        let (shape, gap_m) = self.tensor::<f32>(&format!("{v:04}/gap_m"), Dtype::F32)?;
        if shape != [n, n] {
            return Err(self.malformed("gap_m", format!("expected [{n},{n}], got {shape:?}")));
        }
        Ok(ViewRecord {
            scene_seed: json.scene_seed,
            view: json.view,
            camera: Pinhole { width: camera.width, height: camera.height, fx: camera.fx, fy: camera.fy, cx: camera.cx, cy: camera.cy },
            world_from_camera: self.pose("world_from_camera", &camera.world_from_camera)?,
            view_yaw_rad: json.view_yaw_rad,
            background: self.layer(&format!("{v:04}/background"), json.background)?,
            objects: json.objects.iter().enumerate().map(|(k, o)| self.object(v, k, o)).collect::<Result<_, _>>()?,
            relations: relations.chunks_exact(RELATIONS).map(|row| std::array::from_fn(|r| row[r] != 0)).collect(),
            gap_m,
        })
    }

    fn object(&self, v: usize, k: usize, json: &ObjectJson) -> Result<ObjectRecord, ReadError> {
        let elsewhere = match (json.elsewhere, &json.placed_from_elsewhere) {
            (Some(corner), Some(motion)) => Some(Elsewhere {
                layer: self.layer(&format!("{v:04}/object_{k}/elsewhere"), corner)?,
                placed_from_elsewhere: self.pose("placed_from_elsewhere", motion)?,
            }),
            _ => None,
        };
        Ok(ObjectRecord {
            id: json.id,
            name: json.name.clone(),
            world_from_object: self.pose("world_from_object", &json.world_from_object)?,
            bounds: OrientedBox {
                world_from_box: self.pose("world_from_box", &json.world_from_box)?,
                half_extents: Vector3::from(json.box_half_extents_m),
            },
            alone: self.layer(&format!("{v:04}/object_{k}/alone"), json.alone)?,
            elsewhere,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ShardWriter;

    fn view(seed: u64) -> ViewRecord {
        let layer = |z: u16| Layer { x0: 1, y0: 2, width: 2, height: 3, depth: vec![z, 0, z, z, z, 0] };
        let object = |id: u16| ObjectRecord {
            id,
            name: format!("box {id}"),
            world_from_object: Isometry3::translation(0.1, 0.2, f64::from(id)),
            bounds: OrientedBox { world_from_box: Isometry3::identity(), half_extents: Vector3::new(0.1, 0.2, 0.3) },
            alone: layer(id * 1000),
            elsewhere: (id == 2)
                .then(|| Elsewhere { layer: layer(7), placed_from_elsewhere: Isometry3::new(Vector3::x(), Vector3::z() * 0.3) }),
        };
        let mut relations = vec![[false; RELATIONS]; 4];
        relations[1][9] = true;
        ViewRecord {
            scene_seed: seed,
            view: 1,
            camera: Pinhole { width: 6, height: 8, fx: 5.0, fy: 5.0, cx: 2.5, cy: 3.5 },
            world_from_camera: Isometry3::new(Vector3::new(0.0, -1.0, 0.5), Vector3::x()),
            view_yaw_rad: 0.25,
            background: layer(12_345),
            objects: vec![object(1), object(2)],
            relations,
            gap_m: vec![0.0, 0.01, 0.01, 0.0],
        }
    }

    #[test]
    fn what_was_written_is_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let mut writer = ShardWriter::new(folder.path(), 2, 0).unwrap();
        for seed in 0..3 {
            writer.push(view(seed)).unwrap();
        }
        writer.finish().unwrap();
        let paths = shard_paths(folder.path()).unwrap();
        assert_eq!(paths.len(), 2, "two views, then one");
        let views: Vec<_> = paths.iter().flat_map(|p| read_shard(p).unwrap()).collect();
        assert_eq!(views.len(), 3);
        for (seed, got) in views.iter().enumerate() {
            let want = view(seed as u64);
            assert_eq!((got.objects.len(), &got.relations, &got.gap_m), (2, &want.relations, &want.gap_m));
            assert_eq!((&got.background, &got.objects[0].alone), (&want.background, &want.objects[0].alone));
            let (got, want) = (got.objects[1].elsewhere.as_ref().unwrap(), want.objects[1].elsewhere.as_ref().unwrap());
            assert!((got.placed_from_elsewhere.to_homogeneous() - want.placed_from_elsewhere.to_homogeneous()).amax() < 1e-12);
        }
    }

    #[test]
    fn a_view_that_contradicts_itself_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let mut writer = ShardWriter::new(folder.path(), 2, 0).unwrap();
        let mut bad = view(0);
        bad.gap_m.pop();
        let error = writer.push(bad).unwrap_err().to_string();
        assert!(error.contains("gap_m") && error.contains("expected 4"), "{error}");
    }

    #[test]
    fn a_truncated_shard_is_an_error_with_its_path() {
        let folder = tempfile::tempdir().unwrap();
        let mut writer = ShardWriter::new(folder.path(), 1, 0).unwrap();
        writer.push(view(0)).unwrap();
        let path = &shard_paths(folder.path()).unwrap()[0];
        let bytes = std::fs::read(path).unwrap();
        std::fs::write(path, &bytes[..bytes.len() - 5]).unwrap();
        assert!(matches!(read_shard(path), Err(ReadError::Malformed { .. })));
    }
}
