//! What the planner of motions knows of the world: the labelled cloud and its support surfaces, in the world frame.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::OnceLock;

use nalgebra::{Point2, Point3};
use repose_belief::plane::SupportPlane;
use repose_belief::{Belief, BeliefSettings, BelievedObject, SeenScene, TooWide};
use repose_geometry::Footprint;
use repose_proto::Scene;

/// A horizontal area that objects stand on; solid below, as deep as is known.
#[derive(Debug, Clone, PartialEq)]
pub struct SupportArea {
    /// Height, world z, metres.
    pub height_m: f64,
    /// Its outline seen from above, world x and y.
    pub footprint: Footprint,
    /// The object whose top it is; none for furniture.
    pub object: Option<u16>,
    /// How deep it is solid below its height, metres; none when that is not known.
    pub depth_m: Option<f64>,
}

impl SupportArea {
    /// A surface from its outline; `None` when the outline has no area.
    pub fn new(height_m: f64, outline: &[Point2<f32>], object: Option<u16>) -> Option<Self> {
        Some(Self { height_m, footprint: Footprint::of_places(outline.iter().copied())?, object, depth_m: None })
    }

    /// Moves its outline out at every corner (world frame) by as much to every side, metres.
    pub fn grow(&mut self, by_m: impl Fn(&Point3<f32>) -> f32) {
        let moved = |c: &Point2<f32>| {
            let by_m = by_m(&Point3::new(c.x, c.y, self.height_m as f32));
            [[-by_m, -by_m], [by_m, -by_m], [by_m, by_m], [-by_m, by_m]].map(|[x, y]| Point2::new(c.x + x, c.y + y))
        };
        if let Some(grown) = Footprint::of_places(self.footprint.corners().iter().flat_map(moved)) {
            self.footprint = grown;
        }
    }

    /// A surface as solid as is said, metres.
    fn of(plane: &SupportPlane, depth_m: Option<f32>) -> Self {
        Self {
            height_m: f64::from(plane.height_m),
            footprint: plane.outline.clone(),
            object: (plane.object != 0).then_some(plane.object),
            depth_m: depth_m.map(f64::from),
        }
    }
}

/// The points and support areas observed around an arm: the obstacles of a motion that grasps nothing.
#[derive(Debug, Clone)]
pub struct ArmSurroundings {
    /// The observed points, metres.
    pub points: Vec<Point3<f32>>,
    /// The support surfaces.
    pub surfaces: Vec<SupportArea>,
}

impl ArmSurroundings {
    /// As they were seen.
    pub fn of(scene: &Scene) -> Self {
        let planes = scene.meta.surfaces.iter().filter_map(SupportPlane::of);
        Self {
            points: scene.points.iter().map(|p| Point3::from(*p)).collect(),
            surfaces: planes.map(|plane| SupportArea::of(&plane, None)).collect(),
        }
    }
}

/// A segmented scene in a calibrated world frame, and what is believed of it.
#[derive(Debug, Clone)]
pub struct PlanningScene {
    /// The observed points, metres.
    pub points: Vec<Point3<f32>>,
    /// The object of each point, 0 = not an object. As long as `points`.
    pub labels: Vec<u16>,
    /// Whole shapes, what carries what, and which places were seen to be free: the same as the planner of placements believes.
    pub belief: Belief,
    /// Each object as a whole, made when it is first asked for, with what its border was moved out by (bits of pixels).
    wholes: OnceLock<(u32, Wholes)>,
}

/// The points that stand for each object as a whole, by its id.
type Wholes = BTreeMap<u16, Vec<Point3<f32>>>;

/// Spacing of the points that stand for whole objects in the arm's way, metres: the arm's spheres are larger.
const WHOLE_SPACING_M: f32 = 0.008;

impl PlanningScene {
    /// A scene as it was seen.
    ///
    /// # Errors
    /// When its objects are too far apart.
    pub fn of(seen: &SeenScene<'_>) -> Result<Self, TooWide> {
        let belief = Belief::of(seen, &BeliefSettings::default())?;
        let points = seen.points.iter().map(|p| Point3::from(*p)).collect();
        Ok(Self { points, labels: seen.labels.to_vec(), belief, wholes: OnceLock::new() })
    }

    /// Every object as it is believed to be as a whole, 8 mm between points, its border moved out by as many pixels as are missing of it. Kept for all
    /// requests on the scene, which have the same border.
    pub fn wholes(&self, border_px: f32) -> Cow<'_, Wholes> {
        let whole = |(id, object): (&u16, &BelievedObject)| {
            let border_m = self.belief.view.border_m(&object.centroid.cast(), border_px);
            (*id, self.belief.whole(*id, WHOLE_SPACING_M, border_m))
        };
        let made = || self.belief.objects.iter().map(whole).collect();
        let (border_bits, kept) = self.wholes.get_or_init(|| (border_px.to_bits(), made()));
        if *border_bits == border_px.to_bits() { Cow::Borrowed(kept) } else { Cow::Owned(made()) }
    }

    /// The points of one object, in cloud order; none of an unknown one.
    pub fn points_of(&self, object: u16) -> &[Point3<f32>] {
        self.belief.objects.get(&object).map_or(&[], |object| &object.points)
    }

    /// All points but those of one object, in cloud order.
    pub fn points_without(&self, object: u16) -> Vec<Point3<f32>> {
        self.points.iter().zip(&self.labels).filter(|(_, label)| **label != object).map(|(p, _)| *p).collect()
    }

    /// The support surfaces but an object's own top (0: all of them), as solid as `depth_m` says.
    pub fn surfaces_without(&self, object: u16, depth_m: impl Fn(&SupportPlane) -> Option<f32>) -> Vec<SupportArea> {
        let others = self.belief.planes.iter().filter(|plane| object == 0 || plane.object != object);
        others.map(|plane| SupportArea::of(plane, depth_m(plane))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_surface_grows_by_as_much_on_every_side() {
        let corners = [[0.0, 0.0], [0.3, 0.0], [0.3, 0.2], [0.0, 0.2]].map(Point2::from);
        let mut surface = SupportArea::new(0.1, &corners, None).expect("it has an area");
        surface.grow(|_| 0.005);
        assert!((surface.footprint.area() - 0.31 * 0.21).abs() < 1e-6);
        assert!(surface.footprint.margin(&Point2::new(-0.004, 0.1)) > 0.0 && surface.footprint.margin(&Point2::new(-0.006, 0.1)) < 0.0);
    }
}
