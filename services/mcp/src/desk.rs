//! Where tools are carried out: the cell as an agent's server sees it, the scenes that were shown, the plans that were made.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use repose_proto::robot::RobotState;
use repose_proto::{CallError, ErrorCode, Scene, SceneSummary, Service};
use repose_runtime::{CallOptions, Caller, Moves, STATE_WITHIN, Session, fetch_newest, fetch_scene, robot_state};
use tokio::time::Instant;

use crate::McpError;
use crate::per_session::{Bounds, PerSession};
use crate::plans::Plans;
use crate::seen::{ShownScene, handle};
use crate::settings::McpSettings;

/// Scenes held for agents that name them.
const SCENES: Bounds = Bounds { per_session: 16, total: 256, bytes: 512 << 20 };
/// How long a robot is waited for in a cell without motion: nobody could have it carry anything out there, and there may well be none.
const WITHOUT_MOTION: Duration = Duration::from_secs(1);
/// Between two looks for a newer view.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// Does what tools ask. Any number of agents share one.
pub struct Desk {
    pub(crate) session: Session,
    pub(crate) planner: Caller,
    pub(crate) motion: Caller,
    pub(crate) moves: Moves,
    perception: Caller,
    settings: McpSettings,
    scenes: Mutex<PerSession<ShownScene>>,
    plans: Mutex<Plans>,
}

impl Desk {
    /// A desk for the session's cell.
    ///
    /// # Errors
    /// When a setting is unusable or the network refuses.
    pub async fn open(session: Session, settings: McpSettings) -> Result<Self, McpError> {
        settings.validate().map_err(McpError::Setting)?;
        let (perception, planner, motion) =
            (session.caller(Service::Perception).await?, session.caller(Service::Planner).await?, session.caller(Service::Motion).await?);
        let scenes = Mutex::new(PerSession::<ShownScene>::new(SCENES, |scene| scene));
        Ok(Self { session, planner, motion, moves: Moves::of("the server"), perception, settings, scenes, plans: Mutex::default() })
    }

    /// What it is about.
    pub fn settings(&self) -> &McpSettings {
        &self.settings
    }

    pub(crate) fn plans(&self) -> MutexGuard<'_, Plans> {
        // Every change leaves the plans whole, so a panic elsewhere under the lock does not spoil them.
        self.plans.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn scenes(&self) -> MutexGuard<'_, PerSession<ShownScene>> {
        // As for the plans.
        self.scenes.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Begins no further execution, and waits for the one under way, at most for `drain`; then its arm is brought to rest. All else is done as before:
    /// whoever looks on may stop the robot.
    pub async fn end(&self, drain: Duration) {
        self.moves.ended(drain).await;
    }

    /// When what is begun now must have ended.
    pub(crate) fn deadline(&self) -> Instant {
        Instant::now() + self.settings.deadline
    }

    /// The camera's newest view, kept under its handle for an agent's session.
    pub(crate) async fn newest(&self, session: &str, deadline: Instant) -> Result<Arc<ShownScene>, CallError> {
        self.view_after(0, session, deadline).await
    }

    /// The first view that was seen after an instant, kept under its handle for an agent's session.
    async fn view_after(&self, instant_ns: u64, session: &str, deadline: Instant) -> Result<Arc<ShownScene>, CallError> {
        let camera = &self.settings.camera;
        loop {
            let summary = fetch_newest(&self.perception, camera, &CallOptions::default().until(deadline)).await?;
            if summary.stamp_ns > instant_ns {
                let seen = Arc::new(self.seen(summary, deadline).await?);
                // A scene that looks the same to the last point has the same id and a later stamp: it is kept in the place of the earlier one.
                self.scenes().keep(session, seen.handle(), seen.clone());
                return Ok(seen);
            }
            let next = Instant::now() + LOOK_EVERY;
            if next >= deadline {
                let message = format!("camera {camera} has shown nothing new in time");
                return Err(CallError::new(ErrorCode::DeadlineExceeded, message));
            }
            tokio::time::sleep_until(next).await;
        }
    }

    /// The scene of a summary. One that is held and looks the same to the last point has its id, and is not sent again.
    async fn seen(&self, summary: SceneSummary, deadline: Instant) -> Result<ShownScene, CallError> {
        let SceneSummary { scene_id, stamp_ns, .. } = summary;
        let held = self.scenes().of_any(handle(&scene_id)).filter(|held| held.scene_id == scene_id);
        let scene = match held {
            Some(held) => Scene { stamp_ns, ..held.scene.clone() },
            None => fetch_scene(&self.perception, &scene_id, &CallOptions::default().until(deadline)).await?,
        };
        Ok(ShownScene { scene_id, scene })
    }

    /// What the robot says of itself.
    ///
    /// # Errors
    /// `unavailable` on `robot` when it does not say.
    pub(crate) async fn robot_state(&self, deadline: Instant) -> Result<RobotState, CallError> {
        let patience = if self.motion.workers().is_empty() { WITHOUT_MOTION } else { STATE_WITHIN };
        let within = patience.min(deadline.saturating_duration_since(Instant::now()));
        robot_state(&self.session, &self.settings.robot, within).await
    }

    /// A view from now on, by the robot's clock, which is its cameras': this host's may be behind theirs. Kept as [`Self::newest`] does.
    pub(crate) async fn fresh(&self, session: &str, deadline: Instant) -> Result<Arc<ShownScene>, CallError> {
        let state = self.robot_state(deadline).await?;
        self.view_after(state.stamp_ns, session, deadline).await
    }

    /// A view that was shown, to whomever. It counts as new for the session that names it.
    ///
    /// # Errors
    /// `not_found` on `scene` when it is not held any more, or never was.
    pub(crate) fn shown(&self, handle: &str, session: &str) -> Result<Arc<ShownScene>, CallError> {
        let mut scenes = self.scenes();
        let not_at_hand = || CallError::not_found("scene", format!("scene {handle:?} is not at hand: look again"));
        let seen = scenes.of_any(handle).ok_or_else(not_at_hand)?;
        scenes.keep(session, handle, seen.clone());
        Ok(seen)
    }
}

/// Computes beside the async threads.
pub(crate) async fn computed<T: Send + 'static>(work: impl FnOnce() -> Result<T, CallError> + Send + 'static) -> Result<T, CallError> {
    tokio::task::spawn_blocking(work).await.map_err(|e| CallError::internal(format!("the computation was lost: {e}")))?
}
