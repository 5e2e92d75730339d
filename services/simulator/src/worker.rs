//! The thread that owns the world: steps it at the configured rate, takes commands and requests, shows states and frames.
//!
//! What goes out is the newest only (a reader that is late sees the next one); what comes in waits in a bounded queue and is refused when
//! that is full. When the machine does not keep up, simulated time falls behind rather than running in bursts: between a few steps the world
//! listens.

use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::sync::{Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use repose_geometry::ViewerFrame;
use repose_geometry::transform::to_row_major;
use repose_proto::robot::{EmergencyStop, RobotCommand, RobotMode};
use repose_proto::simulator::{TrueObject, TruePair, Truth};
use repose_proto::{CallError, CameraModel, ErrorCode, Frame, Payload, RigidTransform};
use tokio::sync::{oneshot, watch};

use crate::SimulatorError;
use crate::cell::CellSettings;
use crate::cell_world::CellWorld;
use crate::config::SimulatorConfig;
use crate::robot::{ArmSettings, HandSettings};

/// Longest real time that is made up for when the thread was held up; more is lost to simulated time.
const CATCH_UP: Duration = Duration::from_millis(60);
/// How long nothing has to move until physics is left out, milliseconds of robot time; a command takes it up again.
const STILL_FOR_MS: f64 = 1000.0;
/// Longest nap between two looks at the clock, and longest that the world is stepped between two looks at what comes in.
const NAP: Duration = Duration::from_millis(2);
/// Metres per count of the frames' depth.
const DEPTH_UNIT_M: f64 = 0.001;

/// What the world is told or asked.
enum Input {
    Command { command: Box<RobotCommand>, received: Instant },
    Reset { seed: u64, reply: oneshot::Sender<Result<Truth, CallError>> },
    Truth { view_yaw_rad: Option<f64>, reply: oneshot::Sender<Result<Truth, CallError>> },
}

/// Emergency stops that may wait; a full queue of commands does not hold them up.
const STOPS: usize = 16;

/// A running world.
pub struct Worker {
    inputs: Mutex<Option<SyncSender<Input>>>,
    stops: SyncSender<EmergencyStop>,
    states: watch::Receiver<Option<Payload>>,
    frames: watch::Receiver<Option<Payload>>,
    thread: Mutex<Option<JoinHandle<()>>>,
}

impl Worker {
    /// Starts the world of a configuration. It ends when the worker is dropped.
    ///
    /// # Errors
    /// [`SimulatorError`] when the configuration is out of range, its seed gives no scene, or there is no thread.
    pub fn start(config: &SimulatorConfig) -> Result<Self, SimulatorError> {
        config.validate()?;
        let cell = CellWorld::new(config.seed, CellSettings::default(), ArmSettings::default(), HandSettings::default())?;
        let (inputs, waiting) = sync_channel(config.queue);
        let (stops, waiting_stops) = sync_channel(STOPS);
        let (states_out, states) = watch::channel(None);
        let (frames_out, frames) = watch::channel(None);
        let config = config.clone();
        let world = Running {
            cell,
            config,
            waiting,
            waiting_stops,
            states: states_out,
            frames: frames_out,
            started: Instant::now(),
            stepped_to: Instant::now(),
            states_made: 0,
            moved_ms: 0.0,
        };
        let thread = std::thread::Builder::new().name("world".to_owned()).spawn(move || world.run())?;
        Ok(Self { inputs: Mutex::new(Some(inputs)), stops, states, frames, thread: Mutex::new(Some(thread)) })
    }

    /// Encoded robot states, the newest only.
    pub fn states(&self) -> watch::Receiver<Option<Payload>> {
        self.states.clone()
    }

    /// Encoded frames, the newest only.
    pub fn frames(&self) -> watch::Receiver<Option<Payload>> {
        self.frames.clone()
    }

    /// Comes to its end when the world does. Before it is let go of it only does so where its thread has panicked.
    pub async fn ended(&self) {
        let mut frames = self.frames();
        while frames.changed().await.is_ok() {}
    }

    /// Hands a command to the arm, which may still ignore it.
    ///
    /// # Errors
    /// `resource_exhausted` when too many wait.
    pub fn command(&self, command: RobotCommand) -> Result<(), CallError> {
        self.send(Input::Command { command: Box::new(command), received: Instant::now() })
    }

    /// Hands an emergency stop to the arm.
    ///
    /// # Errors
    /// `resource_exhausted` when too many wait; it is repeated by its sender until the state shows it.
    pub fn emergency_stop(&self, stop: EmergencyStop) -> Result<(), CallError> {
        self.stops.try_send(stop).map_err(refused)
    }

    /// Sets up the scene of a seed, and tells what it is.
    ///
    /// # Errors
    /// `failed_precondition` while the arm moves or when the seed gives no scene; `resource_exhausted` when too many wait.
    pub async fn reset(&self, seed: u64) -> Result<Truth, CallError> {
        let (reply, answer) = oneshot::channel();
        self.send(Input::Reset { seed, reply })?;
        answer.await.unwrap_or_else(|_| Err(gone()))
    }

    /// The world as it is; relations as a viewer sees them, the camera without one.
    ///
    /// # Errors
    /// `resource_exhausted` when too many wait.
    pub async fn truth(&self, view_yaw_rad: Option<f64>) -> Result<Truth, CallError> {
        let (reply, answer) = oneshot::channel();
        self.send(Input::Truth { view_yaw_rad, reply })?;
        answer.await.unwrap_or_else(|_| Err(gone()))
    }

    fn send(&self, input: Input) -> Result<(), CallError> {
        let inputs = self.inputs.lock().unwrap_or_else(PoisonError::into_inner);
        let sender = inputs.as_ref().ok_or_else(gone)?;
        sender.try_send(input).map_err(refused)
    }
}

#[expect(clippy::needless_pass_by_value, reason = "the shape that `map_err` hands it in")]
fn refused<T>(error: TrySendError<T>) -> CallError {
    match error {
        TrySendError::Full(_) => CallError::new(ErrorCode::ResourceExhausted, "the world has too much to take in").retry_after(50),
        TrySendError::Disconnected(_) => gone(),
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        // Without a sender the thread ends within a nap.
        drop(self.inputs.lock().unwrap_or_else(PoisonError::into_inner).take());
        if let Some(thread) = self.thread.lock().unwrap_or_else(PoisonError::into_inner).take()
            && thread.join().is_err()
        {
            tracing::error!("the world's thread had panicked");
        }
    }
}

fn gone() -> CallError {
    CallError::new(ErrorCode::Unavailable, "the world has ended")
}

/// The world on its thread.
struct Running {
    cell: CellWorld,
    config: SimulatorConfig,
    waiting: Receiver<Input>,
    waiting_stops: Receiver<EmergencyStop>,
    states: watch::Sender<Option<Payload>>,
    frames: watch::Sender<Option<Payload>>,
    started: Instant,
    /// Up to when the world was stepped.
    stepped_to: Instant,
    states_made: u64,
    /// When something last moved, or was commanded to, milliseconds of robot time.
    moved_ms: f64,
}

impl Running {
    fn run(mut self) {
        let period = |ms: u64| Duration::from_millis(ms);
        let step = Duration::from_secs_f64(self.cell.step_s() / self.config.time_scale);
        let (mut next_state, mut next_frame) = (Instant::now(), Instant::now());
        let mut mode = self.cell.arm.mode();
        loop {
            let next_step = (self.stepped_to + step).saturating_duration_since(Instant::now());
            let first = match self.waiting.recv_timeout(NAP.min(next_step)) {
                Ok(input) => Some(input),
                Err(RecvTimeoutError::Timeout) => None,
                Err(RecvTimeoutError::Disconnected) => return,
            };
            while let Ok(stop) = self.waiting_stops.try_recv() {
                self.cell.arm.emergency_stop(&stop);
            }
            let others: Vec<Input> = self.waiting.try_iter().collect();
            for input in first.into_iter().chain(others) {
                self.take(input);
            }
            self.catch_up(step);
            let now = Instant::now();
            let changed = std::mem::replace(&mut mode, self.cell.arm.mode()) != mode;
            if changed || now >= next_state {
                next_state = now + period(self.config.state_period_ms);
                self.show_state();
            }
            if now >= next_frame {
                next_frame = now + period(self.config.frame_period_ms);
                self.show_frame();
            }
        }
    }

    /// Steps the world up to now, for a nap's time at most: a world that cannot keep up hears of stops and commands all the same.
    fn catch_up(&mut self, step: Duration) {
        let now = Instant::now();
        // In slow motion a step takes longer than is made up for: it is made up for all the same, or none would ever be due.
        self.stepped_to = self.stepped_to.max(now.checked_sub(CATCH_UP.max(step)).unwrap_or(self.stepped_to));
        while self.stepped_to + step <= now && now.elapsed() < NAP {
            let now_s = self.now_s();
            match self.cell.robot_ms() - self.moved_ms < STILL_FOR_MS {
                true => self.cell.step(now_s),
                false => self.cell.pass(now_s),
            }
            self.stepped_to += step;
            if !self.cell.is_still() {
                self.moved_ms = self.cell.robot_ms();
            }
        }
    }

    fn take(&mut self, input: Input) {
        match input {
            Input::Command { command, received } => {
                self.moved_ms = self.cell.robot_ms();
                let received_s = received.saturating_duration_since(self.started).as_secs_f64();
                let now_s = self.now_s();
                if let Err(why) = self.cell.arm.late_command(&command, received_s, now_s) {
                    tracing::debug!(owner = command.owner.id, seq = command.seq, %why, "command ignored");
                }
            }
            Input::Reset { seed, reply } => {
                let outcome = self.reset(seed);
                // Whoever asked may be gone.
                drop(reply.send(outcome));
            }
            Input::Truth { view_yaw_rad, reply } => drop(reply.send(Ok(self.truth(view_yaw_rad)))),
        }
    }

    fn reset(&mut self, seed: u64) -> Result<Truth, CallError> {
        if self.cell.arm.mode() == RobotMode::Moving {
            return Err(CallError::precondition("the robot moves"));
        }
        if let (Some(task), RobotMode::Idle) = (self.cell.arm.task(), self.cell.arm.mode()) {
            return Err(CallError::precondition(format!("the robot carries out task {task}")));
        }
        self.moved_ms = self.cell.robot_ms();
        self.cell.reset(seed).map_err(|error| CallError::precondition(error.to_string()).at("seed"))?;
        self.show_state();
        self.show_frame();
        Ok(self.truth(None))
    }

    fn truth(&mut self, view_yaw_rad: Option<f64>) -> Truth {
        let scene = self.cell.truth();
        let viewer =
            view_yaw_rad.map_or_else(|| ViewerFrame::from_camera(&self.cell.settings().world_from_camera()), ViewerFrame::from_yaw);
        let n = scene.objects.len();
        let relations = scene.relations(&viewer);
        let pairs = (0..n * n).filter(|k| k / n != k % n).map(|k| TruePair {
            query: scene.objects[k / n].id,
            anchor: scene.objects[k % n].id,
            holds: relations[k],
        });
        let objects = scene.objects.iter().map(|o| {
            let pose = RigidTransform(to_row_major(&o.world_from_object));
            let extent = o.shape.half_extents_m * 2.0;
            TrueObject { id: o.id, name: o.shape.name.to_string(), world_from_object: pose, world_from_box: pose, extent_m: extent.into() }
        });
        Truth {
            seed: scene.seed,
            sim_ms: self.cell.robot_ms(),
            at_rest: self.cell.at_rest(),
            view_yaw_rad: viewer.yaw_rad(),
            objects: objects.collect(),
            relations: pairs.collect(),
        }
    }

    fn show_state(&mut self) {
        self.states_made += 1;
        let state = self.cell.robot_state(self.states_made, wall_ns());
        show(&self.states, Payload::json(&state));
    }

    fn show_frame(&mut self) {
        // Drawing takes longer than a state's period: a later stamp would be that of a later posture.
        let stamp_ns = wall_ns();
        let picture = self.cell.sensed_picture(&self.config.sensor_model(), self.config.show_robot);
        let settings = self.cell.settings();
        let pinhole = settings.camera;
        let counts = |z: &f32| (f64::from(*z) / DEPTH_UNIT_M).round().clamp(0.0, f64::from(u16::MAX)) as u16;
        let camera = CameraModel {
            width: pinhole.width,
            height: pinhole.height,
            fx: pinhole.fx,
            fy: pinhole.fy,
            cx: pinhole.cx,
            cy: pinhole.cy,
            depth_unit_m: DEPTH_UNIT_M,
            world_from_camera: Some(RigidTransform(to_row_major(&settings.world_from_camera()))),
        };
        let depth = picture.depth_m.pixels().iter().map(counts).collect();
        let frame = Frame {
            color: Some(picture.color.into_pixels()),
            labels: self.config.labels.then(|| picture.labels.into_pixels()),
            ..Frame::new(self.config.camera.clone(), stamp_ns, camera, depth)
        };
        show(&self.frames, Payload::bulk(Frame::SCHEMA, &frame.to_bulk()));
    }

    /// Seconds on the clock that commands expire by.
    fn now_s(&self) -> f64 {
        self.started.elapsed().as_secs_f64()
    }
}

fn show(to: &watch::Sender<Option<Payload>>, payload: Result<Payload, CallError>) {
    match payload {
        Ok(payload) => drop(to.send_replace(Some(payload))),
        Err(error) => tracing::error!(%error, "a message could not be encoded"),
    }
}

fn wall_ns() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A world that was stepped up to before its scene was made: longer ago than is made up for.
    fn running() -> Running {
        let started = Instant::now();
        let cell = CellWorld::new(1, CellSettings::default(), ArmSettings::default(), HandSettings::default()).expect("a scene");
        Running {
            cell,
            config: SimulatorConfig::default(),
            waiting: sync_channel(1).1,
            waiting_stops: sync_channel(1).1,
            states: watch::channel(None).0,
            frames: watch::channel(None).0,
            started,
            stepped_to: started,
            states_made: 0,
            moved_ms: 0.0,
        }
    }

    fn steps_of(world: &Running) -> f64 {
        world.cell.robot_ms() * 1e-3 / world.cell.step_s()
    }

    #[test]
    fn a_world_that_cannot_keep_up_with_its_clock_listens_after_a_few_steps() {
        let mut world = running();
        // Some sixty million steps are due, which take minutes.
        world.catch_up(Duration::from_nanos(1));
        let taken = steps_of(&world);
        assert!((0.5..1e6).contains(&taken), "{taken} steps");
    }

    #[tokio::test]
    async fn whoever_serves_a_world_hears_that_it_has_ended() {
        let worker = Worker::start(&SimulatorConfig::default()).expect("a world");
        let soon = Duration::from_millis(300);
        assert!(tokio::time::timeout(soon, worker.ended()).await.is_err(), "it goes on");
        // As where its thread has panicked, there is nobody then who would show anything.
        drop(worker.inputs.lock().expect("nobody has panicked").take());
        tokio::time::timeout(Duration::from_secs(60), worker.ended()).await.expect("it has ended");
    }

    #[test]
    fn a_world_in_slow_motion_moves_though_a_step_takes_longer_than_is_made_up_for() {
        let mut world = running();
        let step = CATCH_UP * 2;
        std::thread::sleep(step.saturating_sub(world.stepped_to.elapsed()));
        world.catch_up(step);
        let taken = steps_of(&world);
        assert!((taken - 1.0).abs() < 1e-6, "{taken} steps");
    }
}
