//! A cell as its viewers see it: followed while somebody looks, and told to everyone who does.
//!
//! One [`WatchedCell`] serves all its viewers: each frame is encoded once and each scene fetched once, whoever looks. Dropping the last handle to a
//! cell or to one of its cameras ends the subscriptions.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, Instant};

use repose_pictures::jpeg;
use repose_proto::robot::RobotState;
use repose_proto::{CallError, ErrorCode, Frame, Message as _, Payload, Scene, SceneSummary, Service, keys};
use repose_runtime::{CallOptions, Caller, Moves, SCENE_WITHIN, Sample, Session, Subscription, fetch_newest, fetch_scene, read_robot_mode};
use tokio::sync::Notify;
use tokio::task::JoinSet;
use tokio::time::{MissedTickBehavior, interval};

use crate::ConsoleConfig;
use crate::activity::{Activity, SequenceShown, StepShown};
use crate::arm::{PlanShown, link_poses, world_from_base};
use crate::arrangement::ArrangementShown;
use crate::messages::{RobotShown, ServerMessage, SystemShown, WorkerShown};
use crate::robots::KnownRobots;
use crate::system::SceneArrivals;
use crate::view::{CameraPicture, SceneView, ViewReason, picture_bytes};
use crate::viewers::{Audience, Topic, ViewerMessage};

/// Robot states that may wait for their turn.
const STATES: usize = 256;
/// Scene summaries that may.
const SUMMARIES: usize = 64;
/// Pictures kept to go with the scenes made of them.
const PICTURES: usize = 8;
/// Views kept for goals about them; what a viewer holds is kept beside these.
const VIEWS: usize = 6;
/// How long to wait for a cell's first camera.
const CAMERA_WITHIN: Duration = Duration::from_secs(2);
/// How long perception may take to say what its newest scene is.
const NEWEST_WITHIN: Duration = Duration::from_secs(5);
/// How often a camera that is looked at is asked for its newest scene; sooner than perception takes nobody to ask.
const ASK_PERIOD: Duration = Duration::from_secs(4);

/// A cell that at least one viewer watches.
pub struct WatchedCell {
    shared: Arc<Shared>,
    cameras: Mutex<BTreeMap<String, Weak<Camera>>>,
    moves: Moves,
    _following: JoinSet<()>,
}

struct Shared {
    session: Session,
    name: String,
    config: Arc<ConsoleConfig>,
    callers: BTreeMap<Service, Caller>,
    audience: Audience,
    known: Mutex<Parts>,
    camera_came: Notify,
}

