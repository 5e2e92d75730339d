//! How far two objects are apart at the heights that both reach: band by band of their clouds, cut level.
//!
//! A plane between whole hulls says too little of what is wide at one height and narrow at another, and a circle through all points too
//! little of what is round at each height only. In a band a few points make a circle, or an outline that half a turn completes.

use nalgebra::{Vector2, Vector3};

use super::cloud::{MeasuredCloud, OutlineSource};
use super::gap::CLOSE_M;
use super::middles::{Circle, Guess};
use super::slices::{Band, Span, direction, directions};

/// By how much the best of [`directions`] is turned afterwards, radians.
const TURNS_RAD: [f32; 4] = [0.2, 0.1, 0.05, 0.025];
/// Circles whose points may be this much above or below the other's, metres.
const SLACK_M: f32 = 0.005;
/// Radii below this count as this where a residual is given as a share of them, metres.
const RADIUS_LEAST_M: f32 = 0.005;

/// What of an outline the gaps are given for.
pub(super) const OUTLINES: [OutlineSource; 4] = [
    OutlineSource::Restored,
    OutlineSource::Completed(Guess::Top),
    OutlineSource::Completed(Guess::Rectangle),
    OutlineSource::Completed(Guess::Circle),
];

/// A gap with what it was found between; far apart where two clouds share no height.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct CircleGap {
    /// Metres, [`CLOSE_M`] at most.
    pub gap_m: f32,
    /// How far points lie from the query's and the anchor's circle, as a share of its radius; zero where there is none.
    pub residuals: [f32; 2],
}

/// The least gap at one height between two outlines, metres, [`CLOSE_M`] at most, and the level direction of it, towards the query.
pub(super) fn outlines_apart(
    query: &MeasuredCloud,
    anchor: &MeasuredCloud,
    offset: &Vector3<f32>,
    outline: OutlineSource,
) -> (f32, Vector2<f32>) {
    let mut least = (CLOSE_M, Vector2::zeros());
    for (ours, theirs) in at_one_height(query, anchor, offset.z) {
        let between = Between { query, ours, anchor, theirs, offset: offset.xy(), outline };
        // Turning the line only widens a gap.
        let coarse = between.coarse();
        let (gap_m, angle_rad) = if coarse.0 < least.0 { between.refined(coarse) } else { coarse };
        if gap_m < least.0 {
            least = (gap_m, direction(angle_rad));
        }
    }
    least
}

/// The least gap at one height between the two clouds' circles.
pub(super) fn circles_apart(query: &MeasuredCloud, anchor: &MeasuredCloud, offset: &Vector3<f32>) -> CircleGap {
    let far = CircleGap { gap_m: CLOSE_M, residuals: [0.0; 2] };
    let gaps = at_one_height(query, anchor, offset.z).filter_map(|(ours, theirs)| {
        let (ours, theirs) = (ours.circle.as_ref()?, theirs.circle.as_ref()?);
        let gap_m = (ours.middle + offset.xy() - theirs.middle).norm() - ours.radius - theirs.radius;
        Some(CircleGap { gap_m, residuals: [ours, theirs].map(share_off) })
    });
    gaps.fold(far, |least, next| if next.gap_m < least.gap_m { next } else { least })
}

/// The least distance of another cloud's points from a cloud's circle of the same height, [`CLOSE_M`] at most, with that circle's residual
/// as a share of its radius, and its radius. `offset` is the other's centroid minus the cloud's own.
pub(super) fn points_from_circle(cloud: &MeasuredCloud, other: &MeasuredCloud, offset: &Vector3<f32>) -> (f32, f32, f32) {
    let [x, y, z] = &other.axes;
    let mut least = (CLOSE_M, 0.0, 0.0);
    for (band, circle) in cloud.bands.iter().filter_map(|band| Some((band, band.circle.as_ref()?))) {
        for i in 0..z.len() {
            let height_m = z[i] + offset.z;
            if height_m >= band.low_m - SLACK_M && height_m <= band.high_m + SLACK_M {
                let gap_m = (Vector2::new(x[i], y[i]) + offset.xy() - circle.middle).norm() - circle.radius;
                if gap_m < least.0 {
                    least = (gap_m, share_off(circle), circle.radius);
                }
            }
        }
    }
    least
}

fn share_off(circle: &Circle) -> f32 {
    circle.residual / circle.radius.max(RADIUS_LEAST_M)
}

/// The bands of the query and the anchor that share a height.
fn at_one_height<'a>(query: &'a MeasuredCloud, anchor: &'a MeasuredCloud, up_m: f32) -> impl Iterator<Item = (&'a Band, &'a Band)> + 'a {
    let shared = move |ours: &Band, theirs: &Band| ours.low_m + up_m <= theirs.high_m && theirs.low_m <= ours.high_m + up_m;
    query
        .bands
        .iter()
        .flat_map(move |ours| anchor.bands.iter().filter(move |theirs| shared(ours, theirs)).map(move |theirs| (ours, theirs)))
}

