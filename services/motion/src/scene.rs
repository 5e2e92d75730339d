//! What the planner of motions knows of the world: the labelled cloud and its support surfaces, in the world frame.

use nalgebra::{Point2, Point3};
use repose_geometry::Footprint;

/// A horizontal surface that things stand on.
#[derive(Debug, Clone, PartialEq)]
pub struct SupportSurface {
    /// Height, world z, metres.
    pub height_m: f64,
    /// Its outline seen from above, world x and y.
    pub footprint: Footprint,
    /// The object whose top it is; none for furniture.
    pub object: Option<u16>,
    /// How deep it is solid below its height, metres; none when that is not known.
    pub depth_m: Option<f64>,
}

impl SupportSurface {
    /// A surface from its outline; `None` when the outline has no area.
    pub fn new(height_m: f64, outline: &[Point2<f32>], object: Option<u16>) -> Option<Self> {
        let corners: Vec<Point3<f32>> = outline.iter().map(|p| Point3::new(p.x, p.y, 0.0)).collect();
        Some(Self { height_m, footprint: Footprint::of(&corners)?, object, depth_m: None })
    }
}

/// A segmented scene in a calibrated world frame.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanningScene {
    /// The observed points, metres.
    pub points: Vec<Point3<f32>>,
    /// The object of each point, 0 = not an object. As long as `points`.
    pub labels: Vec<u16>,
    /// The support surfaces.
    pub surfaces: Vec<SupportSurface>,
    /// Where the camera stood: the side from which objects were seen.
    pub camera_in_world: Point3<f64>,
}

impl PlanningScene {
    /// The points of one object, in cloud order.
    pub fn points_of(&self, object: u16) -> Vec<Point3<f32>> {
        self.points.iter().zip(&self.labels).filter(|(_, label)| **label == object).map(|(p, _)| *p).collect()
    }

    /// All points but those of one object, in cloud order.
    pub fn points_without(&self, object: u16) -> Vec<Point3<f32>> {
        self.points.iter().zip(&self.labels).filter(|(_, label)| **label != object).map(|(p, _)| *p).collect()
    }

    /// The height of the highest surface under (x, y) that is not above `below_m`, the object's own top excepted.
    pub fn support_below(&self, x_m: f64, y_m: f64, below_m: f64, object: u16) -> Option<f64> {
        let xy = Point2::new(x_m as f32, y_m as f32);
        self.surfaces
            .iter()
            .filter(|s| s.object != Some(object) && s.height_m <= below_m && s.footprint.margin(&xy) > 0.0)
            .map(|s| s.height_m)
            .max_by(f64::total_cmp)
    }
}