/// What is known of a cell's parts.
#[derive(Default)]
struct Parts {
    cameras: SceneArrivals,
    robots: KnownRobots,
    activity: Activity,
    /// The plan that is shown.
    plan: Option<Arc<PlanShown>>,
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl WatchedCell {
    /// Begins to follow a cell; `moves` are those that the console has robots make, here and elsewhere.
    ///
    /// # Errors
    /// When the name is no chunk of a key, or the network refuses.
    pub async fn follow(session: &Session, name: &str, config: Arc<ConsoleConfig>, moves: Moves) -> Result<Self, CallError> {
        let session = session.in_cell(name)?;
        let mut callers = BTreeMap::new();
        for service in Service::ALL {
            callers.insert(service, session.caller(service).await?);
        }
        let states = session.subscribe_queue(&session.cell().robot_states(), STATES).await?;
        let summaries = session.subscribe_queue(&session.cell().scenes(), SUMMARIES).await?;
        let (audience, known, camera_came) = (Audience::default(), Mutex::default(), Notify::new());
        let shared = Arc::new(Shared { session, name: name.to_owned(), config, callers, audience, known, camera_came });
        let mut following = JoinSet::new();
        following.spawn(shared.clone().follow_robots(states));
        following.spawn(shared.clone().follow_cameras(summaries));
        following.spawn(shared.clone().follow_workers());
        Ok(Self { shared, cameras: Mutex::default(), moves, _following: following })
    }

    /// The cell's name.
    pub fn name(&self) -> &str {
        &self.shared.name
    }

    /// The session in this cell.
    pub fn session(&self) -> &Session {
        &self.shared.session
    }

    /// Those who look at this cell.
    pub fn audience(&self) -> &Audience {
        &self.shared.audience
    }

    /// The moves of this console.
    pub fn moves(&self) -> &Moves {
        &self.moves
    }

    /// Calls to a service of this cell.
    pub fn caller(&self, service: Service) -> &Caller {
        // `follow` has made one for each.
        &self.shared.callers[&service]
    }

    /// The newest state of a robot.
    ///
    /// # Errors
    /// `unavailable` when it has told none, or one that no robot can be in.
    pub fn robot(&self, robot: &str) -> Result<RobotState, CallError> {
        let unavailable = |message| CallError::new(ErrorCode::Unavailable, message).at("robot");
        let silent = || unavailable(format!("robot {robot} does not tell its state"));
        let state = locked(&self.shared.known).robots.state(robot).cloned().ok_or_else(silent)?;
        state.validate().map_err(|error| unavailable(format!("robot {robot} tells no state that can be read: {error}")))?;
        Ok(state)
    }

    /// Follows one of this cell's cameras; the first by name that shows something where none is named.
    ///
    /// # Errors
    /// `unavailable` when there is no camera yet, or what the network says.
    pub async fn camera(&self, name: Option<&str>) -> Result<Arc<Camera>, CallError> {
        let nobody =
            || CallError::new(ErrorCode::Unavailable, format!("cell {} has no camera that shows a scene", self.name())).at("camera");
        let name = match name {
            Some(name) => name.to_owned(),
            None => tokio::time::timeout(CAMERA_WITHIN, self.first_camera()).await.map_err(|_| nobody())?,
        };
        keys::validate_chunk("camera", &name)?;
        if let Some(camera) = locked(&self.cameras).get(&name).and_then(Weak::upgrade) {
            return Ok(camera);
        }
        let camera = Arc::new(Camera::follow(self.shared.clone(), &name).await?);
        let mut cameras = locked(&self.cameras);
        cameras.retain(|_, known| known.strong_count() > 0);
        // Two viewers may have asked at once: the first one's stays.
        if let Some(other) = cameras.get(&name).and_then(Weak::upgrade) {
            return Ok(other);
        }
        cameras.insert(name, Arc::downgrade(&camera));
        Ok(camera)
    }

    async fn first_camera(&self) -> String {
        loop {
            let mut changed = std::pin::pin!(self.shared.camera_came.notified());
            changed.as_mut().enable();
            if let Some(name) = locked(&self.shared.known).cameras.first(Instant::now()) {
                return name.to_owned();
            }
            changed.await;
        }
    }

    /// Changes what is said to be carried out here, and tells everyone.
    pub fn update(&self, change: impl FnOnce(&mut Activity)) {
        let mut known = locked(&self.shared.known);
        change(&mut known.activity);
        // Told before anybody changes it again: of two who change it at once, the one that came first would otherwise be told last, and stay on the pages.
        self.shared.audience.tell(&Topic::Activity, &ServerMessage::Activity(Box::new(known.activity.clone())).encode());
    }

    /// Begins to carry out something of several moves, unless something is under way.
    ///
    /// # Errors
    /// `failed_precondition` where it is.
    pub fn begin(&self, change: impl FnOnce(&mut Activity)) -> Result<(), CallError> {
        let mut under_way = None;
        self.update(|activity| {
            under_way = activity.under_way();
            if under_way.is_none() {
                change(activity);
            }
        });
        let refusal = |what| CallError::precondition(format!("{what} is under way in this cell; end it first"));
        under_way.map_or(Ok(()), |what| Err(refusal(what)))
    }

    /// Changes the step that the sequence under way is at, where there is one, and tells everybody.
    pub fn update_step(&self, change: impl FnOnce(&mut StepShown)) {
        self.update(|activity| {
            if let Some(step) = activity.sequence.as_mut().and_then(SequenceShown::step_under_way) {
                change(step);
            }
        });
    }

    /// Changes what is shown of the arrangement that is being brought about, where there is one, and tells everybody.
    pub fn update_arrangement(&self, change: impl FnOnce(&mut ArrangementShown)) {
        self.update(|activity| {
            if let Some(shown) = activity.arrangement.as_mut().filter(|shown| !shown.ended) {
                change(shown);
            }
        });
    }

    /// Shows everyone a motion that was planned.
    pub fn show_plan(&self, shown: Arc<PlanShown>) {
        let message = ServerMessage::Plan { shown: Some(shown.clone()) }.encode();
        let mut known = locked(&self.shared.known);
        known.plan = Some(shown);
        // Told before it can be hidden, as in `update`.
        self.shared.audience.tell(&Topic::Plan, &message);
    }

    /// Shows no planned motion any more, where it is one that `is_over`.
    pub fn hide_plan(&self, is_over: impl FnOnce(&PlanShown) -> bool) {
        let mut known = locked(&self.shared.known);
        if known.plan.take_if(|shown| is_over(shown)).is_some() {
            self.shared.audience.tell(&Topic::Plan, &ServerMessage::Plan { shown: None }.encode());
        }
    }

    /// A whole scene from the perception worker that holds it.
    ///
    /// # Errors
    /// `not_found` when nobody does any more.
    pub async fn scene(&self, scene_id: &str) -> Result<Scene, CallError> {
        self.shared.scene(scene_id).await
    }

    /// The same as viewers get it, without the frame that it was made of.
    ///
    /// # Errors
    /// `not_found` when nobody has it any more; `invalid_argument` when its camera has no pose.
    pub async fn view(&self, scene_id: &str) -> Result<SceneView, CallError> {
        let scene = self.scene(scene_id).await?;
        let (cell, scene_id, cloud_points) = (self.name().to_owned(), scene_id.to_owned(), self.shared.config.cloud_points);
        computed(move || SceneView::new(ViewReason::Live, cell, scene_id, scene.into(), None, cloud_points)).await
    }

    /// A view with the object that is seen at a pixel (column, row) of it, where perception can tell one there.
    ///
    /// # Errors
    /// `failed_precondition` when the view's frame is not at hand, `invalid_argument` on `pixel` outside it, or what perception says.
    pub async fn segmented(&self, view: &SceneView, pixel: [usize; 2]) -> Result<SceneView, CallError> {
        let camera = &view.scene.meta.camera;
        if pixel[0] >= camera.width || pixel[1] >= camera.height {
            let message = format!("expected a pixel of {} x {}, got {pixel:?}", camera.width, camera.height);
            return Err(CallError::invalid("pixel", message));
        }
        let frame = view.frame.clone().ok_or_else(|| CallError::precondition("the frame of this scene is no longer at hand"))?;
        let hinted = computed(move || {
            let mut bulk = frame.decode_bulk(Frame::SCHEMA)?;
            bulk.metadata.insert("hints".to_owned(), serde_json::json!({"clicks_px": [pixel]}).to_string());
            Payload::bulk(Frame::SCHEMA, &bulk)
        });
        let (hinted, options) = (hinted.await?, CallOptions::within(SCENE_WITHIN));
        let answer = self.caller(Service::Perception).call("segment", hinted, options).await?;
        let (quality, cloud_points) = (self.shared.config.jpeg_quality, self.shared.config.cloud_points);
        let (cell, frame) = (self.name().to_owned(), view.frame.clone());
        computed(move || {
            let scene = Scene::from_bulk(&answer.payload.decode_bulk(Scene::SCHEMA)?)?;
            let picture = frame.map(|frame| picture_of(frame, quality)).transpose()?;
            SceneView::new(ViewReason::Segmented, cell, scene.id(), scene.into(), picture.as_ref(), cloud_points)
        })
        .await
    }

    /// The newest scene of a camera, in short.
    ///
    /// # Errors
    /// `not_found` when perception has none.
    pub async fn newest(&self, camera: &str) -> Result<SceneSummary, CallError> {
        self.shared.newest(camera).await
    }
}

impl Shared {
    async fn follow_robots(self: Arc<Self>, mut states: Subscription) {
        let mut tick = ticking(self.config.robot_period_ms);
        loop {
            tick.tick().await;
            // States come faster than anybody looks: only the newest of each robot is read.
            let mut newest: BTreeMap<String, Sample> = BTreeMap::new();
            while let Some(sample) = states.try_recv() {
                newest.insert(sample.key.clone(), sample);
            }
            for sample in newest.into_values() {
                let Some(robot) = keys::worker_of(&sample.key) else { continue };
                // Whether it moves or is stopped is shown, and it can be stopped by its name, also beside a number that no robot can have.
                if let Ok(state) = read_robot_mode(&sample) {
                    self.saw_robot(robot, state);
                }
            }
        }
    }

