//! A segmented scene.

use std::sync::{Arc, OnceLock};

use pyo3::prelude::*;
use pyo3::types::PyBytes;
use repose_proto::Bulk;

use crate::error::{pretty, raised};
use crate::frame::Frame;

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
    /// Segments a frame.
    #[staticmethod]
    fn of_frame(py: Python<'_>, frame: &Frame) -> PyResult<Self> {
        py.detach(|| repose_local::scene_of(&frame.frame)).map(Self::of).map_err(raised)
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
