//! The frames of the cameras that this worker owns: each newest frame becomes a scene, which is published.
//!
//! Receiving never waits for computing: a frame that comes while its camera's last one still waits replaces it. What is dropped, late
//! or unusable is counted, so that a camera that is too fast, or broken, can be seen. While nobody asks for a camera's scenes only some of its
//! frames become one (`pace`). A camera's frames are taken one after the other in
//! the order that they came in, up to the publishing: what was published last is its newest scene.

pub mod faults;
pub mod names;
pub mod newest;
pub mod pace;

use std::collections::BTreeSet;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use repose_proto::{CallError, ErrorCode, Payload, keys};
use repose_runtime::{CancellationToken, JobContext, RuntimeError, Session, Subscription, Traffic, now_ns};
use tokio::sync::{Notify, Semaphore};

use crate::config::PerceptionConfig;
use crate::newest_scenes::{Arrival, KeptScene};
use crate::report::report;
use crate::worker::{FrameOrigin, Worker};
use faults::CameraFaults;
use names::CameraNames;
use newest::{NewestFrames, Placed};

/// States of robots that may wait for a frame: a second of sixteen robots at 100 a second, or of two at 1 kHz.
const ROBOT_STATES_WAITING: usize = 2048;
/// Stands for the camera of frames that were lost before anybody looked whose they were.
const ANY_CAMERA: &str = "any";

/// What became of the frames so far. Once nothing is under way, `received` is the sum of the others. The same numbers are kept per
/// camera as the metric `repose_perception_frames_total`.
#[derive(Debug)]
pub struct FrameCounts {
    names: CameraNames,
    /// Frames received.
    pub received: AtomicU64,
    /// Frames that a newer one replaced before their turn, or for which there was no room.
    pub dropped: AtomicU64,
    /// Frames that a newer one replaced while nobody asked for scenes.
    pub unasked: AtomicU64,
    /// Frames that took too long, or came after a newer one.
    pub late: AtomicU64,
    /// Frames that could not be used.
    pub failed: AtomicU64,
    /// Scenes published.
    pub published: AtomicU64,
}

/// What became of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Became {
    Received,
    Dropped,
    Unasked,
    Late,
    Failed,
    Published,
}

impl Became {
    /// Of a frame that gave no scene.
    fn of(error: &CallError) -> Self {
        match error.code {
            ErrorCode::DeadlineExceeded => Self::Late,
            // Callers fill the queue.
            ErrorCode::ResourceExhausted => Self::Dropped,
            _ => Self::Failed,
        }
    }
}

impl FrameCounts {
    fn new(names: CameraNames) -> Self {
        Self {
            names,
            received: AtomicU64::default(),
            dropped: AtomicU64::default(),
            unasked: AtomicU64::default(),
            late: AtomicU64::default(),
            failed: AtomicU64::default(),
            published: AtomicU64::default(),
        }
    }

    fn count(&self, became: Became, camera: &str, by: u64) {
        let (counter, name) = match became {
            Became::Received => (&self.received, "received"),
            Became::Dropped => (&self.dropped, "dropped"),
            Became::Unasked => (&self.unasked, "unasked"),
            Became::Late => (&self.late, "late"),
            Became::Failed => (&self.failed, "failed"),
            Became::Published => (&self.published, "published"),
        };
        counter.fetch_add(by, Ordering::Relaxed);
        metrics::counter!("repose_perception_frames_total", "camera" => self.name(camera), "became" => name).increment(by);
    }

    fn name(&self, camera: &str) -> String {
        if camera == ANY_CAMERA { camera.to_owned() } else { self.names.of(camera) }
    }
}

/// A frame on its way.
struct Waiting {
    payload: Payload,
    /// When it came, or its turn did where nobody asks.
    arrived: Instant,
    /// When it came.
    came: Instant,
    /// Its number.
    number: u64,
}

/// A camera's turn: while it lasts, no other frame of it is taken.
struct Turn<'a> {
    cameras: &'a CameraFollower,
    camera: &'a str,
    number: u64,
}