    fn saw_robot(&self, robot: &str, state: RobotState) {
        if !locked(&self.known).robots.saw(robot, state.clone(), Instant::now()) {
            return;
        }
        let links = state.validate().is_ok().then(|| link_poses(&world_from_base(&state), &state.q_rad));
        let shown = RobotShown { robot: robot.to_owned(), state, links };
        self.audience.tell(&Topic::Robot(robot.to_owned()), &ServerMessage::Robot(Box::new(shown)).encode());
    }

    async fn follow_cameras(self: Arc<Self>, mut summaries: Subscription) {
        while let Some(sample) = summaries.recv().await {
            let is_new = locked(&self.known).cameras.saw(keys::last_chunk(&sample.key), Instant::now());
            if is_new {
                self.camera_came.notify_waiters();
                self.tell_system();
            }
        }
    }

    async fn follow_workers(self: Arc<Self>) {
        let mut tick = ticking(self.config.system_period_ms);
        loop {
            tick.tick().await;
            self.tell_system();
        }
    }

    fn tell_system(&self) {
        let of_service = |(service, caller): (&Service, &Caller)| {
            let shown = |w: repose_runtime::WorkerView| WorkerShown {
                service: *service,
                name: w.name,
                load: w.load,
                silent_ms: w.silent.as_secs_f64() * 1e3,
            };
            caller.workers().into_iter().map(shown).collect::<Vec<_>>()
        };
        let workers: Vec<WorkerShown> = self.callers.iter().flat_map(of_service).collect();
        let now = Instant::now();
        let told = workers.iter().flat_map(|worker| &worker.load).flat_map(|load| &load.cameras);
        let (cameras, robots, is_new) = {
            let mut known = locked(&self.known);
            let (is_new, robots) = (known.cameras.told(told, now), known.robots.names(now));
            self.audience.forget(|topic| matches!(topic, Topic::Robot(name) if !robots.contains(name)));
            (known.cameras.shown(now), robots, is_new)
        };
        if is_new {
            self.camera_came.notify_waiters();
        }
        let shown = SystemShown { cell: self.name.clone(), workers, cameras, robots };
        self.audience.tell(&Topic::System, &ServerMessage::System(shown).encode());
    }

