//! What a viewer asks, carried out: each request a task of its own that ends in one answer.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use repose_geometry::transform::from_row_major;
use repose_proto::motion::{ExecuteReply, ExecutionOutcome, MotionPlanRequest, RecoverReply, RobotResetReply, RobotResetRequest};
use repose_proto::simulator::WorldResetRequest;
use repose_proto::{CallError, ErrorCode, Message as _, Payload, PlaceRequest, Scene, SceneRef, Service};
use repose_runtime::{CallOptions, CancellationToken, UnderWay};
use tokio::sync::mpsc;

use super::calls::{execute, plan, recover};
use super::planned::DisplayedPlan;
use super::site::PageSite;
use super::state::AppState;
use crate::access::Role;
use crate::cell::{Camera, WatchedCell};
use crate::messages::{Answered, Ask, DrawnMessage, Request, ServerMessage};
use crate::view::SceneView;
use crate::viewers::{Outbox, Topic, ViewerMessage};

/// Requests of one viewer that may be open; the next is refused.
const MAX_OPEN: usize = 16;
/// Progress that may wait; what does not fit is dropped.
const PROGRESS: usize = 16;
/// Scenes kept for a viewer: the one that it is sent, and the one before, which is on its screen until then.
const SENT: usize = 2;
/// How long a reset may take.
const RESET: Duration = Duration::from_secs(10);

/// Somebody who looks.
pub struct Viewer {
    id: u64,
    role: Role,
    outbox: Arc<Outbox>,
    state: Arc<AppState>,
    eyes: Mutex<Eyes>,
}

/// What a viewer looks at, and what it has in hand.
#[derive(Default)]
struct Eyes {
    /// The newest request to watch. One that it has overtaken changes nothing any more.
    wanted: Option<u64>,
    cell: Option<Arc<WatchedCell>>,
    camera: Option<Arc<Camera>>,
    held: Option<Arc<SceneView>>,
    /// The scenes that were sent last, newest last: one of them is on the screen.
    sent: VecDeque<Arc<SceneView>>,
    plan: Option<DisplayedPlan>,
    open: BTreeMap<u64, CancellationToken>,
}

impl Viewer {
    /// A viewer that looks at nothing yet.
    pub fn new(id: u64, role: Role, outbox: Arc<Outbox>, state: Arc<AppState>) -> Arc<Self> {
        Arc::new(Self { id, role, outbox, state, eyes: Mutex::default() })
    }

    /// Where its messages go.
    pub fn outbox(&self) -> &Arc<Outbox> {
        &self.outbox
    }

    fn eyes(&self) -> MutexGuard<'_, Eyes> {
        self.eyes.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Begins to be told which cells there are.
    ///
    /// # Errors
    /// When the network refuses.
    pub async fn look_everywhere(&self) -> Result<(), CallError> {
        self.state.everywhere().await?.join(self.id, self.outbox.clone());
        Ok(())
    }

    /// Takes the viewer out of every audience and gives up what it asked for, but for what moves a robot.
    pub async fn leave(&self) {
        // A request to watch that is still open is no longer wanted, and joins nothing.
        let eyes = std::mem::take(&mut *self.eyes());
        eyes.open.values().for_each(CancellationToken::cancel);
        if let Ok(everywhere) = self.state.everywhere().await {
            everywhere.leave(self.id);
        }
        if let (Some(cell), Some(DisplayedPlan { id: plan, .. })) = (&eyes.cell, &eyes.plan) {
            cell.hide_plan(|shown| shown.plan == *plan);
        }
        leave(self.id, &eyes);
    }

    /// Takes a request; its answer comes to the outbox.
    pub fn take(self: &Arc<Self>, request: Request) {
        let Request { id, ask } = request;
        if let Ask::Seen { what } = ask {
            return self.outbox.seen(&if what == DrawnMessage::Picture { Topic::Picture } else { Topic::Scene });
        }
        if ask == Ask::Received {
            return self.outbox.received();
        }
        // None of the open ones: whoever has as many open as may be gives one up to ask for another.
        if let Ask::Cancel { request } = ask {
            if let Some(open) = self.eyes().open.get(&request) {
                open.cancel();
            }
            return self.outbox.put(Topic::Answer(id), ServerMessage::Answer { id, result: Box::new(Answered::Done {}) }.encode());
        }
        let cancel = CancellationToken::new();
        let under_way = match self.admit(id, &ask, cancel.clone()) {
            Ok(under_way) => under_way,
            Err(error) => return self.outbox.put(Topic::Answer(id), ServerMessage::Refused { id, error }.encode()),
        };
        let viewer = self.clone();
        tokio::spawn(async move {
            let answered = viewer.carry_out(id, ask, cancel).await;
            viewer.eyes().open.remove(&id);
            let told = match answered {
                Ok(result) => ServerMessage::Answer { id, result: Box::new(result) },
                Err(error) => ServerMessage::Refused { id, error },
            };
            viewer.outbox.put(Topic::Answer(id), told.encode());
            // Only here: a console that is to end says its last words then.
            drop(under_way);
        });
    }

