//! What the driver needs of a robot's control interface (FCI), so that the driver's rules can be tried on a robot made up for it.

use franka::{Errors, RobotMode};
use repose_panda::Joints;

/// What the robot says of itself, once a millisecond.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reading {
    /// The robot's clock, milliseconds.
    pub time_ms: u64,
    /// What it is doing.
    pub mode: RobotMode,
    /// Where its joints were measured, radians.
    pub measured_rad: Joints,
    /// Where it holds them, radians: where the next set-points have to begin.
    pub held_rad: Joints,
    /// How fast it moves them by its own word, radians per second, over the last millisecond.
    pub held_rad_s: Joints,
    /// How that changes, radians per second squared.
    pub held_rad_s2: Joints,
    /// The errors that are active.
    pub errors: Errors,
    /// The share of the last 100 set-points that came in time.
    pub success_rate: f64,
}

/// What the robot is to do next.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Next {
    /// Go to a set-point, radians, and ask again.
    Go(Joints),
    /// Stay at a set-point, radians, and end the motion.
    End(Joints),
}

/// Why a motion or the connection ended.
#[derive(Debug, Clone, PartialEq)]
pub enum Trouble {
    /// The robot stopped by itself, or refused to begin.
    Stopped {
        /// The robot's own name for it.
        kind: String,
        /// The same for a person.
        reason: String,
    },
    /// The robot is not there any more.
    Lost(String),
}

/// A robot's control interface.
pub trait Fci {
    /// Waits for the next reading of a robot that is not moved by this process.
    ///
    /// # Errors
    /// [`Trouble::Lost`].
    fn read(&mut self) -> Result<Reading, Trouble>;

    /// Moves the robot: `step` is asked once a millisecond, until it ends the motion or the robot does.
    ///
    /// # Errors
    /// [`Trouble`], by which the robot ended it.
    fn follow(&mut self, step: &mut dyn FnMut(&Reading) -> Next) -> Result<(), Trouble>;

    /// Has the robot acknowledge its errors; [`Self::recovered`] says what came of it. It takes a second or so and goes on beside readings.
    fn recover(&mut self);

    /// How the recovery ended that was begun last, once: the robot's refusal, if it refused.
    fn recovered(&mut self) -> Option<Result<(), String>>;
}
