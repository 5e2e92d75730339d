//! The compute side of the service: the bounded queue, the threads that segment, and the scenes that were made.

use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use repose_proto::load::{CameraLoad, NewestSceneLoad};
use repose_proto::{CallError, Frame, Payload, Scene, SceneSummary, SceneWarning, keys};
use repose_runtime::{ComputeQueue, JobContext, LoadGauge, QueueSettings, RuntimeError, SceneStore, Subscription, read_robot_state};
use tokio::sync::Notify;
use tokio::sync::futures::Notified;

use crate::cameras::pace::{Pace, Shown};
use crate::config::PerceptionConfig;
use crate::newest_scenes::{KeptScene, NewestScenes};
use crate::robots::shown::{InPicture, ShownRobots};
use crate::robots::states::RobotStates;
use crate::segment::segment;
use crate::settings::Settings;
use crate::unasked::Unasked;

/// Segments frames on its own threads and keeps the scenes.
pub struct Worker {
    queue: ComputeQueue,
    settings: Arc<Settings>,
    scenes: SceneStore<KeptScene>,
    unasked: Mutex<Unasked>,
    newest: Mutex<NewestScenes>,
    robots: Arc<Mutex<CellRobots>>,
    /// When the first frame of a camera came.
    first_frame: OnceLock<Instant>,
    robots_wait: Duration,
    pace: Mutex<Pace>,
    /// Somebody asked for scenes, or a frame is done.
    paced: Notify,
}

/// Whose frame it is, and so what is known of the robots in it that it says nothing of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FrameOrigin {
    /// A camera of the cell: its robots are in sight.
    Camera,
    /// A caller: it may show another place, or another time.
    Caller,
}

/// Where the cell's robots were. Their states are read when a frame asks: they come oftener than frames do, and nobody else needs them.
struct CellRobots {
    states: RobotStates,
    waiting: Option<Subscription>,
    /// Since when they are listened to, and when one was read last.
    since: Option<Instant>,
    heard: Option<Instant>,
    shown: ShownRobots,
}

impl CellRobots {
    /// Reads what came.
    fn read(&mut self) {
        while let Some(sample) = self.waiting.as_mut().and_then(Subscription::try_recv) {
            let Some(robot) = keys::worker_of(&sample.key) else { continue };
            if let Ok(state) = read_robot_state(&sample) {
                self.states.put(robot, state);
                self.heard = Some(Instant::now());
            }
        }
    }

    /// The robots in a picture that says nothing of them. A caller's that a camera of the cell has shown before has those that it had then.
    fn in_picture(&mut self, camera: &str, stamp_ns: u64, origin: FrameOrigin) -> InPicture {
        self.read();
        match origin {
            FrameOrigin::Camera => {
                let robots = self.states.at_or_nearest(stamp_ns);
                self.shown.put(camera, stamp_ns, robots.clone());
                robots
            }
            FrameOrigin::Caller => self.shown.of(camera, stamp_ns).cloned().unwrap_or_else(|| {
                let robots = self.states.at(stamp_ns);
                let is_unknown = robots.is_empty() && !self.states.is_empty() && self.shown.knows(camera);
                let message = "no robot of the cell told where it was at the time of this picture: what shows of one is taken for objects and furniture";
                let warning = is_unknown.then(|| SceneWarning { field: "robots".to_owned(), message: message.to_owned() });
                (robots, warning.into_iter().collect())
            }),
        }
    }
}

/// How long the stages of a frame took, milliseconds.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct StageTimes {
    /// Reading the frame.
    pub decode_ms: f64,
    /// Frame to scene.
    pub segment_ms: f64,
    /// Scene to bytes, and their hash.
    pub encode_ms: f64,
}

impl Worker {
    /// Starts the threads.
    ///
    /// # Errors
    /// When the operating system gives none.
    pub fn start(config: &PerceptionConfig) -> Result<Self, RuntimeError> {
        let settings = QueueSettings {
            name: "perception".to_owned(),
            capacity: config.queue_capacity,
            threads: config.threads,
            ..QueueSettings::default()
        };
        Ok(Self {
            queue: ComputeQueue::start(settings)?,
            settings: Arc::new(config.segmentation.clone()),
            scenes: SceneStore::new(config.scenes_kept, config.scenes_kept_bytes, |scene| scene.payload.bytes.len()),
            unasked: Mutex::new(Unasked::new(Duration::from_millis(config.unasked_kept_ms), config.scenes_kept)),
            newest: Mutex::new(NewestScenes::new(config.newest_limits())),
            robots: Arc::new(Mutex::new(CellRobots {
                states: RobotStates::new(config.frame_may_wait()),
                waiting: None,
                since: None,
                heard: None,
                shown: ShownRobots::default(),
            })),
            first_frame: OnceLock::new(),
            robots_wait: Duration::from_millis(config.robots_wait_ms),
            pace: Mutex::new(Pace::new(config.pace())),
            paced: Notify::new(),
        })
    }

