//! A deployment of real processes on this machine, for tests: a router and services, each `repose serve …`, on a port of its own.
#![allow(dead_code, reason = "each test file uses some of it")]

pub mod link;

use std::collections::BTreeSet;
use std::net::TcpListener;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use repose_proto::load::WorkerLoad;
use repose_proto::perception::LatestRequest;
use repose_proto::{Message, Payload, Scene, SceneSummary, Service};
use repose_runtime::{CallOptions, RuntimeConfig, Session, SessionMode, Subscription, fetch_scene};
use serde_json::Value;

/// How long anything here may take before the test gives up.
pub const PATIENCE: Duration = Duration::from_secs(120);
/// How often the program may be run until it is fast: a machine that stands still for a second is slow once, and a program that is slow always.
const TRIES: usize = 5;

/// Who waits long for a core on a busy machine is not lost, nor is its link: …
const PATIENT: [(&str, &str); 3] =
    [("REPOSE_MOTION__COMMAND_TTL_MS", "10000"), ("REPOSE_MOTION__ROBOT_SILENCE_MS", "10000"), ("REPOSE_SESSION__LEASE_MS", "10000")];
/// … for tests of what becomes of the lost, where somebody is missed nearly as soon as by default.
const IMPATIENT: [(&str, &str); 3] =
    [("REPOSE_MOTION__COMMAND_TTL_MS", "2000"), ("REPOSE_MOTION__ROBOT_SILENCE_MS", "1500"), ("REPOSE_SESSION__LEASE_MS", "2500")];

/// The program under test.
pub fn repose() -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_repose"));
    command.stdin(Stdio::null());
    command
}

/// Runs the program on a running system: its output, what it has printed as JSON (null where that is none), and how long it took.
pub async fn run(endpoint: &str, arguments: &[&str]) -> (Output, Value, Duration) {
    let mut command = repose();
    command.arg("--json").args(arguments).args(["--connect", endpoint]);
    let begin = Instant::now();
    let output = tokio::task::spawn_blocking(move || command.output()).await.expect("no panic").expect("the program runs");
    let took = begin.elapsed();
    let document = serde_json::from_slice(&output.stdout).unwrap_or(Value::Null);
    (output, document, took)
}

/// How the program refuses a name that is not there.
pub struct Refusal<'a> {
    /// Its exit code.
    pub code: i32,
    /// The field at fault.
    pub field: &'a str,
    /// What is there instead, which its message names.
    pub there: &'a str,
}

/// Asserts that the program refuses, and that it takes less than a bound to say what is there instead, one of [`TRIES`] times at least.
pub async fn assert_refused_within(bound: Duration, endpoint: &str, arguments: &[&str], refusal: &Refusal<'_>) {
    for tries in 1.. {
        let (output, document, took) = run(endpoint, arguments).await;
        let error = &document["error"];
        let told = (output.status.code(), error["field"].as_str());
        assert_eq!(told, (Some(refusal.code), Some(refusal.field)), "{arguments:?}: {document}");
        if took < bound && error["message"].as_str().is_some_and(|message| message.contains(refusal.there)) {
            return;
        }
        assert!(tries < TRIES, "{arguments:?} took {took:?}: {document}");
    }
}

/// A process that is killed when it goes out of scope.
pub struct Process(pub Child);

impl Process {
    /// Sends a signal.
    pub fn signal(&self, signal: i32) {
        let id = i32::try_from(self.0.id()).expect("a process id");
        // SAFETY: a plain system call on a child that has not been waited for, so its id is still its own.
        assert_eq!(unsafe { libc::kill(id, signal) }, 0, "signal {signal} to {id}");
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // Both fail only when it has ended already.
        let _ended = self.0.kill();
        let _ended = self.0.wait();
    }
}

/// A router and services.
pub struct Deployment {
    endpoint: String,
    processes: Vec<(Service, Process)>,
    router: Option<Process>,
    /// The simulated cell's scene, where it is not the usual one.
    seed: Option<u64>,
    /// Whether nobody is missed who is silent for some seconds.
    patient: bool,
}

impl Deployment {
    /// Starts a router and the given services, and waits until all of them are alive.
    pub async fn start(services: &[(Service, usize)]) -> Self {
        Self::start_as(None, true, services).await
    }

    /// The same with another scene in the simulated cell.
    pub async fn start_on(seed: Option<u64>, services: &[(Service, usize)]) -> Self {
        Self::start_as(seed, true, services).await
    }

    /// The same where whoever falls silent is missed soon.
    pub async fn start_impatient(services: &[(Service, usize)]) -> Self {
        Self::start_as(None, false, services).await
    }

