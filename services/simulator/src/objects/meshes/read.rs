//! Triangles out of OBJ, STL and PLY bytes; the libraries parse, this maps.

use nalgebra::Point3;
use ply_rs_bw::parser::Parser;
use ply_rs_bw::ply::DefaultElement;
use repose_geometry::TriMesh;

use super::error::MeshProblem;

/// A mesh file's format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// Wavefront OBJ.
    Obj,
    /// STL, text or binary.
    Stl,
    /// PLY, text or binary.
    Ply,
}

impl Format {
    /// By the file's extension, in any case.
    pub fn of(path: &std::path::Path) -> Option<Self> {
        match path.extension()?.to_str()?.to_ascii_lowercase().as_str() {
            "obj" => Some(Self::Obj),
            "stl" => Some(Self::Stl),
            "ply" => Some(Self::Ply),
            _ => None,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Obj => "OBJ",
            Self::Stl => "STL",
            Self::Ply => "PLY",
        }
    }
}

/// The triangles of a file in its own units, polygons cut into fans. Finite coordinates, valid indices.
///
/// # Errors
/// [`MeshProblem`]: not that format, no triangles, more than `max_triangles`, a coordinate that is not finite, an index out of range.
pub fn triangles(format: Format, bytes: &[u8], max_triangles: usize) -> Result<TriMesh, MeshProblem> {
    let mesh = match format {
        Format::Obj => obj(bytes)?,
        Format::Stl => stl(bytes)?,
        Format::Ply => ply(bytes)?,
    };
    if mesh.triangles.is_empty() {
        return Err(MeshProblem::NoTriangles);
    }
    if mesh.triangles.len() > max_triangles {
        return Err(MeshProblem::TooManyTriangles { limit: max_triangles, got: mesh.triangles.len() });
    }
    if let Some((index, v)) = mesh.vertices.iter().enumerate().find(|(_, v)| v.iter().any(|c| !c.is_finite())) {
        return Err(MeshProblem::NotFinite { index, got: (*v).into() });
    }
    let vertices = mesh.vertices.len();
    let beyond = |t: &[u32; 3]| t.iter().copied().find(|&i| i as usize >= vertices);
    match mesh.triangles.iter().enumerate().find_map(|(i, t)| Some((i, beyond(t)?))) {
        Some((triangle, got)) => Err(MeshProblem::NoSuchVertex { triangle, vertices, got }),
        None => Ok(mesh),
    }
}

fn invalid(format: Format) -> impl Fn(String) -> MeshProblem {
    move |message| MeshProblem::Format { format: format.name(), message }
}

fn obj(bytes: &[u8]) -> Result<TriMesh, MeshProblem> {
    let options = tobj::LoadOptions { triangulate: true, ignore_points: true, ignore_lines: true, ..tobj::LoadOptions::default() };
    // Materials are colors, which objects here get at random.
    let no_materials = |_: &std::path::Path| Ok((Vec::new(), Default::default()));
    let (models, _) =
        tobj::load_obj_buf(&mut std::io::Cursor::new(bytes), &options, no_materials).map_err(|e| invalid(Format::Obj)(e.to_string()))?;
    let mut mesh = TriMesh::default();
    for model in models {
        mesh.append(&TriMesh {
            vertices: model.mesh.positions.chunks_exact(3).map(|p| Point3::new(p[0], p[1], p[2])).collect(),
            triangles: model.mesh.indices.chunks_exact(3).map(|t| [t[0], t[1], t[2]]).collect(),
        });
    }
    Ok(mesh)
}

fn stl(bytes: &[u8]) -> Result<TriMesh, MeshProblem> {
    let read = stl_io::read_stl(&mut std::io::Cursor::new(bytes)).map_err(|e| invalid(Format::Stl)(e.to_string()))?;
    Ok(TriMesh {
        vertices: read.vertices.iter().map(|v| Point3::from(v.0)).collect(),
        triangles: read.faces.iter().map(|f| f.vertices.map(|i| i as u32)).collect(),
    })
}

fn ply(bytes: &[u8]) -> Result<TriMesh, MeshProblem> {
    let invalid = invalid(Format::Ply);
    let read = Parser::<DefaultElement>::new().read_ply(&mut std::io::Cursor::new(bytes)).map_err(|e| invalid(format!("{e:?}")))?;
    let mut mesh = TriMesh::default();
    for vertex in read.payload.get("vertex").into_iter().flatten() {
        let coordinate = |key: &str| {
            vertex.get(key).and_then(ply_rs_bw::ply::Property::to_f32_lossy).ok_or_else(|| invalid(format!("a vertex without {key}")))
        };
        mesh.vertices.push(Point3::new(coordinate("x")?, coordinate("y")?, coordinate("z")?));
    }
    for face in read.payload.get("face").into_iter().flatten() {
        let corners = face.get("vertex_indices").or_else(|| face.get("vertex_index"));
        let corners =
            corners.and_then(ply_rs_bw::ply::Property::to_u32_list).ok_or_else(|| invalid("a face without vertices".to_owned()))?;
        mesh.triangles.extend((2..corners.len()).map(|k| [corners[0], corners[k - 1], corners[k]]));
    }
    Ok(mesh)
}