impl Drop for Turn<'_> {
    fn drop(&mut self) {
        self.cameras.newest.lock().unwrap_or_else(PoisonError::into_inner).done(self.camera);
        self.cameras.worker.done(self.camera, self.number);
        self.cameras.arrived.notify_one();
    }
}

/// Follows the cameras of a cell and segments their newest frames, until its tasks are stopped.
pub struct CameraFollower {
    session: Session,
    worker: Arc<Worker>,
    frame_timeout: Duration,
    newest: Mutex<NewestFrames<Waiting>>,
    arrived: Notify,
    /// A frame came while nobody listened to the robots.
    unheard: Notify,
    /// One permit per compute thread: a frame is taken when it can be started, so that it is the newest one then.
    threads: Arc<Semaphore>,
    counts: FrameCounts,
    faults: CameraFaults,
}

impl CameraFollower {
    /// Cameras that are followed once [`CameraFollower::follow`] runs.
    pub fn new(session: Session, worker: Arc<Worker>, config: &PerceptionConfig) -> Arc<Self> {
        Arc::new(Self {
            session,
            worker,
            frame_timeout: Duration::from_millis(config.frame_timeout_ms),
            newest: Mutex::new(NewestFrames::new(config.max_cameras)),
            arrived: Notify::new(),
            unheard: Notify::new(),
            threads: Arc::new(Semaphore::new(config.threads.max(1))),
            counts: FrameCounts::new(CameraNames::new(config.max_cameras)),
            faults: CameraFaults::default(),
        })
    }

    /// What became of the frames so far.
    pub fn counts(&self) -> &FrameCounts {
        &self.counts
    }

    /// Subscribes to `cameras` (all of the cell when empty), then turns frames into scenes until `stop`.
    ///
    /// # Errors
    /// When the network refuses, or a camera's name is no chunk of a key.
    pub async fn follow(self: Arc<Self>, cameras: &[String], stop: CancellationToken) -> Result<(), RuntimeError> {
        self.worker.follow_robots(self.robot_states().await?);
        tokio::spawn(stop.clone().run_until_cancelled_owned(self.clone().hear_robots()));
        for subscription in self.subscribe(cameras).await? {
            tokio::spawn(stop.clone().run_until_cancelled_owned(self.clone().receive(subscription)));
        }
        tokio::spawn(stop.run_until_cancelled_owned(self.process()));
        Ok(())
    }

    async fn robot_states(&self) -> Result<Subscription, RuntimeError> {
        self.session.subscribe_queue(&self.session.cell().robot_states(), ROBOT_STATES_WAITING).await
    }

    /// Listens to the robots while their states are needed: a hundred a second and more cost an idle cell half of what it costs.
    async fn hear_robots(self: Arc<Self>) {
        const AGAIN: Duration = Duration::from_secs(1);
        loop {
            let (unheard, mut paced) = (self.unheard.notified(), std::pin::pin!(self.worker.paced()));
            paced.as_mut().enable();
            let (wants, mut next) = self.worker.pace().wants_robots(Instant::now());
            if wants && !self.worker.follows_robots() {
                match self.robot_states().await {
                    Ok(states) => self.worker.follow_robots(states),
                    Err(error) => {
                        tracing::warn!(%error, "the robots' states cannot be subscribed to");
                        next = Some(Instant::now() + AGAIN);
                    }
                }
            } else if !wants {
                self.worker.leave_robots();
            }
            tokio::select! {
                () = unheard => {}
                () = paced => {}
                () = time_comes(next) => {}
            }
        }
    }

