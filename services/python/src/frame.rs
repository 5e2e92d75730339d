//! One RGB-D picture.

use std::path::PathBuf;
use std::sync::Arc;

use pyo3::prelude::*;
use repose_proto::message::from_json;
use repose_proto::{CallError, CameraModel, RigidTransform};

use crate::error::raised;

/// A frame whose images have the camera's size.
#[pyclass(frozen, module = "repose._native")]
pub struct Frame {
    pub frame: Arc<repose_proto::Frame>,
}

#[pymethods]
impl Frame {
    /// Images are row-major bytes: depth and labels 16-bit in native order, color 8-bit RGB. `robots` is JSON: a list of `RobotInView`.
    #[new]
    #[pyo3(signature = (depth, size, intrinsics, depth_unit_m, color, labels, world_from_camera, camera, stamp_ns, robots))]
    #[expect(clippy::too_many_arguments, reason = "named arguments of a function that only the package's own Python calls")]
    fn new(
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
        robots: Option<&str>,
    ) -> PyResult<Self> {
        let (width, height) = size;
        let [fx, fy, cx, cy] = intrinsics;
        let world_from_camera = world_from_camera.map(RigidTransform);
        let frame = py.detach(|| {
            repose_proto::keys::validate_chunk("camera", camera)?;
            let model = CameraModel { width, height, fx, fy, cx, cy, depth_unit_m, world_from_camera };
            let robots = robots.map_or(Ok(Vec::new()), |text| from_json(text.as_bytes()).map_err(|e: CallError| e.at("robots")))?;
            let frame = repose_proto::Frame {
                color: color.map(|bytes| bytes.as_chunks::<3>().0.to_vec()),
                labels: labels.map(words),
                robots,
                ..repose_proto::Frame::new(camera.to_owned(), stamp_ns, model, words(depth))
            };
            frame.validate()?;
            Ok(frame)
        });
        Ok(Self { frame: Arc::new(frame.map_err(raised)?) })
    }

    /// Reads a frame folder.
    #[staticmethod]
    fn from_folder(py: Python<'_>, folder: PathBuf, ignore_labels: bool) -> PyResult<Self> {
        let frame = py.detach(|| {
            let mut frame = repose_perception::frame_folder::read(&folder)
                .map_err(|e| CallError::invalid(e.path().display().to_string(), e.to_string()))?;
            if ignore_labels {
                frame.labels = None;
            }
            Ok(frame)
        });
        Ok(Self { frame: Arc::new(frame.map_err(raised)?) })
    }

    /// The same picture under a camera's name and with its time.
    fn named(&self, camera: &str, stamp_ns: u64) -> PyResult<Self> {
        repose_proto::keys::validate_chunk("camera", camera).map_err(raised)?;
        let frame = repose_proto::Frame { camera_name: camera.to_owned(), stamp_ns, ..(*self.frame).clone() };
        Ok(Self { frame: Arc::new(frame) })
    }

    #[getter]
    fn camera(&self) -> &str {
        &self.frame.camera_name
    }

    #[getter]
    fn stamp_ns(&self) -> u64 {
        self.frame.stamp_ns
    }

    /// Width and height, pixels.
    #[getter]
    fn size(&self) -> (usize, usize) {
        (self.frame.camera.width, self.frame.camera.height)
    }
}

fn words(bytes: &[u8]) -> Vec<u16> {
    bytes.as_chunks::<2>().0.iter().map(|b| u16::from_ne_bytes(*b)).collect()
}
