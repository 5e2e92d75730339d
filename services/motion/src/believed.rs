//! The world that a plan keeps clear of: as it is believed to be, hidden parts and all, or only as it was seen.
//!
//! A plan is looked for in the believed world first. Guesses may be wrong and may close the only way, so where nothing is found there, less
//! and less of them is heeded.

use std::cell::OnceCell;

use nalgebra::{Point2, Point3, Vector3};
use repose_belief::far_side::far_side;
use repose_belief::plane::SupportPlane;
use repose_geometry::cloud::voxel_downsampled;

pub use repose_proto::motion::Heeded;

use crate::collision::neighbouring;
use crate::obstacles::Obstacles;
use crate::pick_place::request::PickPlaceRequest;
use crate::pick_place::settings::PickPlaceSettings;
use crate::scene::SupportArea;

/// What is heeded of what was not seen, from the most cautious on. Where all is, things go on where they are hidden: objects behind and down to
/// what they stand on, furniture down to the next lower surface.
pub const HEEDED_IN_TURN: [Heeded; 3] = [Heeded::Everything, Heeded::Obstacles, Heeded::Held];

/// The obstacles that a pick-and-place motion is planned around.
#[derive(Debug)]
pub struct PlanningObstacles<'a> {
    /// Everything but the object to move.
    pub others: &'a Obstacles,
    /// The object where it stands.
    pub query: Obstacles,
    /// The object's points that are carried along, thinned, world frame at its place.
    pub held: Vec<Point3<f32>>,
    /// The height of what the object stands on, world z, metres.
    pub support_m: f64,
    /// The object's upright axis, seen from above, world frame; none where it has no extent.
    pub axis: Option<Point2<f32>>,
}

/// Further from the shoulder than arm, hand and a held object reach, metres.
const ARM_REACH_M: f32 = 1.3;

/// Makes worlds of a request.
#[derive(Debug)]
pub struct Worlds<'a> {
    /// The request.
    pub request: &'a PickPlaceRequest<'a>,
    /// Resolutions.
    pub settings: &'a PickPlaceSettings,
    /// The shoulder, world frame.
    pub shoulder: Point3<f32>,
    believed: OnceCell<Obstacles>,
    seen: OnceCell<Obstacles>,
}

/// How far an object is lifted off what it stands on to see what else it is said to be in, metres: more than the ball around its points.
const LIFTED_M: f64 = 0.015;

impl<'a> Worlds<'a> {
    /// The worlds of a request; what is in them is made when it is first asked for.
    pub fn new(request: &'a PickPlaceRequest<'a>, settings: &'a PickPlaceSettings, shoulder: Point3<f32>) -> Self {
        Self { request, settings, shoulder, believed: OnceCell::new(), seen: OnceCell::new() }
    }

    /// The world in which so much is heeded.
    pub fn world(&self, heeded: Heeded) -> PlanningObstacles<'_> {
        let (scene, query, settings) = (self.request.scene, self.request.query, self.settings);
        let object = scene.points_of(query);
        let others = match heeded {
            Heeded::Everything | Heeded::Obstacles => self.believed.get_or_init(|| self.believed_others()),
            Heeded::Held => self.seen.get_or_init(|| self.seen_others()),
        };
        let shape = scene.belief.objects.get(&query).and_then(|object| object.shape.as_ref());
        let held = match heeded {
            Heeded::Everything => scene.belief.whole(query, settings.held_spacing_m, 0.0),
            Heeded::Obstacles | Heeded::Held => {
                let far = shape.map_or_else(Vec::new, |shape| far_side(object, &shape.turn_axis));
                voxel_downsampled(&[object, &far].concat(), settings.held_spacing_m)
            }
        };
        let lowest_m = object.iter().map(|p| p.z).fold(f32::INFINITY, f32::min);
        // Where a guess or the noise of depth puts the object inside of something else, it does not reach.
        let lifted = |p: &Point3<f32>| p.cast::<f64>() + Vector3::z() * LIFTED_M;
        let possible = held.iter().filter(|p| !others.touches(&lifted(p), settings.held_radius_m)).copied();
        PlanningObstacles {
            held: neighbouring(possible.collect()),
            query: Obstacles::new(&[object, &held].concat(), &[], &settings.obstacles),
            support_m: f64::from(shape.map_or(lowest_m, |shape| shape.bottom_m)),
            axis: shape.map(|shape| shape.axis),
            others,
        }
    }

    fn believed_others(&self) -> Obstacles {
        let (scene, query) = (self.request.scene, self.request.query);
        let border_px = self.settings.grasp.gripper.border_px;
        let wholes = scene.wholes(border_px);
        let guessed = wholes.iter().filter(|(id, _)| **id != query).flat_map(|(_, whole)| whole.iter().copied());
        let solid_m = |plane: &SupportPlane| if plane.object == 0 { scene.belief.solid_m(plane) } else { None };
        let mut surfaces = scene.surfaces_without(query, solid_m);
        // The edges of furniture lose their borders as those of objects do.
        for surface in surfaces.iter_mut().filter(|surface| surface.depth_m.is_some()) {
            surface.grow(|corner| scene.belief.view.border_m(corner, border_px));
        }
        self.others(scene.points_without(query).into_iter().chain(guessed), &surfaces)
    }

    fn seen_others(&self) -> Obstacles {
        let (scene, query) = (self.request.scene, self.request.query);
        self.others(scene.points_without(query).into_iter(), &scene.surfaces_without(query, |_| None))
    }

    /// Obstacles of the points within reach and of surfaces.
    fn others(&self, points: impl Iterator<Item = Point3<f32>>, surfaces: &[SupportArea]) -> Obstacles {
        let in_reach: Vec<Point3<f32>> = points.filter(|p| (p - self.shoulder).norm_squared() < ARM_REACH_M * ARM_REACH_M).collect();
        Obstacles::new(&in_reach, surfaces, &self.settings.obstacles)
            .with_solids(&self.settings.beside)
            .with_keep_out(&self.settings.keep_out)
    }
}
