//! The depth picture that a scene's points make: what the camera read in the direction of a place.

use nalgebra::{Isometry3, Point3};
use repose_geometry::transform::from_row_major;
use repose_geometry::{Image, Pinhole};
use repose_proto::Scene;

/// Where a direction has no reading of its own, the nearest one is taken that is at most half a column of a picture of so many columns away: the points
/// of a scene are fewer than its camera's pixels, and a place falls between them.
const COLUMNS: usize = 160;
/// What is read this much nearer than a place covers it, and what is read as much farther is behind it, metres.
const CLEAR_M: f64 = 0.02;
/// Of something low, what is behind it is read sooner: this share of its height farther along the ray. The rest is for where its points really were.
const OF_HEIGHT: f64 = 0.5;
/// A reading is not told from a place that is nearer than so many of its standard deviations, …
const DEVIATIONS: f64 = 3.0;
/// … or than this, metres.
const LEAST_M: f64 = 0.004;
/// The standard deviation of a reading at a depth of a metre, metres; it grows with the square of the depth.
const NOISE_M: f64 = 0.0018;

/// The picture.
pub struct DepthPicture {
    camera: Pinhole,
    camera_from_world: Isometry3<f64>,
    /// How high the camera is in the world, metres.
    eye_z_m: f64,
    /// Along the optical axis, metres; 0 without a reading.
    depth_m: Image<f32>,
    /// How far from a direction a reading may be taken for it, pixels.
    reach_px: usize,
}

impl DepthPicture {
    /// The picture of a scene; none where its camera has no rigid pose.
    pub fn of(scene: &Scene) -> Option<Self> {
        let model = &scene.meta.camera;
        let world_from_camera = from_row_major(&model.world_from_camera?.0).ok()?;
        let camera_from_world = world_from_camera.inverse();
        let camera = Pinhole { width: model.width, height: model.height, fx: model.fx, fy: model.fy, cx: model.cx, cy: model.cy };
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
        let reach_px = camera.width.div_ceil(COLUMNS) / 2;
        Some(Self { camera, camera_from_world, eye_z_m: world_from_camera.translation.vector.z, depth_m, reach_px })
    }

    /// Whether something nearer than a place (world frame) was read in its direction; none where nothing was, or the place is not in the picture.
    pub fn is_covered(&self, place: &Point3<f64>) -> Option<bool> {
        let (_, farther_m) = self.read(place)?;
        Some(farther_m < -CLEAR_M)
    }

    /// Whether what is behind a place (world frame) was read in its direction, so that nothing is there any more of an object of some height that was;
    /// none where nothing was read, or the place is not in the picture.
    pub fn is_empty(&self, place: &Point3<f64>, height_m: f64) -> Option<bool> {
        let (depth_m, farther_m) = self.read(place)?;
        let down_per_depth = (self.eye_z_m - place.z).max(0.0) / depth_m;
        let noise_m = (DEVIATIONS * NOISE_M * depth_m.powi(2)).max(LEAST_M);
        // A level ray comes down nowhere: infinity or, without a height, NaN, which `max` passes over.
        let behind_m = (OF_HEIGHT * height_m / down_per_depth).max(noise_m).min(CLEAR_M);
        Some(farther_m > behind_m)
    }

    /// The depth of a place, and how much farther what was read in its direction is, metres.
    fn read(&self, place: &Point3<f64>) -> Option<(f64, f64)> {
        let in_camera = self.camera_from_world * place;
        let read_m = self.nearest_reading_m(self.camera.pixel_of(&in_camera)?)?;
        Some((in_camera.z, read_m - in_camera.z))
    }

    /// The reading nearest to a pixel (column, row), the nearer to the camera of two.
    fn nearest_reading_m(&self, (u, v): (usize, usize)) -> Option<f64> {
        let around = |at: usize, end: usize| at.saturating_sub(self.reach_px)..(at + self.reach_px + 1).min(end);
        let pixels = around(v, self.camera.height).flat_map(|row| around(u, self.camera.width).map(move |column| (column, row)));
        let apart = |(column, row): (usize, usize)| column.abs_diff(u).pow(2) + row.abs_diff(v).pow(2);
        let readings = pixels.map(|at| (apart(at), self.depth_m[at])).filter(|(_, depth_m)| *depth_m > 0.0);
        readings.min_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1))).map(|(_, depth_m)| f64::from(depth_m))
    }
}

#[cfg(test)]
mod tests {
    use repose_made_scenes::seen_from_above;
    use repose_proto::CameraModel;

    use super::*;

    /// The floor below the camera, which looks straight down from a metre above it, and in the pixel beside it something 30 cm high.
    fn picture() -> DepthPicture {
        let mut scene = seen_from_above(&[([0.0, 0.0, 0.0], 0), ([0.0014, 0.0, 0.3], 1)]);
        scene.meta.camera = CameraModel { width: 480, height: 360, fx: 500.0, fy: 500.0, cx: 240.0, cy: 180.0, ..scene.meta.camera };
        DepthPicture::of(&scene).expect("a pose")
    }

    #[test]
    fn the_place_of_something_low_is_empty_once_the_ground_is_read_there() {
        let is_empty = |height_m: f64, z_m: f64| picture().is_empty(&Point3::new(0.0, 0.0, z_m), height_m);
        assert_eq!(is_empty(0.009, 0.009), Some(true));
        assert_eq!(is_empty(0.0, 0.009), Some(true), "of what lies flat the top alone may be seen");
        assert_eq!(is_empty(0.004, 0.004), Some(false), "a camera errs by as much");
        assert_eq!(is_empty(0.05, 0.015), Some(false), "it may stand a little lower than it was to");
        assert_eq!(is_empty(0.05, 0.03), Some(true));
    }

    #[test]
    fn a_place_is_told_by_the_reading_nearest_to_its_direction() {
        // 9 mm above the floor; pixels 239 to 242 of the row.
        let told = |x_m: f64| {
            let place = Point3::new(x_m, 0.0, 0.009);
            (picture().is_covered(&place), picture().is_empty(&place, 0.009))
        };
        assert_eq!(told(0.0), (Some(false), Some(true)), "not by what stands beside it");
        assert_eq!(told(-0.00198), (Some(false), Some(true)), "the floor is the nearest");
        assert_eq!(told(0.00198), (Some(true), Some(false)));
        assert_eq!(told(0.00396), (Some(true), Some(false)));
        assert_eq!(told(0.1), (None, None), "nothing was read there");
    }
}
