//! Outcomes of releasing an object of a scene somewhere: what the outcome network learns from.
//!
//! Outcomes belong to scenes, not to views: a folder of views may have a folder `releases` in it, with one file per range of scenes
//! and way of drawing places.
//!
//! ```text
//! metadata  {"format": "repose-releases-1"}
//! tensors   "scene_seed"  u64 [n]     the scene
//!           "object"      u16 [n]     the id of the object that was released
//!           "placed"      f32 [n, 4]  where: world position of the object's origin (metres), and its turn about world z from how it
//!                                     stands in the scene (radians, counter-clockwise)
//!           "outcome"     f32 [n, 4]  how far its centre moved (metres), how far its up axis tilted (radians), how deep it overlapped
//!                                     something at the start (metres), the farthest that another object moved (metres)
//!           "made_with" u8 [bytes]    optional: the generator's settings, as JSON
//! ```

use std::{
    collections::HashMap,
    path::{Path, PathBuf},
};

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use safetensors::{Dtype, SafeTensors, tensor::TensorView};

use crate::{
    manifest::{ManifestError, compare},
    reader::{ReadError, shard_paths},
    whole::write_whole,
    writer::{FORMAT_KEY, WriteError},
};

/// The folder of outcomes within a folder of views.
const RELEASES_FOLDER: &str = "releases";
/// How names of files of proposals begin.
const PROPOSALS: &str = "proposals_";
/// The tensor that says what a file was made with.
const MADE_WITH: &str = "made_with";
/// This version of the format.
const RELEASES_FORMAT: &str = "repose-releases-1";

/// A release of an object, and its outcome.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReleaseRecord {
    /// The scene.
    pub scene_seed: u64,
    /// The object's id.
    pub object: u16,
    /// World position of the object's origin where it was released, metres.
    pub origin_m: [f32; 3],
    /// Its turn about world z from how it stands in the scene, radians.
    pub yaw_rad: f32,
    /// How far its centre moved, metres.
    pub moved_m: f32,
    /// How far its up axis tilted, radians.
    pub tilt_rad: f32,
    /// How deep it overlapped something at the start, metres.
    pub penetration_m: f32,
    /// The farthest that another object's centre moved, metres.
    pub others_moved_m: f32,
}

impl ReleaseRecord {
    /// The motion from where the object stands in the scene to where it was released.
    pub fn placed_from_settled(&self, world_from_object: &Isometry3<f64>) -> Isometry3<f64> {
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), f64::from(self.yaw_rad));
        let origin = Vector3::from(self.origin_m).cast::<f64>();
        Isometry3::from_parts(Translation3::from(origin - turn * world_from_object.translation.vector), turn)
    }
}

/// Whether a file of outcomes is there already, or one of more scenes from the same first one. One that does not say what it was made with is
/// taken as it is.
///
/// # Errors
/// [`ManifestError::Differs`] when one from that scene was made with other settings, and when it cannot be read.
pub fn releases_are_there(path: &Path, made_with: &serde_json::Value) -> Result<bool, ManifestError> {
    let mut are_there = false;
    for (scenes, there) in from_same_scene(path) {
        are_there |= was_made_with(&there, made_with)? && scenes >= scenes_of(path).unwrap_or(u64::MAX);
    }
    Ok(are_there)
}

/// How many scenes a file of outcomes is of, by its name.
fn scenes_of(path: &Path) -> Option<u64> {
    path.file_stem()?.to_str()?.rsplit_once('_')?.1.parse().ok()
}

/// What a file's name says before the number of its scenes: of which kind it is, and which scene is its first.
fn beginning_of(path: &Path) -> Option<&str> {
    Some(path.file_stem()?.to_str()?.rsplit_once('_')?.0)
}

/// Whether a file holds the scenes of another of its kind, and more.
fn replaces(path: &Path, other: &Path) -> bool {
    let is_longer = scenes_of(path).zip(scenes_of(other)).is_some_and(|(scenes, of_other)| scenes > of_other);
    is_longer && beginning_of(path) == beginning_of(other)
}

/// The files of the same kind that begin at the same scene as `path`, itself included, with how many scenes each is of.
fn from_same_scene(path: &Path) -> Vec<(u64, PathBuf)> {
    let entries = path.parent().and_then(|folder| std::fs::read_dir(folder).ok()).into_iter().flatten().flatten();
    let is_other = |there: &PathBuf| there.extension() == path.extension() && beginning_of(there) == beginning_of(path);
    entries.map(|entry| entry.path()).filter(is_other).filter_map(|there| Some((scenes_of(&there)?, there))).collect()
}