    async fn start_as(seed: Option<u64>, patient: bool, services: &[(Service, usize)]) -> Self {
        // The port is free when it is asked for; the router takes it right after.
        let port = TcpListener::bind("127.0.0.1:0").expect("a free port").local_addr().expect("its address").port();
        let endpoint = format!("tcp/127.0.0.1:{port}");
        let mut deployment = Self { endpoint, processes: Vec::new(), router: None, seed, patient };
        deployment.start_router();
        for (service, count) in services {
            for _ in 0..*count {
                deployment.add(*service);
            }
        }
        let session = deployment.session().await;
        for (service, count) in services {
            let caller = session.caller(*service).await.expect("a caller");
            caller.wait_for_workers(*count, PATIENCE).await.expect("the workers are alive");
        }
        session.close().await.expect("the session closes");
        deployment
    }

    /// Starts one more worker.
    pub fn add(&mut self, service: Service) {
        // Two cores serve everything here: one thread a process keeps them from fighting.
        self.add_with_threads(service, 1);
    }

    /// Starts one more worker whose inference, if that is its service, has so many threads.
    pub fn add_with_threads(&mut self, service: Service, threads: usize) {
        let endpoint = self.endpoint.clone();
        self.add_at(service, &endpoint, threads);
    }

    /// Starts one more worker that finds the router at another endpoint.
    pub fn add_at(&mut self, service: Service, endpoint: &str, threads: usize) {
        let mut command = self.command();
        command.args(["serve", service.as_str(), "--connect", endpoint]);
        command.env("REPOSE_INFERENCE__THREADS", threads.to_string());
        command.envs(self.seed.map(|seed| ("REPOSE_SIMULATOR__SEED", seed.to_string())));
        self.processes.push((service, Process(command.spawn().expect("a service"))));
    }

    /// Starts the router, again where it was killed.
    pub fn start_router(&mut self) {
        let mut command = self.command();
        self.router = Some(Process(command.args(["serve", "router", "--connect", &self.endpoint]).spawn().expect("the router")));
    }

    /// Kills the router.
    pub fn kill_router(&mut self) {
        self.router = None;
    }

    /// Kills every process of a service.
    pub fn kill(&mut self, service: Service) {
        self.processes.retain(|(running, _)| *running != service);
    }

    /// Kills one process of a service, where there is one.
    pub fn kill_one(&mut self, service: Service) {
        if let Some(place) = self.processes.iter().position(|(running, _)| *running == service) {
            self.processes.remove(place);
        }
    }

    /// The processes of a service.
    pub fn of(&self, service: Service) -> Vec<&Process> {
        self.processes.iter().filter(|(s, _)| *s == service).map(|(_, p)| p).collect()
    }

    /// Where the router listens.
    pub fn endpoint(&self) -> &str {
        &self.endpoint
    }

    /// The program under test, as patient as everybody here.
    pub fn command(&self) -> Command {
        let mut command = repose();
        command.envs(if self.patient { PATIENT } else { IMPATIENT });
        command
    }

    /// A client session.
    pub async fn session(&self) -> Session {
        let mut config = RuntimeConfig::default();
        config.session.mode = SessionMode::Client;
        config.session.connect = vec![self.endpoint.clone()];
        if self.patient {
            config.session.lease_ms = 10_000;
        }
        Session::open(config).await.expect("a session")
    }
}

/// Waits until so many workers copy their calls for whoever records, by the loads that they tell.
pub async fn copy_their_calls(loads: &mut Subscription, workers: usize) {
    let mut copying = BTreeSet::new();
    let all = async {
        while copying.len() < workers {
            let sample = loads.recv().await.expect("a load");
            if sample.payload.decode_json::<WorkerLoad>().expect("a load").journals {
                copying.insert(sample.key);
            }
        }
    };
    tokio::time::timeout(PATIENCE, all).await.expect("all workers copy their calls");
}

/// The newest scene of the simulated camera, as soon as there is one.
pub async fn newest_scene(session: &Session) -> SceneSummary {
    let perception = session.caller(Service::Perception).await.expect("a caller");
    let request = Payload::json(&LatestRequest { camera: "front".to_owned() }).expect("a request");
    let give_up = tokio::time::Instant::now() + PATIENCE;
    loop {
        match perception.call_any("latest", &request, &CallOptions::default()).await {
            Ok(answer) => return answer.payload.decode_json().expect("a summary"),
            Err(error) => assert!(tokio::time::Instant::now() < give_up, "{error}"),
        }
        tokio::time::sleep(Duration::from_millis(50)).await;
    }
}

/// A scene, whole.
pub async fn whole_scene(session: &Session, summary: &SceneSummary) -> Scene {
    let perception = session.caller(Service::Perception).await.expect("a caller");
    fetch_scene(&perception, &summary.scene_id, &CallOptions::within(PATIENCE)).await.expect("the scene")
}

/// A request with its scene enclosed.
pub fn enclosed<T: Message + serde::Serialize>(request: &T, scene: &Scene) -> Payload {
    Payload::with_scene(request, Some(scene)).expect("a payload")
}
