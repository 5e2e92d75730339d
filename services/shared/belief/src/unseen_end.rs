//! An end of an object that may be farther out than is believed, and how likely that is; [`crate::farther`] says so.

use nalgebra::{Isometry3, Point2, Vector2};

/// How much farther is asked, metres.
pub const STEPS_M: [f32; 6] = [0.005, 0.01, 0.02, 0.04, 0.08, 0.16];

/// An end that was turned up or down is none of those seen from above: less of its direction than this is level then.
const LEAST_LEVEL: f64 = 0.7;

/// An end of an object, seen from above, that may be farther out than is believed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct UnseenEnd {
    /// Where it points to, world axes.
    pub outwards: Vector2<f32>,
    /// How likely it is farther out than believed by more than each of [`STEPS_M`].
    pub chances: [f32; STEPS_M.len()],
}

impl UnseenEnd {
    /// How likely it is farther out than believed by more than a length, metres: between the steps in proportion.
    pub fn chance(&self, farther_m: f32) -> f32 {
        let at = STEPS_M.partition_point(|step_m| *step_m <= farther_m);
        let (Some(before), Some(after)) = (at.checked_sub(1), STEPS_M.get(at)) else {
            // Nearer than the first step, and beyond the last.
            return if at == 0 { self.chances[0] } else { 0.0 };
        };
        let share = (farther_m - STEPS_M[before]) / (after - STEPS_M[before]);
        self.chances[before] + (self.chances[at] - self.chances[before]) * share
    }

    /// The most that it is farther out by with this chance or more, metres; 0 where it is not.
    pub fn longest_m(&self, chance: f32) -> f32 {
        let Some(last) = self.chances.iter().rposition(|of_step| *of_step >= chance) else { return 0.0 };
        let (from_m, from) = (STEPS_M[last], self.chances[last]);
        match (STEPS_M.get(last + 1), self.chances.get(last + 1)) {
            (Some(to_m), Some(to)) if from > *to => from_m + (to_m - from_m) * (from - chance) / (from - to),
            _ => from_m,
        }
    }

    /// The same end of an object that turns out to go on so far, metres, as it may be after that.
    pub fn beyond(&self, known_m: f32) -> Self {
        let comes_there = self.chance(known_m).max(f32::MIN_POSITIVE);
        Self { chances: STEPS_M.map(|step_m| (self.chance(known_m + step_m) / comes_there).min(1.0)), ..*self }
    }

    /// The same end after a motion of the object; none where that turns it up or down.
    pub fn moved(&self, motion: &Isometry3<f64>) -> Option<Self> {
        let there = (motion.rotation * self.outwards.push(0.0).cast::<f64>()).xy();
        let level = there.norm();
        (level >= LEAST_LEVEL).then(|| Self { outwards: (there / level).cast(), ..*self })
    }

    /// How far out a place beyond an outline, seen from above, is in the direction of this end, metres; none where the outline, shifted that way, never
    /// comes there, and in the outline itself.
    pub fn out_m(&self, place: &Point2<f32>, corners: &[Point2<f32>]) -> Option<f32> {
        let along = Vector2::new(-self.outwards.y, self.outwards.x);
        let aside = |p: &Point2<f32>| (p - place).dot(&along);
        let mut nearest_m: Option<f32> = None;
        for (a, b) in corners.iter().zip(corners.iter().cycle().skip(1)) {
            let (from, to) = (aside(a), aside(b));
            // The edge crosses the line of the shift.
            if (from > 0.0) == (to > 0.0) {
                continue;
            }
            let crossing = a + (b - a) * (from / (from - to));
            let out_m = (place - crossing).dot(&self.outwards);
            nearest_m = Some(nearest_m.map_or(out_m, |nearest_m| nearest_m.min(out_m)));
        }
        nearest_m.filter(|out_m| *out_m > 0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn end(outwards: [f32; 2]) -> UnseenEnd {
        UnseenEnd { outwards: outwards.into(), chances: [0.6, 0.5, 0.4, 0.2, 0.1, 0.0] }
    }

    #[test]
    fn between_the_steps_a_chance_is_in_proportion() {
        let chances = [0.0, 0.005, 0.015, 0.03, 0.12, 0.16, 1.0].map(|m| end([1.0, 0.0]).chance(m));
        let expected = [0.6, 0.6, 0.45, 0.3, 0.05, 0.0, 0.0];
        assert!(chances.iter().zip(expected).all(|(is, expected)| (is - expected).abs() < 1e-6), "{chances:?}");
        let longest = [0.7, 0.6, 0.3, 0.15, 0.05].map(|chance| end([1.0, 0.0]).longest_m(chance));
        let expected = [0.0, 0.005, 0.03, 0.06, 0.12];
        assert!(longest.iter().zip(expected).all(|(is, expected)| (is - expected).abs() < 1e-6), "{longest:?}");
        // Of the four of ten that come as far as 2 cm, two go on by 2 cm more.
        let beyond = end([1.0, 0.0]).beyond(0.02);
        assert!((beyond.chances[2] - 0.5).abs() < 1e-6 && beyond.chances[5] == 0.0, "{beyond:?}");
    }

    #[test]
    fn a_place_is_as_far_out_as_the_outline_must_be_shifted_to_come_there() {
        let square = [[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]].map(Point2::from);
        let out_m = |outwards: [f32; 2], place: [f32; 2]| end(outwards).out_m(&place.into(), &square);
        let is =
            |value: Option<f32>, expected: f32| assert!(value.is_some_and(|m| (m - expected).abs() < 1e-6), "{value:?}, not {expected}");
        is(out_m([1.0, 0.0], [0.08, 0.02]), 0.03);
        is(out_m([0.0, -1.0], [0.01, -0.15]), 0.1);
        let half = std::f32::consts::FRAC_1_SQRT_2;
        is(out_m([half, half], [0.06, 0.06]), 0.01 / half);
        for (outwards, place) in [([1.0, 0.0], [0.08, 0.07]), ([1.0, 0.0], [-0.08, 0.0]), ([1.0, 0.0], [0.0, 0.0])] {
            assert_eq!(out_m(outwards, place), None, "{outwards:?} {place:?}");
        }
    }

    #[test]
    fn an_end_turns_with_its_object_and_is_none_once_it_points_up() {
        let turned = |axis: nalgebra::Vector3<f64>, rad: f64| end([1.0, 0.0]).moved(&Isometry3::rotation(axis * rad));
        let quarter = std::f64::consts::FRAC_PI_2;
        let left = turned(nalgebra::Vector3::z(), quarter).expect("about the vertical");
        assert!((left.outwards - Vector2::y()).norm() < 1e-6 && left.chances == end([1.0, 0.0]).chances);
        assert_eq!(turned(nalgebra::Vector3::y(), quarter), None);
        assert!(turned(nalgebra::Vector3::x(), quarter).is_some_and(|same| (same.outwards - Vector2::x()).norm() < 1e-6));
    }
}
