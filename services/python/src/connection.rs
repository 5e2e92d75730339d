//! A connection to a running system: calls by the runtime's own `Caller`, subscriptions and puts.
//!
//! Choice of workers, retries, deadlines and cancelling are those of the services among themselves, since it is the same code. The network
//! runs on threads of its own; who waits for it releases the interpreter lock and still sees Ctrl-C.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use pyo3::prelude::*;
use repose_proto::{CallError, Payload, Priority, Service, keys};
use repose_runtime::{
    Answer, CallOptions, Caller, CancellationToken, RuntimeConfig, RuntimeError, Session, SessionMode, Traffic, fetch_scene,
};
use tokio::runtime::{Builder, Handle};
use tokio::sync::{Mutex, OwnedRwLockReadGuard, RwLock, mpsc};

use crate::error::raised;
use crate::frame::Frame;
use crate::pending::{GIVEN_UP_WITHIN, Pending};
use crate::scene::Scene;
use crate::subscription::Subscription;
use crate::threads::Threads;
use crate::waiting::wait_for;

/// Where a router is looked for when nothing says otherwise.
const ENDPOINT: &str = "tcp/127.0.0.1:7447";
/// Threads of the network: it waits more than it works.
const THREADS: usize = 2;
/// Progress replies that may wait to be read.
const PROGRESS_WAITING: usize = 256;
/// Messages of a subscription that may wait where not only the newest counts.
const MESSAGES_WAITING: usize = 256;

/// A session with a cell.
#[pyclass(frozen, module = "repose._native")]
pub struct Connection {
    threads: Arc<Threads>,
    session: Session,
    cell: String,
    callers: Arc<Mutex<BTreeMap<&'static str, Caller>>>,
    /// Triggered when the connection is closed: it cancels every call.
    closed: CancellationToken,
    /// Every call under way shares it: whoever has it alone knows that there is none.
    under_way: Arc<RwLock<()>>,
}

fn of_runtime(error: RuntimeError) -> PyErr {
    raised(match error {
        RuntimeError::Config { .. } => CallError::invalid("config", error.to_string()),
        other => other.into(),
    })
}

fn service_of(name: &str) -> PyResult<Service> {
    Service::parse(name).ok_or_else(|| raised(CallError::invalid("service", format!("there is no service {name:?}"))))
}

#[pymethods]
impl Connection {
    #[new]
    #[pyo3(signature = (endpoints, cell = None, config = None))]
    fn new(py: Python<'_>, endpoints: Vec<String>, cell: Option<String>, config: Option<PathBuf>) -> PyResult<Self> {
        let mut config = RuntimeConfig::read(config.as_deref()).map_err(of_runtime)?;
        let session = &mut config.session;
        (session.mode, session.listen) = (SessionMode::Client, Vec::new());
        if let Some(cell) = cell {
            session.cell = cell;
        }
        if !endpoints.is_empty() {
            session.connect = endpoints;
        } else if session.connect.is_empty() && session.zenoh_file.is_none() {
            session.connect = vec![ENDPOINT.to_owned()];
        }
        let system = |source| of_runtime(RuntimeError::System { operation: "starting threads".to_owned(), source });
        let runtime = Builder::new_multi_thread().worker_threads(THREADS).enable_all().build().map_err(system)?;
        // Kept here from the start, so that an attempt that fails waits for no thread at its end.
        let (handle, threads) = (runtime.handle().clone(), Arc::new(Threads::new(runtime)));
        let cell = config.session.cell.clone();
        let session = wait_for(py, &handle, || Session::open(config))?.map_err(of_runtime)?;
        Ok(Self { threads, session, cell, callers: Arc::default(), closed: CancellationToken::new(), under_way: Arc::default() })
    }