    async fn scene(&self, scene_id: &str) -> Result<Scene, CallError> {
        fetch_scene(&self.callers[&Service::Perception], scene_id, &CallOptions::within(SCENE_WITHIN)).await
    }

    async fn newest(&self, camera: &str) -> Result<SceneSummary, CallError> {
        fetch_newest(&self.callers[&Service::Perception], camera, &CallOptions::within(NEWEST_WITHIN)).await
    }
}

/// A camera that somebody looks at.
pub struct Camera {
    name: String,
    seen: Arc<Seen>,
    _following: JoinSet<()>,
}

/// What a camera has shown.
#[derive(Default)]
struct Seen {
    audience: Audience,
    pictures: Mutex<VecDeque<CameraPicture>>,
    views: Mutex<VecDeque<Arc<SceneView>>>,
}

impl Camera {
    async fn follow(cell: Arc<Shared>, name: &str) -> Result<Self, CallError> {
        let frames = cell.session.subscribe_latest(&cell.session.cell().camera_frame(name)).await?;
        let summaries = cell.session.subscribe_latest(&cell.session.cell().scene(name)).await?;
        let seen = Arc::new(Seen::default());
        let mut following = JoinSet::new();
        following.spawn(follow_frames(cell.config.clone(), name.to_owned(), frames, seen.clone()));
        following.spawn(follow_scenes(cell, name.to_owned(), summaries, seen.clone()));
        Ok(Self { name: name.to_owned(), seen, _following: following })
    }

    /// The camera's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Those who look through this camera.
    pub fn audience(&self) -> &Audience {
        &self.seen.audience
    }

