//! The hand: what it was told to do, and what came of it.

use repose_robot_side::GripperState;
use repose_ros_messages::GripperCommandResult;

use super::unended::CANCEL_EVERY_MS;

/// By how much the fingers close further when what they held has gone or slipped, metres.
const LOST_M: f64 = 0.004;
/// Fingers that stand further apart than they were told, by more than this, stand against something, metres.
const BETWEEN_M: f64 = 0.002;
/// Fingers that have moved by less than this, metres, for so long, milliseconds, stand.
const STILL_M: f64 = 0.001;
const STANDS_MS: u64 = 300;

/// What is known of a hand.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Hand {
    /// The number of the goal that its controller has.
    goal: Option<u64>,
    /// Whether something stalls the fingers on their way.
    stalls: bool,
    /// When the goal was last canceled, milliseconds.
    canceled_ms: Option<u64>,
    /// Since when nobody knows whether the controller has the goal, or is still at it, milliseconds.
    lost_ms: Option<u64>,
    /// How wide the fingers stand, as they were last told to be or said to be, metres.
    width_m: f64,
    /// How wide they were last told to stand, metres.
    told_m: f64,
    /// How wide something held them apart, metres.
    held_at_m: Option<f64>,
    /// How wide something had held them apart as they were sent elsewhere, metres, until it is known what became of it.
    had_m: Option<f64>,
    /// How wide they stood as they last closed further on what they hold no more, metres, and when, milliseconds.
    slipped: Option<(f64, u64)>,
}

impl Hand {
    /// It was sent to a width, metres.
    pub fn sent(&mut self, number: u64, width_m: f64) {
        self.had_m = self.held_at_m.map(|held_m| held_m.max(self.width_m)).or(self.had_m);
        (self.goal, self.told_m, self.held_at_m, self.slipped) = (Some(number), width_m, None, None);
        (self.stalls, self.canceled_ms, self.lost_ms) = (false, None, None);
    }

    /// The controller says on the way that something stalls the fingers.
    pub fn stalled(&mut self, number: u64) {
        self.stalls |= self.goal == Some(number);
    }

    /// The goal of a robot that is stopped which is to be canceled now: none where something is between the fingers, for it must not fall.
    pub fn to_cancel(&mut self, now_ms: u64) -> Option<u64> {
        let goal = self.goal.filter(|_| !self.stalls && self.canceled_ms.is_none_or(|last_ms| now_ms >= last_ms + CANCEL_EVERY_MS))?;
        self.canceled_ms = Some(now_ms);
        Some(goal)
    }

    /// The controller has ended a goal, with a result where there is one; `width_m` is what its position means. Whether it was to carry that out:
    /// no goal of before, and none that was canceled.
    pub fn ended(&mut self, number: u64, result: Option<&GripperCommandResult>, width_m: f64) -> bool {
        if self.goal != Some(number) {
            return false;
        }
        self.goal = None;
        if let Some(result) = result {
            self.width_m = width_m;
            self.held_at_m = (result.stalled && !result.reached_goal).then_some(width_m);
            // Of one that was canceled or failed, what is measured then tells what became of what it had.
            if self.held_at_m.is_some() || result.reached_goal || self.is_there() {
                self.had_m = None;
            }
        }
        self.canceled_ms.is_none()
    }

    /// The controller does not answer, and may have the goal all the same: it stays one to be canceled. Whether it was to carry that out, as with
    /// [`Self::ended`].
    pub fn lost(&mut self, number: u64, now_ms: u64) -> bool {
        if self.goal != Some(number) {
            return false;
        }
        self.lost_ms = Some(now_ms);
        self.canceled_ms.is_none()
    }

    /// The controller says to a cancel that it carries out no such goal. Within `patience_ms` of its being lost the goal may still be on its way; of
    /// one that is not lost the end is told.
    pub fn not_there(&mut self, number: u64, now_ms: u64, patience_ms: u64) {
        let is_over = self.lost_ms.is_some_and(|lost_ms| now_ms >= lost_ms + patience_ms);
        if self.goal == Some(number) && is_over {
            self.goal = None;
        }
    }

    /// Whether a goal is still to be canceled though the stop for which it was is cleared: one that may be carried out late.
    pub fn is_given_up(&self) -> bool {
        self.goal.is_some() && (self.canceled_ms.is_some() || self.lost_ms.is_some())
    }

    /// Whether the fingers stand where they were told to be.
    pub fn is_there(&self) -> bool {
        (self.width_m - self.told_m).abs() <= LOST_M
    }

