//! The depth picture that a scene's points make, coarse: what the camera read in the direction of a place.

use nalgebra::{Isometry3, Point3};
use repose_geometry::transform::from_row_major;
use repose_geometry::{Image, Pinhole};
use repose_proto::Scene;

/// Columns of the picture at most.
const COLUMNS: usize = 160;
/// What is read this much nearer or farther than a place is not at that place, metres.
const THERE_M: f64 = 0.02;

/// How the depth reading in the direction of a place compares with the place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum DepthComparison {
    /// Nothing, or the place is not in the picture.
    None,
    /// Something nearer.
    Before,
    /// Something at the place.
    There,
    /// Something farther: the place is empty.
    Behind,
}

/// The picture.
pub struct DepthPicture {
    camera: Pinhole,
    camera_from_world: Isometry3<f64>,
    /// Along the optical axis, metres; 0 without a reading.
    depth_m: Image<f32>,
}

impl DepthPicture {
    /// The picture of a scene; none where its camera has no rigid pose.
    pub fn of(scene: &Scene) -> Option<Self> {
        let model = &scene.meta.camera;
        let camera_from_world = from_row_major(&model.world_from_camera?.0).ok()?.inverse();
        let whole = Pinhole { width: model.width, height: model.height, fx: model.fx, fy: model.fy, cx: model.cx, cy: model.cy };
        let camera = whole.shrunk(COLUMNS);
        let mut depth_m = Image::filled(camera.width, camera.height, 0.0f32);
        for point in &scene.points {
            let in_camera = camera_from_world * Point3::from(*point).cast::<f64>();
            if let Some(at) = camera.pixel_of(&in_camera) {
                let (known, depth) = (&mut depth_m[at], in_camera.z as f32);
                if *known == 0.0 || depth < *known {
                    *known = depth;
                }
            }
        }
        Some(Self { camera, camera_from_world, depth_m })
    }

    /// What was read in the direction of a place (world frame).
    pub fn reading(&self, place: &Point3<f64>) -> DepthComparison {
        let in_camera = self.camera_from_world * place;
        let depth_m = self.camera.pixel_of(&in_camera).map_or(0.0, |at| f64::from(self.depth_m[at]));
        match depth_m - in_camera.z {
            _ if depth_m == 0.0 => DepthComparison::None,
            farther_m if farther_m < -THERE_M => DepthComparison::Before,
            farther_m if farther_m > THERE_M => DepthComparison::Behind,
            _ => DepthComparison::There,
        }
    }
}
