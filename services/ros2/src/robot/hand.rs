//! The hand: what it was told to do, and what came of it.

use repose_robot_side::GripperState;
use repose_ros_messages::GripperCommandResult;

use super::unended::CANCEL_EVERY_MS;

/// By how much the fingers close further when what they held has gone, metres.
const LOST_M: f64 = 0.004;

/// What is known of a hand.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Hand {
    /// The number of the goal that its controller has.
    goal: Option<u64>,
    /// Whether something stalls the fingers on their way.
    stalls: bool,
    /// When the goal was last canceled, milliseconds.
    canceled_ms: Option<u64>,
    /// How wide the fingers stand, as they were last told to be or said to be, metres.
    width_m: f64,
    /// How wide something held them apart, metres.
    held_at_m: Option<f64>,
}

impl Hand {
    /// It was sent to a width.
    pub fn sent(&mut self, number: u64) {
        (self.goal, self.held_at_m) = (Some(number), None);
        (self.stalls, self.canceled_ms) = (false, None);
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

    /// The controller has ended a goal, with a result where there is one; `width_m` is what its position means.
    pub fn ended(&mut self, number: u64, result: Option<&GripperCommandResult>, width_m: f64) {
        if self.goal != Some(number) {
            return;
        }
        self.goal = None;
        if let Some(result) = result {
            self.width_m = width_m;
            self.held_at_m = (result.stalled && !result.reached_goal).then_some(width_m);
        }
    }

    /// The fingers were measured, metres.
    pub fn measured(&mut self, width_m: f64) {
        self.width_m = width_m;
        if self.held_at_m.is_some_and(|held_m| width_m < held_m - LOST_M) {
            self.held_at_m = None;
        }
    }

    /// What a state says of it.
    pub fn state(&self) -> GripperState {
        GripperState { width_m: self.width_m, settled: self.goal.is_none(), holding: self.held_at_m.is_some() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hand_that_stalls_holds_until_its_fingers_close_further() {
        let mut hand = Hand::default();
        hand.sent(4);
        assert!(!hand.state().settled);
        let stalled = GripperCommandResult { stalled: true, ..GripperCommandResult::default() };
        hand.ended(3, Some(&stalled), 0.05);
        assert!(!hand.state().settled, "of another goal");
        hand.ended(4, Some(&stalled), 0.05);
        assert_eq!(hand.state(), GripperState { width_m: 0.05, settled: true, holding: true });
        hand.measured(0.048);
        assert!(hand.state().holding);
        hand.measured(0.01);
        assert!(!hand.state().holding);
    }

    #[test]
    fn a_hand_that_reached_its_width_or_was_refused_holds_nothing() {
        let mut hand = Hand::default();
        hand.sent(1);
        hand.ended(1, Some(&GripperCommandResult { reached_goal: true, stalled: true, ..GripperCommandResult::default() }), 0.08);
        assert!(!hand.state().holding);
        hand.sent(2);
        hand.ended(2, None, 0.0);
        assert_eq!(hand.state(), GripperState { width_m: 0.08, settled: true, holding: false });
    }
}
