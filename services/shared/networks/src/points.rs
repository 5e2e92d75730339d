//! From a raw cloud to one in the networks' form: thinned, in the viewer's axes, in farthest-point order.
//!
//! The one place where this happens, for training and for serving: a cloud is thinned to one point per voxel (so that it does not matter
//! how many pixels a camera has), then ordered once by farthest point sampling; every crop takes the first n of that order.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Point3, Rotation3};
use repose_geometry::{Pinhole, ViewerFrame, cloud};

use crate::sampling::farthest_point_order;

/// How clouds are prepared.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CloudConfig {
    /// Edge of the voxels that keep one (mean) point, metres. Smaller keeps more of what a near camera sees and costs time.
    pub voxel_m: f32,
    /// Points of a scene that are kept, in sampling order. Fewer starves crops of points near the candidate.
    pub scene_points: usize,
    /// Scene points farther than this from every object's centroid are left out, metres (level distance). A crop reaches 0.5 m from a
    /// candidate, and candidates lie near anchors.
    pub scene_reach_m: f32,
    /// Points of an object that are kept, in sampling order.
    pub object_points: usize,
    /// The width of the band that cleaning removes on either side of a mask's border, pixels: the same as perception's. Clouds end short of
    /// their objects by it ([`Rim`]).
    pub border_px: f32,
}

impl Default for CloudConfig {
    fn default() -> Self {
        Self { voxel_m: 0.004, scene_points: 16_384, scene_reach_m: 1.0, object_points: 512, border_px: 2.0 }
    }
}

/// The camera that observed a cloud: where it was, and how fine its pixels are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observer {
    /// The optical centre, in the axes of the points that go with it, metres.
    pub eye: Point3<f32>,
    /// What a pixel spans in the middle of the picture, radians: the inverse of the focal length in pixels.
    pub pixel_rad: f32,
}

impl Observer {
    /// A pinhole camera at its pose.
    pub fn of_camera(camera: &Pinhole, world_from_camera: &Isometry3<f64>) -> Self {
        let focal_px = 0.5 * (camera.fx + camera.fy);
        Self { eye: world_from_camera.translation.vector.cast::<f32>().into(), pixel_rad: (1.0 / focal_px) as f32 }
    }

    /// The same in turned axes.
    pub fn turned(&self, rotation: &Rotation3<f32>) -> Self {
        Self { eye: rotation * self.eye, ..*self }
    }
}

/// The band that cleaning removed from a cloud's outline: the object reaches about `width_m` farther than its cloud, across the line of
/// sight. Two touching objects show a gap of both their widths, millimetres near a camera and more than a centimetre at arm's length, so
/// gaps mean little without them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rim {
    /// How much is missing on every side, metres.
    pub width_m: f32,
    /// Unit vector from the camera to the cloud, in the cloud's axes.
    pub line_of_sight: [f32; 3],
}

impl Rim {
    fn new(centroid: &Point3<f32>, observer: &Observer, border_px: f32) -> Self {
        let line = centroid - observer.eye;
        let far_m = line.norm().max(f32::EPSILON);
        // Of the outermost pixel that is left, half lies beyond its point.
        Self { width_m: (border_px + 0.5) * observer.pixel_rad * far_m, line_of_sight: (line / far_m).into() }
    }

    /// How much farther than its cloud the object reaches in a direction (unit vector), metres.
    pub fn beyond_m(&self, direction: [f32; 3]) -> f32 {
        let along: f32 = (0..3).map(|k| direction[k] * self.line_of_sight[k]).sum();
        self.width_m * (1.0 - along * along).max(0.0).sqrt()
    }
}

/// An object's cloud: points relative to its observed centroid, in the viewer's axes, in sampling order.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectCloud {
    /// The mean of *all* observed points, in the viewer's axes (world origin).
    pub centroid_in_viewer: Point3<f32>,
    /// Up to [`CloudConfig::object_points`] points minus the centroid.
    pub points: Vec<[f32; 3]>,
    /// The band that cleaning removed from its outline.
    pub rim: Rim,
}

impl ObjectCloud {
    /// From the object's points and the camera that saw them, both in the viewer's axes; `None` without points.
    pub fn new(points_in_viewer: &[Point3<f32>], observer: &Observer, config: &CloudConfig) -> Option<Self> {
        let centroid = cloud::centroid(points_in_viewer)?;
        let thinned = cloud::voxel_downsampled(points_in_viewer, config.voxel_m);
        let order = farthest_point_order(&thinned, config.object_points);
        let points = order.iter().map(|i| (thinned[*i as usize].cast::<f64>() - centroid).cast::<f32>().into()).collect();
        let centroid_in_viewer = centroid.cast();
        Some(Self { centroid_in_viewer, points, rim: Rim::new(&centroid_in_viewer, observer, config.border_px) })
    }

    /// The same cloud turned counter-clockwise about z through its centroid. The sampling order does not change.
    pub fn turned(&self, yaw_rad: f32) -> Self {
        if yaw_rad == 0.0 {
            return self.clone();
        }
        let rim = Rim { line_of_sight: turned(&[self.rim.line_of_sight], yaw_rad)[0], ..self.rim };
        Self { centroid_in_viewer: self.centroid_in_viewer, points: turned(&self.points, yaw_rad), rim }
    }

