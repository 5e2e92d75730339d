//! The hand: what it was told to do, and what came of it.

use repose_panda::FINGER_OPENING_MAX_M;
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
    /// How wide they were measured last, metres.
    measured_m: Option<f64>,
    /// How wide they were last told to stand, metres.
    told_m: f64,
    /// Whether that was further together than they stood.
    closes: bool,
    /// Whether it was sent nowhere yet: what it may hold is from before this process.
    is_as_found: bool,
    /// How wide something held them apart, metres.
    held_at_m: Option<f64>,
    /// How wide something had held them apart as they were sent elsewhere, metres, until it is known what became of it.
    had_m: Option<f64>,
    /// How wide they stand, metres, and since when, milliseconds, while they may still be closing on something: on what has slipped, or within their
    /// controller's tolerance, which takes fingers to have arrived that something thin holds apart.
    closing_at: Option<(f64, u64)>,
}

impl Hand {
    /// A hand of which nothing is known yet. Where a controller moves it, what is between its fingers may be held from before; where none does, nobody
    /// could let go of it.
    pub fn found(has_controller: bool) -> Self {
        Self { is_as_found: has_controller, ..Self::default() }
    }

    /// It was sent to a width, metres.
    pub fn sent(&mut self, number: u64, width_m: f64) {
        self.is_as_found = false;
        self.closes = self.measured_m.is_some_and(|measured_m| width_m < measured_m);
        self.had_m = self.held_at_m.map(|held_m| held_m.max(self.width_m)).or(self.had_m);
        (self.goal, self.told_m, self.held_at_m, self.closing_at) = (Some(number), width_m, None, None);
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

    /// The controller has refused a goal. Whether it was to carry that out, as with [`Self::ended`].
    pub fn refused(&mut self, number: u64) -> bool {
        if self.goal != Some(number) {
            return false;
        }
        self.goal = None;
        self.canceled_ms.is_none()
    }

    /// The controller has ended a goal; `width_m` is what the result's position means. Whether it was to carry that out: no goal of before, and none
    /// that was canceled.
    pub fn ended(&mut self, number: u64, result: &GripperCommandResult, width_m: f64, now_ms: u64) -> bool {
        if self.goal != Some(number) {
            return false;
        }
        self.goal = None;
        self.width_m = width_m;
        self.held_at_m = (result.stalled && !result.reached_goal).then_some(width_m);
        let is_there = result.reached_goal || self.is_there();
        // Of one that was canceled or failed, what is measured then tells what became of what it had.
        if self.held_at_m.is_some() || is_there {
            self.had_m = None;
        }
        // Fingers that a cancel has stopped close no further.
        if self.held_at_m.is_none() && self.closes && (result.reached_goal || (is_there && self.canceled_ms.is_none())) {
            let apart_m = self.measured_m.filter(|measured_m| *measured_m > self.told_m + BETWEEN_M);
            self.closing_at = apart_m.map(|measured_m| (measured_m, now_ms));
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
        (self.width_m, self.measured_m) = (width_m, Some(width_m));
        if self.is_as_found {
            let between = BETWEEN_M..FINGER_OPENING_MAX_M - BETWEEN_M;
            self.had_m = between.contains(&width_m).then_some(width_m);
        }
        let has_closed = |held_m: Option<f64>| held_m.is_some_and(|held_m| width_m < held_m - LOST_M);
        if has_closed(self.held_at_m) || (self.goal.is_none() && has_closed(self.had_m)) {
            (self.held_at_m, self.had_m, self.closing_at) = (None, None, Some((width_m, now_ms)));
        }
        if self.had_m.is_some_and(|had_m| width_m > had_m + LOST_M) {
            self.had_m = None;
        }
        let Some((at_m, since_ms)) = self.closing_at else { return };
        if width_m <= self.told_m + BETWEEN_M {
            self.closing_at = None;
        } else if (width_m - at_m).abs() > STILL_M {
            self.closing_at = Some((width_m, now_ms));
        } else if now_ms >= since_ms + STANDS_MS {
            (self.held_at_m, self.closing_at) = (Some(width_m), None);
        }
    }

    /// What a state says of it.
    pub fn state(&self) -> GripperState {
        let settled = self.goal.is_none() && self.closing_at.is_none();
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
        hand.ended(3, &stalled, 0.05, 0);
        assert!(!hand.state().settled, "of another goal");
        hand.ended(4, &stalled, 0.05, 0);
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
        hand.ended(1, &GripperCommandResult { stalled: true, ..GripperCommandResult::default() }, 0.05, 0);
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
            hand.ended(1, &GripperCommandResult { stalled: true, ..GripperCommandResult::default() }, 0.05, 0);
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
                match result {
                    Some(result) => hand.ended(2, &result, 0.0, 100),
                    None => hand.refused(2),
                };
                hand.measured(fingers_m, 200);
                hand.measured(fingers_m, 300);
                assert_eq!(hand.state().holding, holds, "{fingers_m} {result:?}");
            }
        }
        // One that has opened has let go, though its joints are told late.
        let mut hand = holding();
        hand.ended(2, &GripperCommandResult { reached_goal: true, ..GripperCommandResult::default() }, 0.08, 100);
        hand.measured(0.05, 100);
        assert!(!hand.state().holding);
    }

    #[test]
    fn a_goal_that_was_canceled_was_not_to_be_carried_out_any_more() {
        let mut hand = Hand::default();
        hand.sent(1, 0.0);
        assert_eq!(hand.to_cancel(0), Some(1));
        assert!(!hand.refused(1));
    }

    #[test]
    fn a_hand_that_reached_its_width_or_was_refused_holds_nothing() {
        let mut hand = Hand::default();
        hand.sent(1, 0.08);
        hand.ended(1, &GripperCommandResult { reached_goal: true, stalled: true, ..GripperCommandResult::default() }, 0.08, 0);
        assert!(!hand.state().holding);
        hand.sent(2, 0.0);
        assert!(!hand.refused(1) && hand.refused(2));
        assert_eq!(hand.state(), GripperState { width_m: 0.08, settled: true, holding: false });
    }
    #[test]
    fn fingers_that_a_cancel_has_stopped_on_their_way_hold_nothing() {
        for (reached_goal, holds) in [(false, false), (true, true)] {
            let mut hand = Hand::default();
            hand.measured(0.08, 0);
            hand.sent(1, 0.01);
            hand.to_cancel(50);
            hand.measured(0.0135, 100);
            hand.ended(1, &GripperCommandResult { reached_goal, ..GripperCommandResult::default() }, 0.0135, 100);
            hand.measured(0.0135, 500);
            assert_eq!(hand.state(), GripperState { width_m: 0.0135, settled: true, holding: holds }, "reached: {reached_goal}");
        }
    }

    #[test]
    fn what_is_between_the_fingers_is_held_until_they_were_sent_somewhere() {
        for (has_controller, width_m, holds) in [(true, 0.05, true), (true, 0.08, false), (true, 0.001, false), (false, 0.05, false)] {
            let mut hand = Hand::found(has_controller);
            hand.measured(width_m, 0);
            assert_eq!(hand.state(), GripperState { width_m, settled: true, holding: holds }, "{width_m}");
        }
        let mut hand = Hand::found(true);
        hand.measured(0.05, 0);
        hand.measured(0.07, 100);
        assert!(hand.state().holding, "somebody moves them");
        hand.measured(0.08, 200);
        assert!(!hand.state().holding);
        hand.measured(0.05, 300);
        hand.sent(1, 0.08);
        hand.refused(1);
        assert!(hand.state().holding, "they have not opened");
    }
}