    /// Turns an encoded frame into a scene, which is not kept yet.
    ///
    /// # Errors
    /// `invalid_argument` and `failed_precondition` as [`segment`] has them, and those of the queue.
    pub async fn segment(
        &self,
        context: JobContext,
        frame: Payload,
        origin: FrameOrigin,
    ) -> Result<(Arc<KeptScene>, StageTimes), CallError> {
        let (settings, robots) = (self.settings.clone(), self.robots.clone());
        self.queue.run(context, move |context| scene_of(&frame, origin, &robots, &settings, context)).await
    }

    /// Frames that say nothing of robots are taken to show those of the cell where these states say that they are.
    pub fn follow_robots(&self, states: Subscription) {
        let mut robots = self.robots();
        (robots.waiting, robots.since) = (Some(states), Some(Instant::now()));
    }

    /// States are not listened to any more; those that came stay known.
    pub fn leave_robots(&self) {
        let mut robots = self.robots();
        robots.read();
        (robots.waiting, robots.since) = (None, None);
    }

    /// Whether the robots' states are listened to.
    pub fn follows_robots(&self) -> bool {
        self.robots().waiting.is_some()
    }

    /// Waits for a word of a robot since its states are listened to, `[perception] robots_wait_ms` at most: frames and states come on ways of their own, and
    /// before the states do, the arm would be taken for objects. Where no robot told anything yet, the cell may have none, and the cell's first frame
    /// alone waits.
    pub async fn robots_heard(&self) {
        const LOOK: Duration = Duration::from_millis(10);
        let begun = Instant::now();
        let first_frame = *self.first_frame.get_or_init(|| begun);
        loop {
            let since = {
                let mut robots = self.robots();
                robots.read();
                if robots.since.is_some() && robots.heard >= robots.since {
                    return;
                }
                if robots.states.is_empty() { first_frame } else { robots.since.unwrap_or(begun) }
            };
            if since.elapsed() >= self.robots_wait {
                return;
            }
            tokio::time::sleep(LOOK).await;
        }
    }

