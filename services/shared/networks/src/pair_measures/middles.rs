//! Where the middle of an object may be, seen from above, by what its cloud shows of it.
//!
//! `centered` compares the middles of two boxes to a millimetre, while a cloud lacks its object's far side and what is hidden. A box's outline
//! is whole where its top is seen, a round thing's axis follows from its front alone, and of what carries something else neither may be: so there
//! are three guesses, and the predictor learns when to believe which.

use nalgebra::{Matrix3, Vector2, Vector3};

/// How far below its highest points a cloud's top reaches, metres.
const TOP_M: f32 = 0.012;
/// The share of points that is left out at either end.
const STRAY_SHARE: f32 = 0.01;
/// Points farther than this many mean distances from a circle are left out when it is drawn anew.
const FAR_OFF: f32 = 2.0;
/// Directions tried for the edges of the smallest rectangle.
const EDGE_DIRECTIONS: usize = 30;

/// By what a middle is guessed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Guess {
    /// [`Middles::top`].
    Top,
    /// [`Middles::rectangle`].
    Rectangle,
    /// [`Middles::circle`].
    Circle,
}

impl Guess {
    /// All of them; a guess is its own position.
    pub const ALL: [Self; 3] = [Self::Top, Self::Rectangle, Self::Circle];
}

/// Guesses at the middle, relative to the cloud's centroid, level, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Middles {
    /// Of the highest points' box.
    pub top: [f32; 2],
    /// Of the smallest rectangle around all points.
    pub rectangle: [f32; 2],
    /// That rectangle's shorter and longer edge.
    pub edges: [f32; 2],
    /// Of the circle through all points.
    pub circle: [f32; 2],
    /// That circle's radius.
    pub radius: f32,
    /// How far points lie from it, in the mean.
    pub residual: f32,
}

impl Middles {
    /// From coordinates by axis.
    pub fn new([x, y, z]: &[Vec<f32>; 3]) -> Self {
        let (rectangle, edges) = smallest_rectangle(x, y);
        let (circle, radius, residual) = circle(x, y).unwrap_or((rectangle, 0.5 * edges[1], 0.5 * edges[1]));
        Self { top: top(x, y, z), rectangle, edges, circle, radius, residual }
    }

    /// The middle by one of the guesses.
    pub fn by(&self, guess: Guess) -> [f32; 2] {
        match guess {
            Guess::Top => self.top,
            Guess::Rectangle => self.rectangle,
            Guess::Circle => self.circle,
        }
    }
}

/// The values at `share` and at `1 − share` of the sorted list; zeros where it is empty.
pub fn without_strays(mut values: Vec<f32>, share: f32) -> [f32; 2] {
    values.sort_by(f32::total_cmp);
    let stray = (share * values.len() as f32) as usize;
    let at = |i: Option<usize>| i.and_then(|i| values.get(i)).copied().unwrap_or(0.0);
    [at(Some(stray)), at(values.len().checked_sub(stray + 1))]
}

/// The middle of the box around the points near the highest.
fn top(x: &[f32], y: &[f32], z: &[f32]) -> [f32; 2] {
    let [_, highest] = without_strays(z.to_vec(), STRAY_SHARE);
    [x, y].map(|axis| {
        let [low, high] = without_strays(axis.iter().zip(z).filter(|(_, z)| **z > highest - TOP_M).map(|(v, _)| *v).collect(), STRAY_SHARE);
        0.5 * (low + high)
    })
}

/// The rectangle of least area around points, whatever way it is turned: its middle and its edges, the shorter first.
fn smallest_rectangle(x: &[f32], y: &[f32]) -> ([f32; 2], [f32; 2]) {
    let mut best = (f32::INFINITY, [0.0; 2], [0.0; 2]);
    for k in 0..EDGE_DIRECTIONS {
        let (sin, cos) = (std::f32::consts::FRAC_PI_2 * k as f32 / EDGE_DIRECTIONS as f32).sin_cos();
        let (mut low, mut high) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
        for (x, y) in x.iter().zip(y) {
            let turned = [cos * x + sin * y, cos * y - sin * x];
            for a in 0..2 {
                (low[a], high[a]) = (low[a].min(turned[a]), high[a].max(turned[a]));
            }
        }
        let edges = [high[0] - low[0], high[1] - low[1]];
        let area = edges[0] * edges[1];
        if area < best.0 {
            let [u, v] = [0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1])];
            best = (area, [cos * u - sin * v, sin * u + cos * v], [edges[0].min(edges[1]), edges[0].max(edges[1])]);
        }
    }
    (best.1, best.2)
}

/// A circle through points of a level slice.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Circle {
    /// Relative to the cloud's centroid, metres.
    pub middle: Vector2<f32>,
    /// Metres.
    pub radius: f32,
    /// How far points lie from it, in the mean, metres.
    pub residual: f32,
}

