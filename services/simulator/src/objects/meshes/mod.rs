//! A folder of the user's meshes as objects.
//!
//! Every `.obj`, `.stl` and `.ply` below the folder is one object, except files called `convex_parts`, which are the ready parts of the
//! one mesh beside them. An object is called by its sidecar, else by its folder where it is the only mesh there, else by its file. Folders
//! and files whose names begin with a dot are passed over. Anything wrong with any file is an error: nothing is skipped in silence.
//!
//! The YCB objects of `data/ycb` load as they are (masses from their `model.urdf`, parts from their `convex_parts.stl`). They are for
//! evaluation only: no training default names a folder of meshes.

pub mod cache;
pub mod clean;
pub mod decompose;
pub mod error;
pub mod probe;
pub mod read;
pub mod settings;
pub mod sidecar;
pub mod simplify;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use parry3d::shape::SharedShape;
use rapier3d::math::{Pose, Vector};
use repose_geometry::TriMesh;

use self::cache::{Cache, Geometry};
use self::clean::{cleaned, signed_volume};
use self::decompose::{decomposed, feet, ready_parts};
pub use self::error::{MeshError, MeshProblem};
use self::probe::Heights;
use self::read::{Format, triangles};
pub use self::settings::{DecompositionSettings, MeshSettings, UpAxis};
use self::sidecar::{Sidecar, positive, sidecar_of};
use self::simplify::simplified;
use super::ObjectShape;
use super::material::Mass;
use crate::convert;

/// Files of this name hold ready parts.
const READY_PARTS: &str = "convex_parts";
/// The folder beside the meshes where finished objects are kept.
const CACHE_FOLDER: &str = ".repose-cache";

/// The objects of a folder, in the order of their paths.
#[derive(Clone)]
pub struct MeshLibrary {
    shapes: Arc<[Arc<ObjectShape>]>,
    /// Hash of all that the objects follow from.
    digest: blake3::Hash,
}

impl std::fmt::Debug for MeshLibrary {
    /// Names and the hash: what tells two libraries apart, without a million triangles.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let names: Vec<&str> = self.shapes.iter().map(|shape| shape.name.as_ref()).collect();
        f.debug_struct("MeshLibrary").field("shapes", &names).field("digest", &self.digest.to_hex().as_str()).finish()
    }
}

impl PartialEq for MeshLibrary {
    fn eq(&self, other: &Self) -> bool {
        self.digest == other.digest
    }
}

impl MeshLibrary {
    /// Loads all meshes below a folder.
    ///
    /// # Errors
    /// [`MeshError`] that names the first file that is not a usable object, or the folder when it has none.
    pub fn load(folder: &Path, settings: &MeshSettings) -> Result<Self, MeshError> {
        let fields = [("scale", settings.scale), ("density_kg_m3", settings.density_kg_m3), ("friction", settings.friction)];
        fields.into_iter().try_for_each(|(field, value)| positive(field, value)).map_err(|problem| problem.at(folder))?;
        let mut paths = Vec::new();
        collect(folder, &mut BTreeSet::new(), &mut paths)?;
        if paths.is_empty() {
            return Err(MeshProblem::NoMeshes.at(folder));
        }
        let cache = Cache::new(settings.cache.clone().unwrap_or_else(|| folder.join(CACHE_FOLDER)));
        let mut digest = blake3::Hasher::new();
        let mut shapes = Vec::with_capacity(paths.len());
        for path in &paths {
            let alone = paths.iter().filter(|p| p.parent() == path.parent()).count() == 1;
            let name = name_of(path, alone && path.parent() != Some(folder));
            let source = Source::read(path, settings)?;
            if let (false, Some((parts, ..))) = (alone, &source.parts) {
                return Err(MeshProblem::PartsOfSeveral.at(parts));
            }
            digest.update(name.as_bytes()).update(source.key.as_bytes()).update(format!("{:?}", source.sidecar).as_bytes());
            let geometry = source.geometry(settings, &cache)?;
            shapes.push(Arc::new(source.shape(&name, geometry, settings)));
        }
        digest.update(format!("{settings:?}").as_bytes());
        Ok(Self { shapes: shapes.into(), digest: digest.finalize() })
    }

    /// The objects.
    pub fn shapes(&self) -> &[Arc<ObjectShape>] {
        &self.shapes
    }
}

/// A mesh file with what belongs to it.
struct Source<'a> {
    path: &'a Path,
    format: Format,
    bytes: Vec<u8>,
    parts: Option<(PathBuf, Format, Vec<u8>)>,
    sidecar: Sidecar,
    key: String,
}

impl<'a> Source<'a> {
    fn read(path: &'a Path, settings: &MeshSettings) -> Result<Self, MeshError> {
        let read = |path: &Path| std::fs::read(path).map_err(|e| MeshProblem::Io(e).at(path));
        let format = Format::of(path).ok_or_else(|| MeshProblem::NoMeshes.at(path))?;
        let mut parts = None;
        for extension in ["stl", "obj", "ply"] {
            let file = path.with_file_name(format!("{READY_PARTS}.{extension}"));
            if settings.decomposition.ready_parts && parts.is_none() && file.is_file() {
                let bytes = read(&file)?;
                parts = Format::of(&file).map(|format| (file, format, bytes));
            }
        }
        let bytes = read(path)?;
        let sidecar = sidecar_of(path)?;
        let frame = (sidecar.scale.unwrap_or(settings.scale), sidecar.up.unwrap_or(settings.up));
        let relevant = format!("{frame:?} {} {} {:?}", settings.drawn_triangles, settings.tolerance_m, settings.decomposition);
        let key = Cache::key(&[&bytes, parts.as_ref().map_or(&[], |p| p.2.as_slice())], &relevant);
        Ok(Self { path, format, bytes, parts, sidecar, key })
    }