    /// Starts a call. `request` is JSON; with a scene it goes by id first and is sent whole to who lacks it. `everyone`: whoever has it. `missed`: the
    /// worker is to notice when this process is gone before the call has ended.
    #[pyo3(signature = (
        service, method, schema, request, *, deadline_s, priority, idempotent,
        scene=None, worker=None, id=None, everyone=false, missed=false,
    ))]
    #[expect(clippy::too_many_arguments, reason = "named arguments of a method that only the package's own Python calls")]
    fn call(
        &self,
        service: &str,
        method: String,
        schema: &str,
        request: &[u8],
        deadline_s: f64,
        priority: &str,
        idempotent: bool,
        scene: Option<&Scene>,
        worker: Option<String>,
        id: Option<String>,
        everyone: bool,
        missed: bool,
    ) -> PyResult<Pending> {
        let service = service_of(service)?;
        let deadline = Duration::try_from_secs_f64(deadline_s)
            .map_err(|_| raised(CallError::invalid("deadline_s", format!("expected a time from now in seconds, got {deadline_s}"))))?;
        let priority = match priority {
            "interactive" => Priority::Interactive,
            "batch" => Priority::Batch,
            other => return Err(raised(CallError::invalid("priority", format!("expected interactive or batch, got {other:?}")))),
        };
        let payload = crate::payload::json(schema, request).map_err(raised)?;
        let (schema, scene) = (schema.to_owned(), scene.map(|scene| scene.scene.clone()));
        let (cancel, under_way) = self.begin()?;
        let (sender, progress) = mpsc::channel(PROGRESS_WAITING);
        let token = id.as_deref().filter(|_| missed).map(|id| self.session.cell().live_client(id));
        let options = CallOptions {
            deadline,
            priority,
            idempotent,
            cancel: cancel.clone(),
            worker,
            progress: Some(sender),
            id,
            ..CallOptions::default()
        };
        let (session, callers) = (self.session.clone(), self.callers.clone());
        let answer = async move {
            let _under_way = under_way;
            // Held until the call has ended: the network takes it back when this process is gone.
            let _there = match &token {
                Some(token) => Some(session.transport().declare_alive(token).await?),
                None => None,
            };
            let caller = caller(&session, &callers, service).await?;
            if everyone {
                return caller.call_any(&method, &payload, &options).await;
            }
            let encode = |scene: Option<&repose_proto::Scene>| match scene {
                Some(scene) => crate::payload::enclosing(&schema, &payload, scene),
                None => Ok(payload.clone()),
            };
            match (service, method.as_str()) {
                // What was seen anew, and not only where it is not held.
                (Service::Motion, "plan") => caller.plan_with_scene(scene.as_deref(), encode, options).await,
                // What is carried out at most once is asked once, with the scene: asked by its id first it would be another request under the same id.
                _ if !idempotent && scene.is_some() => caller.call(&method, encode(scene.as_deref())?, options).await,
                _ => caller.call_with_scene(&method, scene.as_deref(), encode, options).await,
            }
        };
        Pending::start(&self.threads, answer, cancel, progress)
    }

    /// A scene, whole, from whichever perception worker has it: in parts, as a slow link bears it, and packed where the configuration says so. The answer
    /// is its bulk form.
    fn scene(&self, scene_id: String, deadline_s: f64) -> PyResult<Pending> {
        let deadline = Duration::try_from_secs_f64(deadline_s).map_err(|e| raised(CallError::invalid("deadline_s", e.to_string())))?;
        let (cancel, under_way) = self.begin()?;
        let (_, progress) = mpsc::channel(1);
        let options = CallOptions { cancel: cancel.clone(), ..CallOptions::within(deadline) };
        let (session, callers) = (self.session.clone(), self.callers.clone());
        let answer = async move {
            let _under_way = under_way;
            let perception = caller(&session, &callers, Service::Perception).await?;
            let scene = fetch_scene(&perception, &scene_id, &options).await?;
            let whole = tokio::task::spawn_blocking(move || Payload::bulk(repose_proto::Scene::SCHEMA, &scene.to_bulk())).await;
            let payload = whole.map_err(|e| CallError::internal(format!("a scene was lost: {e}")))??;
            Ok(Answer { payload, worker: String::new(), attempts: 1, timing_ms: BTreeMap::new() })
        };
        Pending::start(&self.threads, answer, cancel, progress)
    }

    /// Sends a frame to perception.
    fn segment(&self, py: Python<'_>, frame: &Frame, deadline_s: f64) -> PyResult<Pending> {
        let payload = py.detach(|| bulk_of(frame)).map_err(raised)?;
        let deadline = Duration::try_from_secs_f64(deadline_s).map_err(|e| raised(CallError::invalid("deadline_s", e.to_string())))?;
        let (cancel, under_way) = self.begin()?;
        let (sender, progress) = mpsc::channel(1);
        let options = CallOptions { cancel: cancel.clone(), progress: Some(sender), ..CallOptions::within(deadline) };
        let (session, callers) = (self.session.clone(), self.callers.clone());
        let answer = async move {
            let _under_way = under_way;
            caller(&session, &callers, Service::Perception).await?.call("segment", payload, options).await
        };
        Pending::start(&self.threads, answer, cancel, progress)
    }

    /// The workers of a service that are alive, by name.
    fn workers(&self, py: Python<'_>, service: &str) -> PyResult<Vec<String>> {
        let service = service_of(service)?;
        let handle = self.handle().map_err(raised)?;
        let caller = wait_for(py, handle, || caller(&self.session, &self.callers, service))?.map_err(raised)?;
        Ok(caller.workers().into_iter().map(|w| w.name).collect())
    }

    /// Follows a key: `scene` or `frame` of a camera, `robot_state`, `robot_command` or `robot_estop` of a robot.
    fn subscribe(&self, py: Python<'_>, kind: &str, name: &str, newest_only: bool) -> PyResult<Subscription> {
        let ((key, _), handle) = (self.key(kind, name)?, self.handle().map_err(raised)?);
        let capacity = if newest_only { 1 } else { MESSAGES_WAITING };
        let subscribed = wait_for(py, handle, || self.session.subscribe_queue(&key, capacity))?.map_err(of_runtime)?;
        Ok(Subscription::new(self.threads.clone(), subscribed))
    }

    /// Puts a message on a key, as JSON.
    fn put(&self, py: Python<'_>, kind: &str, name: &str, schema: &str, body: &[u8]) -> PyResult<()> {
        let ((key, traffic), handle) = (self.key(kind, name)?, self.handle().map_err(raised)?);
        let payload = crate::payload::json(schema, body).map_err(raised)?;
        wait_for(py, handle, || self.session.put(&key, payload, traffic))?.map_err(of_runtime)
    }

    /// Puts a frame on its camera's key.
    fn publish(&self, py: Python<'_>, frame: &Frame) -> PyResult<()> {
        let (key, handle) = (self.session.cell().camera_frame(&frame.frame.camera_name), self.handle().map_err(raised)?);
        let payload = py.detach(|| bulk_of(frame)).map_err(raised)?;
        wait_for(py, handle, || self.session.put(&key, payload, Traffic::Frame))?.map_err(of_runtime)
    }

    /// Cancels the calls under way, and ends the session.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        // In a process that was forked there is nothing to end: the session is the other's.
        let Ok(handle) = self.threads.handle() else { return Ok(()) };
        self.closed.cancel();
        let close = || async move {
            // While there is still a way to their workers.
            drop(tokio::time::timeout(GIVEN_UP_WITHIN, self.under_way.write()).await);
            self.session.close().await
        };
        wait_for(py, handle, close)?.map_err(of_runtime)
    }

    /// The cell's name.
    #[getter]
    fn cell(&self) -> String {
        self.cell.clone()
    }
}

