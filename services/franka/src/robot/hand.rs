//! The hand: what it was told to do, and what came of it.
//!
//! Franka's hand has two commands: `move`, which goes to a width, and `grasp`, which closes until something resists, however narrow that is, and
//! presses with a force. A gripper action of the contract that is told to grasp something is a grasp. One that only closes, before the arm
//! goes around a thing or by a commander that does not say, is a move, and a grasp where the fingers do not get to their width.

use repose_panda::FINGER_OPENING_MAX_M;
use repose_proto::robot::GripperCommand;
use repose_robot_side::GripperState;

/// Things thinner than this are not told from fingers that reached their width, metres.
pub const HOLDING_M: f64 = 0.002;

/// A command for the hand.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum HandCommand {
    /// Open to a width, metres.
    Open(f64),
    /// Close to a width, metres, and where something is in between press against it with a force, newtons.
    Close(f64, f64),
    /// Close on something that should be wider than a width, metres, and press with a force, newtons.
    Grasp(f64, f64),
}

/// What the hand is to leave off when the robot is stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct HandHalt {
    /// Commands up to this one are not begun any more, nor gone on with.
    pub up_to: u64,
    /// Whether the one under way is stopped: not where something is held, which must not fall.
    pub stops: bool,
}

/// What the hand says of itself.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct HandReading {
    /// How far the fingers are apart, metres.
    pub width_m: f64,
    /// Whether it grasps something, as far as it can tell.
    pub grasps: bool,
    /// The number of the last command that has ended.
    pub ended: u64,
    /// The number of the last that it could not carry out, 0 where there is none: not one whose fingers did not get to their width, which is how
    /// closing on something ends, and on nothing.
    pub failed: u64,
    /// Whether it is there.
    pub connected: bool,
}

/// The hand as the driver sees it.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Hand {
    reading: HandReading,
    /// How many commands it was sent.
    sent: u64,
    /// The width that it was to close to, where it was to close, metres.
    closing_to_m: Option<f64>,
    /// The width that it was to open to, where it was to open, metres.
    opening_to_m: Option<f64>,
    /// The last command whose failure was told.
    told_failed: u64,
}

impl Hand {
    /// Takes what it says of itself.
    pub fn read(&mut self, reading: HandReading) {
        self.reading = reading;
    }

    /// Whether it is there.
    pub fn is_connected(&self) -> bool {
        self.reading.connected
    }

    /// The command that carries out a gripper action, with no more force than `max_force_n`, and its number. `is_to_grasp`: it was told what.
    pub fn command(&mut self, action: &GripperCommand, is_to_grasp: bool, max_force_n: f64) -> (u64, HandCommand) {
        let (width_m, force_n) = (action.width_m.clamp(0.0, FINGER_OPENING_MAX_M), action.force_n.min(max_force_n));
        let closes = width_m < self.reading.width_m;
        self.sent += 1;
        (self.closing_to_m, self.opening_to_m) = if closes { (Some(width_m), None) } else { (None, Some(width_m)) };
        let command = match (closes, is_to_grasp) {
            (true, true) => HandCommand::Grasp(width_m, force_n),
            (true, false) => HandCommand::Close(width_m, force_n),
            (false, _) => HandCommand::Open(width_m),
        };
        (self.sent, command)
    }

    /// What it is to leave off now.
    pub fn halt(&self) -> HandHalt {
        HandHalt { up_to: self.sent, stops: !self.grips() }
    }

    /// Whether a command has failed since this was last asked.
    pub fn take_failure(&mut self) -> bool {
        std::mem::replace(&mut self.told_failed, self.reading.failed) < self.reading.failed
    }

    /// Whether it has closed on something, be it that it still presses harder.
    fn grips(&self) -> bool {
        // What it had closed on before this driver was there it may have been sent to any width for.
        let closing_to_m = self.closing_to_m.or((self.sent == 0).then_some(0.0));
        self.reading.grasps && (closing_to_m.is_some_and(|width_m| self.reading.width_m > width_m + HOLDING_M) || self.has_not_let_go())
    }

    /// Whether it was to open and has not: an order that was left off when the robot was stopped, or that never reached it. It has what it had.
    fn has_not_let_go(&self) -> bool {
        self.is_settled() && self.opening_to_m.is_some_and(|width_m| self.reading.width_m < width_m - HOLDING_M)
    }

    /// Whether the last command has ended, or come to nothing.
    fn is_settled(&self) -> bool {
        self.reading.ended >= self.sent
    }

