//! What there is around a client, as it says of itself: cells, workers with their loads, cameras with their newest scenes, robots.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use repose_proto::load::{CameraLoad, WorkerLoad};
use repose_proto::robot::RobotState;
use repose_proto::{Cell, SceneSummary, Service, keys};
use repose_runtime::{Lives, Sample, Session, Subscription, now_ns, read_robot_state};
use tokio::time::Instant;

use crate::failure::Failure;

/// Messages that may wait while others are read.
const WAITING: usize = 1024;
/// How long names are listened for that an error is to list. A worker tells its load every 200 ms at least, a robot its state more often.
const NAMES_WITHIN: Duration = Duration::from_millis(400);

/// A message and the instant at which it was received.
#[derive(Debug, Clone)]
pub struct Received<T> {
    /// The first message while it was listened.
    pub first: T,
    /// When that came.
    pub first_at: Instant,
    /// The newest message.
    pub newest: T,
    /// When it came.
    pub at: Instant,
    /// How many came while it was listened.
    pub count: u64,
    /// The least time from a message's stamp to when it came, by this host's clock, milliseconds; none where messages have no stamp.
    pub lag_ms: Option<f64>,
}

/// What was heard of a camera. While nobody asks for its scenes they are seldom, and the worker that takes its frames tells of it.
#[derive(Debug, Clone, Default)]
pub struct CameraHeard {
    /// Its scenes.
    pub scenes: Option<Received<SceneSummary>>,
    /// What the worker told.
    pub told: Option<Received<CameraLoad>>,
}

impl CameraHeard {
    /// Its newest scene in a survey: the id, the number of objects, and how long ago it was made.
    pub fn newest(&self, survey: &CellSurvey) -> Option<(&str, usize, Duration)> {
        let heard = self.scenes.as_ref().map(|scene| (&*scene.newest.scene_id, scene.newest.objects.len(), survey.age(scene.at)));
        let told = || {
            let told = self.told.as_ref()?;
            let newest = told.newest.newest.as_ref()?;
            Some((&*newest.scene_id, newest.objects, Duration::from_millis(newest.age_ms) + survey.age(told.at)))
        };
        heard.or_else(told)
    }

    /// Scenes heard a second of a while.
    pub fn scenes_per_s(&self, while_s: f64) -> f64 {
        self.scenes.as_ref().map_or(0.0, |scenes| scenes.count as f64 / while_s)
    }

    /// Frames a second, as the worker tells them; none where it told once only, or is of a release that does not.
    pub fn frames_per_s(&self) -> Option<f64> {
        let told = self.told.as_ref().filter(|told| told.at > told.first_at)?;
        let frames = told.newest.frames.checked_sub(told.first.frames)?;
        Some(frames as f64 / told.at.duration_since(told.first_at).as_secs_f64())
    }

    /// How long ago it showed something, as far as a survey knows.
    pub fn silent(&self, survey: &CellSurvey) -> Option<Duration> {
        let told = self.told.as_ref().map(|told| Duration::from_millis(told.newest.frame_age_ms) + survey.age(told.at));
        told.or_else(|| self.scenes.as_ref().map(|scene| survey.age(scene.at)))
    }

    /// The least time from a stamp to its arrival, milliseconds: by this host's clock where a scene was heard, else by the worker's.
    pub fn lag_ms(&self) -> Option<f64> {
        let told = || self.told.as_ref().and_then(|told| told.newest.newest.as_ref()).map(|newest| newest.lag_ms);
        self.scenes.as_ref().and_then(|scenes| scenes.lag_ms).or_else(told)
    }
}

/// A worker as a survey knows it: a cell and its pool may each have one of a name.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct WorkerName {
    /// Its service.
    pub service: Service,
    /// The cell that it is in.
    pub cell: String,
    /// Its name there.
    pub worker: String,
}

impl WorkerName {
    fn new(cell: &str, service: Service, worker: &str) -> Self {
        Self { service, cell: cell.to_owned(), worker: worker.to_owned() }
    }

    /// The name of one whose load is told under a key.
    fn of_load(key: &str) -> Option<Self> {
        let (service, worker) = keys::of_load(key)?;
        Some(Self::new(keys::cell_of(key)?, service, worker))
    }
}

