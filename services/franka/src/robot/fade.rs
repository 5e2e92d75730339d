//! What set-points are off the arm's way by, and how that fades out.
//!
//! A motion begins where the robot holds its joints, a little off where the arm stands. In the midst of one, the robot that gets no set-points
//! goes on by itself with the acceleration that it had, and holds its joints off the arm's way once they come again. In both, the next set-points
//! go on from where the robot is, as fast and as accelerated as it is, and come back to the arm's way.
//!
//! A robot judges set-points by their differences over a millisecond. What fades out is a quintic through the last three offsets, not one of their
//! derivatives, so that the differences go on exactly.

use repose_panda::{JOINT_COUNT, JointLimits, Joints};

const DT_MS: f64 = 1.0;
/// In how many milliseconds it may fade out.
const SPANS_MS: [f64; 8] = [20.0, 40.0, 80.0, 150.0, 250.0, 400.0, 600.0, LONGEST_MS as f64];
/// The longest of these.
pub const LONGEST_MS: u64 = 1000;
/// What is as good as nothing where a motion ends: so far off, radians, and so far from there a millisecond before.
const NOTHING_RAD: f64 = 1e-6;
const STILL_RAD: f64 = 1e-8;
/// In how many places a span is looked at for what it asks of the joints.
const LOOKS: usize = 24;

/// How many times as long as the gap before it a fade is at least: in another such gap the robot goes on with the fade's acceleration.
const GAPS: f64 = 8.0;

/// What a fade after a gap may ask.
#[derive(Debug, Clone, Copy)]
pub struct FadeBounds<'a> {
    /// Of the joints.
    pub limits: &'a JointLimits,
    /// The share of the limits that it may take.
    pub share: f64,
    /// How long the gap was, milliseconds.
    pub gap_ms: f64,
}

/// An offset that fades out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fade {
    /// Per joint, of `(span - t)³ (c₀ + c₁ t + c₂ t²)`: radians, and milliseconds in `t` and the span.
    coefficients: [[f64; 3]; JOINT_COUNT],
    span_ms: f64,
    at_ms: f64,
}

impl Default for Fade {
    /// Nothing is off.
    fn default() -> Self {
        Self { coefficients: [[0.0; 3]; JOINT_COUNT], span_ms: 0.0, at_ms: 0.0 }
    }
}

impl Fade {
    /// From an offset (radians) at rest to none, in so many milliseconds.
    pub fn at_rest(offset_rad: &Joints, span_ms: f64) -> Self {
        Self::through(&[*offset_rad; 3], span_ms)
    }

    /// From offsets (radians) of now, a millisecond ago and two to none: in the shortest span that is within bounds, so that it is over soon, before
    /// the next gap; where none is, in the one that asks least of the joints.
    pub fn going_on(offsets_rad: &[Joints; 3], bounds: &FadeBounds<'_>) -> Self {
        let spans = SPANS_MS.map(|span_ms| Self::through(offsets_rad, span_ms));
        let asks = spans.map(|fade| fade.share_of(bounds.limits));
        let least = || (1..spans.len()).fold(0, |least, i| if asks[i] < asks[least] { i } else { least });
        let is_within = |&i: &usize| asks[i] <= bounds.share && spans[i].span_ms >= GAPS * bounds.gap_ms;
        spans[(0..spans.len()).find(is_within).unwrap_or_else(least)]
    }

    /// What is off after a millisecond more, radians.
    pub fn step(&mut self) -> Joints {
        self.at_ms += DT_MS;
        self.now()
    }

    /// What is off now, radians.
    pub fn now(&self) -> Joints {
        std::array::from_fn(|joint| self.at(joint, self.at_ms))
    }

    /// Whether it has come to its end.
    pub fn is_over(&self) -> bool {
        self.at_ms >= self.span_ms
    }

    /// Whether what is off is as good as nothing: where gaps follow each other faster than they fade out, no fade comes to its end.
    pub fn is_nothing(&self) -> bool {
        let is_nothing = |joint| {
            let (now, before) = (self.at(joint, self.at_ms), self.at(joint, self.at_ms - DT_MS));
            now.abs() <= NOTHING_RAD && (now - before).abs() <= STILL_RAD
        };
        (0..JOINT_COUNT).all(is_nothing)
    }

