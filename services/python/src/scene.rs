//! A segmented scene.

use std::path::PathBuf;
use std::sync::{Arc, OnceLock};

use pyo3::prelude::*;
use pyo3::types::PyBytes;
use repose_proto::{Bulk, CallError, CameraModel, Frame, RigidTransform};

use crate::error::{pretty, raised};

/// A scene with its id.
#[pyclass(frozen, module = "repose._native")]
pub struct Scene {
    pub scene: Arc<repose_proto::Scene>,
    id: OnceLock<String>,
}

impl Scene {
    pub fn of(scene: repose_proto::Scene) -> Self {
        Self { scene: Arc::new(scene), id: OnceLock::new() }
    }

    /// The scene's id, computed once.
    pub fn scene_id(&self) -> &str {
        self.id.get_or_init(|| self.scene.id())
    }
}

#[pymethods]
impl Scene {
    /// Segments a frame. Images are row-major bytes: depth and labels 16-bit in native order, color 8-bit RGB.
    #[staticmethod]
    #[pyo3(signature = (depth, size, intrinsics, depth_unit_m, color, labels, world_from_camera, camera, stamp_ns))]
    #[expect(clippy::too_many_arguments, reason = "named arguments of a function that only the package's own Python calls")]
    fn from_rgbd(
        py: Python<'_>,
        depth: &[u8],
        size: (usize, usize),
        intrinsics: [f64; 4],
        depth_unit_m: f64,
        color: Option<&[u8]>,
        labels: Option<&[u8]>,
        world_from_camera: Option<[f64; 16]>,
        camera: &str,
        stamp_ns: u64,
    ) -> PyResult<Self> {
        let (width, height) = size;
        let [fx, fy, cx, cy] = intrinsics;
        let world_from_camera = world_from_camera.map(RigidTransform);
        let segmented = py.detach(|| {
            repose_proto::keys::validate_chunk("camera", camera)?;
            let model = CameraModel { width, height, fx, fy, cx, cy, depth_unit_m, world_from_camera };
            let frame = Frame {
                color: color.map(|bytes| bytes.as_chunks::<3>().0.to_vec()),
                labels: labels.map(words),
                ..Frame::new(camera.to_owned(), stamp_ns, model, words(depth))
            };
            repose_local::scene_of(&frame)
        });
        segmented.map(Self::of).map_err(raised)
    }

    /// Reads a frame folder and segments it.
    #[staticmethod]
    fn from_folder(py: Python<'_>, folder: PathBuf, ignore_labels: bool) -> PyResult<Self> {
        let segmented = py.detach(|| {
            let mut frame = repose_perception::frame_folder::read(&folder)
                .map_err(|e| CallError::invalid(e.path().display().to_string(), e.to_string()))?;
            if ignore_labels {
                frame.labels = None;
            }
            repose_local::scene_of(&frame)
        });
        segmented.map(Self::of).map_err(raised)
    }

    /// Reads the bulk form.
    #[staticmethod]
    fn from_bytes(py: Python<'_>, bytes: &[u8]) -> PyResult<Self> {
        py.detach(|| repose_proto::Scene::from_bulk(&Bulk::decode(bytes)?)).map(Self::of).map_err(raised)
    }

    /// The bulk form.
    fn to_bytes<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        let bytes = py.detach(|| self.scene.to_bulk().encode());
        PyBytes::new(py, &bytes)
    }

    #[getter]
    fn id(&self, py: Python<'_>) -> String {
        py.detach(|| self.scene_id().to_owned())
    }

    #[getter]
    fn camera(&self) -> &str {
        &self.scene.camera_name
    }

    #[getter]
    fn stamp_ns(&self) -> u64 {
        self.scene.stamp_ns
    }

    /// All of the scene but its points.
    fn meta(&self) -> PyResult<String> {
        pretty(&self.scene.meta)
    }

    /// Points, f32 [n, 3] in native order.
    fn points<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        let bytes: Vec<u8> = self.scene.points.iter().flatten().flat_map(|v| v.to_ne_bytes()).collect();
        PyBytes::new(py, &bytes)
    }

    /// Labels, u16 [n] in native order.
    fn labels<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        let bytes: Vec<u8> = self.scene.labels.iter().flat_map(|v| v.to_ne_bytes()).collect();
        PyBytes::new(py, &bytes)
    }

    /// Colors, u8 [n, 3].
    fn colors<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyBytes>> {
        self.scene.colors.as_ref().map(|colors| PyBytes::new(py, colors.as_flattened()))
    }
}

fn words(bytes: &[u8]) -> Vec<u16> {
    bytes.as_chunks::<2>().0.iter().map(|b| u16::from_ne_bytes(*b)).collect()
}