/// Listens to the workers, cameras and robots of a cell.
pub struct CellListener {
    session: Session,
    lives: Lives,
    /// The cell's own workers', and those of its pool's that serve it.
    loads: Vec<Subscription>,
    scenes: Subscription,
    robots: Subscription,
}

/// What a listener received from a cell.
#[derive(Debug, Clone, Default)]
pub struct CellSurvey {
    /// Cells that have a worker.
    pub cells: BTreeSet<String>,
    /// Workers alive in the session's cell, and those of its pool that serve it, with their newest load where one was heard.
    pub workers: BTreeMap<WorkerName, Option<Received<WorkerLoad>>>,
    /// Cameras whose scenes were heard, or whose frames a perception worker says that it receives.
    pub cameras: BTreeMap<String, CameraHeard>,
    /// Robots whose states were heard.
    pub robots: BTreeMap<String, Received<RobotState>>,
    /// When listening was to end; none before it began.
    until: Option<Instant>,
}

impl CellSurvey {
    /// How long before the end of listening something came. Who listens may wait for a core after that: nobody else was silent meanwhile.
    pub fn age(&self, at: Instant) -> Duration {
        self.until.map_or(Duration::ZERO, |until| until.saturating_duration_since(at))
    }
}

impl CellListener {
    /// Begins to listen.
    pub async fn new(session: &Session) -> Result<Self, Failure> {
        let cell = session.cell();
        let pool = session.pool().map(Cell::new).transpose()?;
        let of_pool = pool.iter().flat_map(|pool| Service::ALL.into_iter().filter(|s| s.is_poolable()).map(|service| pool.loads(service)));
        let mut loads = Vec::new();
        for key in of_pool.chain([cell.all_loads()]) {
            loads.push(session.subscribe_queue(&key, WAITING).await?);
        }
        Ok(Self {
            lives: session.watch_lives().await?,
            loads,
            scenes: session.subscribe_queue(&cell.scenes(), WAITING).await?,
            robots: session.subscribe_queue(&cell.robot_states(), WAITING).await?,
            session: session.clone(),
        })
    }

    /// Listens for a while. What `before` knew stays; counts begin anew.
    pub async fn listen(&mut self, within: Duration, before: &CellSurvey) -> Result<CellSurvey, Failure> {
        let mut heard = before.clone();
        heard.cameras.values_mut().filter_map(|camera| camera.scenes.as_mut()).for_each(|scenes| scenes.count = 0);
        heard.cameras.values_mut().filter_map(|camera| camera.told.as_mut()).for_each(|told| told.count = 0);
        heard.robots.values_mut().for_each(|robot| robot.count = 0);
        let mut loads: BTreeMap<WorkerName, Received<WorkerLoad>> = BTreeMap::new();
        let until = tokio::time::sleep(within);
        tokio::pin!(until);
        loop {
            let closed = || Failure::other("the session has closed");
            tokio::select! {
                () = &mut until => break,
                sample = next_of(&mut self.loads) => {
                    let sample = sample.ok_or_else(closed)?;
                    if let (Some(worker), Ok(load)) = (WorkerName::of_load(&sample.key), sample.payload.decode_json::<WorkerLoad>()) {
                        for camera in &load.cameras {
                            hear_of(&mut heard.cameras.entry(camera.camera.clone()).or_default().told, camera.clone(), None);
                        }
                        let stamp_ns = load.stamp_ns;
                        hear(&mut loads, worker, load, stamp_ns);
                    }
                }
                sample = self.scenes.recv() => {
                    let sample = sample.ok_or_else(closed)?;
                    if let Ok(scene) = sample.payload.decode_json::<SceneSummary>() {
                        let stamp_ns = Some(scene.stamp_ns);
                        hear_of(&mut heard.cameras.entry(keys::last_chunk(&sample.key).to_owned()).or_default().scenes, scene, stamp_ns);
                    }
                }
                sample = self.robots.recv() => {
                    let sample = sample.ok_or_else(closed)?;
                    if let (Some(robot), Ok(state)) = (keys::worker_of(&sample.key), read_robot_state(&sample)) {
                        let stamp_ns = Some(state.stamp_ns);
                        hear(&mut heard.robots, robot.to_owned(), state, stamp_ns);
                    }
                }
            }
        }
        heard.until = Some(until.deadline());
        let lives = self.lives.current();
        let alive: Vec<(&str, Service, &str)> = lives.iter().filter_map(|key| keys::of_live(key)).collect();
        heard.cells = alive.iter().map(|(cell, _, _)| (*cell).to_owned()).collect();
        let (own, pool) = (self.session.cell().name(), self.session.pool());
        let serves = |cell: &str, service: Service| cell == own || (pool == Some(cell) && service.is_poolable());
        let serving = alive.into_iter().filter(|(cell, service, _)| serves(cell, *service));
        let workers = serving.map(|(cell, service, worker)| WorkerName::new(cell, service, worker));
        heard.workers = workers
            .map(|name| {
                let load = loads.remove(&name).or_else(|| before.workers.get(&name).cloned().flatten());
                (name, load)
            })
            .collect();
        Ok(heard)
    }
}