/// Whether a file is there. One that was made with other settings is an error.
fn was_made_with(path: &Path, made_with: &serde_json::Value) -> Result<bool, ManifestError> {
    let malformed = |e: &dyn std::fmt::Display| ManifestError::Malformed { path: path.to_path_buf(), reason: e.to_string() };
    let bytes = match std::fs::read(path) {
        Ok(bytes) => bytes,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(false),
        Err(source) => return Err(ManifestError::Io { path: path.to_path_buf(), source }),
    };
    let tensors = SafeTensors::deserialize(&bytes).map_err(|e| malformed(&e))?;
    let Ok(text) = tensors.tensor(MADE_WITH) else { return Ok(true) };
    let there: serde_json::Value = serde_json::from_slice(text.data()).map_err(|e| malformed(&e))?;
    let mut differences = Vec::new();
    compare(MADE_WITH, &there, made_with, &mut differences);
    if differences.is_empty() { Ok(true) } else { Err(ManifestError::Differs { path: path.to_path_buf(), differences }) }
}

/// Writes a file of outcomes whole, or not at all, in place of those of fewer scenes from the same first one.
///
/// # Errors
/// [`WriteError`] when the folder or the file cannot be written.
pub fn write_releases(path: &Path, made_with: &serde_json::Value, releases: &[ReleaseRecord]) -> Result<(), WriteError> {
    let n = releases.len();
    let seeds: Vec<u8> = releases.iter().flat_map(|r| r.scene_seed.to_le_bytes()).collect();
    let objects: Vec<u8> = releases.iter().flat_map(|r| r.object.to_le_bytes()).collect();
    let rows = |row: &dyn Fn(&ReleaseRecord) -> [f32; 4]| -> Vec<u8> { releases.iter().flat_map(row).flat_map(f32::to_le_bytes).collect() };
    let placed = rows(&|r| [r.origin_m[0], r.origin_m[1], r.origin_m[2], r.yaw_rad]);
    let outcome = rows(&|r| [r.moved_m, r.tilt_rad, r.penetration_m, r.others_moved_m]);
    let made_with = made_with.to_string().into_bytes();
    let view = |dtype, shape: Vec<usize>, bytes| TensorView::new(dtype, shape, bytes).map_err(|e| WriteError::Container(e.to_string()));
    let tensors = [
        ("scene_seed", view(Dtype::U64, vec![n], &seeds)?),
        ("object", view(Dtype::U16, vec![n], &objects)?),
        ("placed", view(Dtype::F32, vec![n, 4], &placed)?),
        ("outcome", view(Dtype::F32, vec![n, 4], &outcome)?),
        (MADE_WITH, view(Dtype::U8, vec![made_with.len()], &made_with)?),
    ];
    let metadata = HashMap::from([(FORMAT_KEY.to_owned(), RELEASES_FORMAT.to_owned())]);
    let bytes = safetensors::serialize(tensors, Some(metadata)).map_err(|e| WriteError::Container(e.to_string()))?;
    write_whole(path, &bytes).map_err(|source| WriteError::Io { path: path.to_path_buf(), source })?;
    // Only now: had the disk been full, they would be all there is. Should this be interrupted, readers pass over them.
    for (_, shorter) in from_same_scene(path).into_iter().filter(|(_, there)| replaces(path, there)) {
        std::fs::remove_file(&shorter).map_err(|source| WriteError::Io { path: shorter, source })?;
    }
    Ok(())
}

/// The path of the file of outcomes whose first scene is `first_scene`, for `scenes` scenes, under a folder of views.
pub fn releases_path(folder: &Path, first_scene: u64, scenes: u64) -> PathBuf {
    folder.join(RELEASES_FOLDER).join(format!("releases_{first_scene:06}_{scenes}.safetensors"))
}

/// The same for places that the prior and the planner proposed.
pub fn proposals_path(folder: &Path, first_scene: u64, scenes: u64) -> PathBuf {
    folder.join(RELEASES_FOLDER).join(format!("{PROPOSALS}{first_scene:06}_{scenes}.safetensors"))
}

/// All outcomes under a folder of views, in the order of the files' names; none where there is no such folder.
///
/// # Errors
/// [`ReadError`] when a file cannot be read or does not hold what the format says.
pub fn read_releases(folder: &Path) -> Result<Vec<ReleaseRecord>, ReadError> {
    read_named(folder, "")
}

/// The same of places that the prior and the planner proposed, alone.
///
/// # Errors
/// As [`read_releases`].
pub fn read_proposals(folder: &Path) -> Result<Vec<ReleaseRecord>, ReadError> {
    read_named(folder, PROPOSALS)
}

