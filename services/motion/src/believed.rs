//! The world that a plan keeps clear of: as it is believed to be, hidden parts and all, or only as it was seen.
//!
//! A plan is looked for in the believed world first. Guesses may be wrong and may close the only way, so where nothing is found there, what
//! was seen decides alone.

use std::collections::BTreeSet;

use nalgebra::Point3;
use repose_geometry::{Aabb, cloud::voxel_downsampled};

use crate::grasp::sight::Sight;
use crate::hidden::{self, Guess};
use crate::obstacles::Obstacles;
use crate::pick_place::{PickPlaceRequest, PickPlaceSettings};
use crate::scene::SupportSurface;

/// What is in the way of arm and object.
#[derive(Debug, Clone)]
pub struct World {
    /// Everything but the object to move.
    pub others: Obstacles,
    /// The object where it stands.
    pub query: Obstacles,
    /// The object's points that are carried along, thinned, world frame at its place.
    pub held: Vec<Point3<f32>>,
    /// The height of what the object stands on, world z, metres.
    pub support_m: f64,
}

/// Further from the shoulder than arm, hand and a held object reach, metres.
const ARM_REACH_M: f32 = 1.3;
/// Spacing of the points that stand for hidden parts of other things, metres: the arm's spheres are larger.
const GUESS_SPACING_M: f32 = 0.008;

/// Makes worlds of a request.
#[derive(Debug, Clone, Copy)]
pub struct Worlds<'a> {
    /// The request.
    pub request: &'a PickPlaceRequest<'a>,
    /// Resolutions.
    pub settings: &'a PickPlaceSettings,
    /// What was seen to be free.
    pub sight: &'a Sight,
    /// The shoulder, world frame.
    pub shoulder: Point3<f32>,
}

impl Worlds<'_> {
    /// Things go on where they are hidden: objects behind and down to what they stand on, furniture down to the next lower surface.
    pub fn believed(&self) -> World {
        let scene = self.request.scene;
        let guess = self.guess(GUESS_SPACING_M, self.settings.grasp.gripper.border_m as f32);
        let labels: BTreeSet<u16> = scene.labels.iter().copied().filter(|l| *l != 0 && *l != self.request.query).collect();
        let guessed = labels.into_iter().flat_map(|id| guess.whole(id, &scene.points_of(id)));
        let around: Vec<Point3<f32>> = scene.points_without(self.request.query).into_iter().chain(guessed).collect();
        let solid = |s: &SupportSurface| match s.object {
            None => SupportSurface { depth_m: guess.solid_m(s), ..s.clone() },
            Some(_) => s.clone(),
        };
        let object = scene.points_of(self.request.query);
        let held = self.guess(self.settings.held_spacing_m, 0.0).whole(self.request.query, &object);
        let query = Obstacles::new(&[object, held.clone()].concat(), &[], &self.settings.obstacles);
        World { query, held, ..self.world(&around, &solid) }
    }

    /// Things end where what was seen of them ends, but for the far side of what is held.
    pub fn seen(&self) -> World {
        self.world(&self.request.scene.points_without(self.request.query), &SupportSurface::clone)
    }

    fn world(&self, around: &[Point3<f32>], solid: &dyn Fn(&SupportSurface) -> SupportSurface) -> World {
        let (scene, query) = (self.request.scene, self.request.query);
        let surfaces: Vec<_> = scene.surfaces.iter().filter(|s| s.object != Some(query)).map(solid).collect();
        let in_reach = |p: &&Point3<f32>| (*p - self.shoulder).norm_squared() < ARM_REACH_M * ARM_REACH_M;
        let around: Vec<Point3<f32>> = around.iter().filter(in_reach).copied().collect();
        let object = scene.points_of(query);
        let hidden_m = self.settings.grasp.hidden_m;
        let middle = Aabb::of(&object).map(|bounds| hidden::middle(&bounds, &scene.camera_in_world, hidden_m));
        let far = middle.map_or_else(Vec::new, |middle| hidden::far_side(&object, &middle));
        let lowest_m = object.iter().map(|p| p.z).fold(f32::INFINITY, f32::min);
        World {
            others: Obstacles::new(&around, &surfaces, &self.settings.obstacles),
            query: Obstacles::new(&object, &[], &self.settings.obstacles),
            support_m: f64::from(self.guess(self.settings.held_spacing_m, 0.0).foot_m(query, &object).unwrap_or(lowest_m)),
            held: voxel_downsampled(&[object, far].concat(), self.settings.held_spacing_m),
        }
    }

    fn guess(&self, spacing_m: f32, border_m: f32) -> Guess<'_> {
        Guess { scene: self.request.scene, sight: self.sight, hidden_m: self.settings.grasp.hidden_m, spacing_m, border_m }
    }
}
