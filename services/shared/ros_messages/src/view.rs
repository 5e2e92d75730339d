//! What a camera's pictures show: its intrinsics, as a `CameraInfo` or a cloud's own points tell them, and its lens, where it bends.

use repose_proto::CameraModel;

use crate::calibration::Lens;
use crate::cdr::MessageError;
use crate::cloud::{Sight, camera_of};
use crate::frames::{SampledPoint, check_rays, model_of};
use crate::pictures::{Color, Depth};
use crate::rectify::Rectifier;
use crate::sensor::CameraInfo;

/// Whether the name of a topic of depth says that its pictures are rectified, as ROS names such topics: `image_rect`, `image_rect_raw`.
pub fn is_rectified_topic(depth_topic: &str) -> bool {
    depth_topic.split(['/', '_']).any(|word| word.starts_with("rect"))
}

/// A camera as its pictures show the world.
#[derive(Debug, Clone)]
pub struct View {
    camera: CameraModel,
    bending: Option<(Lens, Rectifier)>,
}

impl View {
    /// By intrinsics; none when those are of another size.
    ///
    /// # Errors
    /// [`MessageError::Unsupported`] for a lens that cannot be taken out.
    pub fn of(info: &CameraInfo, depth: &Depth, is_rectified: bool) -> Result<Option<Self>, MessageError> {
        let lens = if is_rectified { None } else { Lens::of(info)? };
        // Pictures that the lens has bent have the intrinsics of K; those of P are of rectified ones.
        let as_bent = CameraInfo { p: [0.0; 12], ..info.clone() };
        let info = if lens.is_some() { &as_bent } else { info };
        let Some(camera) = model_of(info, (depth.width, depth.height), depth.unit_m) else { return Ok(None) };
        let bending = lens.map(|lens| (lens, Rectifier::new(&camera, &lens)));
        Ok(Some(Self { camera, bending }))
    }

    /// By the points of a cloud.
    ///
    /// # Errors
    /// [`MessageError`] when they show no camera.
    pub fn of_points(sight: &Sight) -> Result<Self, MessageError> {
        Ok(Self { camera: camera_of(&sight.sample, (sight.depth.width, sight.depth.height))?, bending: None })
    }

    /// Whether it is of pictures of a size.
    pub fn has_size(&self, (width, height): (usize, usize)) -> bool {
        (self.camera.width, self.camera.height) == (width, height)
    }

    /// Checks that points show in their pixels.
    ///
    /// # Errors
    /// [`MessageError::NotOptical`] when they do not.
    pub fn check(&self, sample: &[SampledPoint]) -> Result<(), MessageError> {
        let Some((lens, _)) = &self.bending else { return check_rays(sample, &self.camera) };
        let bent = |at: &SampledPoint| {
            let [x, y, z] = at.point_m.map(f64::from);
            let (x, y) = lens.bent((x / z, y / z));
            SampledPoint { pixel: at.pixel, point_m: [x * z, y * z, z].map(|c| c as f32) }
        };
        check_rays(&sample.iter().map(bent).collect::<Vec<_>>(), &self.camera)
    }

    /// The pictures without what the lens bends, and the camera that they are of.
    pub fn straight(&self, depth: Depth, color: Option<Color>) -> (CameraModel, Depth, Option<Color>) {
        let camera = CameraModel { depth_unit_m: depth.unit_m, ..self.camera.clone() };
        match &self.bending {
            Some((_, rectifier)) => (camera, rectifier.depth(&depth), color.map(|color| rectifier.color(&color))),
            None => (camera, depth, color),
        }
    }
}
