//! Cross-sections: convex outlines around the z axis that profiles sweep into solids and walls.
//!
//! An outline reaches from −1 to 1 along x, so a profile's "radius" is half the width along x. Circles are polygons here like all
//! others: what is drawn and what is touched have the same facets.

use nalgebra::{Point2, Point3, Vector2};

/// A point of a profile: distance from the axis (along x) and height, metres.
pub type ProfilePoint = [f32; 2];

/// Facets of a circle: at 5 cm of radius the flat of a facet is 0.4 mm inside the circle.
pub const FACETS: usize = 24;

/// A convex outline, counter-clockwise, that contains the origin.
#[derive(Debug, Clone, PartialEq)]
pub struct Outline {
    points: Vec<Vector2<f32>>,
    round: bool,
}

impl Outline {
    /// A circle of [`FACETS`] facets.
    pub fn circle() -> Self {
        Self::circle_of(FACETS)
    }

    /// A circle of `facets` facets.
    pub fn circle_of(facets: usize) -> Self {
        Self { round: true, ..Self::regular(facets) }
    }

    /// A regular polygon with a corner on the x axis.
    pub fn regular(sides: usize) -> Self {
        let points = (0..sides).map(|k| {
            let turn = std::f32::consts::TAU * k as f32 / sides as f32;
            Vector2::new(turn.cos(), turn.sin())
        });
        Self { points: points.collect(), round: false }
    }

    /// A rectangle, `aspect` times as deep (y) as wide (x).
    pub fn rectangle(aspect: f32) -> Self {
        let corner = |x: f32, y: f32| Vector2::new(x, y * aspect);
        Self { points: vec![corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0), corner(-1.0, -1.0)], round: false }
    }

    /// A rectangle whose corners are rounded by `corner` (a share of half the width).
    pub fn rounded(aspect: f32, corner: f32) -> Self {
        let corner = corner.min(aspect);
        let mut points = Vec::with_capacity(16);
        for (quarter, (x, y)) in [(1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0f32)].into_iter().enumerate() {
            let center = Vector2::new(x * (1.0 - corner), y * (aspect - corner));
            for k in 0..4 {
                let turn = std::f32::consts::FRAC_PI_2 * (quarter as f32 - 1.0 + k as f32 / 3.0);
                points.push(center + Vector2::new(turn.cos(), turn.sin()) * corner);
            }
        }
        Self { points, round: false }
    }

    /// A superellipse |x|ᵉ + |y / aspect|ᵉ = 1; an exponent of 2 is an ellipse, more are boxier.
    pub fn superellipse(exponent: f32, aspect: f32) -> Self {
        let points = (0..20).map(|k| {
            let turn = std::f32::consts::TAU * k as f32 / 20.0;
            let power = |v: f32| v.signum() * v.abs().powf(2.0 / exponent);
            Vector2::new(power(turn.cos()), aspect * power(turn.sin()))
        });
        Self { points: points.collect(), round: false }
    }

    /// Number of facets around.
    pub fn sides(&self) -> usize {
        self.points.len()
    }

    /// Whether a true circle is meant.
    pub fn is_round(&self) -> bool {
        self.round
    }

    /// The corner number `k` (modulo the number of sides) of the ring at a profile point.
    pub fn corner(&self, [radius, height]: ProfilePoint, k: usize) -> Point3<f32> {
        let p = self.points[k % self.points.len()] * radius;
        Point3::new(p.x, p.y, height)
    }

    /// All corners of the ring at a profile point; a single one on the axis.
    pub fn ring(&self, at: ProfilePoint) -> impl Iterator<Item = Point3<f32>> + '_ {
        (0..if at[0] == 0.0 { 1 } else { self.sides() }).map(move |k| self.corner(at, k))
    }

    /// Radius of the largest circle around the axis inside the outline of radius 1.
    pub fn inradius(&self) -> f32 {
        self.edges().map(|(a, b)| a.perp(&b).abs() / (b - a).norm()).fold(f32::MAX, f32::min)
    }

    /// Half the edge lengths (x, y) of a large level rectangle inside the outline of radius 1, with the proportions of its box.
    pub fn inner_half_extents(&self) -> [f32; 2] {
        let aspect = self.points.iter().map(|p| p.y).fold(0.0, f32::max);
        let scale = [(1.0, aspect), (-1.0, aspect), (1.0, -aspect), (-1.0, -aspect)]
            .into_iter()
            .map(|(x, y)| self.reach(Vector2::new(x, y)))
            .fold(f32::MAX, f32::min);
        [scale, scale * aspect]
    }

    /// Index sets of quadrilaterals that together cover the outline well; the engine knows at most four corners of a face.
    pub fn quads(&self) -> Vec<[usize; 4]> {
        let n = self.sides();
        if n <= 4 {
            return Vec::new();
        }
        let quarter = (n + 2) / 4;
        let step = quarter.div_ceil(3);
        let count = if n < 12 { n / 2 } else { quarter.div_ceil(step) };
        (0..count).map(|k| k * if n < 12 { 1 } else { step }).map(|k| [k, k + quarter, k + n / 2, k + n / 2 + quarter]).collect()
    }

    /// How far one can go from the axis in a direction, in multiples of it.
    fn reach(&self, direction: Vector2<f32>) -> f32 {
        let crossing = |(a, b): (Vector2<f32>, Vector2<f32>)| {
            let edge = b - a;
            let along = direction.perp(&edge);
            (along.abs() > 1e-9).then(|| a.perp(&edge) / along).filter(|t| *t > 0.0)
        };
        self.edges().filter_map(crossing).fold(f32::MAX, f32::min)
    }

    fn edges(&self) -> impl Iterator<Item = (Vector2<f32>, Vector2<f32>)> + '_ {
        (0..self.points.len()).map(|k| (self.points[k], self.points[(k + 1) % self.points.len()]))
    }
}