/// The next message of any of several subscriptions, one at least.
async fn next_of(subscriptions: &mut [Subscription]) -> Option<Sample> {
    futures::future::select_all(subscriptions.iter_mut().map(|subscription| Box::pin(subscription.recv()))).await.0
}

fn hear<K: Ord, T: Clone>(known: &mut BTreeMap<K, Received<T>>, name: K, newest: T, stamp_ns: Option<u64>) {
    let mut heard = known.remove(&name);
    hear_of(&mut heard, newest, stamp_ns);
    known.extend(heard.map(|heard| (name, heard)));
}

fn hear_of<T: Clone>(known: &mut Option<Received<T>>, newest: T, stamp_ns: Option<u64>) {
    let at = Instant::now();
    let lag_ms = stamp_ns.map(|stamp_ns| (now_ns() as f64 - stamp_ns as f64) / 1e6);
    match known {
        Some(heard) if heard.count > 0 => {
            (heard.newest, heard.at, heard.count) = (newest, at, heard.count + 1);
            heard.lag_ms = heard.lag_ms.zip(lag_ms).map(|(least, this)| least.min(this));
        }
        _ => *known = Some(Received { first: newest.clone(), first_at: at, newest, at, count: 1, lag_ms }),
    }
}

/// What there is, heard just long enough to name it.
pub async fn names(session: &Session) -> Result<CellSurvey, Failure> {
    CellListener::new(session).await?.listen(NAMES_WITHIN, &CellSurvey::default()).await
}

/// A list of names for an error: `front, wrist`, or `none`.
pub fn listed<'a>(names: impl IntoIterator<Item = &'a String>) -> String {
    let names: Vec<&str> = names.into_iter().map(String::as_str).collect();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

#[cfg(test)]
mod tests {
    use repose_proto::Payload;
    use repose_runtime::{RuntimeConfig, Traffic};

    use super::*;

    #[tokio::test(flavor = "multi_thread")]
    async fn a_cell_and_its_pool_may_each_have_a_worker_of_one_name() {
        let mut config = RuntimeConfig::default();
        config.caller.pool = Some("rack".to_owned());
        let session = Session::open(config).await.expect("a session");
        let mut listener = CellListener::new(&session).await.expect("it listens");
        let mut alive = Vec::new();
        for (waiting, cell) in [session.cell().clone(), Cell::new("rack").expect("a cell")].iter().enumerate() {
            alive.push(session.transport().declare_alive(&cell.live(Service::Planner, "planner-1")).await.expect("a token"));
            let load = Payload::json(&WorkerLoad { queue_depth: waiting, ..WorkerLoad::default() }).expect("encoded");
            session.put(&cell.load(Service::Planner, "planner-1"), load, Traffic::Load).await.expect("put");
        }
        let heard = listener.listen(NAMES_WITHIN, &CellSurvey::default()).await.expect("heard");
        let waiting =
            |cell: &str| heard.workers[&WorkerName::new(cell, Service::Planner, "planner-1")].as_ref().map(|l| l.newest.queue_depth);
        assert_eq!((heard.workers.len(), waiting("cell"), waiting("rack")), (2, Some(0), Some(1)));
        drop(alive);
    }
}