    /// What a state says of it.
    pub fn state(&self) -> GripperState {
        let settled = self.is_settled();
        GripperState { width_m: self.reading.width_m, settled, holding: settled && self.grips() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(width_m: f64, grasps: bool, ended: u64) -> HandReading {
        HandReading { width_m, grasps, ended, failed: 0, connected: true }
    }

    /// An open hand that was told to close on something.
    fn closing_to(width_m: f64) -> Hand {
        let mut hand = Hand::default();
        hand.read(at(0.08, false, 0));
        hand.command(&GripperCommand { width_m, force_n: 30.0 }, true, 70.0);
        hand
    }

    #[test]
    fn closing_grasps_with_no_more_force_than_allowed_and_opening_moves() {
        let mut hand = Hand::default();
        hand.read(at(0.08, false, 0));
        assert_eq!(hand.command(&GripperCommand { width_m: 0.06, force_n: 60.0 }, false, 40.0), (1, HandCommand::Close(0.06, 40.0)));
        assert_eq!(hand.command(&GripperCommand { width_m: 0.02, force_n: 60.0 }, true, 40.0), (2, HandCommand::Grasp(0.02, 40.0)));
        hand.read(at(0.03, true, 2));
        assert_eq!(hand.command(&GripperCommand { width_m: 0.08, force_n: 10.0 }, false, 40.0), (3, HandCommand::Open(0.08)));
    }

    #[test]
    fn what_keeps_the_fingers_apart_is_held_until_it_is_gone() {
        let mut hand = closing_to(0.01);
        hand.read(at(0.05, false, 0));
        assert_eq!(hand.state(), GripperState { width_m: 0.05, settled: false, holding: false }, "still closing");
        hand.read(at(0.04, true, 1));
        assert!(hand.state().holding && hand.state().settled);
        hand.read(at(0.01, false, 1));
        assert!(!hand.state().holding);
    }

    #[test]
    fn what_was_in_the_hand_before_the_driver_started_is_held() {
        let mut hand = Hand::default();
        hand.read(at(0.04, true, 0));
        assert!(hand.state().holding);
        hand.command(&GripperCommand { width_m: 0.08, force_n: 30.0 }, false, 70.0);
        hand.read(at(0.08, true, 1));
        assert!(!hand.state().holding, "it was to let go");
        let mut empty = Hand::default();
        empty.read(at(0.0005, true, 0));
        assert!(!empty.state().holding, "its fingers are closed");
    }

    #[test]
    fn a_failure_is_told_once() {
        let mut hand = closing_to(0.01);
        assert!(!hand.take_failure());
        hand.read(HandReading { failed: 1, ..at(0.08, false, 1) });
        assert!(hand.take_failure() && !hand.take_failure());
    }

    #[test]
    fn fingers_on_their_way_are_stopped_and_those_that_have_closed_on_something_are_not() {
        let mut hand = closing_to(0.01);
        hand.read(at(0.05, false, 0));
        assert_eq!(hand.halt(), HandHalt { up_to: 1, stops: true });
        hand.read(at(0.04, true, 0));
        assert_eq!(hand.halt(), HandHalt { up_to: 1, stops: false });
        hand.command(&GripperCommand { width_m: 0.08, force_n: 30.0 }, false, 70.0);
        assert_eq!(hand.halt(), HandHalt { up_to: 2, stops: true }, "it was to let go");
    }

    #[test]
    fn what_a_hand_was_to_let_go_of_and_did_not_is_still_held() {
        let mut hand = closing_to(0.0);
        hand.read(at(0.04, true, 1));
        hand.command(&GripperCommand { width_m: 0.08, force_n: 30.0 }, false, 70.0);
        assert!(!hand.state().holding, "it is letting go");
        // The order was left off, by a stop, or was lost with the connection.
        hand.read(at(0.04, true, 2));
        assert_eq!(hand.state(), GripperState { width_m: 0.04, settled: true, holding: true });
        assert_eq!(hand.halt(), HandHalt { up_to: 2, stops: false }, "it must not fall");
        hand.read(at(0.05, false, 2));
        assert!(!hand.state().holding, "the hand says that it has nothing");
    }

    #[test]
    fn fingers_that_reached_their_width_hold_nothing_whatever_the_hand_says() {
        let mut hand = closing_to(0.0);
        hand.read(at(0.0005, true, 1));
        assert_eq!(hand.state(), GripperState { width_m: 0.0005, settled: true, holding: false });
    }
}