    /// Takes a request among the open ones, and a robot's move as one under way.
    fn admit(&self, id: u64, ask: &Ask, cancel: CancellationToken) -> Result<Option<UnderWay>, CallError> {
        self.role.check(ask.needs())?;
        let mut eyes = self.eyes();
        if eyes.open.len() >= MAX_OPEN {
            return Err(busy(MAX_OPEN));
        }
        if eyes.open.contains_key(&id) {
            return Err(CallError::invalid("id", format!("request {id} is open already")));
        }
        let under_way = ask.moves_until_answered().then(|| self.state.moves.begin("a request of a page")).transpose()?;
        eyes.open.insert(id, cancel);
        // Noted here, in the order in which they come: their tasks run in any.
        if matches!(ask, Ask::Watch { .. }) {
            eyes.wanted = Some(id);
        }
        Ok(under_way)
    }

    async fn carry_out(self: &Arc<Self>, id: u64, ask: Ask, cancel: CancellationToken) -> Result<Answered, CallError> {
        match ask {
            Ask::Watch { cell, camera } => self.watch(id, &cell, camera.as_deref()).await,
            // Taken above.
            Ask::Seen { .. } | Ask::Received | Ask::Cancel { .. } => Ok(Answered::Done {}),
            Ask::Hold { scene_id } => self.hold(&scene_id).await,
            Ask::Segment { scene_id, pixel } => self.segment(&scene_id, pixel).await,
            Ask::Place { request } => self.place(id, &request, cancel).await,
            Ask::Plan { scene_id, robot, query, placements, seed } => {
                let scene = SceneRef { scene_id };
                let request = MotionPlanRequest { scene, robot, query, placements, start_joints_rad: [0.0; 7], grasps: None, seed };
                self.plan(request, cancel).await
            }
            Ask::Execute { plan } => self.execute(&plan).await,
            Ask::Discard { plan } => {
                // Everybody in the cell is shown the id: one that is another's stays.
                if self.eyes().plan.take_if(|known| known.id == plan).is_some() {
                    self.cell()?.hide_plan(|shown| shown.plan == plan);
                }
                Ok(Answered::Done {})
            }
            Ask::Sequence { scene_id, robot, goals } => {
                let (cell, camera) = self.watched()?;
                let scene = self.scene(&cell, &scene_id).await?;
                super::sequence::begin(cell, camera, (scene_id, scene), robot, goals, &self.state.config)
            }
            Ask::Arrange { request } => {
                let cell = self.cell()?;
                let scene = self.scene(&cell, &request.scene.scene_id).await.ok();
                let options = CallOptions { cancel, ..CallOptions::within(self.deadline()) };
                super::arrangement::asked(&cell, &request, scene.as_deref(), options).await
            }
            Ask::BringAbout { robot, request } => {
                let (cell, camera) = self.watched()?;
                let scene = self.scene(&cell, &request.scene.scene_id).await?;
                super::arrangement::begin(cell, camera, scene, robot, *request, &self.state.config)
            }
            Ask::EndSequence => {
                let cell = self.cell()?;
                super::sequence::end(&cell);
                super::arrangement::end(&cell);
                Ok(Answered::Done {})
            }
            Ask::Reset { robot, stop } => self.reset(RobotResetRequest { robot, stop }).await,
            Ask::Recover { robot, motion, unchecked } => {
                let (cell, camera) = self.watched()?;
                let RecoverReply { outcome, reason, checked_against, .. } =
                    recover(&cell, camera.name(), &robot, motion, unchecked).await?;
                Ok(Answered::Recovered { outcome, reason, checked_against, camera: camera.name().to_owned() })
            }
            Ask::NewScene { seed } => {
                let request = Payload::json(&WorldResetRequest { seed })?;
                self.cell()?.caller(Service::Simulator).call("reset", request, CallOptions::at_most_once(RESET)).await?;
                Ok(Answered::Done {})
            }
        }
    }

    fn cell(&self) -> Result<Arc<WatchedCell>, CallError> {
        self.eyes().cell.clone().ok_or_else(|| CallError::precondition("no cell is watched yet").at("cell"))
    }

    /// The cell, and the camera of it.
    fn watched(&self) -> Result<(Arc<WatchedCell>, Arc<Camera>), CallError> {
        let eyes = self.eyes();
        let nothing = |what: &str| CallError::precondition(format!("no {what} is watched yet")).at(what);
        let cell = eyes.cell.clone().ok_or_else(|| nothing("cell"))?;
        Ok((cell, eyes.camera.clone().ok_or_else(|| nothing("camera"))?))
    }