    /// The fingers were measured, metres. Those that close further have lost what they held, until they stand against it where it is thinner; those that
    /// were to open and have not still have it.
    pub fn measured(&mut self, width_m: f64, now_ms: u64) {
        self.width_m = width_m;
        let has_closed = |held_m: Option<f64>| held_m.is_some_and(|held_m| width_m < held_m - LOST_M);
        if has_closed(self.held_at_m) || (self.goal.is_none() && has_closed(self.had_m)) {
            (self.held_at_m, self.had_m, self.slipped) = (None, None, Some((width_m, now_ms)));
        }
        if self.had_m.is_some_and(|had_m| width_m > had_m + LOST_M) {
            self.had_m = None;
        }
        let Some((at_m, since_ms)) = self.slipped else { return };
        if width_m <= self.told_m + BETWEEN_M {
            self.slipped = None;
        } else if (width_m - at_m).abs() > STILL_M {
            self.slipped = Some((width_m, now_ms));
        } else if now_ms >= since_ms + STANDS_MS {
            (self.held_at_m, self.slipped) = (Some(width_m), None);
        }
    }

    /// What a state says of it.
    pub fn state(&self) -> GripperState {
        let settled = self.goal.is_none() && self.slipped.is_none();
        let has_not_let_go = self.goal.is_none() && self.had_m.is_some();
        GripperState { width_m: self.width_m, settled, holding: self.held_at_m.is_some() || has_not_let_go }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hand_that_stalls_holds_until_its_fingers_close_further() {
        let mut hand = Hand::default();
        hand.sent(4, 0.01);
        assert!(!hand.state().settled);
        let stalled = GripperCommandResult { stalled: true, ..GripperCommandResult::default() };
        hand.ended(3, Some(&stalled), 0.05);
        assert!(!hand.state().settled, "of another goal");
        hand.ended(4, Some(&stalled), 0.05);
        assert_eq!(hand.state(), GripperState { width_m: 0.05, settled: true, holding: true });
        hand.measured(0.048, 0);
        assert!(hand.state().holding);
        hand.measured(0.01, 100);
        hand.measured(0.01, 1000);
        assert_eq!(hand.state(), GripperState { width_m: 0.01, settled: true, holding: false });
    }

    #[test]
    fn what_slips_and_is_held_again_where_it_is_thinner_is_held() {
        let mut hand = Hand::default();
        hand.sent(1, 0.01);
        hand.ended(1, Some(&GripperCommandResult { stalled: true, ..GripperCommandResult::default() }), 0.05);
        for k in 0..10u32 {
            hand.measured(0.05 - 0.002 * f64::from(k), 100 * u64::from(k));
        }
        assert_eq!(hand.state(), GripperState { width_m: 0.032, settled: false, holding: false }, "they are still closing");
        hand.measured(0.032, 1100);
        assert!(!hand.state().holding);
        hand.measured(0.032, 1200);
        assert_eq!(hand.state(), GripperState { width_m: 0.032, settled: true, holding: true });
    }

    #[test]
    fn a_hand_that_was_to_open_and_has_not_still_has_what_it_had() {
        let holding = || {
            let mut hand = Hand::default();
            hand.sent(1, 0.01);
            hand.ended(1, Some(&GripperCommandResult { stalled: true, ..GripperCommandResult::default() }), 0.05);
            hand.measured(0.05, 0);
            hand.sent(2, 0.08);
            assert!(!hand.state().holding, "it is letting go");
            hand
        };
        // A result of a goal that was canceled may be empty; a refusal has none.
        for result in [Some(GripperCommandResult::default()), None] {
            for (fingers_m, holds) in [(0.05, true), (0.052, true), (0.06, false), (0.03, false)] {
                let mut hand = holding();
                hand.measured(fingers_m, 100);
                hand.ended(2, result.as_ref(), 0.0);
                hand.measured(fingers_m, 200);
                hand.measured(fingers_m, 300);
                assert_eq!(hand.state().holding, holds, "{fingers_m} {result:?}");
            }
        }
        // One that has opened has let go, though its joints are told late.
        let mut hand = holding();
        hand.ended(2, Some(&GripperCommandResult { reached_goal: true, ..GripperCommandResult::default() }), 0.08);
        hand.measured(0.05, 100);
        assert!(!hand.state().holding);
    }

    #[test]
    fn a_goal_that_was_canceled_was_not_to_be_carried_out_any_more() {
        let mut hand = Hand::default();
        hand.sent(1, 0.0);
        assert_eq!(hand.to_cancel(0), Some(1));
        assert!(!hand.ended(1, None, 0.0));
    }

    #[test]
    fn a_hand_that_reached_its_width_or_was_refused_holds_nothing() {
        let mut hand = Hand::default();
        hand.sent(1, 0.08);
        hand.ended(1, Some(&GripperCommandResult { reached_goal: true, stalled: true, ..GripperCommandResult::default() }), 0.08);
        assert!(!hand.state().holding);
        hand.sent(2, 0.0);
        assert!(!hand.ended(1, None, 0.0) && hand.ended(2, None, 0.0));
        assert_eq!(hand.state(), GripperState { width_m: 0.08, settled: true, holding: false });
    }
}