impl Connection {
    /// The session, for what lives as long as it.
    pub fn session(&self) -> &Session {
        &self.session
    }

    /// The network's threads.
    ///
    /// # Errors
    /// `failed_precondition` once the connection is closed, and in a process that was forked from its own.
    pub fn handle(&self) -> Result<&Handle, CallError> {
        if self.closed.is_cancelled() { Err(closed()) } else { self.threads.handle() }
    }

    /// What cancels a new call, and what the call keeps until it has ended.
    fn begin(&self) -> PyResult<(CancellationToken, OwnedRwLockReadGuard<()>)> {
        let under_way = self.under_way.clone().try_read_owned().ok().filter(|_| !self.closed.is_cancelled());
        under_way.map(|under_way| (self.closed.child_token(), under_way)).ok_or_else(|| raised(closed()))
    }

    fn key(&self, kind: &str, name: &str) -> PyResult<(String, Traffic)> {
        keys::validate_chunk(if matches!(kind, "scene" | "frame") { "camera" } else { "robot" }, name).map_err(raised)?;
        let cell = self.session.cell();
        match kind {
            "scene" => Ok((cell.scene(name), Traffic::Scene)),
            "frame" => Ok((cell.camera_frame(name), Traffic::Frame)),
            "robot_state" => Ok((cell.robot_state(name), Traffic::RobotState)),
            "robot_command" => Ok((cell.robot_command(name), Traffic::RobotCommand)),
            "robot_estop" => Ok((cell.robot_estop(name), Traffic::EmergencyStop)),
            other => Err(raised(CallError::invalid("kind", format!("there is no key of kind {other:?}")))),
        }
    }
}

fn closed() -> CallError {
    CallError::precondition("the connection is closed")
}

/// A frame as it travels.
fn bulk_of(frame: &Frame) -> Result<Payload, CallError> {
    Payload::bulk(repose_proto::Frame::SCHEMA, &frame.frame.to_bulk())
}

/// The caller of a service, which goes on following its workers.
async fn caller(session: &Session, callers: &Mutex<BTreeMap<&'static str, Caller>>, service: Service) -> Result<Caller, CallError> {
    let mut callers = callers.lock().await;
    if let Some(caller) = callers.get(service.as_str()) {
        return Ok(caller.clone());
    }
    let caller = session.caller(service).await?;
    callers.insert(service.as_str(), caller.clone());
    Ok(caller)
}
