//! The scene's points: every reading outside the border bands, thinned evenly where there are too many.

use repose_geometry::{Isometry3, Vector3};

use crate::masks::clean::CleanMasks;
use crate::readings::depth::DepthMap;

/// Points in the picture's order.
#[derive(Debug)]
pub struct Cloud {
    /// Points, world frame, metres.
    pub points: Vec<[f32; 3]>,
    /// The object of each point, 0 = none.
    pub labels: Vec<u16>,
    /// The color of each point.
    pub colors: Option<Vec<[u8; 3]>>,
}

impl Cloud {
    /// Every reading outside the bands of the masks; at most `max_points`.
    pub fn new(
        depth: &DepthMap,
        world_from_camera: &Isometry3<f64>,
        masks: &CleanMasks,
        colors: Option<&[[u8; 3]]>,
        max_points: usize,
    ) -> Self {
        let depths = depth.depth_m().pixels();
        let (labels, band) = (masks.labels.pixels(), masks.band.pixels());
        let available = masks.available;
        let wanted = available.min(max_points);

        // Every pixel is written, and the end moves on behind those that stay: no branch to guess wrong at every outline. The last
        // pixel that does not stay needs a place, too.
        let mut points = vec![[0f32; 3]; wanted + 1];
        let mut ids = vec![0u16; wanted + 1];
        let mut pixels = vec![0u32; wanted + 1];
        let mut end = 0;
        let mut owed = 0;
        let to_world = RaysToWorld::new(world_from_camera);
        let width = depth.width();
        for (v, y) in depth.slope_y().iter().enumerate() {
            let row = v * width..(v + 1) * width;
            let of_row = to_world.row(*y);
            let (depths, labels, band) = (&depths[row.clone()], &labels[row.clone()], &band[row.clone()]);
            for (u, (((z, &id), banded), x)) in depths.iter().zip(labels).zip(band).zip(depth.slope_x()).enumerate() {
                let stays = !z.is_nan() & !banded;
                // Of `available` points take `wanted`, as evenly as integers allow.
                owed += if stays { wanted } else { 0 };
                let taken = stays & (owed >= available);
                owed -= if taken { available } else { 0 };
                points[end] = of_row.point(*x, *z);
                ids[end] = id;
                pixels[end] = (row.start + u) as u32;
                end += usize::from(taken);
            }
        }
        points.truncate(end);
        ids.truncate(end);
        let colors = colors.map(|colors| pixels[..end].iter().map(|i| colors[*i as usize]).collect());
        Self { points, labels: ids, colors }
    }
}

/// A camera's pose, applied to rays: the rotated ray of a pixel is linear in its slopes.
struct RaysToWorld {
    x: Vector3<f32>,
    y: Vector3<f32>,
    z: Vector3<f32>,
    origin: Vector3<f32>,
}

/// The part of it that a row shares.
struct RowToWorld {
    x: Vector3<f32>,
    forward: Vector3<f32>,
    origin: Vector3<f32>,
}

impl RaysToWorld {
    fn new(world_from_camera: &Isometry3<f64>) -> Self {
        let rotation = world_from_camera.rotation.to_rotation_matrix().into_inner().cast::<f32>();
        let axis = |k: usize| rotation.column(k).into_owned();
        Self { x: axis(0), y: axis(1), z: axis(2), origin: world_from_camera.translation.vector.cast() }
    }

    fn row(&self, slope_y: f32) -> RowToWorld {
        RowToWorld { x: self.x, forward: self.y * slope_y + self.z, origin: self.origin }
    }
}

impl RowToWorld {
    fn point(&self, slope_x: f32, depth_m: f32) -> [f32; 3] {
        (self.origin + (self.x * slope_x + self.forward) * depth_m).into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Settings;
    use proptest::prelude::*;
    use repose_geometry::{Image, Pinhole, Point3};

    proptest! {
        #[test]
        fn points_are_the_readings_moved_by_the_cameras_pose(
            axis_angle in prop::array::uniform3(-2.0..2.0f64), shift in prop::array::uniform3(-3.0..3.0f64), counts in prop::collection::vec(0u16..4000, 20),
        ) {
            let camera = Pinhole { width: 5, height: 4, fx: 6.0, fy: 7.0, cx: 2.2, cy: 1.4 };
            let world_from_camera = Isometry3::new(Vector3::from(shift), Vector3::from(axis_angle));
            let depth = DepthMap::new(&counts, 0.001, &camera, 5.0);
            let masks = CleanMasks::new(Image::filled(5, 4, 0), std::collections::BTreeMap::new(), depth.depth_m(), &Settings::default());
            prop_assume!(masks.is_some());
            let cloud = Cloud::new(&depth, &world_from_camera, &masks.unwrap(), None, 1000);
            let seen = counts.iter().enumerate().filter(|(_, count)| **count > 0);
            let expected: Vec<Point3<f64>> =
                seen.map(|(i, count)| world_from_camera * camera.unproject((i % 5) as f64, (i / 5) as f64, f64::from(*count) * 0.001)).collect();
            prop_assert_eq!(cloud.points.len(), expected.len());
            for (p, q) in cloud.points.iter().zip(&expected) {
                prop_assert!((Point3::from(*p).cast::<f64>() - q).norm() < 2e-5);
            }
        }
    }
}