    fn geometry(&self, settings: &MeshSettings, cache: &Cache) -> Result<Geometry, MeshError> {
        if let Some(geometry) = cache.get(&self.key) {
            return Ok(geometry);
        }
        let geometry = self.made(settings)?;
        if geometry.open_edges > 0 {
            tracing::info!(file = %self.path.display(), open_edges = geometry.open_edges, "the surface is not closed");
        }
        if let Err(error) = cache.put(&self.key, &geometry) {
            tracing::warn!(file = %self.path.display(), %error, "the finished object is not kept");
        }
        Ok(geometry)
    }

    fn made(&self, settings: &MeshSettings) -> Result<Geometry, MeshError> {
        let scale = self.sidecar.scale.unwrap_or(settings.scale);
        let turn = self.sidecar.up.unwrap_or(settings.up).world_from_file();
        let in_metres = |format: Format, bytes: &[u8], path: &Path| -> Result<TriMesh, MeshError> {
            let mut mesh = triangles(format, bytes, settings.max_triangles).map_err(|problem| problem.at(path))?;
            for v in &mut mesh.vertices {
                *v = turn * (*v * scale);
            }
            Ok(mesh)
        };
        let mut mesh = in_metres(self.format, &self.bytes, self.path)?;
        let longest = mesh.aabb().map_or(0.0, |b| (b.max - b.min).max());
        if !(0.005..=1.0).contains(&longest) {
            return Err(MeshProblem::Size { got_m: longest }.at(self.path));
        }
        let weld = longest * 1e-5;
        let clean = cleaned(&mesh, weld);
        mesh = clean.mesh;
        let Some(bounds) = mesh.aabb() else { return Err(MeshProblem::NoTriangles.at(self.path)) };
        let center = nalgebra::center(&bounds.min, &bounds.max).coords;
        let mut parts = match &self.parts {
            Some((path, format, bytes)) => ready_parts(&in_metres(*format, bytes, path)?, weld, settings.decomposition.max_corners),
            None => decomposed(&mesh, &settings.decomposition),
        };
        let volume_m3 = signed_volume(&mesh);
        // Before the feet: they alone are no body.
        if parts.is_empty() {
            return Err(MeshProblem::NoParts.at(self.parts.as_ref().map_or(self.path, |(path, ..)| path.as_path())));
        }
        let mut mesh = simplified(&mesh, settings.drawn_triangles, settings.tolerance_m);
        parts.extend(feet(&mesh, &parts));
        for p in mesh.vertices.iter_mut().chain(parts.iter_mut().flatten()) {
            *p -= center;
        }
        Ok(Geometry { mesh, parts, volume_m3, open_edges: clean.open_edges })
    }

    fn shape(&self, name: &str, geometry: Geometry, settings: &MeshSettings) -> ObjectShape {
        let parts = geometry.parts.iter().filter_map(|corners| {
            let corners: Vec<Vector> = corners.iter().map(convert::vector).collect();
            SharedShape::convex_hull(&corners).map(|hull| (Pose::IDENTITY, hull))
        });
        let density_kg_m3 = self.sidecar.density_kg_m3.unwrap_or(settings.density_kg_m3);
        let half_extents = geometry.mesh.vertices.iter().fold(nalgebra::Vector3::zeros(), |h, v| v.coords.abs().sup(&h));
        let heights = Heights::of(&geometry.mesh);
        ObjectShape {
            name: self.sidecar.name.as_deref().unwrap_or(name).into(),
            parts: parts.collect(),
            half_extents_m: half_extents.cast(),
            mass_kg: self.sidecar.mass_kg.unwrap_or_else(|| Mass::Solid.of(density_kg_m3, geometry.volume_m3, 0.0)),
            friction: self.sidecar.friction.unwrap_or(settings.friction),
            is_friction_known: self.sidecar.friction.is_some(),
            top: heights.top(),
            opening: heights.opening(),
            mesh: geometry.mesh,
        }
    }
}

/// All mesh files below a folder, in the order of their paths. A folder that several links lead to is searched once.
fn collect(folder: &Path, searched: &mut BTreeSet<PathBuf>, found: &mut Vec<PathBuf>) -> Result<(), MeshError> {
    let listed = |e: std::io::Error| MeshProblem::Io(e).at(folder);
    if !searched.insert(folder.canonicalize().map_err(listed)?) {
        return Ok(());
    }
    let mut entries: Vec<PathBuf> =
        std::fs::read_dir(folder).map_err(listed)?.map(|entry| entry.map(|e| e.path())).collect::<Result<_, _>>().map_err(listed)?;
    entries.sort();
    for path in entries {
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        if name.starts_with('.') {
            continue;
        }
        if path.is_dir() {
            collect(&path, searched, found)?;
        } else if Format::of(&path).is_some() && path.file_stem().is_some_and(|stem| stem != READY_PARTS) {
            found.push(path);
        }
    }
    Ok(())
}

fn name_of(path: &Path, by_folder: bool) -> String {
    let name = if by_folder { path.parent().and_then(Path::file_name) } else { path.file_stem() };
    name.map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
}