    /// Changes what is looked at, unless the viewer has gone on to another cell since it asked.
    fn change_in(&self, cell: &Arc<WatchedCell>, change: impl FnOnce(&mut Eyes)) -> Result<(), CallError> {
        let mut eyes = self.eyes();
        if !eyes.cell.as_ref().is_some_and(|now| Arc::ptr_eq(now, cell)) {
            return Err(CallError::precondition(format!("cell {} is no longer watched", cell.name())).at("cell"));
        }
        change(&mut eyes);
        Ok(())
    }

    /// Begins to watch; `id` is the request's. Both times that something was waited for, only the newest such request goes on: else a camera
    /// that comes late would be looked through in a cell that is not its own.
    async fn watch(&self, id: u64, cell: &str, camera: Option<&str>) -> Result<Answered, CallError> {
        let overtaken = || CallError::new(ErrorCode::Cancelled, "another cell or camera was asked for since");
        let cell = self.state.cell(cell).await?;
        // The cell is shown even where it has no camera yet.
        {
            let mut eyes = self.eyes();
            if eyes.wanted != Some(id) {
                return Err(overtaken());
            }
            let is_same = eyes.cell.as_ref().is_some_and(|old| Arc::ptr_eq(old, &cell));
            let (wanted, open, held, plan) = (eyes.wanted, std::mem::take(&mut eyes.open), eyes.held.take(), eyes.plan.take());
            let before = std::mem::replace(&mut *eyes, Eyes { wanted, cell: Some(cell.clone()), open, ..Eyes::default() });
            leave(self.id, &before);
            // Nobody can carry it out any more, and those who still look at that cell would see it as the motion to come.
            if let (false, Some(old), Some(DisplayedPlan { id: plan, .. })) = (is_same, &before.cell, &plan) {
                old.hide_plan(|shown| shown.plan == *plan);
            }
            if is_same {
                (eyes.held, eyes.plan) = (held, plan);
            }
            // What is told from here on is of this cell.
            self.outbox.forget(Topic::is_of_cell);
            self.outbox.put(Topic::Watching, ServerMessage::Watching { cell: cell.name().to_owned() }.encode());
            cell.audience().join(self.id, self.outbox.clone());
        }
        let camera = cell.camera(camera).await?;
        let mut eyes = self.eyes();
        if eyes.wanted != Some(id) {
            return Err(overtaken());
        }
        camera.audience().join(self.id, self.outbox.clone());
        eyes.camera = Some(camera);
        Ok(Answered::Done {})
    }

    /// Keeps a scene; one that is at hand no longer, as after a connection that was lost for a while, as perception has it.
    async fn hold(&self, scene_id: &str) -> Result<Answered, CallError> {
        let cell = self.cell()?;
        let view = match self.view(&cell, scene_id) {
            Ok(view) => view,
            Err(gone) => Arc::new(cell.view(scene_id).await.map_err(|_| gone)?),
        };
        self.change_in(&cell, |eyes| eyes.held = Some(view))?;
        Ok(Answered::Done {})
    }

    /// Notes that a scene is sent to this viewer.
    pub fn sends(&self, view: Arc<SceneView>) {
        let mut eyes = self.eyes();
        // One that was on its way when the viewer went to another cell is not of what it looks at.
        if eyes.cell.as_ref().is_some_and(|cell| cell.name() == view.cell) {
            eyes.sent.push_back(view);
        }
        if eyes.sent.len() > SENT {
            eyes.sent.pop_front();
        }
    }

    /// A scene of a cell that this viewer holds or may have on its screen; where it came more than once, as it came with its frame.
    fn view(&self, cell: &WatchedCell, scene_id: &str) -> Result<Arc<SceneView>, CallError> {
        let eyes = self.eyes();
        let shown = eyes.camera.as_ref().and_then(|camera| camera.view(scene_id));
        let known = eyes.held.iter().chain(&eyes.sent).chain(&shown).filter(|v| v.scene_id == scene_id && v.cell == cell.name());
        // The first of those that are best.
        let best = known.min_by_key(|view| view.frame.is_none());
        best.cloned().ok_or_else(|| CallError::not_found("scene_id", "this scene is no longer shown"))
    }

    async fn segment(&self, scene_id: &str, pixel: [usize; 2]) -> Result<Answered, CallError> {
        let cell = self.cell()?;
        let view = self.view(&cell, scene_id)?;
        let view = Arc::new(cell.segmented(&view, pixel).await?);
        self.change_in(&cell, |eyes| {
            self.outbox.put(Topic::Segmented, ViewerMessage::View(view.clone()));
            eyes.held = Some(view);
        })?;
        Ok(Answered::Done {})
    }

