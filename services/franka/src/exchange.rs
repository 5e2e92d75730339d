//! What passes between the control loop and the rest of the process, without either waiting for the other.
//!
//! The loop tries its ends and goes on: a queue that is empty or full costs it nothing. (The standard library's bounded channels take no lock
//! while nobody sleeps at them, and nobody does: the other side looks at them a few hundred times a second.) It writes no log either; what it has
//! to say goes out with its states.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Instant;

use repose_proto::robot::{EmergencyStop, RobotCommand, RobotState};

/// Commands that may wait for the loop; it looks every millisecond.
const COMMANDS: usize = 64;
/// Emergency stops that may wait; they are repeated.
const STOPS: usize = 16;
/// States and words that may wait for the network's side.
const TOLD: usize = 64;

/// How urgent a word is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
    /// Of interest when one looks.
    Debug,
    /// Worth knowing.
    Info,
    /// Somebody should see to it.
    Warn,
}

/// What the loop tells.
#[derive(Debug, Clone, PartialEq)]
pub enum Told {
    /// A state to put.
    State(Box<RobotState>),
    /// A word for the log.
    Word(Level, String),
}

/// The network's end.
pub struct CellEnd {
    /// Commands, with the time at which they came.
    pub commands: SyncSender<(Instant, RobotCommand)>,
    /// Emergency stops.
    pub stops: SyncSender<EmergencyStop>,
    /// What the loop tells.
    pub told: Receiver<Told>,
    /// Whether the loop is to end.
    pub end: Arc<AtomicBool>,
}

/// The control loop's end.
pub struct LoopEnd {
    /// Commands, with the time at which they came.
    pub commands: Receiver<(Instant, RobotCommand)>,
    /// Emergency stops.
    pub stops: Receiver<EmergencyStop>,
    told: SyncSender<Told>,
    end: Arc<AtomicBool>,
}

impl LoopEnd {
    /// Tells something; whether there was room for it.
    pub fn tell(&self, told: Told) -> bool {
        self.told.try_send(told).is_ok()
    }

    /// Whether the loop is to end.
    pub fn is_to_end(&self) -> bool {
        self.end.load(Ordering::Acquire)
    }
}

/// Both ends.
pub fn exchange() -> (CellEnd, LoopEnd) {
    let (commands_in, commands) = sync_channel(COMMANDS);
    let (stops_in, stops) = sync_channel(STOPS);
    let (told, told_out) = sync_channel(TOLD);
    let end = Arc::<AtomicBool>::default();
    (CellEnd { commands: commands_in, stops: stops_in, told: told_out, end: end.clone() }, LoopEnd { commands, stops, told, end })
}
