//! How far what is believed of the objects of a scene is from their true shapes, and from what truly lies on them.

use nalgebra::{Point2, Point3, Vector2};
use rand_pcg::Pcg64;
use repose_belief::front::span;
use repose_belief::outlines::area_centroid;
use repose_belief::{BeliefSettings, Shape};
use repose_geometry::{Aabb, Footprint};
use repose_planner::PreparedScene;
use repose_simulator::contact::PlacedParts;
use repose_simulator::scene::{SceneKind, SceneObject, SimulatedScene, scene_of_seed};
use serde::Serialize;

use crate::scenes::loads::{LoadBelief, believed_loads};
use crate::scenes::perturbation::with_found_masks;
use crate::scenes::problem::{CameraView, ProblemSettings};
use crate::scenes::true_objects::{CELL_M, cells, true_corners, true_shape};

/// Objects with fewer observed points are left out.
pub const MIN_POINTS: usize = 100;
/// What a doubt may be off by, metres.
pub const DOUBT_SLACK_M: f32 = 0.005;

/// How far one object's believed shape deviates from the true one, metres (believed less true).
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct BeliefDeviation {
    /// The scene.
    pub seed: u64,
    /// The object.
    pub id: u16,
    /// Its kind of scene.
    pub kind: SceneKind,
    /// The height of its bottom.
    pub bottom_m: f32,
    /// How far it reaches on the side away from the camera, seen from above.
    pub far_m: f32,
    /// How far it reaches towards the camera.
    pub near_m: f32,
    /// Where its centre of mass is, away from the camera, …
    pub axis_away_m: f32,
    /// … and across.
    pub axis_across_m: f32,
    /// How much farther it may reach, as is said.
    pub doubt_m: f32,
    /// The share of what the believed and the true base cover, seen from above, that both do.
    pub base_overlap: f32,
    /// The same of outlines.
    pub outline_overlap: f32,
    /// The share of what the believed prisms and prisms around the true shape fill that both do.
    pub prism_overlap: f32,
    /// The share of what the believed prisms and the true volume fill that both do.
    pub volume_overlap: f32,
}

/// What is believed of the objects of one scene.
#[derive(Debug, Clone, PartialEq)]
pub struct BelievedScene {
    /// Of their shapes.
    pub shapes: Vec<BeliefDeviation>,
    /// Of what lies on them.
    pub loads: Vec<LoadBelief>,
    /// The time that believing took.
    pub took: std::time::Duration,
}

/// The objects of a scene, from one view; none where the seed gives no scene. Masks are given, or found and then named after the objects that
/// they match.
pub fn believed_objects(seed: u64, settings: &ProblemSettings, masks_found: bool, belief: &BeliefSettings) -> Option<BelievedScene> {
    let (truth, _) = scene_of_seed(seed, &settings.scene).ok()?;
    let mut rng = Pcg64::new(u128::from(seed), 0xbe11_efed);
    let view = CameraView::at_random(&truth, settings, &mut rng, seed)?;
    let observed = if masks_found { with_found_masks(view.frame, &settings.perception).ok()? } else { view.observed };
    let began = std::time::Instant::now();
    let scene_id = observed.id();
    let prepared = PreparedScene::with_settings(std::sync::Arc::new(observed), scene_id, belief);
    let took = began.elapsed();
    let eye = prepared.belief.view.eye().xy();
    let seen = prepared.belief.objects.iter().filter(|(_, object)| object.points.len() >= MIN_POINTS);
    let objects = seen.filter_map(|(id, object)| {
        let (shape, object) = (object.shape.as_ref()?, truth.objects.iter().find(|o| o.id == *id)?);
        compared(shape, object, &truth, &eye)
    });
    Some(BelievedScene { shapes: objects.collect(), loads: believed_loads(&truth, &prepared.belief, MIN_POINTS), took })
}

/// A believed shape and that of a scene's object, from a camera at `eye`, seen from above.
fn compared(shape: &Shape, object: &SceneObject, scene: &SimulatedScene, eye: &Point2<f32>) -> Option<BeliefDeviation> {
    let corners = true_corners(object);
    let (outline, bounds) = (Footprint::of(&corners)?, Aabb::of(&corners)?);
    let believed: Vec<Point3<f32>> = shape.corners().collect();
    let (believed_outline, believed_bounds) = (Footprint::of(&believed)?, Aabb::of(&believed)?);
    let known = true_shape(object, shape.centroid)?;
    let away = (area_centroid(&outline) - eye).try_normalize(1e-3)?;
    let across = Vector2::new(-away.y, away.x);
    let [near_m, far_m] = span(outline.corners(), &away);
    let [believed_near_m, believed_far_m] = span(believed_outline.corners(), &away);
    let possible: Vec<Point2<f32>> = shape.with_doubt()?.corners().map(|corner| corner.xy()).collect();
    let [_, possible_far_m] = span(&possible, &away);
    let solid = PlacedParts::new(&object.shape.parts, &object.world_from_object)?;
    let both = Aabb { min: bounds.min.inf(&believed_bounds.min), max: bounds.max.sup(&believed_bounds.max) };
    Some(BeliefDeviation {
        seed: scene.seed,
        id: object.id,
        kind: scene.kind,
        bottom_m: shape.bottom_m - bounds.min.z,
        far_m: believed_far_m - far_m,
        near_m: near_m - believed_near_m,
        axis_away_m: (shape.axis - known.axis).dot(&away),
        axis_across_m: (shape.axis - known.axis).dot(&across),
        doubt_m: (possible_far_m - believed_far_m).max(0.0),
        base_overlap: overlap(cells(&both).filter(|p| p.z <= both.min.z + CELL_M), |p| {
            [&known.base, &shape.base].map(|base| base.margin(&p.xy()) >= 0.0)
        }),
        outline_overlap: overlap(cells(&both).filter(|p| p.z <= both.min.z + CELL_M), |p| {
            [outline.margin(&p.xy()) >= 0.0, believed_outline.margin(&p.xy()) >= 0.0]
        }),
        prism_overlap: overlap(cells(&both), |p| [&known, shape].map(|shape| is_within(shape, &p))),
        volume_overlap: overlap(cells(&both), |p| [solid.contains(&p), is_within(shape, &p)]),
    })
}

/// Whether a place is within a shape's prisms.
fn is_within(shape: &Shape, place: &Point3<f32>) -> bool {
    shape.slabs.iter().any(|s| (s.low_m..=s.high_m).contains(&place.z) && s.outline.margin(&place.xy()) >= 0.0)
}

/// The share of the places in either that are in both.
fn overlap(places: impl Iterator<Item = Point3<f32>>, is_in: impl Fn(Point3<f32>) -> [bool; 2]) -> f32 {
    let (mut either, mut both) = (0, 0);
    for [a, b] in places.map(is_in) {
        either += u32::from(a || b);
        both += u32::from(a && b);
    }
    both as f32 / either.max(1) as f32
}