    /// What each camera has shown, for the load; those long silent are not told of.
    pub fn cameras(&self) -> Vec<CameraLoad> {
        const TOLD: Duration = Duration::from_secs(600);
        let (pace, newest) = (self.pace(), self.newest());
        let age_ms = |at: Instant| at.elapsed().as_millis() as u64;
        let told = |shown: Shown<'_>| CameraLoad {
            camera: shown.camera.to_owned(),
            frames: shown.frames,
            frame_age_ms: age_ms(shown.came_at),
            newest: shown.scene.zip(newest.of(shown.camera)).map(|((made, lag_ms), summary)| NewestSceneLoad {
                scene_id: summary.scene_id.clone(),
                objects: summary.objects.len(),
                age_ms: age_ms(made),
                lag_ms,
            }),
        };
        pace.shown().filter(|shown| shown.came_at.elapsed() < TOLD).map(told).collect()
    }

    fn robots(&self) -> MutexGuard<'_, CellRobots> {
        locked(&self.robots)
    }

    /// The scene of that id, which stays longer from now on.
    ///
    /// # Errors
    /// `not_found` on `scene_id`.
    pub fn scene(&self, scene_id: &str) -> Result<Arc<KeptScene>, CallError> {
        self.unasked().asked(scene_id);
        let scene = self.scenes.get(scene_id)?;
        self.asked(&scene.summary.camera);
        Ok(scene)
    }

    /// The newest scene of a camera, in short: that of its newest frame where nobody had asked for a while.
    ///
    /// # Errors
    /// `not_found` on `camera`.
    pub async fn latest(&self, camera: &str) -> Result<SceneSummary, CallError> {
        if let Some(number) = self.asked(camera) {
            loop {
                let mut paced = std::pin::pin!(self.paced.notified());
                paced.as_mut().enable();
                if self.pace().is_done(camera, number) {
                    break;
                }
                paced.await;
            }
        }
        let newest = self.newest().of(camera).cloned();
        newest.ok_or_else(|| CallError::not_found("camera", format!("no scene of camera {camera:?} was made here")))
    }

    fn asked(&self, camera: &str) -> Option<u64> {
        let waits_for = self.pace().asked(camera, Instant::now());
        self.paced.notify_waiters();
        waits_for
    }

    /// When which frames become scenes.
    pub fn pace(&self) -> MutexGuard<'_, Pace> {
        // Every change leaves it whole, so a panic elsewhere under the lock does not spoil it.
        self.pace.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until somebody asks for scenes, or a frame is done. Register before looking.
    pub fn paced(&self) -> Notified<'_> {
        self.paced.notified()
    }

    /// A frame is done, whatever became of it.
    pub fn done(&self, camera: &str, number: u64) {
        self.pace().done(camera, number);
        self.paced.notify_waiters();
    }

    /// Keeps a scene that a caller had made under its id. The same content again is kept once, as it came last.
    pub fn keep(&self, scene: Arc<KeptScene>) {
        let scene_id = scene.summary.scene_id.clone();
        self.unasked().asked(&scene_id);
        self.scenes.keep_over(&scene_id, scene, |_| true);
    }

    /// Keeps a scene of a camera likewise, and lets those go that nobody asked for in time. The `newest` scene of each camera stays, however old: whoever
    /// is told of it by `latest` asks for it next.
    pub fn keep_streamed(&self, scene: Arc<KeptScene>, newest: &NewestScenes) {
        let scene_id = scene.summary.scene_id.clone();
        for id in newest.scene_ids() {
            // Where there is no room the least recently used goes.
            let _ = self.scenes.get(id);
        }
        let mut was_held = false;
        let was_held_of = |_: &KeptScene| {
            was_held = true;
            true
        };
        self.scenes.keep_over(&scene_id, scene, was_held_of);
        let is_newest = |id: &str| newest.scene_ids().any(|newest| newest == id);
        for over in self.unasked().came(&scene_id, was_held, is_newest, Instant::now()) {
            self.scenes.let_go(&over);
        }
    }

    fn unasked(&self) -> MutexGuard<'_, Unasked> {
        // Every change leaves it whole, so a panic elsewhere under the lock does not spoil it.
        self.unasked.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Which scene is each camera's newest.
    pub fn newest(&self) -> MutexGuard<'_, NewestScenes> {
        // Every change leaves it whole, so a panic elsewhere under the lock does not spoil it.
        self.newest.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What waits and what runs.
    pub fn gauge(&self) -> Arc<LoadGauge> {
        self.queue.gauge()
    }

    /// Frames that may wait.
    pub fn capacity(&self) -> usize {
        self.queue.capacity()
    }
}

fn locked(robots: &Mutex<CellRobots>) -> MutexGuard<'_, CellRobots> {
    // Every change leaves it whole, so a panic elsewhere under the lock does not spoil it.
    robots.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Decodes, segments, encodes and names a scene.
fn scene_of(
    frame: &Payload,
    origin: FrameOrigin,
    robots: &Mutex<CellRobots>,
    settings: &Settings,
    context: &JobContext,
) -> Result<(Arc<KeptScene>, StageTimes), CallError> {
    let mut times = StageTimes::default();
    let mut frame = timed(&mut times.decode_ms, || Frame::from_bulk(&frame.decode_bulk(Frame::SCHEMA)?))?;
    let mut warnings = Vec::new();
    if frame.robots.is_empty() {
        (frame.robots, warnings) = locked(robots).in_picture(&frame.camera_name, frame.stamp_ns, origin);
    }
    context.check()?;
    let mut scene = timed(&mut times.segment_ms, || segment(&frame, settings).map_err(CallError::from))?;
    scene.meta.warnings.append(&mut warnings);
    context.check()?;
    let kept = timed(&mut times.encode_ms, || {
        let payload = Payload::bulk(Scene::SCHEMA, &scene.to_bulk())?;
        Ok::<_, CallError>(KeptScene { summary: scene.summary(scene.id()), payload })
    })?;
    Ok((Arc::new(kept), times))
}

/// Runs something and tells how long it took.
fn timed<T>(ms: &mut f64, work: impl FnOnce() -> T) -> T {
    let started = Instant::now();
    let result = work();
    *ms = started.elapsed().as_secs_f64() * 1e3;
    result
}