    async fn subscribe(&self, cameras: &[String]) -> Result<Vec<Subscription>, RuntimeError> {
        if cameras.is_empty() {
            // Room for a burst of several cameras; receiving empties it at once.
            return Ok(vec![self.session.subscribe_queue(&self.session.cell().camera_frames(), 16).await?]);
        }
        let mut subscriptions = Vec::new();
        // One that is named twice is one camera.
        for camera in cameras.iter().collect::<BTreeSet<_>>() {
            keys::validate_chunk("cameras", camera).map_err(|e| RuntimeError::Config {
                section: "perception".to_owned(),
                file: None,
                message: e.to_string(),
            })?;
            subscriptions.push(self.session.subscribe_latest(&self.session.cell().camera_frame(camera)).await?);
        }
        Ok(subscriptions)
    }

    /// Puts frames where they wait for their turn.
    async fn receive(self: Arc<Self>, mut subscription: Subscription) {
        let mut dropped_before = 0;
        while let Some(sample) = subscription.recv().await {
            let Some(camera) = keys::worker_of(&sample.key) else { continue };
            let dropped = subscription.dropped();
            self.counts.count(Became::Received, camera, 1);
            // Of a subscription to several cameras nobody knows whose were lost.
            self.counts.count(Became::Received, ANY_CAMERA, dropped - dropped_before);
            self.counts.count(Became::Dropped, ANY_CAMERA, dropped - dropped_before);
            dropped_before = dropped;
            let arrived = Instant::now();
            let (number, is_idle) = {
                let mut pace = self.worker.pace();
                (pace.came(camera, arrived), pace.is_idle(camera, arrived))
            };
            let frame = Waiting { payload: sample.payload, arrived, came: arrived, number };
            if !self.worker.follows_robots() {
                self.unheard.notify_one();
            }
            let placed = self.newest.lock().unwrap_or_else(PoisonError::into_inner).put(camera, frame);
            match placed {
                Placed::Waiting => {}
                Placed::Replaced => self.counts.count(if is_idle { Became::Unasked } else { Became::Dropped }, camera, 1),
                Placed::Refused => {
                    self.worker.done(camera, number);
                    self.counts.count(Became::Dropped, camera, 1);
                    tracing::warn!(camera, "a frame was refused: too many cameras");
                }
            }
            self.arrived.notify_one();
        }
    }

    /// Starts a frame whenever a thread is free.
    async fn process(self: Arc<Self>) {
        loop {
            // Closed by nobody; an error would mean that there is no more work to start.
            let Ok(permit) = self.threads.clone().acquire_owned().await else { return };
            let (camera, frame) = self.next().await;
            let this = self.clone();
            tokio::spawn(async move {
                {
                    // Ends the turn even where publishing panics.
                    let _turn = Turn { cameras: &this, camera: &camera, number: frame.number };
                    this.publish(&camera, frame).await;
                }
                drop(permit);
            });
        }
    }

    /// The next frame whose time has come.
    async fn next(&self) -> (String, Waiting) {
        loop {
            let (arrived, mut paced) = (self.arrived.notified(), std::pin::pin!(self.worker.paced()));
            paced.as_mut().enable();
            let now = Instant::now();
            let (next, due) = self.take(now);
            if let Some(next) = next {
                return next;
            }
            tokio::select! {
                () = arrived => {}
                () = paced => {}
                () = time_comes(due) => {}
            }
        }
    }

    /// A frame whose time has come, or when that of the first that waits comes.
    fn take(&self, now: Instant) -> (Option<(String, Waiting)>, Option<Instant>) {
        let mut pace = self.worker.pace();
        let mut newest = self.newest.lock().unwrap_or_else(PoisonError::into_inner);
        let mut next = newest.take(|camera| pace.due(camera, now) <= now);
        if let Some((camera, frame)) = &mut next {
            if pace.is_idle(camera, now) {
                // What it waited for was its turn, and nobody waited for it.
                frame.arrived = now;
            }
            pace.taken(camera, now);
        }
        let due = newest.waiting().map(|camera| pace.due(camera, now)).min();
        (next, due)
    }

