//! One view of one scene, in memory.

use nalgebra::Isometry3;
use repose_geometry::{OrientedBox, Pinhole};

use crate::layer::Layer;

/// How many relations a pair has, in wire order: `left_of right_of in_front_of behind above below near touching centered aligned`.
pub const RELATIONS: usize = 10;

/// Pixels from which on an object counts as seen in a picture of 320 × 240.
const SEEN_PX: u32 = 25;

/// An object seen alone by the same camera, before it was brought to where it stands.
#[derive(Debug, Clone, PartialEq)]
pub struct Elsewhere {
    /// The object alone, at the earlier pose.
    pub layer: Layer,
    /// The motion that carries the earlier pose to the one in the scene: a turn about world z and a translation.
    pub placed_from_elsewhere: Isometry3<f64>,
}

/// A piece of furniture: a box that never moves. All of them together are the view's background.
#[derive(Debug, Clone, PartialEq)]
pub struct FixtureRecord {
    /// What it is (`table`, `shelf`, …).
    pub name: String,
    /// Where it is and how large, in the world.
    pub bounds: OrientedBox,
}

/// One movable object of a view.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectRecord {
    /// The instance id, from 1; unique in the view.
    pub id: u16,
    /// What it is (`mug`, `box`, …).
    pub name: String,
    /// What it weighs.
    pub mass_kg: f32,
    /// True pose.
    pub world_from_object: Isometry3<f64>,
    /// True object-oriented box, in the world.
    pub bounds: OrientedBox,
    /// Pixels of it in the full picture, everything present; 0 when the camera does not see it. Labels count only for pairs that are seen.
    pub visible_px: u32,
    /// Pixels of it when nothing else is there.
    pub alone_px: u32,
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
    /// What kind of scene it is (`table`, `shelf`, `drawer`, …); empty when the maker tells none apart.
    pub scene_kind: String,
    /// Which of the scene's views this is, from 0.
    pub view: u32,
    /// Intrinsics of the full picture.
    pub camera: Pinhole,
    /// Who holds the camera (`tripod`, `head`, `wrist`).
    pub viewpoint: String,
    /// Pose of the camera. World is z up.
    pub world_from_camera: Isometry3<f64>,
    /// The viewer's yaw about world z, radians ([`repose_geometry::ViewerFrame`]).
    pub view_yaw_rad: f64,
    /// Everything that is not a movable object, with all objects absent.
    pub background: Layer,
    /// The boxes that the background consists of.
    pub fixtures: Vec<FixtureRecord>,
    /// The movable objects. Ones outside the picture have an empty layer.
    pub objects: Vec<ObjectRecord>,
    /// Ground-truth relations, `[n * n]` of `query * n + anchor`. Object i rests on j where `above` and `touching` hold.
    pub relations: Vec<[bool; RELATIONS]>,
    /// Distance between the meshes, metres, `[n * n]` of `query * n + anchor`.
    pub gap_m: Vec<f32>,
}

impl ViewRecord {
    /// Which relations hold between objects `query` and `anchor` (indices into `objects`).
    pub fn relations_of(&self, query: usize, anchor: usize) -> &[bool; RELATIONS] {
        &self.relations[query * self.objects.len() + anchor]
    }

    /// Whether object `k` is seen in the full picture: relations count only for pairs that are.
    pub fn is_seen(&self, k: usize) -> bool {
        let share = self.objects[k].visible_px as usize * 320 * 240;
        share >= SEEN_PX as usize * self.camera.width * self.camera.height
    }

    /// Whether color was kept.
    pub fn has_color(&self) -> bool {
        !self.background.color.is_empty() || self.objects.iter().any(|o| !o.alone.color.is_empty())
    }
}
