//! The picture on which supports and objects are found: coarse enough to be searched.

use repose_geometry::{Image, Isometry3, Pinhole, Point3};

use crate::readings::point_map::{PointMap, strided, transformed};
use crate::readings::upward;
use crate::settings::Settings;

/// A picture with its points in both frames, as those see it who tell objects apart by geometry.
pub struct CoarseView<'a> {
    /// Points in the camera frame.
    pub in_camera: &'a PointMap,
    /// The same points in the world.
    pub in_world: &'a PointMap,
    /// Which of them face up.
    pub faces_up: &'a Image<bool>,
    /// Focal length of this picture, pixels.
    pub focal_px: f32,
    /// The camera's height in the world, metres.
    pub camera_m: f32,
}

/// The coarse picture of a frame.
#[derive(Debug, Clone)]
pub struct CoarsePicture {
    /// The camera of the whole picture.
    pub of_full: Pinhole,
    /// Its pose.
    pub world_from_camera: Isometry3<f64>,
    /// How many columns of the whole picture make one of this.
    pub stride: usize,
    /// The camera of this picture.
    pub camera: Pinhole,
    /// Points in the camera frame.
    pub in_camera: PointMap,
    /// The same points in the world.
    pub in_world: PointMap,
    /// Depth, NaN where there is no reading.
    pub depth_m: Image<f32>,
    /// Which pixels show something that faces up.
    pub faces_up: Image<bool>,
}

impl CoarsePicture {
    /// From every `stride`-th pixel of `camera`'s picture.
    pub fn new(in_camera: PointMap, world_from_camera: &Isometry3<f64>, camera: &Pinhole, stride: usize, settings: &Settings) -> Self {
        let scale = stride as f64;
        let of_full = *camera;
        let camera = Pinhole {
            width: in_camera.width(),
            height: in_camera.height(),
            fx: camera.fx / scale,
            fy: camera.fy / scale,
            cx: camera.cx / scale,
            cy: camera.cy / scale,
        };
        let in_world = transformed(&in_camera, world_from_camera);
        let depth_m = in_camera.map(|p| p.z);
        let faces_up = upward::upward_facing(&in_world, &depth_m, camera.fx as f32, settings.surfaces.max_tilt_rad);
        Self { of_full, world_from_camera: *world_from_camera, stride, camera, in_camera, in_world, depth_m, faces_up }
    }

    /// What geometry looks at.
    pub fn view(&self) -> CoarseView<'_> {
        CoarseView {
            in_camera: &self.in_camera,
            in_world: &self.in_world,
            faces_up: &self.faces_up,
            focal_px: self.camera.fx as f32,
            camera_m: self.world_from_camera.translation.z as f32,
        }
    }

    /// Readings that were taken out of the whole picture since, `depth_m`, are of no surface: this one holds every `stride`-th of its pixels.
    pub fn leave_out_unread(&mut self, depth_m: &Image<f32>) {
        let left = strided(depth_m, self.stride);
        self.faces_up.pixels_mut().iter_mut().zip(left.pixels()).for_each(|(up, z)| *up &= !z.is_nan());
    }

    /// The points that face up, with the label of their pixel; pixels without one are left out.
    pub fn upward(&self, label: impl Fn(usize) -> Option<u16>) -> impl Iterator<Item = (Point3<f32>, u16)> {
        let facing = self.faces_up.pixels().iter().enumerate().filter(|(_, up)| **up);
        facing.filter_map(move |(i, _)| Some((self.in_world.pixels()[i], label(i)?)))
    }
}
