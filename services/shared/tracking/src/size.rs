//! How large what is seen of an object is, however it is turned about the vertical: by that it is known where it stands elsewhere.
//!
//! The edges of a box along the world's axes change by centimetres when something long is turned. Its height does not, nor do the sides of the
//! rectangle around what is seen of it from above.

use nalgebra::{Point3, Vector2};
use repose_geometry::Footprint;

/// Sizes of one object in two views differ by at most this much, metres.
pub(crate) const SAME_SIZE_M: f64 = 0.03;

/// The edge lengths of the upright box around something, turned as it fits best, in ascending order: it may have toppled since.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Size([f64; 3]);

impl Size {
    /// The size of what is seen of an object; 0 where that is nothing.
    pub(crate) fn of(points: &[Point3<f64>]) -> Self {
        let [one_m, other_m] = sides_m(points);
        let mut edges_m = [span_m(points.iter().map(|p| p.z)), one_m, other_m];
        edges_m.sort_by(f64::total_cmp);
        Self(edges_m)
    }

    /// By how much the edges of two differ at most, metres.
    pub(crate) fn differs_m(&self, other: &Self) -> f64 {
        self.0.iter().zip(other.0).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    }
}

/// The sides of the rectangle around points seen from above, of those along an edge of their outline the one of least girth. The least area would not
/// tell: around two sides of a box that meet at a corner, without its top, two rectangles of different sides have the same.
fn sides_m(points: &[Point3<f64>]) -> [f64; 2] {
    let Some(footprint) = Footprint::of_places(points.iter().map(|p| p.xy().cast::<f32>())) else {
        // On a line.
        return [span_m(points.iter().map(|p| p.x)).hypot(span_m(points.iter().map(|p| p.y))), 0.0];
    };
    let corners: Vec<Vector2<f64>> = footprint.corners().iter().map(|corner| corner.coords.cast::<f64>()).collect();
    let next = corners.iter().cycle().skip(1);
    let sides = corners.iter().zip(next).map(|(corner, next)| {
        let along = (next - corner).normalize();
        [along, Vector2::new(-along.y, along.x)].map(|axis| span_m(corners.iter().map(|corner| corner.dot(&axis))))
    });
    sides.min_by(|a, b| (a[0] + a[1]).total_cmp(&(b[0] + b[1]))).unwrap_or_default()
}

/// From the least to the greatest of some numbers, metres; 0 without any.
fn span_m(numbers_m: impl Iterator<Item = f64>) -> f64 {
    let [low_m, high_m] = numbers_m.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], m| [low.min(m), high.max(m)]);
    (high_m - low_m).max(0.0)
}

#[cfg(test)]
mod tests {
    use nalgebra::{Rotation3, Vector3};

    use super::*;

    /// Points on the side of a box that goes from the origin some metres far, 6 cm high.
    fn side(to_m: [f64; 2]) -> Vec<Point3<f64>> {
        let at = |share: f64, z_m: f64| Point3::new(share * to_m[0], share * to_m[1], z_m);
        (0..=20).flat_map(|i| (0..=6).map(move |k| at(f64::from(i) / 20.0, f64::from(k) / 100.0))).collect()
    }

    #[test]
    fn a_size_stays_when_something_is_turned_about_the_vertical() {
        for (to_m, edges_m) in [([0.0, 0.1], [0.06, 0.1, 0.1]), ([0.0, 0.05], [0.05, 0.06, 0.1]), ([0.3, 0.0], [0.0, 0.06, 0.3])] {
            let seen = [side([0.1, 0.0]), side(to_m)].concat();
            for step in 0..36 {
                let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), f64::from(step) * 0.1);
                let turned: Vec<Point3<f64>> = seen.iter().map(|p| turn * p).collect();
                let size = Size::of(&turned);
                assert!(size.differs_m(&Size(edges_m)) < 1e-4, "{size:?}, {edges_m:?}");
            }
        }
    }

    #[test]
    fn a_line_and_a_point_and_nothing_have_a_size() {
        let line: Vec<Point3<f64>> = (0..=10).map(|i| Point3::new(0.03, 0.04, 0.0) * f64::from(i) / 10.0).collect();
        assert!(Size::of(&line).differs_m(&Size([0.0, 0.0, 0.05])) < 1e-6, "{:?}", Size::of(&line));
        assert_eq!([Size::of(&line[..1]), Size::of(&[])], [Size([0.0; 3]); 2]);
    }
}
