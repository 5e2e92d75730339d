//! From a raw cloud to one in the networks' form: thinned, in the viewer's axes, in farthest-point order.
//!
//! The one place where this happens, for training and for serving: a cloud is thinned to one point per voxel (so that it does not matter
//! how many pixels a camera has), then ordered once by farthest point sampling; every crop takes the first n of that order.

use std::collections::BTreeMap;

use nalgebra::Point3;
use repose_geometry::{ViewerFrame, cloud};

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

/// The order of [`repose_geometry::sampling::farthest_point_order`], found faster.
///
/// A new point can only shorten the distances of points nearer to it than the farthest distance left, so after the first few points only
/// the grid cells around it are visited: about O(n log count) in place of O(n · count).
pub fn farthest_point_order(points: &[Point3<f32>], count: usize) -> Vec<u32> {
    let count = count.min(points.len());
    if count == 0 {
        return Vec::new();
    }
    let sum = points.iter().fold(nalgebra::Vector3::<f64>::zeros(), |s, p| s + p.coords.cast::<f64>());
    let mean = Point3::from((sum / points.len() as f64).cast::<f32>());
    let cells = Cells::new(points);
    let mut distance = vec![f32::INFINITY; cells.order.len()];
    // Per cell: the largest distance left and the lowest original index that has it.
    let mut farthest: Vec<(f32, u32)> = vec![(f32::INFINITY, 0); cells.count()];
    let mut next = first_largest(points.iter().map(|p| (p - mean).norm_squared()));
    let mut reach = f32::INFINITY;
    let mut result = Vec::with_capacity(count);
    loop {
        result.push(next);
        if result.len() == count {
            return result;
        }
        let chosen = points[next as usize];
        cells.for_each_near(&chosen, reach, |c| {
            let mut best = (f32::NEG_INFINITY, u32::MAX);
            for slot in cells.range(c) {
                let p = &cells.points[slot];
                let d = &mut distance[slot];
                *d = d.min((p - chosen).norm_squared());
                if cells.order[slot] == next {
                    *d = -1.0;
                }
                if *d > best.0 || (*d == best.0 && cells.order[slot] < best.1) {
                    best = (*d, cells.order[slot]);
                }
            }
            farthest[c] = best;
        });
        let best = farthest.iter().fold((f32::NEG_INFINITY, u32::MAX), |b, f| if f.0 > b.0 || (f.0 == b.0 && f.1 < b.1) { *f } else { b });
        (reach, next) = (best.0.max(0.0).sqrt(), best.1);
    }
}

fn first_largest(values: impl Iterator<Item = f32>) -> u32 {
    let mut best = (f32::NEG_INFINITY, 0);
    for (i, v) in values.enumerate() {
        if v > best.0 {
            best = (v, i as u32);
        }
    }
    best.1
}

/// Points sorted into the cells of a uniform grid, index order within a cell.
struct Cells {
    low: Point3<f32>,
    edge_m: f32,
    shape: [usize; 3],
    starts: Vec<u32>,
    order: Vec<u32>,
    points: Vec<Point3<f32>>,
}

impl Cells {
    /// About 24 points a cell, at most a few thousand cells (the largest is looked for among all of them).
    fn new(points: &[Point3<f32>]) -> Self {
        let low = points.iter().fold(points[0], |l, p| l.inf(p));
        let high = points.iter().fold(points[0], |h, p| h.sup(p));
        let extent = (high - low).map(|e| e.max(1e-6));
        // Surfaces fill about the square of what they span, not the cube.
        let wanted = (points.len() as f32 / 24.0).clamp(1.0, 1024.0);
        let edge_m = (extent.max() / wanted.sqrt()).max(1e-6);
        let shape: [usize; 3] = std::array::from_fn(|k| (extent[k] / edge_m) as usize + 1);
        let cell_of = |p: &Point3<f32>| {
            let [x, y, z]: [usize; 3] = std::array::from_fn(|k| (((p[k] - low[k]) / edge_m) as usize).min(shape[k] - 1));
            (x * shape[1] + y) * shape[2] + z
        };
        let keys: Vec<usize> = points.iter().map(cell_of).collect();
        let mut starts = vec![0u32; shape.iter().product::<usize>() + 1];
        for key in &keys {
            starts[key + 1] += 1;
        }
        for c in 1..starts.len() {
            starts[c] += starts[c - 1];
        }
        let mut fill = starts.clone();
        let mut order = vec![0u32; points.len()];
        for (i, key) in keys.iter().enumerate() {
            order[fill[*key] as usize] = i as u32;
            fill[*key] += 1;
        }
        let sorted = order.iter().map(|i| points[*i as usize]).collect();
        Self { low, edge_m, shape, starts, order, points: sorted }
    }

    fn count(&self) -> usize {
        self.starts.len() - 1
    }

    fn range(&self, cell: usize) -> std::ops::Range<usize> {
        self.starts[cell] as usize..self.starts[cell + 1] as usize
    }

    /// Calls `visit` for every cell that may hold a point within `reach` of `p`.
    fn for_each_near(&self, p: &Point3<f32>, reach: f32, mut visit: impl FnMut(usize)) {
        // One cell of slack covers the rounding of cell numbers.
        let bound = |k: usize, at: f32| ((at - self.low[k]) / self.edge_m).clamp(0.0, (self.shape[k] - 1) as f32) as usize;
        let [x, y, z]: [std::ops::RangeInclusive<usize>; 3] = std::array::from_fn(|k| {
            bound(k, p[k] - reach).saturating_sub(1)..=(bound(k, p[k] + reach) + 1).min(self.shape[k] - 1)
        });
        for x in x {
            for y in y.clone() {
                for z in z.clone() {
                    visit((x * self.shape[1] + y) * self.shape[2] + z);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_fast_order_is_the_plain_order(
            raw in prop::collection::vec(prop::array::uniform3(-1.0..1.0f32), 1..300), count in 1usize..320, flat in any::<bool>(),
        ) {
            let points: Vec<_> = raw.into_iter().map(|[x, y, z]| Point3::new(x, y, if flat { 0.0 } else { z })).collect();
            prop_assert_eq!(farthest_point_order(&points, count), repose_geometry::sampling::farthest_point_order(&points, count));
        }
    }

    #[test]
    fn duplicates_each_come_once_in_index_order() {
        let points = [Point3::new(1.0, 2.0, 3.0); 5];
        assert_eq!(farthest_point_order(&points, 5), repose_geometry::sampling::farthest_point_order(&points, 5));
    }

    #[test]
    fn turning_an_object_keeps_its_order_and_its_centroid() {
        let points: Vec<_> = (0..40).map(|i| Point3::new((i % 7) as f32 * 0.01, (i % 5) as f32 * 0.013, i as f32 * 0.002)).collect();
        let cloud = ObjectCloud::new(&points, &CloudConfig::default()).unwrap();
        let back = cloud.turned(0.7).turned(-0.7);
        assert_eq!(back.centroid_in_viewer, cloud.centroid_in_viewer);
        assert!(back.points.iter().flatten().zip(cloud.points.iter().flatten()).all(|(a, b)| (a - b).abs() < 1e-6));
    }
}