/// Two bands of one height, and what of their outlines is measured.
struct Between<'a> {
    query: &'a MeasuredCloud,
    ours: &'a Band,
    anchor: &'a MeasuredCloud,
    theirs: &'a Band,
    offset: Vector2<f32>,
    outline: OutlineSource,
}

impl Between<'_> {
    /// The gap along a direction towards the query, with what the anchor's and the query's points span along it; negative where they overlap.
    fn gap_m(&self, u: &Vector2<f32>, theirs: Span, ours: Span) -> f32 {
        let reach = |cloud: &MeasuredCloud, u: &Vector2<f32>, span: Span| {
            let beyond_m = cloud.rim.beyond_m([u.x, u.y, 0.0]);
            match self.outline {
                OutlineSource::Observed => span.most,
                OutlineSource::Restored => span.most + beyond_m,
                // The rim is as wide in the opposite direction.
                OutlineSource::Completed(guess) => span.most.max(cloud.turned_reach(u, -span.least, guess)) + beyond_m,
            }
        };
        u.dot(&self.offset) - reach(self.query, &-u, ours.opposite()) - reach(self.anchor, u, theirs)
    }

    /// The widest of the gaps along [`directions`], and its angle.
    fn coarse(&self) -> (f32, f32) {
        let spans = self.theirs.spans.iter().zip(&self.ours.spans);
        let known = directions().iter().zip(spans).map(|((u, angle_rad), (theirs, ours))| (self.gap_m(u, *theirs, *ours), *angle_rad));
        known.fold((f32::NEG_INFINITY, 0.0), widest)
    }

    /// The widest gap that a line between the outlines can have, near the best so far.
    fn refined(&self, mut best: (f32, f32)) -> (f32, f32) {
        let gap = |angle_rad: f32| {
            let u = direction(angle_rad);
            (self.gap_m(&u, Span::of(&self.theirs.points, &u), Span::of(&self.ours.points, &u)), angle_rad)
        };
        for turn_rad in TURNS_RAD {
            best = [best.1 - turn_rad, best.1 + turn_rad].into_iter().map(gap).fold(best, widest);
        }
        best
    }
}

fn widest(best: (f32, f32), next: (f32, f32)) -> (f32, f32) {
    if next.0 > best.0 { next } else { best }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::super::tests::{cuboid, measured};
    use super::*;

    /// A can that stands at the origin, seen from −y: the half of its wall towards the camera.
    fn front_of_can(radius: f32) -> MeasuredCloud {
        let wall = (0..=40).flat_map(|i| {
            let (sin, cos) = (-std::f32::consts::PI * i as f32 / 40.0).sin_cos();
            (0..=25).map(move |k| nalgebra::Point3::new(radius * cos, radius * sin, 0.004 * k as f32))
        });
        measured(&wall.collect::<Vec<_>>(), 0.0)
    }

    proptest! {
        #[test]
        fn the_gap_behind_a_can_follows_from_its_front(radius in 0.02..0.05f32, gap_m in 0.0..0.03f32) {
            let can = front_of_can(radius);
            let wall = cuboid([0.08, 0.01, 0.05], 0.0, 0.0);
            // The can's centroid is 2/π of its radius before its axis; the wall's near face is `gap_m` behind its back.
            let to_axis = can.middles.circle[1];
            let offset = Vector3::new(0.0, -(radius + gap_m + 0.01) - to_axis, 0.0);
            let (from_points, off, r) = points_from_circle(&can, &wall, &-offset);
            prop_assert!((from_points - gap_m).abs() < 0.003 && off < 0.05 && (r - radius).abs() < 0.002, "{from_points} {off} {r}");
            let (completed, normal) = outlines_apart(&can, &wall, &offset, OutlineSource::Completed(Guess::Circle));
            prop_assert!((completed - gap_m).abs() < 0.003 && normal.y < -0.95, "{completed} {normal}");
            let (restored, _) = outlines_apart(&can, &wall, &offset, OutlineSource::Restored);
            prop_assert!(restored > completed + 0.8 * radius || restored == CLOSE_M, "the back that does not show is missing: {restored}");
        }
    }

    #[test]
    fn what_shares_no_height_is_far_apart() {
        let (query, anchor) = (cuboid([0.03, 0.03, 0.03], 0.0, 0.0), cuboid([0.03, 0.03, 0.03], 0.0, 0.0));
        let above = Vector3::new(0.0, 0.0, 0.08);
        assert_eq!(outlines_apart(&query, &anchor, &above, OutlineSource::Restored).0, CLOSE_M);
        assert_eq!(circles_apart(&query, &anchor, &above).gap_m, CLOSE_M);
    }

    #[test]
    fn the_gap_of_two_cans_is_that_of_their_circles() {
        let (query, anchor) = (front_of_can(0.03), front_of_can(0.04));
        let between = Vector3::new(0.075, 0.0, 0.0) + Vector3::new(0.0, anchor.middles.circle[1] - query.middles.circle[1], 0.0);
        let CircleGap { gap_m, residuals } = circles_apart(&query, &anchor, &between);
        assert!((gap_m - 0.005).abs() < 0.002 && residuals.iter().all(|r| *r < 0.05), "{gap_m} {residuals:?}");
    }
}
