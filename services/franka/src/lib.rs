//! The driver of a real Franka robot: a cell's robot keys on one side, Franka's control interface (FCI) at 1 kHz on the other.
//!
//! It runs on the robot's host. [`robot`] is the robot: the rules that set-points, stops and recoveries keep, and the connection to the arm and
//! the hand. [`control`] is the loop that reads and moves the robot, in a thread of its own that never waits for the network; [`exchange`](mod@exchange) is
//! what passes between the two; [`endpoints`] is the network's side.

mod config;
pub mod control;
pub mod endpoints;
mod error;
pub mod exchange;
pub mod robot;

use repose_runtime::{Session, Shutdown};

pub use config::{FrankaConfig, Realtime};
pub use error::DriverError;

use control::Control;
use endpoints::RobotKeys;
use exchange::{Level, LoopEnd, Told, exchange};
use robot::connection::Connection;
use robot::gripper::HandLink;
use robot::side::Side;

/// Runs the driver until `shutdown`.
///
/// # Errors
/// When the configuration is unusable, another driver of the robot is there, or the robot is another one than the configuration says.
pub async fn run(session: Session, config: FrankaConfig, shutdown: Shutdown) -> Result<(), DriverError> {
    config.validate()?;
    let (side, settings) = (Side::new(config.side()?), config.connect()?);
    let keys = RobotKeys::join(&session, &config.name).await?;
    let hand = config.hand().map(HandLink::start).transpose().map_err(|source| DriverError::Thread { what: "the hand", source })?;
    let (cell, robot) = exchange();
    let (cpu, state_period) = (config.cpu, config.state_period());
    let drive = move || {
        prepare_thread(&robot, cpu);
        Control::new(side, robot, hand, state_period).run(move || Connection::open(&settings))
    };
    let thread = std::thread::Builder::new().name("control".to_owned()).spawn(drive);
    let thread = thread.map_err(|source| DriverError::Thread { what: "control", source })?;
    keys.serve(&cell, || thread.is_finished(), shutdown.clone()).await?;
    if !thread.is_finished() {
        // The network has closed, or the robot does not let go: it stops by itself without set-points.
        return if shutdown.is_requested() { Ok(()) } else { Err(DriverError::LoopEnded) };
    }
    thread.join().map_err(|_| DriverError::LoopEnded)?.map_err(DriverError::Robot)
}

/// Gives the control loop's thread the highest priority, and says where it may not have it.
fn prepare_thread(end: &LoopEnd, cpu: Option<usize>) {
    let word = match franka::realtime::set_current_thread_to_highest_scheduler_priority() {
        Ok(()) if franka::realtime::has_realtime_kernel() => (Level::Info, "the control loop has real-time priority".to_owned()),
        Ok(()) => (Level::Warn, "the control loop has real-time priority on a kernel that is not made for real time".to_owned()),
        Err(why) => (Level::Warn, format!("the control loop has no real-time priority: {why}")),
    };
    end.tell(Told::Word(word.0, word.1));
    if let Some(Err(why)) = cpu.map(franka::realtime::pin_current_thread_to_cpu) {
        end.tell(Told::Word(Level::Warn, why));
    }
}
