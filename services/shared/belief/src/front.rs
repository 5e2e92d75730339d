//! What was seen of an object, measured along and across the line of sight as seen from above.

use nalgebra::{Point2, Point3, Vector2};
use repose_geometry::{Footprint, cloud};

use crate::outlines::area_centroid;
use crate::settings::ShapeSettings;
use crate::thin;

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
        let of_parts = thin::beyond(points, &robust, &settings.thin);
        let stays = |(i, p): &(usize, &Point3<f32>)| robust.contains(p) || of_parts.contains(i);
        let points: Vec<Point3<f32>> = points.iter().enumerate().filter(stays).map(|(_, p)| *p).collect();
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

#[cfg(test)]
mod tests {
    use super::*;

    /// The front half of a mug of 8 cm by 10 cm at the origin, and apart from it its handle to the right, of fewer points than are left out.
    fn mug() -> (Vec<Point3<f32>>, Vec<Point3<f32>>) {
        let mut body = Vec::new();
        for (i, k) in (0..=80).flat_map(|i| (0..=75).map(move |k| (i as f32 / 80.0, k as f32 / 75.0))) {
            let angle = std::f32::consts::PI * (1.0 + i);
            body.push(Point3::new(0.04 * angle.cos(), 0.04 * angle.sin(), 0.1 * k));
        }
        let bar = (0..14).map(|k| Point3::new(0.07, 0.0, 0.031 + 0.003 * k as f32));
        let arms = (0..7).flat_map(|k| [0.031, 0.07].map(|z| Point3::new(0.049 + 0.003 * k as f32, 0.0, z)));
        let handle: Vec<Point3<f32>> = bar.chain(arms).collect();
        assert!(handle.len() * 200 < body.len() + handle.len());
        (body, handle)
    }

    fn front(points: &[Point3<f32>]) -> Front {
        Front::of(points, 0.0, &Point2::new(0.0, -0.8), &ShapeSettings::default()).unwrap()
    }

    /// What is left without the shares of points at both ends of each axis.
    fn trimmed(points: &[Point3<f32>]) -> Vec<Point3<f32>> {
        let share = ShapeSettings::default().stray_share;
        let robust = cloud::percentile_box(points, share, 1.0 - share).unwrap().inflated(1e-4);
        points.iter().filter(|p| robust.contains(p)).copied().collect()
    }

    #[test]
    fn a_handle_of_few_points_is_part_of_the_front_and_strays_are_not() {
        let (body, handle) = mug();
        let strays: [Point3<f32>; 4] = [[0.13, 0.0, 0.05], [-0.09, 0.02, 0.08], [-0.094, 0.02, 0.08], [0.0, 0.0, 0.2]].map(Point3::from);
        let points: Vec<Point3<f32>> = body.iter().chain(&handle).chain(&strays).copied().collect();
        let front = front(&points);
        let [left_m, right_m] = front.span(&Vector2::x());
        assert!((left_m + 0.04).abs() < 1e-3 && (right_m - 0.07).abs() < 1e-6, "{left_m} to {right_m}");
        assert!((front.top_m - 0.1).abs() < 1e-3 && strays.iter().all(|p| !front.points.contains(p)));
    }

    #[test]
    fn what_has_no_thin_parts_is_trimmed_as_ever() {
        let (body, handle) = mug();
        assert_eq!(front(&body).points, trimmed(&body));
        // The top of a box, turned by 45°: the trim takes its corners.
        let steps = || (0..=100).map(|k| k as f32 * 0.003);
        let top: Vec<Point3<f32>> = steps().flat_map(|a| steps().map(move |b| Point3::new(a - b, a + b, 0.1 + 0.01 * a))).collect();
        assert_eq!(front(&top).points, trimmed(&top));
        // The handle alone, somewhere else.
        let apart = handle.iter().map(|p| p + nalgebra::Vector3::new(0.06, 0.0, 0.0));
        let points: Vec<Point3<f32>> = body.iter().copied().chain(apart).collect();
        assert_eq!(front(&points).points, trimmed(&points), "nothing leads to it");
    }
}