impl Circle {
    /// The circle through points, and again without those that lie far from it (a handle, a stray reading); `None` of fewer than `least`
    /// points, and where they lie on a line.
    pub fn robust(points: &[Vector2<f32>], least: usize) -> Option<Self> {
        let through = |points: &[Vector2<f32>]| {
            let [x, y]: [Vec<f32>; 2] = std::array::from_fn(|k| points.iter().map(|p| p[k]).collect());
            let (middle, radius, residual) = (points.len() >= least).then(|| circle(&x, &y))??;
            Some(Self { middle: middle.into(), radius, residual })
        };
        let first = through(points)?;
        let close = |p: &&Vector2<f32>| ((*p - first.middle).norm() - first.radius).abs() <= FAR_OFF * first.residual;
        Some(through(&points.iter().filter(close).copied().collect::<Vec<_>>()).unwrap_or(first))
    }
}

/// The circle through points in the sense of least squares of `|p|² − 2 c·p − (r² − |c|²)` (Kåsa 1976, "A circle fitting procedure and its
/// error analysis"), and the mean distance from it; `None` where points lie on a line.
fn circle(x: &[f32], y: &[f32]) -> Option<([f32; 2], f32, f32)> {
    let (mut normal, mut right) = (Matrix3::<f64>::zeros(), Vector3::<f64>::zeros());
    for (x, y) in x.iter().zip(y).map(|(x, y)| (f64::from(*x), f64::from(*y))) {
        let row = Vector3::new(2.0 * x, 2.0 * y, 1.0);
        normal += row * row.transpose();
        right += row * (x * x + y * y);
    }
    let found = normal.cholesky()?.solve(&right);
    let middle = [found.x as f32, found.y as f32];
    let radius = (found.z + found.x * found.x + found.y * found.y).max(0.0).sqrt() as f32;
    let off = |(x, y): (&f32, &f32)| ((x - middle[0]).hypot(y - middle[1]) - radius).abs();
    let residual = x.iter().zip(y).map(off).sum::<f32>() / x.len().max(1) as f32;
    (residual.is_finite() && radius.is_finite()).then_some((middle, radius, residual))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Points of a wall around `middle` from `from_rad` on, over `over_rad`, and of a cover over it all.
    fn can(middle: [f32; 2], radius: f32, from_rad: f32, over_rad: f32) -> [Vec<f32>; 3] {
        let mut axes = [const { Vec::new() }; 3];
        for i in 0..40 {
            let (sin, cos) = (from_rad + over_rad * i as f32 / 39.0).sin_cos();
            for k in 0..10 {
                for (axis, v) in axes.iter_mut().zip([middle[0] + radius * cos, middle[1] + radius * sin, 0.01 * k as f32]) {
                    axis.push(v);
                }
            }
        }
        axes
    }

    proptest! {
        #[test]
        fn the_axis_of_a_round_thing_follows_from_a_third_of_its_wall(
            x in -0.1..0.1f32, y in -0.1..0.1f32, radius in 0.02..0.08f32, from_rad in 0.0..6.0f32,
        ) {
            let middles = Middles::new(&can([x, y], radius, from_rad, 2.1));
            prop_assert!((middles.circle[0] - x).hypot(middles.circle[1] - y) < 1e-4, "{:?}", middles);
            prop_assert!((middles.radius - radius).abs() < 1e-4 && middles.residual < 1e-4);
        }

        #[test]
        fn the_middle_of_a_rectangle_is_found_whatever_way_it_is_turned(yaw_rad in 0.0..3.0f32, x in -0.1..0.1f32, y in -0.1..0.1f32) {
            let (sin, cos) = yaw_rad.sin_cos();
            let mut axes = [const { Vec::new() }; 3];
            for (i, j) in (0..=20).flat_map(|i| (0..=10).map(move |j| (i, j))) {
                let (u, v) = (0.01 * i as f32 - 0.1, 0.01 * j as f32 - 0.05);
                for (axis, c) in axes.iter_mut().zip([x + cos * u - sin * v, y + sin * u + cos * v, 0.0]) {
                    axis.push(c);
                }
            }
            let middles = Middles::new(&axes);
            // Edges are tried every three degrees, which makes the rectangle a little larger and leaves its middle.
            prop_assert!((middles.rectangle[0] - x).hypot(middles.rectangle[1] - y) < 1e-4, "{:?}", middles);
            prop_assert!((middles.edges[0] - 0.1).abs() < 0.006 && (middles.edges[1] - 0.2).abs() < 0.006, "{:?}", middles);
        }
    }

    #[test]
    fn what_lies_on_a_line_has_no_circle_and_is_finite() {
        let line: Vec<f32> = (0..30).map(|i| 0.001 * i as f32).collect();
        for axes in [[line.clone(), vec![0.0; 30], vec![0.0; 30]], [vec![0.0], vec![0.0], vec![0.0]]] {
            let m = Middles::new(&axes);
            assert!([m.top, m.rectangle, m.circle].concat().iter().all(|v| v.is_finite()) && m.radius.is_finite(), "{m:?}");
        }
    }
}
