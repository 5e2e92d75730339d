//! The control loop: a thread of its own that reads the robot once a millisecond, moves it, and hands out its states.
//!
//! It waits for nothing but the robot. While there is no connection it still takes emergency stops and shows its state; another thread connects.

use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use repose_panda::JointLimits;
use repose_proto::robot::RobotMode;

use crate::exchange::{Level, LoopEnd, Told};
use crate::robot::connection::ConnectError;
use crate::robot::fci::{Fci, Next, Reading, Trouble};
use crate::robot::gripper::HandLink;
use crate::robot::side::{Do, Refused, Side};

/// Between two looks while there is no connection.
const LOOK: Duration = Duration::from_millis(5);
/// Between two attempts to connect.
const AGAIN: Duration = Duration::from_secs(1);
/// Below this share of set-points in time the log says so.
const GOOD_SHARE: f64 = 0.95;
/// Between two such words.
const SHARE_EVERY: Duration = Duration::from_secs(5);

/// A robot, what it may be commanded under, and what is worth knowing of it.
pub type Connected<F> = (F, JointLimits, Vec<String>);

/// The loop beside the robot.
pub struct Control {
    side: Side,
    end: LoopEnd,
    hand: Option<HandLink>,
    state_period: Duration,
    started: Instant,
    next_state: Instant,
    shown: Option<(RobotMode, Option<String>)>,
    next_share: Instant,
}

impl Control {
    /// A loop that has not begun.
    pub fn new(side: Side, end: LoopEnd, hand: Option<HandLink>, state_period: Duration) -> Self {
        let now = Instant::now();
        Self { side, end, hand, state_period, started: now, next_state: now, shown: None, next_share: now }
    }

    /// Connects and drives the robot until it is told to end; again after every loss.
    ///
    /// # Errors
    /// When the robot is not the one that it should be.
    pub fn run<F, C>(mut self, connect: C) -> Result<(), ConnectError>
    where
        F: Fci + Send + 'static,
        C: Fn() -> Result<Connected<F>, ConnectError> + Send + Sync + 'static,
    {
        let connect = Arc::new(connect);
        loop {
            let Some((mut robot, limits, notes)) = self.connected(&connect)? else { return Ok(()) };
            notes.into_iter().for_each(|note| self.say(Level::Warn, note));
            if !self.side.connected(limits) {
                return Err(ConnectError::Unfit("another robot than before: its limits are others".to_owned()));
            }
            self.say(Level::Info, "connected".to_owned());
            match self.drive(&mut robot) {
                None => return Ok(()),
                Some(why) => {
                    self.say(Level::Warn, format!("the connection is lost ({why}); trying again"));
                    self.side.lost(why);
                    self.show();
                }
            }
        }
    }

    /// The robot once it can be reached; none when the loop is to end.
    fn connected<F, C>(&mut self, connect: &Arc<C>) -> Result<Option<Connected<F>>, ConnectError>
    where
        F: Fci + Send + 'static,
        C: Fn() -> Result<Connected<F>, ConnectError> + Send + Sync + 'static,
    {
        let mut said = String::new();
        loop {
            let tried = connect.clone();
            let attempt = std::thread::Builder::new().name("connect".to_owned()).spawn(move || tried());
            let attempt = attempt.map_err(|e| ConnectError::Unfit(format!("no thread to connect: {e}")))?;
            let Some(attempt) = self.awaited(attempt) else { return Ok(None) };
            match attempt {
                Ok(connected) => return Ok(Some(connected)),
                Err(ConnectError::Unreachable(why)) if why != said => {
                    self.say(Level::Warn, format!("{why}; trying again"));
                    said = why;
                }
                Err(ConnectError::Unreachable(_)) => {}
                Err(unfit) => return Err(unfit),
            }
            let next = Instant::now() + AGAIN;
            while Instant::now() < next {
                if !self.look() {
                    return Ok(None);
                }
            }
        }
    }

    /// What a thread comes to; none when the loop is to end before that.
    fn awaited<T>(&mut self, thread: JoinHandle<Result<T, ConnectError>>) -> Option<Result<T, ConnectError>> {
        while !thread.is_finished() {
            if !self.look() {
                return None;
            }
        }
        Some(thread.join().unwrap_or_else(|_| Err(ConnectError::Unfit("connecting panicked".to_owned()))))
    }

    /// A moment without a robot; whether to go on.
    fn look(&mut self) -> bool {
        self.take();
        self.show();
        std::thread::sleep(LOOK);
        !self.end.is_to_end()
    }

