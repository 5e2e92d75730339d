//! Which of the points between the planes of the pads the fingers close on.
//!
//! Points that no finger fits between are one run. A solid object is one run and is taken across; the walls of something hollow are two, with room
//! for a finger between them. A hand whose middle is over a wall closes on that wall; one whose middle is over the hollow closes on both walls, as
//! the outer sides of both are between its fingers.

use std::ops::Range;

use repose_panda::FINGER_OPENING_MAX_M;

use super::contact::SlabPoint;
use super::settings::GripperSettings;

/// Further from the rest than the noise of depth is apart, metres.
pub const APART_M: f64 = 0.006;

/// What the fingers close on of the points between the planes of the pads (sorted along y): the run at the middle. Where the middle is over the hollow
/// between two walls, further from both than the noise of depth, it is both of them, if the hand opens wide enough for both. None where the fingers reach
/// nothing.
pub fn closed_on(slab: &[SlabPoint], settings: &GripperSettings) -> Option<Range<usize>> {
    let near = run_at_the_middle(slab, settings)?;
    let (low, high) = (slab[near.start].0.y, slab[near.end - 1].0.y);
    let beyond = if high < -APART_M && near.end < slab.len() {
        run_around(near.end, slab, settings)
    } else if low > APART_M && near.start > 0 {
        run_around(near.start - 1, slab, settings)
    } else {
        return Some(near);
    };
    let both = near.start.min(beyond.start)..near.end.max(beyond.end);
    let width_m = slab[both.end - 1].0.y - slab[both.start].0.y;
    let fits = beyond.len() >= settings.points_min && width_m <= settings.widest_m();
    Some(if fits { both } else { near })
}

/// The run of points (sorted along y) around the one nearest y = 0.
fn run_at_the_middle(slab: &[SlabPoint], settings: &GripperSettings) -> Option<Range<usize>> {
    let middle = (0..slab.len()).min_by(|a, b| slab[*a].0.y.abs().total_cmp(&slab[*b].0.y.abs()))?;
    let is_reached = slab[middle].0.y.abs() <= 0.5 * FINGER_OPENING_MAX_M;
    is_reached.then(|| run_around(middle, slab, settings)).filter(|run| run.len() >= settings.points_min)
}

/// The run of points (sorted along y) around one of them, ended by gaps that a finger and its room fit into.
fn run_around(point: usize, slab: &[SlabPoint], settings: &GripperSettings) -> Range<usize> {
    let gap_m = settings.finger_thickness_m + settings.clearance_min_m;
    let (mut start, mut end) = (point, point + 1);
    while start > 0 && slab[start].0.y - slab[start - 1].0.y < gap_m {
        start -= 1;
    }
    while end < slab.len() && slab[end].0.y - slab[end - 1].0.y < gap_m {
        end += 1;
    }
    start..end
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;

    /// Walls of 4 mm at these places along y, eight points each, sorted.
    fn walls(at_m: &[f64]) -> Vec<SlabPoint> {
        let place = |wall: f64| (0..8).map(move |k| wall - 0.002 + 0.0005 * f64::from(k));
        at_m.iter().flat_map(|wall| place(*wall)).enumerate().map(|(i, y)| (Vector3::new(0.0, y, 0.0), i)).collect()
    }

    fn closed_on_of(at_m: &[f64]) -> Range<usize> {
        closed_on(&walls(at_m), &GripperSettings::default()).expect("something is between the fingers")
    }

    #[test]
    fn over_the_hollow_the_fingers_close_on_both_walls_and_over_a_wall_on_that_alone() {
        assert_eq!(closed_on_of(&[-0.02, 0.03]), 0..16, "the middle is between the two");
        assert_eq!(closed_on_of(&[-0.05, 0.0]), 8..16);
        assert_eq!(closed_on_of(&[0.005, 0.045]), 0..8, "so near it may be over the wall");
        assert_eq!(closed_on_of(&[-0.06, -0.02, 0.03]), 8..24, "what is beyond the walls is not between the fingers");
    }

    #[test]
    fn of_two_walls_that_the_hand_does_not_open_for_the_nearer_one_is_closed_on() {
        assert_eq!(closed_on_of(&[-0.05, 0.04]), 8..16);
        assert_eq!(closed_on_of(&[-0.03, 0.06]), 0..8);
    }

    #[test]
    fn walls_that_no_finger_fits_between_are_one() {
        assert_eq!(closed_on_of(&[-0.02, 0.001]), 0..16);
    }

    #[test]
    fn what_the_fingers_do_not_reach_is_nothing_to_close_on() {
        assert_eq!(closed_on(&walls(&[0.06]), &GripperSettings::default()), None);
        assert_eq!(closed_on(&[], &GripperSettings::default()), None);
    }
}