    /// Lowest and highest coordinates relative to the centroid.
    pub fn bounds(&self) -> [[f32; 3]; 2] {
        self.points.iter().fold([[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]], |[low, high], p| {
            [std::array::from_fn(|k| low[k].min(p[k])), std::array::from_fn(|k| high[k].max(p[k]))]
        })
    }
}

/// Points turned counter-clockwise about z through the origin.
pub fn turned(points: &[[f32; 3]], yaw_rad: f32) -> Vec<[f32; 3]> {
    let (sin, cos) = yaw_rad.sin_cos();
    points.iter().map(|[x, y, z]| [cos * x - sin * y, sin * x + cos * y, *z]).collect()
}

/// A scene's cloud with labels, in the viewer's axes (world origin), in sampling order.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SceneCloud {
    /// Points in sampling order.
    pub points: Vec<[f32; 3]>,
    /// The label of each point's voxel (0 = not an object).
    pub labels: Vec<u16>,
}

impl SceneCloud {
    /// From labelled points in the viewer's axes, near `centers` (the objects' centroids; none means everywhere).
    ///
    /// Voxels are formed per label, so that a mean never mixes an object with what it stands on.
    pub fn new(points_in_viewer: &[Point3<f32>], labels: &[u16], centers: &[Point3<f32>], config: &CloudConfig) -> Self {
        let reach = config.scene_reach_m * config.scene_reach_m;
        let near = |p: &Point3<f32>| centers.is_empty() || centers.iter().any(|c| (p.xy() - c.xy()).norm_squared() <= reach);
        let mut by_label: BTreeMap<u16, Vec<Point3<f32>>> = BTreeMap::new();
        for (p, label) in points_in_viewer.iter().zip(labels).filter(|(p, _)| near(p)) {
            by_label.entry(*label).or_default().push(*p);
        }
        let mut thinned = Vec::new();
        let mut thinned_labels = Vec::new();
        for (label, points) in &by_label {
            thinned.extend(cloud::voxel_downsampled(points, config.voxel_m));
            thinned_labels.resize(thinned.len(), *label);
        }
        let order = farthest_point_order(&thinned, config.scene_points);
        Self {
            points: order.iter().map(|i| thinned[*i as usize].into()).collect(),
            labels: order.iter().map(|i| thinned_labels[*i as usize]).collect(),
        }
    }

    /// The same order without the points of one object.
    pub fn without(&self, label: u16) -> Self {
        let keep = |i: &usize| self.labels[*i] != label;
        Self {
            points: (0..self.points.len()).filter(keep).map(|i| self.points[i]).collect(),
            labels: self.labels.iter().copied().filter(|l| *l != label).collect(),
        }
    }
}

/// World points in the viewer's axes.
pub fn in_viewer(points_in_world: &[Point3<f32>], view_yaw_rad: f64) -> Vec<Point3<f32>> {
    ViewerFrame::from_yaw(view_yaw_rad).points_in_viewer(points_in_world)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A camera a metre off, on the left and above.
    pub(crate) fn observer() -> Observer {
        Observer { eye: Point3::new(-0.5, -0.7, 0.5), pixel_rad: 0.002 }
    }

    #[test]
    fn turning_an_object_keeps_its_order_and_its_centroid() {
        let points: Vec<_> = (0..40).map(|i| Point3::new((i % 7) as f32 * 0.01, (i % 5) as f32 * 0.013, i as f32 * 0.002)).collect();
        let cloud = ObjectCloud::new(&points, &observer(), &CloudConfig::default()).unwrap();
        let back = cloud.turned(0.7).turned(-0.7);
        assert_eq!(back.centroid_in_viewer, cloud.centroid_in_viewer);
        assert!(back.points.iter().flatten().zip(cloud.points.iter().flatten()).all(|(a, b)| (a - b).abs() < 1e-6));
    }

    #[test]
    fn the_rim_is_as_wide_as_the_removed_pixels_and_half_a_pixel_across_the_line_of_sight() {
        let config = CloudConfig { border_px: 3.0, ..CloudConfig::default() };
        let observer = Observer { eye: Point3::new(0.0, -2.0, 0.0), pixel_rad: 0.002 };
        let cloud = ObjectCloud::new(&[Point3::origin()], &observer, &config).unwrap();
        assert!((cloud.rim.width_m - 0.014).abs() < 1e-6);
        assert!((cloud.rim.beyond_m([1.0, 0.0, 0.0]) - 0.014).abs() < 1e-6 && cloud.rim.beyond_m([0.0, 1.0, 0.0]) < 1e-6);
        // After a quarter turn, the side that faced the camera faces right.
        let turned = cloud.turned(std::f32::consts::FRAC_PI_2).rim;
        assert!(turned.beyond_m([1.0, 0.0, 0.0]) < 1e-5 && (turned.beyond_m([0.0, 1.0, 0.0]) - 0.014).abs() < 1e-6);
        // The same camera in turned axes sees the same.
        let quarter = Rotation3::from_axis_angle(&nalgebra::Vector3::z_axis(), std::f32::consts::FRAC_PI_2);
        assert!((quarter * observer.eye - observer.turned(&quarter).eye).norm() < 1e-6);
    }
}