    /// A scene that was shown a short while ago.
    pub fn view(&self, scene_id: &str) -> Option<Arc<SceneView>> {
        locked(&self.seen.views).iter().find(|v| v.scene_id == scene_id).cloned()
    }
}

async fn follow_frames(config: Arc<ConsoleConfig>, camera: String, mut frames: Subscription, seen: Arc<Seen>) {
    let mut pause = ticking(config.picture_period_ms);
    loop {
        pause.tick().await;
        let Some(sample) = frames.recv().await else { return };
        let quality = config.jpeg_quality;
        match computed(move || picture_of(sample.payload, quality)).await {
            Ok(picture) => {
                seen.audience.tell(&Topic::Picture, &ViewerMessage::Binary(picture_bytes(&camera, &picture)));
                let mut pictures = locked(&seen.pictures);
                pictures.push_back(picture);
                if pictures.len() > PICTURES {
                    pictures.pop_front();
                }
            }
            Err(error) => tracing::debug!(camera, %error, "a frame that cannot be shown"),
        }
    }
}

fn picture_of(payload: Payload, quality: u8) -> Result<CameraPicture, CallError> {
    let frame = Frame::from_bulk(&payload.decode_bulk(Frame::SCHEMA)?)?;
    let jpeg = jpeg(&frame, quality)?.into();
    Ok(CameraPicture { stamp_ns: frame.stamp_ns, jpeg, frame: payload })
}

async fn follow_scenes(cell: Arc<Shared>, camera: String, mut summaries: Subscription, seen: Arc<Seen>) {
    // What there is already need not be waited for.
    if let Ok(summary) = cell.newest(&camera).await {
        show_scene(&cell, &summary, &seen).await;
    }
    let (mut pause, mut asked) = (ticking(cell.config.scene_period_ms), Instant::now());
    loop {
        pause.tick().await;
        let Some(sample) = summaries.recv().await else { return };
        if asked.elapsed() >= ASK_PERIOD {
            asked = Instant::now();
            // Where nothing changes no scene is asked for, and perception makes fewer of them; who looks wants to see what changes at once.
            drop(cell.newest(&camera).await);
        }
        match sample.payload.decode_json::<SceneSummary>() {
            Ok(summary) => show_scene(&cell, &summary, &seen).await,
            Err(error) => tracing::debug!(camera, %error, "a scene's summary that cannot be read"),
        }
    }
}

async fn show_scene(cell: &Shared, summary: &SceneSummary, seen: &Seen) {
    let scene_id = summary.scene_id.clone();
    let picture = locked(&seen.pictures).iter().find(|p| p.stamp_ns == summary.stamp_ns).cloned();
    // Where nothing changes the id stays: one that came before the first frame gets its picture from a later one, which shows the same.
    let shown = locked(&seen.views).back().filter(|view| view.scene_id == scene_id).cloned();
    if shown.as_ref().is_some_and(|view| view.frame.is_some() || picture.is_none()) {
        return;
    }
    let (name, cloud_points, stamp_ns) = (cell.name.clone(), cell.config.cloud_points, summary.stamp_ns);
    let made = async {
        let scene = match shown {
            Some(view) => Scene { stamp_ns, ..(*view.scene).clone() },
            None => cell.scene(&scene_id).await?,
        };
        computed(move || SceneView::new(ViewReason::Live, name, scene_id, scene.into(), picture.as_ref(), cloud_points)).await
    };
    match made.await {
        Ok(view) => {
            let view = Arc::new(view);
            seen.audience.tell(&Topic::Scene, &ViewerMessage::View(view.clone()));
            let mut views = locked(&seen.views);
            views.retain(|known| known.scene_id != view.scene_id);
            views.push_back(view);
            if views.len() > VIEWS {
                views.pop_front();
            }
        }
        // The next one comes soon.
        Err(error) => tracing::debug!(camera = summary.camera, %error, "a scene that cannot be shown"),
    }
}

/// Computes beside the async threads.
async fn computed<T: Send + 'static>(work: impl FnOnce() -> Result<T, CallError> + Send + 'static) -> Result<T, CallError> {
    tokio::task::spawn_blocking(work).await.map_err(|e| CallError::internal(format!("the computation was lost: {e}")))?
}

fn ticking(period_ms: u64) -> tokio::time::Interval {
    let mut tick = interval(Duration::from_millis(period_ms));
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    tick
}
