//! From a raw cloud to one in the networks' form: thinned, in the viewer's axes, in farthest-point order.
//!
//! The one place where this happens, for training and for serving: a cloud is thinned to one point per voxel (so that it does not matter
//! how many pixels a camera has), then ordered once by farthest point sampling; every crop takes the first n of that order.

use std::collections::BTreeMap;

use nalgebra::Point3;
use repose_geometry::{ViewerFrame, cloud};

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
}

impl Default for CloudConfig {
    fn default() -> Self {
        Self { voxel_m: 0.004, scene_points: 16_384, scene_reach_m: 1.0, object_points: 512 }
    }
}

/// An object's cloud: points relative to its observed centroid, in the viewer's axes, in sampling order.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectCloud {
    /// The mean of *all* observed points, in the viewer's axes (world origin).
    pub centroid_in_viewer: Point3<f32>,
    /// Up to [`CloudConfig::object_points`] points minus the centroid.
    pub points: Vec<[f32; 3]>,
}

impl ObjectCloud {
    /// From the object's points in the viewer's axes; `None` without points.
    pub fn new(points_in_viewer: &[Point3<f32>], config: &CloudConfig) -> Option<Self> {
        let centroid = cloud::centroid(points_in_viewer)?;
        let thinned = cloud::voxel_downsampled(points_in_viewer, config.voxel_m);
        let order = farthest_point_order(&thinned, config.object_points);
        let points = order.iter().map(|i| (thinned[*i as usize].cast::<f64>() - centroid).cast::<f32>().into()).collect();
        Some(Self { centroid_in_viewer: centroid.cast(), points })
    }

    /// The same cloud turned counter-clockwise about z through its centroid. The sampling order does not change.
    pub fn turned(&self, yaw_rad: f32) -> Self {
        if yaw_rad == 0.0 {
            return self.clone();
        }
        Self { centroid_in_viewer: self.centroid_in_viewer, points: turned(&self.points, yaw_rad) }
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
mod tests {
    use super::*;

    #[test]
    fn turning_an_object_keeps_its_order_and_its_centroid() {
        let points: Vec<_> = (0..40).map(|i| Point3::new((i % 7) as f32 * 0.01, (i % 5) as f32 * 0.013, i as f32 * 0.002)).collect();
        let cloud = ObjectCloud::new(&points, &CloudConfig::default()).unwrap();
        let back = cloud.turned(0.7).turned(-0.7);
        assert_eq!(back.centroid_in_viewer, cloud.centroid_in_viewer);
        assert!(back.points.iter().flatten().zip(cloud.points.iter().flatten()).all(|(a, b)| (a - b).abs() < 1e-6));
    }
}
