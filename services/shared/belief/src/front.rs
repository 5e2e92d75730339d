//! What was seen of an object, measured along and across the line of sight as seen from above.

use nalgebra::{Point2, Point3, Vector2};
use repose_geometry::{Footprint, cloud};

use crate::outlines::area_centroid;
use crate::settings::ShapeSettings;

/// The seen part of an object, world frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Front {
    /// Its points, without stray ones.
    pub points: Vec<Point3<f32>>,
    /// The mean of all its points.
    pub centroid: Point3<f64>,
    /// Height of what it stands on, world z, metres.
    pub bottom_m: f32,
    /// Height of its top, world z, metres.
    pub top_m: f32,
    /// The outline of its points, seen from above.
    pub outline: Footprint,
    /// Away from the camera; any direction where the camera is right above.
    pub away: Vector2<f32>,
    /// To the left of that.
    pub across: Vector2<f32>,
}

impl Front {
    /// Of an object's points, the height that it stands on and where the camera is, seen from above. `None` when the points have no extent
    /// from above.
    pub fn of(points: &[Point3<f32>], bottom_m: f32, eye: &Point2<f32>, settings: &ShapeSettings) -> Option<Self> {
        let centroid = cloud::centroid(points)?;
        let robust = cloud::percentile_box(points, settings.stray_share, 1.0 - settings.stray_share)?.inflated(1e-4);
        let points: Vec<Point3<f32>> = points.iter().filter(|p| robust.contains(p)).copied().collect();
        let top_m = points.iter().map(|p| p.z).fold(bottom_m + settings.min_height_m, f32::max);
        let outline = Footprint::of(&points)?;
        let away = (area_centroid(&outline) - eye).try_normalize(1e-3).unwrap_or_else(Vector2::x);
        Some(Self { points, centroid, bottom_m, top_m, outline, away, across: Vector2::new(-away.y, away.x) })
    }

    /// Its height, metres.
    pub fn height_m(&self) -> f32 {
        self.top_m - self.bottom_m
    }

    /// From where to where its outline reaches along a direction, seen from above, metres.
    pub fn span(&self, along: &Vector2<f32>) -> [f32; 2] {
        span(self.outline.corners(), along)
    }

    /// Its points between two heights, as shares of its own, seen from above.
    pub fn band(&self, low: f32, high: f32) -> Vec<Point2<f32>> {
        let at = |share: f32| self.bottom_m + share * self.height_m();
        self.points.iter().filter(|p| (at(low)..=at(high)).contains(&p.z)).map(|p| p.xy()).collect()
    }
}

/// From where to where points reach along a direction, metres; the wrong way round without any.
pub fn span(points: &[Point2<f32>], along: &Vector2<f32>) -> [f32; 2] {
    let values = points.iter().map(|p| p.coords.dot(along));
    values.fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], v| [low.min(v), high.max(v)])
}
