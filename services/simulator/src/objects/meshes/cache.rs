//! Finished objects on disk, so that a folder of meshes is decomposed once.
//!
//! A file per object, named by the BLAKE3 hash of everything that its content follows from: this format's version, the bytes of the mesh
//! and of its ready parts, and the settings. It holds a line with the hash of the rest, then JSON; whatever does not match is as good as
//! not there.

use std::path::{Path, PathBuf};

use nalgebra::Point3;
use repose_dataset::write_whole;
use repose_geometry::TriMesh;
use serde::{Deserialize, Serialize};

use super::decompose::ConvexPart;

/// Goes up when the same bytes and settings would give another object.
const VERSION: u32 = 2;

/// What is worth keeping of an object: its surface and its parts, metres, z up, origin at the centre of the surface's box.
#[derive(Debug, Clone, PartialEq)]
pub struct Geometry {
    /// What is drawn.
    pub mesh: TriMesh,
    /// Corners of the convex parts.
    pub parts: Vec<ConvexPart>,
    /// Volume enclosed by the file's surface, m³.
    pub volume_m3: f32,
    /// Edges of the file's surface that do not have exactly two triangles.
    pub open_edges: usize,
}

#[derive(Serialize, Deserialize)]
struct Stored {
    vertices: Vec<[f32; 3]>,
    triangles: Vec<[u32; 3]>,
    parts: Vec<Vec<[f32; 3]>>,
    volume_m3: f32,
    open_edges: usize,
}

/// A folder of finished objects.
#[derive(Debug, Clone, PartialEq)]
pub struct Cache {
    folder: PathBuf,
}

impl Cache {
    /// Keeps files in `folder`, which is made when something is put into it.
    pub fn new(folder: PathBuf) -> Self {
        Self { folder }
    }

    /// The key of an object made from these bytes and settings (any text that says them all).
    pub fn key(inputs: &[&[u8]], settings: &str) -> String {
        let mut hasher = blake3::Hasher::new();
        hasher.update(&VERSION.to_le_bytes());
        for input in inputs.iter().copied().chain([settings.as_bytes()]) {
            hasher.update(&(input.len() as u64).to_le_bytes());
            hasher.update(input);
        }
        hasher.finalize().to_hex().to_string()
    }

    /// What is kept under a key; `None` when there is nothing, or it is damaged.
    pub fn get(&self, key: &str) -> Option<Geometry> {
        let text = std::fs::read_to_string(self.file(key)).ok()?;
        let (hash, json) = text.split_once('\n')?;
        if blake3::hash(json.as_bytes()).to_hex().as_str() != hash {
            return None;
        }
        let stored: Stored = serde_json::from_str(json).ok()?;
        let points = |list: Vec<[f32; 3]>| list.into_iter().map(Point3::from).collect();
        Some(Geometry {
            mesh: TriMesh { vertices: points(stored.vertices), triangles: stored.triangles },
            parts: stored.parts.into_iter().map(points).collect(),
            volume_m3: stored.volume_m3,
            open_edges: stored.open_edges,
        })
    }

    /// Keeps something under a key: whole or not at all, also when several processes do it at once.
    ///
    /// # Errors
    /// When the folder cannot be made or written.
    pub fn put(&self, key: &str, geometry: &Geometry) -> std::io::Result<()> {
        let plain = |list: &[Point3<f32>]| list.iter().map(|p| (*p).into()).collect();
        let stored = Stored {
            vertices: plain(&geometry.mesh.vertices),
            triangles: geometry.mesh.triangles.clone(),
            parts: geometry.parts.iter().map(|p| plain(p)).collect(),
            volume_m3: geometry.volume_m3,
            open_edges: geometry.open_edges,
        };
        let json = serde_json::to_string(&stored)?;
        write_whole(&self.file(key), format!("{}\n{json}", blake3::hash(json.as_bytes()).to_hex()).as_bytes())
    }

    fn file(&self, key: &str) -> PathBuf {
        self.folder.join(Path::new(key).with_extension("json"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_put_is_got_bit_for_bit_and_damage_is_noticed() {
        let folder = tempfile::tempdir().expect("a folder");
        let cache = Cache::new(folder.path().join("deep/er"));
        let geometry = Geometry {
            mesh: TriMesh { vertices: vec![Point3::new(0.1, -1e-7, 1.0 / 3.0)], triangles: vec![[0, 0, 0]] },
            parts: vec![vec![Point3::new(0.3, 0.2, 0.1)]],
            volume_m3: 1.2345e-4,
            open_edges: 3,
        };
        let key = Cache::key(&[b"mesh"], "settings");
        assert_eq!(cache.get(&key), None);
        cache.put(&key, &geometry).expect("written");
        let again = geometry.clone();
        assert_eq!(cache.get(&key), Some(geometry));
        let file = cache.file(&key);
        let text = std::fs::read_to_string(&file).expect("there").replace("0.3", "0.4");
        std::fs::write(&file, text).expect("written");
        assert_eq!(cache.get(&key), None);
        let leftovers = std::fs::read_dir(file.parent().expect("a folder")).expect("there").count();
        assert_eq!(leftovers, 1);
        // Where it cannot be put, nothing of it stays, either.
        std::fs::remove_file(&file).expect("removed");
        std::fs::create_dir(&file).expect("a folder in its place");
        assert!(cache.put(&key, &again).is_err());
        assert_eq!(std::fs::read_dir(file.parent().expect("a folder")).expect("there").count(), 1);
    }

    #[test]
    fn keys_tell_apart_whatever_differs() {
        let keys =
            [Cache::key(&[b"ab", b"c"], "s"), Cache::key(&[b"a", b"bc"], "s"), Cache::key(&[b"ab", b"c"], "t"), Cache::key(&[b"abc"], "s")];
        assert!((0..4).all(|i| (0..i).all(|j| keys[i] != keys[j])));
    }
}
