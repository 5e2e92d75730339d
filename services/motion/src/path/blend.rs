//! A path whose corners are rounded, so that it can be driven without stopping at them.
//!
//! Every corner `P` is replaced by the quadratic Bézier curve from `P − d·u` to `P + d·v` (`u`, `v` the directions before and after), with
//! `2d` of path parameter. Then the derivative by the parameter is a unit vector on the straight pieces and goes linearly from `u` to `v` on
//! the curve, so it is continuous, and the second derivative is the constant `(v − u) / 2d`: simple exact bounds for the timing.

use repose_panda::{JOINT_COUNT, Joints};

use crate::path::joint_path::distance;

/// Edges shorter than this are dropped, radians.
const SHORTEST_EDGE_RAD: f64 = 1e-7;

/// One stretch of the path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Piece {
    /// Where it begins.
    pub from: Joints,
    /// Derivative by the path parameter at its beginning.
    pub tangent: Joints,
    /// Second derivative, constant on the piece; zero on straight ones.
    pub curvature: Joints,
    /// Length in path parameter.
    pub length: f64,
}

impl Piece {
    /// The configuration at parameter `s` from the piece's beginning.
    pub fn at(&self, s: f64) -> Joints {
        std::array::from_fn(|i| self.from[i] + s * (self.tangent[i] + 0.5 * s * self.curvature[i]))
    }

    /// The derivative by the parameter there.
    pub fn derivative(&self, s: f64) -> Joints {
        std::array::from_fn(|i| self.tangent[i] + s * self.curvature[i])
    }
}

/// The pieces of the path through `corners`, which leaves the polyline by at most `deviation_rad` (Euclidean) at each corner.
///
/// Empty when all corners coincide.
pub fn blended(corners: &[Joints], deviation_rad: f64) -> Vec<Piece> {
    let mut distinct: Vec<Joints> = Vec::with_capacity(corners.len());
    for corner in corners {
        if distinct.last().is_none_or(|last| distance(last, corner) > SHORTEST_EDGE_RAD) {
            distinct.push(*corner);
        }
    }
    let lengths: Vec<f64> = distinct.windows(2).map(|w| distance(&w[0], &w[1])).collect();
    let directions: Vec<Joints> =
        distinct.windows(2).zip(&lengths).map(|(w, length)| std::array::from_fn(|i| (w[1][i] - w[0][i]) / length)).collect();
    // How much of the edges beside each corner its curve takes.
    let cuts: Vec<f64> = (0..distinct.len())
        .map(|k| {
            if k == 0 || k + 1 >= distinct.len() {
                return 0.0;
            }
            let turn = distance(&directions[k - 1], &directions[k]);
            // The curve's middle is d/4 · |v − u| from the corner.
            let by_deviation = if turn > 1e-12 { 4.0 * deviation_rad / turn } else { f64::INFINITY };
            by_deviation.min(0.5 * lengths[k - 1]).min(0.5 * lengths[k])
        })
        .collect();
    let mut pieces = Vec::with_capacity(2 * directions.len());
    for (k, direction) in directions.iter().enumerate() {
        let straight = lengths[k] - cuts[k] - cuts[k + 1];
        if straight > SHORTEST_EDGE_RAD {
            let from = std::array::from_fn(|i| distinct[k][i] + cuts[k] * direction[i]);
            pieces.push(Piece { from, tangent: *direction, curvature: [0.0; JOINT_COUNT], length: straight });
        }
        let (cut, corner) = (cuts[k + 1], &distinct[k + 1]);
        if cut > 0.0 {
            pieces.push(Piece {
                from: std::array::from_fn(|i| corner[i] - cut * direction[i]),
                tangent: *direction,
                curvature: std::array::from_fn(|i| (directions[k + 1][i] - direction[i]) / (2.0 * cut)),
                length: 2.0 * cut,
            });
        }
    }
    pieces
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_path_is_smooth_and_near_its_corners(
            corners in prop::collection::vec(prop::array::uniform7(-2.0..2.0f64), 2..7), deviation in 0.001..0.2f64,
        ) {
            let pieces = blended(&corners, deviation);
            prop_assert!(distance(&pieces[0].from, &corners[0]) < 1e-12);
            for w in pieces.windows(2) {
                prop_assert!(distance(&w[0].at(w[0].length), &w[1].from) < 1e-6);
                prop_assert!(distance(&w[0].derivative(w[0].length), &w[1].tangent) < 1e-9);
            }
            let last = pieces[pieces.len() - 1];
            prop_assert!(distance(&last.at(last.length), &corners[corners.len() - 1]) < 1e-6);
            for corner in &corners[1..corners.len() - 1] {
                let nearest = pieces.iter().map(|p| distance(&p.at(0.5 * p.length), corner)).fold(f64::INFINITY, f64::min);
                prop_assert!(nearest <= deviation + 1e-9);
            }
        }
    }

    #[test]
    fn a_path_that_goes_nowhere_has_no_pieces() {
        assert!(blended(&[[0.1; 7]; 3], 0.01).is_empty());
    }
}