    fn through(offsets_rad: &[Joints; 3], span_ms: f64) -> Self {
        let coefficients = std::array::from_fn(|joint| {
            // Newton's form of the parabola that is left once the triple root at the end is divided out.
            let times = [0.0, -DT_MS, -2.0 * DT_MS];
            let values: [f64; 3] = std::array::from_fn(|i| offsets_rad[i][joint] / (span_ms - times[i]).powi(3));
            let first = (values[0] - values[1]) / DT_MS;
            let second = (first - (values[1] - values[2]) / DT_MS) / (2.0 * DT_MS);
            [values[0], first + DT_MS * second, second]
        });
        Self { coefficients, span_ms, at_ms: 0.0 }
    }

    fn at(&self, joint: usize, t_ms: f64) -> f64 {
        let [c0, c1, c2] = self.coefficients[joint];
        (self.span_ms - t_ms).max(0.0).powi(3) * (c0 + t_ms * (c1 + t_ms * c2))
    }

    /// The largest share of a limit of velocity, acceleration or jerk that fading out takes by itself.
    fn share_of(&self, limits: &JointLimits) -> f64 {
        let h_ms = self.span_ms / LOOKS as f64;
        let h_s = h_ms * 1e-3;
        let joint_share = |joint: usize| {
            let values: [f64; LOOKS + 1] = std::array::from_fn(|k| self.at(joint, k as f64 * h_ms));
            let over = |differences: fn(&[f64]) -> f64, order: usize, limit: f64| {
                values.windows(order + 1).map(|w| differences(w).abs() / h_s.powi(order as i32) / limit).fold(0.0, f64::max)
            };
            over(|w| w[1] - w[0], 1, limits.velocity_rad_s[joint])
                .max(over(|w| w[2] - 2.0 * w[1] + w[0], 2, limits.acceleration_rad_s2[joint]))
                .max(over(|w| w[3] - 3.0 * w[2] + 3.0 * w[1] - w[0], 3, limits.jerk_rad_s3[joint]))
        };
        (0..JOINT_COUNT).map(joint_share).fold(0.0, f64::max)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use repose_panda::Model;

    use super::*;

    proptest! {
        #[test]
        fn it_goes_on_from_what_was_and_ends_in_nothing_at_rest(
            offset_rad in -0.01..0.01f64, speed_rad_s in -0.3..0.3f64, acceleration_rad_s2 in -5.0..5.0f64,
        ) {
            let before = offset_rad - speed_rad_s * 1e-3;
            let offsets = [offset_rad, before, before - (speed_rad_s - acceleration_rad_s2 * 1e-3) * 1e-3];
            let limits = Model::Fr3.limits();
            let mut fade = Fade::going_on(&offsets.map(|offset| [offset; JOINT_COUNT]), &FadeBounds { limits: &limits, share: 0.05, gap_ms: 2.0 });
            let mut trace: Vec<f64> = offsets.iter().rev().copied().collect();
            while !fade.is_over() {
                trace.push(fade.step()[0]);
            }
            trace.extend((0..3).map(|_| fade.step()[0]));
            prop_assert_eq!(&trace[trace.len() - 4..], &[0.0; 4]);
            let differences: Vec<f64> = trace.windows(4).map(|w| (w[3] - 3.0 * w[2] + 3.0 * w[1] - w[0]) * 1e9).collect();
            let jerk = differences.iter().fold(0.0f64, |most, jerk| most.max(jerk.abs()));
            prop_assert!(jerk < 0.5 * limits.jerk_rad_s3[0], "{jerk} rad/s³ in {} ms", fade.span_ms);
        }
    }

    #[test]
    fn an_offset_at_rest_fades_as_the_smooth_step_does() {
        let mut fade = Fade::at_rest(&[0.005; JOINT_COUNT], 500.0);
        for k in 1..=500 {
            let smooth = 0.005 * (1.0 - repose_panda::smooth_step(f64::from(k) / 500.0));
            // The quintic's derivatives at its first place are those of differences: a hair apart.
            assert!((fade.step()[3] - smooth).abs() < 2e-5);
        }
        assert!(fade.is_over());
    }
}