    /// Drives a connected robot; why it is lost, or none when the loop is to end.
    pub fn drive(&mut self, robot: &mut impl Fci) -> Option<String> {
        loop {
            let reading = match robot.read() {
                Ok(reading) => reading,
                Err(Trouble::Lost(why) | Trouble::Stopped { reason: why, .. }) => return Some(why),
            };
            if self.end.is_to_end() {
                return None;
            }
            self.take();
            if let Some(outcome) = robot.recovered() {
                match &outcome {
                    Ok(()) => self.say(Level::Info, "the robot has acknowledged its errors".to_owned()),
                    Err(why) => self.say(Level::Warn, format!("the robot does not acknowledge its errors: {why}")),
                }
                self.side.recovered(outcome, self.now_s());
            }
            match self.side.standing(&reading, self.now_s()) {
                Do::Read => {}
                Do::Recover => robot.recover(),
                Do::Follow => {
                    let outcome = robot.follow(&mut |reading| self.step(reading));
                    if let Err(trouble) = &outcome {
                        self.say(Level::Warn, format!("the motion has ended: {trouble:?}"));
                    }
                    let lost = matches!(&outcome, Err(Trouble::Lost(_)));
                    self.side.ended(outcome.clone());
                    if lost && let Err(Trouble::Lost(why)) = outcome {
                        return Some(why);
                    }
                }
            }
            self.command_hand();
            self.show();
        }
    }

    /// A millisecond of a motion.
    fn step(&mut self, reading: &Reading) -> Next {
        self.take();
        if self.end.is_to_end() {
            self.side.end();
        }
        let next = self.side.following(reading, self.now_s());
        self.command_hand();
        self.watch_share(reading);
        self.show();
        next
    }

    /// Takes what has come.
    fn take(&mut self) {
        while let Ok(stop) = self.end.stops.try_recv() {
            if !self.side.emergency_stop(&stop) {
                self.say(Level::Warn, format!("an emergency stop of {} came before the robot was reached", stop.source));
            }
        }
        if let Some(hand) = &self.hand {
            self.side.hand(hand.board.reading());
        }
        // Before a command that may clear the stop.
        self.halt_hand();
        while let Ok((received, command)) = self.end.commands.try_recv() {
            let received_s = received.saturating_duration_since(self.started).as_secs_f64();
            if let Err(refused) = self.side.command(&command, received_s, self.now_s()) {
                // Repeats are refused as a matter of course.
                let level = if matches!(refused, Refused::NotReady(_)) { Level::Warn } else { Level::Debug };
                self.say(level, format!("command {} of {} is not taken: {refused}", command.seq, command.owner.id));
            }
        }
    }

    /// Has the hand leave off what it does where a stop has latched.
    fn halt_hand(&mut self) {
        if let (Some(halt), Some(hand)) = (self.side.take_hand_halt(), &self.hand) {
            hand.halt(halt);
        }
    }

    fn command_hand(&mut self) {
        let Some(order) = self.side.take_hand_command() else { return };
        let is_sent = self.hand.as_ref().is_some_and(|hand| hand.commands.try_send(order).is_ok());
        if !is_sent {
            self.side.hand_failed("the hand takes no more commands");
        }
    }

    /// Says when set-points do not reach the robot in time.
    fn watch_share(&mut self, reading: &Reading) {
        let now = Instant::now();
        // The share is over the last 100 set-points: at a motion's beginning it is of nothing.
        if reading.success_rate > 0.0 && reading.success_rate < GOOD_SHARE && now >= self.next_share {
            self.next_share = now + SHARE_EVERY;
            self.say(Level::Warn, format!("only {:.0} % of the set-points reach the robot in time", 100.0 * reading.success_rate));
        }
    }

    /// Tells a state where it is time for one, or the arm does something else.
    fn show(&mut self) {
        let Some(mode) = self.side.mode() else { return };
        let now = Instant::now();
        let stop = self.side.stop();
        let changed = match &self.shown {
            Some((shown, kind)) => *shown != mode || kind.as_deref() != stop.map(|(kind, _)| kind),
            None => true,
        };
        if changed {
            let (level, why) = stop.map_or((Level::Info, String::new()), |(kind, reason)| (Level::Warn, format!(": {kind}: {reason}")));
            self.shown = Some((mode, stop.map(|(kind, _)| kind.to_owned())));
            self.say(level, format!("{mode:?}{why}"));
        }
        if !changed && now < self.next_state {
            return;
        }
        self.next_state = now + self.state_period;
        let stamp_ns = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as u64);
        if let Some(state) = self.side.state(stamp_ns) {
            // Where the network's side is held up, the next state is as good.
            self.end.tell(Told::State(Box::new(state)));
        }
    }

    fn say(&self, level: Level, word: String) {
        self.end.tell(Told::Word(level, word));
    }

    fn now_s(&self) -> f64 {
        self.started.elapsed().as_secs_f64()
    }
}