/// The radius of a profile at a height, between its points.
pub fn radius_at(profile: &[ProfilePoint], height: f32) -> f32 {
    for pair in profile.windows(2) {
        let ([r0, z0], [r1, z1]) = (pair[0], pair[1]);
        if (z0..=z1).contains(&height) && z1 > z0 {
            return r0 + (r1 - r0) * (height - z0) / (z1 - z0);
        }
    }
    profile.last().map_or(0.0, |p| p[0])
}

/// A smooth profile through a few points: a Catmull-Rom spline with `pieces` pieces between each two.
pub fn smooth(points: &[ProfilePoint], pieces: usize) -> Vec<ProfilePoint> {
    let at = |i: isize| Point2::from(points[i.clamp(0, points.len() as isize - 1) as usize]).coords;
    let mut profile = vec![points[0]];
    for i in 0..points.len() as isize - 1 {
        let (before, from, to, after) = (at(i - 1), at(i), at(i + 1), at(i + 2));
        for k in 1..=pieces {
            let t = k as f32 / pieces as f32;
            let (t2, t3) = (t * t, t * t * t);
            let p = (from * 2.0
                + (to - before) * t
                + (before * 2.0 - from * 5.0 + to * 4.0 - after) * t2
                + (from * 3.0 - before - to * 3.0 + after) * t3)
                * 0.5;
            // Profiles never run downwards: overshoot of the spline is cut off.
            let height = p.y.clamp(profile[profile.len() - 1][1], points[points.len() - 1][1]);
            profile.push([p.x.max(1e-4), height]);
        }
    }
    profile
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all() -> Vec<Outline> {
        let mut outlines = vec![Outline::circle(), Outline::rectangle(0.6), Outline::rounded(0.7, 0.3), Outline::superellipse(3.0, 0.5)];
        outlines.extend((3..10).map(Outline::regular));
        outlines
    }

    #[test]
    fn outlines_are_convex_and_counter_clockwise() {
        for outline in all() {
            let n = outline.sides();
            for k in 0..n {
                let [a, b, c] = [0, 1, 2].map(|i| outline.points[(k + i) % n]);
                assert!((b - a).perp(&(c - b)) > 0.0, "{n} sides, corner {k}");
            }
        }
    }

    #[test]
    fn the_inner_rectangle_and_circle_are_inside_and_large() {
        for outline in all() {
            let [x, y] = outline.inner_half_extents();
            for corner in [Vector2::new(x, y), Vector2::new(-x, y), Vector2::new(x, -y), Vector2::new(-x, -y)] {
                assert!(outline.reach(corner) > 0.999, "{} sides", outline.sides());
            }
            assert!(x > 0.35 && outline.inradius() > 0.3, "{} sides: {x}, {}", outline.sides(), outline.inradius());
        }
    }

    #[test]
    fn quads_of_an_outline_surround_the_axis() {
        for outline in all() {
            let n = outline.sides();
            let mut covered = vec![n <= 4; n];
            for quad in outline.quads() {
                let corners = quad.map(|k| outline.points[k % n]);
                for k in 0..4 {
                    assert!(corners[k].perp(&corners[(k + 1) % 4]) > -1e-5, "{n} sides");
                    covered[quad[k] % n] = true;
                }
            }
            assert!(covered.iter().filter(|c| **c).count() * 2 >= n, "{n} sides");
        }
    }

    #[test]
    fn a_smooth_profile_goes_through_its_points() {
        let points = [[0.03, 0.0], [0.05, 0.04], [0.02, 0.09]];
        let profile = smooth(&points, 4);
        for p in points {
            assert!(profile.iter().any(|q| (q[0] - p[0]).abs() + (q[1] - p[1]).abs() < 1e-6));
        }
        assert!(profile.windows(2).all(|w| w[1][1] >= w[0][1]));
        assert!((radius_at(&[[0.02, 0.0], [0.04, 0.1]], 0.05) - 0.03).abs() < 1e-6);
    }
}
