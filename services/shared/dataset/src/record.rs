//! One view of one scene, in memory and in the JSON part of a shard.

use nalgebra::Isometry3;
use repose_geometry::{OrientedBox, Pinhole};

/// One step of stored depth, metres. `u16` then reaches 6.5 m.
pub const DEPTH_UNIT_M: f32 = 1e-4;

/// How many relations a pair has, in wire order: `left_of right_of in_front_of behind above below near touching centered aligned`.
pub const RELATIONS: usize = 10;

/// A depth picture cropped to the rectangle that it fills.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Layer {
    /// Column of the rectangle's left edge in the full picture.
    pub x0: u32,
    /// Row of the rectangle's upper edge in the full picture.
    pub y0: u32,
    /// Columns of the rectangle.
    pub width: u32,
    /// Rows of the rectangle.
    pub height: u32,
    /// Depth along the optical axis in [`DEPTH_UNIT_M`], row-major `[height, width]`, 0 = nothing.
    pub depth: Vec<u16>,
}

impl Layer {
    /// Crops and quantises a full picture of depth in metres, row-major `[rows, columns]`. Zero, NaN, infinite, negative, and what lies
    /// beyond 6.5 m is nothing. `columns` must not be 0 when there are pixels.
    pub fn from_depth_m(depth_m: &[f32], columns: usize) -> Self {
        let quantised = |z: f32| {
            let steps = (z / DEPTH_UNIT_M).round();
            if (1.0..=f32::from(u16::MAX)).contains(&steps) { steps as u16 } else { 0 }
        };
        let (mut x0, mut y0, mut x1, mut y1) = (usize::MAX, usize::MAX, 0, 0);
        for (i, _) in depth_m.iter().enumerate().filter(|(_, z)| quantised(**z) > 0) {
            let (x, y) = (i % columns, i / columns);
            (x0, y0, x1, y1) = (x0.min(x), y0.min(y), x1.max(x + 1), y1.max(y + 1));
        }
        if x0 >= x1 {
            return Self::default();
        }
        let depth = (y0..y1).flat_map(|y| (x0..x1).map(move |x| y * columns + x)).map(|i| quantised(depth_m[i])).collect();
        Self { x0: x0 as u32, y0: y0 as u32, width: (x1 - x0) as u32, height: (y1 - y0) as u32, depth }
    }

    /// The filled pixels as (column, row, depth in [`DEPTH_UNIT_M`]), row by row.
    pub fn pixels(&self) -> impl Iterator<Item = (u32, u32, u16)> + '_ {
        let width = self.width.max(1);
        self.depth.iter().enumerate().filter(|(_, d)| **d > 0).map(move |(i, d)| {
            let i = i as u32;
            (self.x0 + i % width, self.y0 + i / width, *d)
        })
    }

    /// How many pixels are filled.
    pub fn count(&self) -> usize {
        self.depth.iter().filter(|d| **d > 0).count()
    }
}

/// An object seen alone by the same camera, before it was brought to where it stands.
#[derive(Debug, Clone, PartialEq)]
pub struct Elsewhere {
    /// The object alone, at the earlier pose.
    pub layer: Layer,
    /// The motion that carries the earlier pose to the one in the scene: a turn about world z and a translation.
    pub placed_from_elsewhere: Isometry3<f64>,
}

/// One movable object of a view.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectRecord {
    /// The instance id, from 1; unique in the view.
    pub id: u16,
    /// What it is (`mug`, `box`, …).
    pub name: String,
    /// True pose.
    pub world_from_object: Isometry3<f64>,
    /// True object-oriented box, in the world.
    pub bounds: OrientedBox,
    /// The object alone, where it stands: what the camera would see without anything else.
    pub alone: Layer,
    /// The object alone, somewhere else (random offset within the view, random yaw); what the moved clouds are made from.
    pub elsewhere: Option<Elsewhere>,
}

/// One view of one settled scene.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewRecord {
    /// The seed that the scene was made from; decides its split ([`crate::Split::of_seed`]).
    pub scene_seed: u64,
    /// Which of the scene's views this is, from 0.
    pub view: u32,
    /// Intrinsics of the full picture.
    pub camera: Pinhole,
    /// Pose of the camera. World is z up.
    pub world_from_camera: Isometry3<f64>,
    /// The viewer's yaw about world z, radians ([`repose_geometry::ViewerFrame`]).
    pub view_yaw_rad: f64,
    /// Everything that is not a movable object, with all objects absent.
    pub background: Layer,
    /// The movable objects. Ones that the camera cannot see have an empty layer.
    pub objects: Vec<ObjectRecord>,
    /// Ground-truth relations, `[n * n]` of `query * n + anchor`.
    pub relations: Vec<[bool; RELATIONS]>,
    /// Distance between the meshes, metres, `[n * n]` of `query * n + anchor`.
    pub gap_m: Vec<f32>,
}

impl ViewRecord {
    /// Whether relation number `relation` holds between objects `query` and `anchor` (indices into `objects`).
    pub fn relations_of(&self, query: usize, anchor: usize) -> &[bool; RELATIONS] {
        &self.relations[query * self.objects.len() + anchor]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_layer_keeps_the_rectangle_that_is_filled() {
        let mut depth_m = vec![0.0f32; 6 * 4];
        depth_m[8] = 0.5; // column 2, row 1
        depth_m[2 * 6 + 4] = 0.75;
        depth_m[3] = f32::NAN;
        let layer = Layer::from_depth_m(&depth_m, 6);
        assert_eq!((layer.x0, layer.y0, layer.width, layer.height), (2, 1, 3, 2));
        assert_eq!(layer.pixels().collect::<Vec<_>>(), [(2, 1, 5000), (4, 2, 7500)]);
        assert_eq!(Layer::from_depth_m(&[0.0; 24], 6), Layer::default());
    }
}
