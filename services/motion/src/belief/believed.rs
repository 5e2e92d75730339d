//! The world that a plan keeps clear of: as it is believed to be, hidden parts and all, or only as it was seen.
//!
//! A plan is looked for in the believed world first. Guesses may be wrong and may close the only way, so where nothing is found there, less
//! and less of them is heeded.

use std::cell::OnceCell;
use std::collections::BTreeSet;

use nalgebra::{Point3, Vector3};
use repose_geometry::{Aabb, cloud::voxel_downsampled};
use serde::Serialize;

use crate::belief::hidden::{self, Guess};
use crate::belief::sight::Sight;
use crate::obstacles::Obstacles;
use crate::pick_place::request::PickPlaceRequest;
use crate::pick_place::settings::PickPlaceSettings;
use crate::scene::SupportSurface;

/// What is heeded of what was not seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Heeded {
    /// Things go on where they are hidden: objects behind and down to what they stand on, furniture down to the next lower surface.
    Everything,
    /// The same of what is in the way; what is held ends where what was seen of it ends, but for its far side.
    Obstacles,
    /// Nothing but the far side of what is held.
    Held,
}

impl Heeded {
    /// From the most cautious on.
    pub const IN_TURN: [Self; 3] = [Self::Everything, Self::Obstacles, Self::Held];
}

/// What is in the way of arm and object.
#[derive(Debug)]
pub struct World<'a> {
    /// Everything but the object to move.
    pub others: &'a Obstacles,
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
#[derive(Debug)]
pub struct Worlds<'a> {
    /// The request.
    pub request: &'a PickPlaceRequest<'a>,
    /// Resolutions.
    pub settings: &'a PickPlaceSettings,
    /// What was seen to be free.
    pub sight: &'a Sight,
    /// The shoulder, world frame.
    pub shoulder: Point3<f32>,
    believed: OnceCell<Obstacles>,
    seen: OnceCell<Obstacles>,
}

/// How far an object is lifted off what it stands on to see what else it is said to be in, metres: more than the ball around its points.
const LIFTED_M: f64 = 0.015;

impl<'a> Worlds<'a> {
    /// The worlds of a request; what is in them is made when it is first asked for.
    pub fn new(request: &'a PickPlaceRequest<'a>, settings: &'a PickPlaceSettings, sight: &'a Sight, shoulder: Point3<f32>) -> Self {
        Self { request, settings, sight, shoulder, believed: OnceCell::new(), seen: OnceCell::new() }
    }

    /// The world in which so much is heeded.
    pub fn world(&self, heeded: Heeded) -> World<'_> {
        let (scene, settings) = (self.request.scene, self.settings);
        let object = scene.points_of(self.request.query);
        let others = match heeded {
            Heeded::Everything | Heeded::Obstacles => self.believed.get_or_init(|| self.believed_others()),
            Heeded::Held => self.seen.get_or_init(|| self.seen_others()),
        };
        let guess = self.guess(settings.held_spacing_m, 0.0);
        let held = match heeded {
            Heeded::Everything => guess.whole(self.request.query, &object),
            Heeded::Obstacles | Heeded::Held => self.with_far_side(&object),
        };
        let lowest_m = object.iter().map(|p| p.z).fold(f32::INFINITY, f32::min);
        // Where a guess or the noise of depth puts the object inside of something else, it does not reach.
        let lifted = |p: &Point3<f32>| p.cast::<f64>() + Vector3::z() * LIFTED_M;
        let possible = held.iter().filter(|p| !others.touches(&lifted(p), settings.held_radius_m)).copied();
        World {
            held: possible.collect(),
            query: Obstacles::new(&[&*object, &*held].concat(), &[], &settings.obstacles),
            support_m: f64::from(guess.foot_m(self.request.query, &object).unwrap_or(lowest_m)),
            others,
        }
    }

    fn believed_others(&self) -> Obstacles {
        let scene = self.request.scene;
        let guess = self.guess(GUESS_SPACING_M, self.settings.grasp.gripper.border_m as f32);
        let labels: BTreeSet<u16> = scene.labels.iter().copied().filter(|l| *l != 0 && *l != self.request.query).collect();
        let guessed = labels.into_iter().flat_map(|id| guess.whole(id, &scene.points_of(id)));
        self.others(scene.points_without(self.request.query).into_iter().chain(guessed), |surface| match surface.object {
            None => SupportSurface { depth_m: guess.solid_m(surface), ..surface.clone() },
            Some(_) => surface.clone(),
        })
    }

    fn seen_others(&self) -> Obstacles {
        self.others(self.request.scene.points_without(self.request.query).into_iter(), SupportSurface::clone)
    }

    /// Obstacles of points and of the scene's surfaces, as `solid` has them; the object's own top is none.
    fn others(&self, points: impl Iterator<Item = Point3<f32>>, solid: impl Fn(&SupportSurface) -> SupportSurface) -> Obstacles {
        let surfaces = self.request.scene.surfaces.iter().filter(|s| s.object != Some(self.request.query));
        let surfaces: Vec<SupportSurface> = surfaces.map(solid).collect();
        let in_reach: Vec<Point3<f32>> = points.filter(|p| (p - self.shoulder).norm_squared() < ARM_REACH_M * ARM_REACH_M).collect();
        Obstacles::new(&in_reach, &surfaces, &self.settings.obstacles).with_keep_out(&self.settings.keep_out)
    }

    /// What was seen of the object and its likeness behind, thinned.
    fn with_far_side(&self, object: &[Point3<f32>]) -> Vec<Point3<f32>> {
        let (camera_in_world, hidden_m) = (&self.request.scene.camera_in_world, self.settings.grasp.hidden_m);
        let middle = Aabb::of(object).map(|bounds| hidden::middle(&bounds, camera_in_world, hidden_m));
        let far = middle.map_or_else(Vec::new, |middle| hidden::far_side(object, &middle));
        voxel_downsampled(&[object, &far].concat(), self.settings.held_spacing_m)
    }

    fn guess(&self, spacing_m: f32, border_m: f32) -> Guess<'_> {
        Guess { scene: self.request.scene, sight: self.sight, hidden_m: self.settings.grasp.hidden_m, spacing_m, border_m }
    }
}
