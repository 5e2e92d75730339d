//! What can be wrong with a folder of meshes; every error names the file.

use std::path::{Path, PathBuf};

/// A file that is no usable object.
#[derive(Debug, thiserror::Error)]
#[error("{}: {problem}", path.display())]
pub struct MeshError {
    /// Which.
    pub path: PathBuf,
    /// What is wrong.
    pub problem: MeshProblem,
}

/// What is wrong with it.
#[derive(Debug, thiserror::Error)]
pub enum MeshProblem {
    /// It cannot be read from disk.
    #[error("cannot be read: {0}")]
    Io(#[from] std::io::Error),
    /// It is not what its extension says.
    #[error("not a valid {format} file: {message}")]
    Format {
        /// OBJ, STL, PLY, TOML or URDF.
        format: &'static str,
        /// What the parser says.
        message: String,
    },
    /// It has no triangle with an area.
    #[error("expected triangles, found none with an area")]
    NoTriangles,
    /// It has more triangles than `max_triangles`.
    #[error("expected at most {limit} triangles, got {got}")]
    TooManyTriangles {
        /// `max_triangles`.
        limit: usize,
        /// In the file.
        got: usize,
    },
    /// A coordinate is not a finite number.
    #[error("vertex {index}: expected finite coordinates, got {got:?}")]
    NotFinite {
        /// Which vertex.
        index: usize,
        /// Its coordinates.
        got: [f32; 3],
    },
    /// A triangle refers to a vertex that is not there.
    #[error("triangle {triangle}: expected vertices below {vertices}, got {got}")]
    NoSuchVertex {
        /// Which triangle.
        triangle: usize,
        /// How many vertices there are.
        vertices: usize,
        /// What it refers to.
        got: u32,
    },
    /// Its size is not that of something to put on a table: the scale is wrong.
    #[error("expected a longest edge of 0.005 to 1 m, got {got_m} m: set `scale` (metres per unit of the file)")]
    Size {
        /// Longest edge of its box at the scale given, metres.
        got_m: f32,
    },
    /// A setting or a sidecar's field is out of range.
    #[error("{field}: expected a finite number above 0, got {got}")]
    OutOfRange {
        /// Which.
        field: &'static str,
        /// What came.
        got: f32,
    },
    /// No convex part came out of it.
    #[error("expected a body with a volume, found no convex part")]
    NoParts,
    /// Ready parts lie in a folder with several meshes, of which they can be those of one.
    #[error("expected one mesh beside ready parts, found several: give each a folder of its own with its parts")]
    PartsOfSeveral,
    /// There is no mesh in the folder.
    #[error("expected .obj, .stl or .ply files in this folder, found none")]
    NoMeshes,
}

impl MeshProblem {
    /// The error of a file.
    pub fn at(self, path: &Path) -> MeshError {
        MeshError { path: path.to_owned(), problem: self }
    }
}