    /// One frame to its published scene.
    async fn publish(&self, camera: &str, frame: Waiting) {
        let deadline = frame.arrived + self.frame_timeout;
        // However long robots are waited for, half of the frame's time is left to make a scene of it.
        let robots_may_take = deadline.saturating_duration_since(Instant::now()) / 2;
        let _ = tokio::time::timeout(robots_may_take, self.worker.robots_heard()).await;
        let context = JobContext::new(deadline, CancellationToken::new());
        let outcome = self.worker.segment(context, frame.payload, FrameOrigin::Camera).await.and_then(|(scene, times)| {
            let named = &scene.summary.camera;
            if named != camera {
                return Err(CallError::invalid("camera", format!("a frame of camera {named:?} was published on the key of {camera:?}")));
            }
            Ok((scene, times))
        });
        let (scene, times) = match outcome {
            Ok(made) => made,
            Err(error) => {
                self.counts.count(Became::of(&error), camera, 1);
                match self.faults.begins(self.counts.name(camera), &error) {
                    true => tracing::warn!(camera, %error, "frames give no scene"),
                    false => tracing::debug!(camera, %error, "a frame gave no scene"),
                }
                return;
            }
        };
        if self.faults.ends(&self.counts.name(camera)) {
            tracing::info!(camera, "frames give scenes again");
        }
        let stamp_ns = scene.summary.stamp_ns;
        let lag_ms = (now_ns() as f64 - stamp_ns as f64) * 1e-6 - frame.came.elapsed().as_secs_f64() * 1e3;
        let summary = Payload::json(&scene.summary);
        if self.keep(camera, scene) == Arrival::Late {
            self.counts.count(Became::Late, camera, 1);
            return;
        }
        self.worker.pace().made(camera, Instant::now(), lag_ms);
        let key = self.session.cell().scene(camera);
        let put = match summary {
            Ok(payload) => self.session.put(&key, payload, Traffic::Scene).await.map_err(CallError::from),
            Err(error) => Err(error),
        };
        match put {
            Ok(()) => {
                self.counts.count(Became::Published, camera, 1);
                let age_ms = frame.arrived.elapsed().as_secs_f64() * 1e3;
                metrics::histogram!("repose_perception_frame_to_scene_seconds", "camera" => self.counts.name(camera)).record(age_ms / 1e3);
                tracing::debug!(camera, stamp_ns, age_ms, segment_ms = times.segment_ms, "scene published");
            }
            Err(error) => {
                self.counts.count(Became::Failed, camera, 1);
                tracing::warn!(camera, %error, "a scene could not be published");
            }
        }
    }

    /// Keeps a camera's scene, and says what its owner should know.
    fn keep(&self, camera: &str, scene: Arc<KeptScene>) -> Arrival {
        let mut known = self.worker.newest();
        report(&scene.summary, known.of(camera));
        let newest_ns = known.of(camera).map(|newest| newest.stamp_ns);
        let stamp_ns = scene.summary.stamp_ns;
        let arrival = known.take(&scene);
        if arrival != Arrival::Late {
            self.worker.keep_streamed(scene, &known);
        }
        match arrival {
            Arrival::Newest => {}
            Arrival::Restarted => {
                tracing::warn!(camera, stamp_ns, newest_ns, "a frame's stamp is far before the last one's: its clock was set back");
            }
            Arrival::Late => tracing::warn!(camera, stamp_ns, newest_ns, "a frame came after one with a newer stamp and was dropped"),
        }
        arrival
    }
}

/// Waits for an instant; without one for ever.
async fn time_comes(at: Option<Instant>) {
    match at {
        Some(at) => tokio::time::sleep_until(at.into()).await,
        None => std::future::pending().await,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_for_which_the_queue_has_no_room_was_dropped_and_is_not_at_fault() {
        let became = |code: ErrorCode| Became::of(&CallError::new(code, ""));
        let codes = [ErrorCode::ResourceExhausted, ErrorCode::DeadlineExceeded, ErrorCode::InvalidArgument];
        assert_eq!(codes.map(became), [Became::Dropped, Became::Late, Became::Failed]);
    }
}
