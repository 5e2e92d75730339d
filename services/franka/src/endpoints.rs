//! The driver on the cell's keys: commands and emergency stops in, states out.

use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use repose_proto::Payload;
use repose_proto::robot::{EmergencyStop, RobotCommand};
use repose_runtime::{Publisher, Session, Shutdown, Subscription, Traffic, refuse_a_second_driver};
use tokio::time::MissedTickBehavior;

use crate::error::DriverError;
use crate::exchange::{CellEnd, Level, Told};

/// Commands and stops that may wait in the network.
const WAITING: usize = 64;
/// Between two looks at what the control loop tells.
const LOOK: Duration = Duration::from_millis(4);
/// How long an arm may take to come to rest when the driver is told to end.
const END: Duration = Duration::from_secs(3);

/// A robot's keys.
pub struct RobotKeys {
    name: String,
    stops: Subscription,
    commands: Subscription,
    states: Publisher,
}

impl RobotKeys {
    /// Joins a robot to its keys.
    ///
    /// # Errors
    /// When another driver of that name is there, or the network refuses.
    pub async fn join(session: &Session, robot: &str) -> Result<Self, DriverError> {
        refuse_a_second_driver(session, robot).await?;
        let cell = session.cell();
        Ok(Self {
            name: robot.to_owned(),
            stops: session.subscribe_queue(&cell.robot_estop(robot), WAITING).await?,
            commands: session.subscribe_queue(&cell.robot_command(robot), WAITING).await?,
            states: session.publisher(cell.robot_state(robot), Traffic::RobotState),
        })
    }

    /// Passes on what comes and what the control loop tells, until that has ended. Told to end, the loop first brings the arm to rest.
    ///
    /// # Errors
    /// When the network closes.
    pub async fn serve(mut self, end: &CellEnd, is_over: impl Fn() -> bool, shutdown: Shutdown) -> Result<(), DriverError> {
        let mut looks = tokio::time::interval(LOOK);
        looks.set_missed_tick_behavior(MissedTickBehavior::Delay);
        let mut ends_by: Option<Instant> = None;
        loop {
            tokio::select! {
                biased;
                sample = self.stops.recv() => match sample {
                    // Whatever comes here stops the arm: its form does not matter. Where too many wait, this one is repeated.
                    Some(sample) => drop(end.stops.try_send(EmergencyStop::read(&sample.payload.bytes))),
                    None => return Ok(()),
                },
                sample = self.commands.recv() => {
                    let Some(sample) = sample else { return Ok(()) };
                    match sample.payload.decode_json::<RobotCommand>() {
                        // Where too many wait, this one is lost; commanders repeat what is not taken.
                        Ok(command) => drop(end.commands.try_send((Instant::now(), command))),
                        Err(error) => tracing::debug!(robot = self.name, %error, "a command that cannot be read"),
                    }
                }
                _ = looks.tick() => {
                    let over = is_over();
                    self.tell(end).await?;
                    if over || ends_by.is_some_and(|by| Instant::now() > by) {
                        return Ok(());
                    }
                }
                () = shutdown.requested(), if ends_by.is_none() => {
                    end.end.store(true, Ordering::Release);
                    ends_by = Some(Instant::now() + END);
                }
            }
        }
    }

    async fn tell(&self, end: &CellEnd) -> Result<(), DriverError> {
        while let Ok(told) = end.told.try_recv() {
            match told {
                Told::State(state) => {
                    // What the network refuses now it may take with the next state.
                    let _ = self.states.put(Payload::json(&*state)?).await;
                }
                Told::Word(Level::Debug, word) => tracing::debug!(robot = self.name, "{word}"),
                Told::Word(Level::Info, word) => tracing::info!(robot = self.name, "{word}"),
                Told::Word(Level::Warn, word) => tracing::warn!(robot = self.name, "{word}"),
            }
        }
        Ok(())
    }
}
