//! The hand: what it was told to do, and what came of it.

use repose_panda::FINGER_OPENING_MAX_M;
use repose_robot_side::GripperState;
use repose_ros_messages::GripperCommandResult;

use super::unended::CANCEL_EVERY_MS;

/// By how much the fingers close further when what they held has gone or slipped, metres.
const LOST_M: f64 = 0.004;
/// Fingers that stand further apart than they were told, by more than this, stand against something, metres.
const BETWEEN_M: f64 = 0.002;
/// Fingers that stand this far apart are wide open, and nothing is between them, metres.
const WIDE_OPEN_M: f64 = FINGER_OPENING_MAX_M - BETWEEN_M;
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
    /// How wide something had held them apart as they were sent elsewhere, or may hold them apart, metres, until it is known what became of it.
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
        // What came of a goal that is still open nobody tells any more.
        self.had_m = self.held_at_m.map(|held_m| held_m.max(self.width_m)).or(self.closed_on_m()).or(self.had_m);
        self.closes = self.measured_m.is_some_and(|measured_m| width_m < measured_m);
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
        let closed_on_m = self.closed_on_m();
        self.goal = None;
        self.width_m = width_m;
        self.held_at_m = (result.stalled && !result.reached_goal).then_some(width_m);
        let is_there = result.reached_goal || self.is_there();
        // Of one that was canceled or failed, what is measured then tells what became of what it had.
        if self.held_at_m.is_some() || is_there {
            self.had_m = None;
        }
        if self.held_at_m.is_none() && self.closes {
            let has_arrived = result.reached_goal || (is_there && self.canceled_ms.is_none());
            match closed_on_m.filter(|_| !has_arrived) {
                // Whether something or a cancel has stopped them nobody knows: they may have met it before the controller could tell.
                Some(_) => self.had_m = closed_on_m,
                // Where their joints are told late, they are not where they seem to be.
                None => self.closing_at = self.apart_m().map(|apart_m| (apart_m, now_ms)),
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
    /// one that is not lost the end is told. It may have been carried out long ago: what the fingers stand at may be held.
    pub fn not_there(&mut self, number: u64, now_ms: u64, patience_ms: u64) {
        let is_over = self.lost_ms.is_some_and(|lost_ms| now_ms >= lost_ms + patience_ms);
        if self.goal == Some(number) && is_over {
            self.had_m = self.closed_on_m().or(self.had_m);
            self.goal = None;
        }
    }

    /// Whether a goal is still to be canceled though the stop for which it was is cleared: one that may be carried out late.
    pub fn is_given_up(&self) -> bool {
        self.goal.is_some() && (self.canceled_ms.is_some() || self.lost_ms.is_some())
    }

    /// How wide the fingers stand, metres, where that is further apart than they were told.
    fn apart_m(&self) -> Option<f64> {
        self.measured_m.filter(|measured_m| *measured_m > self.told_m + BETWEEN_M)
    }

    /// How wide what their open goal may have closed on is, metres: fingers that have begun to close and are not where they were told may stand against it.
    fn closed_on_m(&self) -> Option<f64> {
        self.apart_m().filter(|apart_m| self.goal.is_some() && self.closes && *apart_m < WIDE_OPEN_M)
    }

    /// Whether the fingers stand where they were told to be.
    pub fn is_there(&self) -> bool {
        (self.width_m - self.told_m).abs() <= LOST_M
    }

    /// The fingers were measured, metres. Those that close further have lost what they held, until they stand against it where it is thinner; those that
    /// were to open and have not still have it, unless they are wide open.
    pub fn measured(&mut self, width_m: f64, now_ms: u64) {
        (self.width_m, self.measured_m) = (width_m, Some(width_m));
        if self.is_as_found {
            let between = BETWEEN_M..WIDE_OPEN_M;
            self.had_m = between.contains(&width_m).then_some(width_m);
        }
        let has_closed = |held_m: Option<f64>| held_m.is_some_and(|held_m| width_m < held_m - LOST_M);
        if has_closed(self.held_at_m) || (self.is_untold() && has_closed(self.had_m)) {
            (self.held_at_m, self.had_m, self.closing_at) = (None, None, Some((width_m, now_ms)));
        }
        if self.had_m.is_some_and(|had_m| width_m > had_m + LOST_M || (had_m < WIDE_OPEN_M && width_m >= WIDE_OPEN_M)) {
            self.had_m = None;
        }
        let Some((at_m, since_ms)) = self.closing_at else { return };
        if width_m <= self.told_m + BETWEEN_M {
            self.closing_at = None;
        } else if (width_m - at_m).abs() > STILL_M {
            self.closing_at = Some((width_m, now_ms));
        } else if now_ms >= since_ms + STANDS_MS {
            (self.held_at_m, self.closing_at) = ((width_m < WIDE_OPEN_M).then_some(width_m), None);
        }
    }

    /// Whether no controller is to tell any more what becomes of the fingers: what is measured has to.
    fn is_untold(&self) -> bool {
        self.goal.is_none() || self.is_given_up()
    }

    /// What a state says of it. What may be held counts as held: an empty hand that is taken for a full one costs an opening, and a full one that is
    /// taken for an empty one what is in it.
    pub fn state(&self) -> GripperState {
        let settled = self.goal.is_none() && self.closing_at.is_none();
        let has_not_let_go = self.is_untold() && self.had_m.is_some();
        let may_have_closed = (self.stalls || self.is_given_up()) && self.closed_on_m().is_some();
        GripperState { width_m: self.width_m, settled, holding: self.held_at_m.is_some() || has_not_let_go || may_have_closed }
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

    /// A hand that was sent from wide open to a width, as its goal 1, and whose fingers have come so far, metres.
    fn closing(to_m: f64, at_m: f64) -> Hand {
        let mut hand = Hand::default();
        hand.measured(0.08, 0);
        hand.sent(1, to_m);
        hand.measured(at_m, 100);
        assert_eq!(hand.state(), GripperState { width_m: at_m, settled: false, holding: false });
        hand
    }

    #[test]
    fn fingers_that_a_cancel_has_stopped_on_their_way_may_have_closed_on_something() {
        for (at_m, reached_goal, holds) in
            [(0.0135, false, true), (0.0135, true, true), (0.05, false, true), (0.0115, false, false), (0.079, false, false)]
        {
            let mut hand = closing(0.01, at_m);
            hand.to_cancel(150);
            assert_eq!(hand.state(), GripperState { width_m: at_m, settled: false, holding: holds }, "{at_m}: it may have closed already");
            // What is told of where they are may be wrong: such a result may be empty.
            for width_m in [at_m, 0.0] {
                let mut hand = hand;
                hand.ended(1, &GripperCommandResult { reached_goal, ..GripperCommandResult::default() }, width_m, 200);
                hand.measured(at_m, 600);
                assert_eq!(hand.state(), GripperState { width_m: at_m, settled: true, holding: holds }, "{at_m}, reached: {reached_goal}");
            }
        }
    }

    #[test]
    fn fingers_that_a_cancel_has_stopped_and_that_are_told_of_late_may_have_closed_on_something() {
        let mut hand = closing(0.01, 0.079);
        hand.to_cancel(150);
        hand.ended(1, &GripperCommandResult::default(), 0.0, 200);
        hand.measured(0.06, 220);
        assert!(!hand.state().settled);
        hand.measured(0.06, 520);
        assert_eq!(hand.state(), GripperState { width_m: 0.06, settled: true, holding: true });
    }

    #[test]
    fn fingers_that_stop_short_without_a_word_of_why_may_have_closed_on_something() {
        let mut hand = closing(0.01, 0.05);
        assert!(hand.ended(1, &GripperCommandResult::default(), 0.05, 200));
        assert_eq!(hand.state(), GripperState { width_m: 0.05, settled: true, holding: true });
    }

    #[test]
    fn what_a_goal_that_nobody_tells_the_end_of_may_have_closed_on_is_held_until_the_fingers_move_on() {
        for (later_m, holds) in [(0.04, true), (0.042, true), (0.06, false), (0.079, false), (0.01, false)] {
            let mut hand = closing(0.01, 0.06);
            hand.lost(1, 100);
            hand.measured(0.04, 200);
            assert_eq!(hand.state(), GripperState { width_m: 0.04, settled: false, holding: true });
            hand.not_there(1, 1000, 2000);
            assert!(!hand.state().settled, "it may come late");
            hand.not_there(1, 2100, 2000);
            assert_eq!(hand.state(), GripperState { width_m: 0.04, settled: true, holding: true });
            hand.measured(later_m, 2200);
            assert_eq!(hand.state(), GripperState { width_m: later_m, settled: true, holding: holds }, "{later_m}");
        }
    }

    #[test]
    fn a_hand_whose_controller_has_fallen_silent_has_what_it_had_until_its_fingers_move_on() {
        for (told_m, at_m, holds) in [(0.08, 0.05, true), (0.08, 0.06, false), (0.0, 0.05, true), (0.0, 0.03, true), (0.0, 0.001, false)] {
            let mut hand = Hand::default();
            hand.sent(1, 0.01);
            hand.ended(1, &GripperCommandResult { stalled: true, ..GripperCommandResult::default() }, 0.05, 0);
            hand.measured(0.05, 0);
            hand.sent(2, told_m);
            hand.lost(2, 100);
            hand.measured(at_m, 200);
            assert_eq!(hand.state().holding, holds, "sent to {told_m}, at {at_m}");
        }
    }

    #[test]
    fn what_a_hand_was_closing_on_as_it_was_sent_elsewhere_is_in_it_until_it_opens() {
        let mut hand = closing(0.0, 0.04);
        hand.sent(2, 0.08);
        assert!(!hand.state().holding, "it is letting go");
        hand.to_cancel(200);
        assert!(hand.state().holding);
        hand.ended(2, &GripperCommandResult::default(), 0.0, 300);
        hand.measured(0.04, 400);
        assert_eq!(hand.state(), GripperState { width_m: 0.04, settled: true, holding: true });
    }

    #[test]
    fn fingers_that_are_wide_open_have_let_go_though_their_controller_does_not_say_so() {
        let mut hand = closing(0.0, 0.077);
        hand.to_cancel(150);
        hand.ended(1, &GripperCommandResult::default(), 0.0, 200);
        assert!(hand.state().holding);
        hand.sent(2, 0.08);
        hand.measured(0.08, 300);
        hand.ended(2, &GripperCommandResult::default(), 0.0, 400);
        hand.measured(0.08, 500);
        assert_eq!(hand.state(), GripperState { width_m: 0.08, settled: true, holding: false });
    }

    #[test]
    fn what_the_controller_says_to_stall_the_fingers_is_held_while_its_result_is_still_to_come() {
        let mut hand = closing(0.0, 0.04);
        hand.stalled(1);
        assert_eq!((hand.to_cancel(200), hand.state()), (None, GripperState { width_m: 0.04, settled: false, holding: true }));
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