/// The outcomes in files whose names begin so.
fn read_named(folder: &Path, beginning: &str) -> Result<Vec<ReleaseRecord>, ReadError> {
    let folder = folder.join(RELEASES_FOLDER);
    if !folder.is_dir() {
        return Ok(Vec::new());
    }
    let begins = |path: &Path| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(beginning));
    let paths: Vec<PathBuf> = shard_paths(&folder)?.into_iter().filter(|path| begins(path)).collect();
    let mut all = Vec::new();
    // Outcomes that are in two files would count twice.
    for path in paths.iter().filter(|path| !paths.iter().any(|other| replaces(other, path))) {
        match std::fs::read(path) {
            Ok(bytes) => all.extend(parsed(path, &bytes)?),
            // It was there a moment ago: one of more scenes has been put in its place.
            Err(gone) if gone.kind() == std::io::ErrorKind::NotFound => {}
            Err(source) => return Err(ReadError::Io { path: path.clone(), source }),
        }
    }
    Ok(all)
}

fn parsed(path: &Path, bytes: &[u8]) -> Result<Vec<ReleaseRecord>, ReadError> {
    let malformed = |field: &str, reason: String| ReadError::Malformed { path: path.to_path_buf(), field: field.to_owned(), reason };
    let (_, header) = SafeTensors::read_metadata(bytes).map_err(|e| malformed("header", e.to_string()))?;
    let version = header.metadata().as_ref().and_then(|entries| entries.get(FORMAT_KEY)).map_or("none", String::as_str);
    if version != RELEASES_FORMAT {
        return Err(malformed("format", format!("expected {RELEASES_FORMAT}, got {version}")));
    }
    let tensors = SafeTensors::deserialize(bytes).map_err(|e| malformed("header", e.to_string()))?;
    let n = tensors.tensor("scene_seed").map_err(|e| malformed("scene_seed", e.to_string()))?.shape().iter().product::<usize>();
    let tensor = |name: &str, dtype: Dtype, shape: &[usize]| {
        let tensor = tensors.tensor(name).map_err(|e| malformed(name, e.to_string()))?;
        if tensor.dtype() != dtype || tensor.shape() != shape {
            let reason = format!("expected {dtype:?} {shape:?}, got {:?} {:?}", tensor.dtype(), tensor.shape());
            return Err(malformed(name, reason));
        }
        Ok(tensor.data())
    };
    let floats = |bytes: &[u8]| -> Vec<f32> { bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect() };
    let seeds = tensor("scene_seed", Dtype::U64, &[n])?.chunks_exact(8).map(|b| u64::from_le_bytes(std::array::from_fn(|i| b[i])));
    let objects = tensor("object", Dtype::U16, &[n])?.chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]]));
    let (placed, outcome) = (floats(tensor("placed", Dtype::F32, &[n, 4])?), floats(tensor("outcome", Dtype::F32, &[n, 4])?));
    if let Some(i) = placed.iter().chain(&outcome).position(|x| !x.is_finite()) {
        return Err(malformed("placed, outcome", format!("entry {i} is not finite")));
    }
    let records = seeds.zip(objects).zip(placed.as_chunks::<4>().0).zip(outcome.as_chunks::<4>().0);
    let records = records.map(|(((scene_seed, object), p), o)| ReleaseRecord {
        scene_seed,
        object,
        origin_m: [p[0], p[1], p[2]],
        yaw_rad: p[3],
        moved_m: o[0],
        tilt_rad: o[1],
        penetration_m: o[2],
        others_moved_m: o[3],
    });
    Ok(records.collect())
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;
    use serde_json::json;

    use super::*;

    fn record(scene_seed: u64) -> ReleaseRecord {
        ReleaseRecord {
            scene_seed,
            object: 3,
            origin_m: [0.1, -0.2, 0.3],
            yaw_rad: 0.5,
            moved_m: 0.01,
            tilt_rad: 0.02,
            penetration_m: 0.003,
            others_moved_m: 0.004,
        }
    }

    #[test]
    fn what_is_written_is_read_in_the_order_of_the_scenes() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(read_releases(folder.path()).unwrap(), []);
        write_releases(&releases_path(folder.path(), 16, 16), &json!({}), &[record(7), record(8)]).unwrap();
        write_releases(&releases_path(folder.path(), 0, 16), &json!({}), &[record(1)]).unwrap();
        assert_eq!(read_releases(folder.path()).unwrap(), [record(1), record(7), record(8)]);
    }

    #[test]
    fn a_file_made_with_other_settings_is_refused_by_what_differs() {
        let folder = tempfile::tempdir().unwrap();
        let path = releases_path(folder.path(), 0, 16);
        let made_with = json!({"per_scene": 2});
        assert!(!releases_are_there(&path, &made_with).unwrap());
        write_releases(&path, &made_with, &[record(1)]).unwrap();
        assert!(releases_are_there(&path, &made_with).unwrap());
        let refused = releases_are_there(&path, &json!({"per_scene": 3})).unwrap_err().to_string();
        assert!(refused.contains("releases_000000_16") && refused.contains("made_with.per_scene: there 2, now 3"), "{refused}");
    }

    #[test]
    fn a_file_of_more_scenes_is_kept_and_one_of_fewer_is_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let (made_with, of) = (json!({"per_scene": 2}), |scenes| releases_path(folder.path(), 0, scenes));
        write_releases(&of(3), &made_with, &[record(1), record(2), record(3)]).unwrap();
        write_releases(&releases_path(folder.path(), 16, 3), &made_with, &[record(17)]).unwrap();
        assert!(releases_are_there(&of(1), &made_with).unwrap() && !releases_are_there(&of(16), &made_with).unwrap());
        assert!(!releases_are_there(&proposals_path(folder.path(), 0, 1), &made_with).unwrap(), "proposals are others");
        assert!(releases_are_there(&of(16), &json!({"per_scene": 3})).is_err());
        write_releases(&of(16), &made_with, &[record(1)]).unwrap();
        assert_eq!(read_releases(folder.path()).unwrap(), [record(1), record(17)]);
    }

    #[test]
    fn a_file_that_cannot_be_written_leaves_those_of_fewer_scenes() {
        let folder = tempfile::tempdir().unwrap();
        let of = |scenes| releases_path(folder.path(), 0, scenes);
        write_releases(&of(3), &json!({}), &[record(1), record(2)]).unwrap();
        // Where the new one is written before it is renamed, there is no room for it.
        std::fs::create_dir(of(16).with_extension(format!("safetensors.{}.tmp", std::process::id()))).unwrap();
        assert!(write_releases(&of(16), &json!({}), &[record(1)]).is_err());
        assert_eq!(read_releases(folder.path()).unwrap(), [record(1), record(2)]);
    }

    #[test]
    fn scenes_that_are_in_a_longer_file_too_count_once() {
        let folder = tempfile::tempdir().unwrap();
        let of = |scenes| releases_path(folder.path(), 0, scenes);
        // The longer file first, so that nothing removes the shorter one: as after an interruption.
        write_releases(&of(16), &json!({}), &[record(1), record(9)]).unwrap();
        write_releases(&of(3), &json!({}), &[record(1)]).unwrap();
        write_releases(&proposals_path(folder.path(), 0, 3), &json!({}), &[record(2)]).unwrap();
        assert!(of(3).exists());
        assert_eq!(read_releases(folder.path()).unwrap(), [record(2), record(1), record(9)]);
    }

    #[cfg(unix)]
    #[test]
    fn a_file_that_has_gone_since_it_was_listed_is_passed_over() {
        let folder = tempfile::tempdir().unwrap();
        write_releases(&releases_path(folder.path(), 0, 16), &json!({}), &[record(1)]).unwrap();
        std::os::unix::fs::symlink("gone", releases_path(folder.path(), 16, 3)).unwrap();
        assert_eq!(read_releases(folder.path()).unwrap(), [record(1)]);
    }

    #[test]
    fn a_broken_file_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = releases_path(folder.path(), 0, 1);
        write_releases(&path, &json!({}), &[ReleaseRecord { moved_m: f32::NAN, ..record(1) }]).unwrap();
        let error = read_releases(folder.path()).unwrap_err().to_string();
        assert!(error.contains("releases_000000_1") && error.contains("not finite"), "{error}");
        write_releases(&path, &json!({}), &[record(1)]).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() - 8]).unwrap();
        assert!(read_releases(folder.path()).is_err());
    }

    #[test]
    fn a_motion_brings_the_origin_there_and_turns_about_it() {
        let standing = Isometry3::translation(0.5, 0.5, 0.1);
        let placed = record(1).placed_from_settled(&standing) * standing;
        assert!((placed.translation.vector - Vector3::new(0.1, -0.2, 0.3)).norm() < 1e-6);
        let ahead = placed * Point3::new(1.0, 0.0, 0.0) - placed * Point3::origin();
        assert!((ahead.y.atan2(ahead.x) - 0.5).abs() < 1e-6);
    }
}