    /// A scene of a cell that this viewer has seen, or that the cell's perception still has.
    async fn scene(&self, cell: &WatchedCell, scene_id: &str) -> Result<Arc<Scene>, CallError> {
        match self.view(cell, scene_id) {
            Ok(view) => Ok(view.scene.clone()),
            Err(_) => Ok(Arc::new(cell.scene(scene_id).await?)),
        }
    }

    fn deadline(&self) -> Duration {
        Duration::from_millis(self.state.config.request_deadline_ms)
    }

    async fn place(&self, id: u64, request: &PlaceRequest, cancel: CancellationToken) -> Result<Answered, CallError> {
        request.validate()?;
        let (cell, started) = (self.cell()?, Instant::now());
        let scene = self.scene(&cell, &request.scene.scene_id).await.ok();
        let (sender, mut progress) = mpsc::channel::<Payload>(PROGRESS);
        let telling = {
            let outbox = self.outbox.clone();
            tokio::spawn(async move {
                while let Some(payload) = progress.recv().await {
                    let Ok(progress) = serde_json::from_slice(&payload.bytes) else { continue };
                    outbox.put(Topic::Progress(id), ServerMessage::Progress { id, progress }.encode());
                }
            })
        };
        let options = CallOptions { progress: Some(sender), cancel, ..CallOptions::within(self.deadline()) };
        let answered = cell.caller(Service::Planner).place(request, scene.as_deref(), options).await;
        telling.abort();
        let (placed, answer) = answered?;
        let took_ms = started.elapsed().as_secs_f64() * 1e3;
        Ok(Answered::Placed { placed: Box::new(placed), worker: answer.worker, timing_ms: answer.timing_ms, took_ms })
    }

    async fn plan(&self, request: MotionPlanRequest, cancel: CancellationToken) -> Result<Answered, CallError> {
        let cell = self.cell()?;
        let scene = self.scene(&cell, &request.scene.scene_id).await?;
        let options = CallOptions { cancel, ..CallOptions::within(self.deadline()) };
        let placements = request.placements.clone();
        let (plan, shown) = plan(&cell, request, &scene, options).await?;
        let placed = placements.get(plan.placement).ok_or_else(|| CallError::internal("motion chose no placement of ours"))?;
        let moved = from_row_major(&placed.0).map_err(|e| CallError::internal(e.to_string()))?;
        let id = shown.plan.clone();
        self.change_in(&cell, |eyes| {
            eyes.plan = Some(DisplayedPlan { id: id.clone(), plan, scene, moved });
            // At the same instant: whoever leaves hides what is at hand, and this would be shown after that.
            cell.show_plan(shown);
        })?;
        Ok(Answered::Planned { plan: id })
    }

    async fn execute(&self, id: &str) -> Result<Answered, CallError> {
        // A plan goes with the cell that it was made in: both are taken at one instant.
        let (planned, cell, camera) = {
            let mut eyes = self.eyes();
            (eyes.plan.take_if(|known| known.id == id), eyes.cell.clone(), eyes.camera.clone())
        };
        let (Some(planned), Some(cell)) = (planned, cell) else {
            return Err(CallError::not_found("plan", "this plan is not at hand; plan again"));
        };
        let reply: ExecuteReply = execute(&cell, planned.id.clone(), &planned.plan).await?.payload.decode_json()?;
        let is_done = reply.outcome == ExecutionOutcome::Done;
        if let Some(camera) = camera {
            let site = PageSite::of(cell, camera, planned.plan.robot.clone(), self.deadline());
            tokio::spawn(async move {
                if let Err(error) = planned.look_after(&site, is_done).await {
                    tracing::debug!(%error, "what else has moved cannot be seen");
                }
            });
        }
        Ok(Answered::Executed { outcome: reply.outcome, reason: reply.reason })
    }

    async fn reset(&self, wanted: RobotResetRequest) -> Result<Answered, CallError> {
        let request = Payload::json(&wanted)?;
        let answer = self.cell()?.caller(Service::Motion).call("reset", request, CallOptions::at_most_once(RESET)).await?;
        let reply: RobotResetReply = answer.payload.decode_json()?;
        Ok(Answered::Cleared { was_stopped: reply.was_stopped })
    }
}

fn leave(viewer: u64, eyes: &Eyes) {
    if let Some(cell) = &eyes.cell {
        cell.audience().leave(viewer);
    }
    if let Some(camera) = &eyes.camera {
        camera.audience().leave(viewer);
    }
}

/// The answer to a request that came while too many were open.
fn busy(most: usize) -> CallError {
    CallError::new(ErrorCode::ResourceExhausted, format!("{most} requests of this page are open already"))
}
