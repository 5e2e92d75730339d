//! Left, right, in front, behind, above, below: the appendix's six rules.
//!
//! `left(i, j)`: i's centre lies in the trapezoid that opens to the left from j's box at θ = 45°, in both planes that contain the
//! left-right axis (rules 1 to 4), left of all of j's corners (5), and all of i's corners lie left of j's centre (6). Front and below
//! are the same on their axes; right, behind and above are these with the objects exchanged, so the trapezoid is then the query's.
//!
//! Two things the appendix leaves open. "The upper corner" of a turned box is read as the upper corner of what its eight corners span
//! in the viewer's axes, on the side of the query: that is the corner of the figure where the box is level and faces the viewer, it
//! makes the same rules serve the baseline (whose box is never turned), and the highest corner itself would let the relation jump by a
//! box's width as an upright box tilts by a micron. And no rule holds at equality: a thing exactly on the border is on neither side.

use nalgebra::{Point3, Vector3};
use repose_geometry::{Aabb, OrientedBox, ViewerFrame};

/// What an object spans along the viewer's axes (x right, y away, z up), metres; and its box's centre there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ViewerExtents {
    /// Lowest coordinates of any corner.
    pub low: Point3<f64>,
    /// Highest coordinates of any corner.
    pub high: Point3<f64>,
    /// Centre of the box (not the centroid of a cloud).
    pub center: Point3<f64>,
}

impl ViewerExtents {
    /// What the corners of a box in the world span for a viewer.
    pub fn of_box(bounds: &OrientedBox, viewer: &ViewerFrame) -> Self {
        let viewer_from_world = viewer.viewer_from_world();
        let corners = bounds.corners().map(|c| viewer_from_world * c);
        let low = corners.iter().fold(corners[0], |low, c| low.inf(c));
        let high = corners.iter().fold(corners[0], |high, c| high.sup(c));
        Self { low, high, center: viewer_from_world * bounds.center() }
    }

    /// A box that is already in the viewer's axes.
    pub fn of_viewer_aabb(bounds_in_viewer: &Aabb) -> Self {
        let (low, high) = (bounds_in_viewer.min.cast::<f64>(), bounds_in_viewer.max.cast::<f64>());
        Self { low, high, center: nalgebra::center(&low, &high) }
    }

    /// Horizontal distance between the centres, metres.
    pub fn center_offset_m(&self, other: &Self) -> f64 {
        (self.center - other.center).xy().norm()
    }

    /// Distance between what the two span; 0 when that overlaps, metres.
    pub fn distance_m(&self, other: &Self) -> f64 {
        (self.low - other.high).sup(&(other.low - self.high)).sup(&Vector3::zeros()).norm()
    }
}

/// Margins of left, right, front, behind, above, below (metres), the contract's order.
pub fn directional_margins(query: &ViewerExtents, anchor: &ViewerExtents) -> [f64; 6] {
    const RIGHT: usize = 0;
    const AWAY: usize = 1;
    const UP: usize = 2;
    [
        toward_low(query, anchor, RIGHT),
        toward_low(anchor, query, RIGHT),
        toward_low(query, anchor, AWAY),
        toward_low(anchor, query, AWAY),
        toward_low(anchor, query, UP),
        toward_low(query, anchor, UP),
    ]
}

/// The least slack of the six rules for "i lies on the low side of j along `axis`", metres; positive where all hold.
///
/// NaN when any coordinate is: what is unknown lies on no side.
fn toward_low(i: &ViewerExtents, j: &ViewerExtents, axis: usize) -> f64 {
    // θ = 45°: the tangent is 1, and a slack along the axis times this is the distance to the line.
    const COS_THETA: f64 = std::f64::consts::FRAC_1_SQRT_2;
    let past_face = j.low[axis] - i.center[axis];
    let before_center = j.center[axis] - i.high[axis];
    let [first, second] = [(axis + 1) % 3, (axis + 2) % 3].map(|side| {
        let upper = past_face + j.high[side] - i.center[side];
        let lower = past_face + i.center[side] - j.low[side];
        [upper * COS_THETA, lower * COS_THETA]
    });
    let slacks = [first[0], first[1], second[0], second[1], past_face, before_center];
    // Not `f64::min`, which would pass over a NaN.
    slacks.into_iter().reduce(|least, slack| if slack < least || slack.is_nan() { slack } else { least }).unwrap_or(f64::NAN)
}
