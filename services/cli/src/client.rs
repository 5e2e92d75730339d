//! A session with a running system, and the calls that the client commands make.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use repose_proto::motion::KeepOutZone;
use repose_proto::place::ReachingRobot;
use repose_proto::robot::RobotState;
use repose_proto::{CallError, ErrorCode, Scene, SceneSummary, Service, keys};
use repose_runtime::{
    CallOptions, RuntimeConfig, RuntimeError, STATE_WITHIN, Session, SessionMode, endpoint_fault, fetch_newest, fetch_scene,
};
use tokio::time::Instant;

use crate::cell_survey::{listed, names};
use crate::failure::Failure;

/// Where a router is looked for when nothing says otherwise, and where `up` has its own.
pub const ENDPOINT: &str = "tcp/127.0.0.1:7447";

/// How long somebody who is not there is waited for, before it is said who is: services tell of themselves five times a second.
pub const PATIENCE: Duration = Duration::from_millis(600);
/// The most that one of several calls for a scene may take.
const ONE_CALL: Duration = Duration::from_secs(5);

/// How to reach a running system.
#[derive(Debug, Clone, Args)]
pub struct SystemArgs {
    /// The router to connect to; of several, separated by commas, the first that answers is used. Default: the configuration's, or
    /// tcp/127.0.0.1:7447.
    #[arg(long, env = "REPOSE_CONNECT")]
    pub connect: Option<String>,
    /// The robot cell. Default: the configuration's, or "cell".
    #[arg(long, env = "REPOSE_CELL")]
    pub cell: Option<String>,
    /// The pool whose planners and inference workers serve the cell. Default: the configuration's, or none.
    #[arg(long)]
    pub pool: Option<String>,
    /// Configuration (TOML): its sections [session], [caller] and [worker].
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
}

impl SystemArgs {
    /// The first option on the command line that selects a running system. One whose value is also the environment's does not count: that may be meant
    /// for other commands.
    pub fn chosen(&self) -> Option<&'static str> {
        let is_ours = |given: &Option<String>, variable: &str| given.is_some() && *given != std::env::var(variable).ok();
        let options = [
            ("connect", is_ours(&self.connect, "REPOSE_CONNECT")),
            ("cell", is_ours(&self.cell, "REPOSE_CELL")),
            ("pool", self.pool.is_some()),
        ];
        options.into_iter().find(|(_, is_given)| *is_given).map(|(option, _)| option)
    }
}

/// A running system, and which of its cameras counts.
#[derive(Debug, Clone, Args)]
pub struct ConnectArgs {
    /// The system.
    #[command(flatten)]
    pub system: SystemArgs,
    /// The camera whose newest scene to use.
    #[arg(long, default_value = "front")]
    pub camera: String,
    /// The deadline of a request, milliseconds.
    #[arg(long, default_value_t = 60_000)]
    pub deadline_ms: u64,
}

impl From<RuntimeError> for Failure {
    fn from(error: RuntimeError) -> Self {
        match error {
            RuntimeError::Config { .. } => Self::bad_input("config", error),
            RuntimeError::Transport { .. } => Self::Other(error.into()),
            other => Self::other(other),
        }
    }
}

/// A client of a deployment.
pub async fn connect(args: &SystemArgs) -> Result<Session, Failure> {
    Ok(Session::open(client_config(args)?).await?)
}

/// The configuration of a process behind a router: the file's and the environment's, and over it what the command line says.
pub fn client_config(args: &SystemArgs) -> Result<RuntimeConfig, Failure> {
    let mut config = cell_config(args)?;
    let session = &mut config.session;
    // A file may be shared with the router; a client listens nowhere.
    (session.mode, session.listen) = (SessionMode::Client, Vec::new());
    set_endpoint(&mut session.connect, args, session.zenoh_file.is_some())?;
    Ok(config)
}

/// The configuration of the router itself.
pub fn router_config(args: &SystemArgs) -> Result<RuntimeConfig, Failure> {
    let mut config = cell_config(args)?;
    let session = &mut config.session;
    if session.mode != SessionMode::Router {
        // What the other processes connect to is this router.
        session.connect.clear();
    }
    session.mode = SessionMode::Router;
    let secured = session.listen.iter().find(|endpoint| endpoint.starts_with("quic/"));
    if let (Some(secured), Some(plain)) = (secured, args.connect.as_ref().filter(|given| given.starts_with("tcp/"))) {
        let message =
            format!("--connect or REPOSE_CONNECT says {plain}, without certificates, and the configuration says {secured}: take one away");
        return Err(Failure::bad_input("connect", message));
    }
    set_endpoint(&mut session.listen, args, session.zenoh_file.is_some())?;
    Ok(config)
}

fn cell_config(args: &SystemArgs) -> Result<RuntimeConfig, Failure> {
    let mut config = RuntimeConfig::read(args.config.as_deref())?;
    if let Some(cell) = &args.cell {
        config.session.cell.clone_from(cell);
    }
    if args.pool.is_some() {
        config.caller.pool.clone_from(&args.pool);
    }
    Ok(config)
}

/// The command line's endpoints, else the configuration's, else those of its Zenoh file, else [`ENDPOINT`].
fn set_endpoint(endpoints: &mut Vec<String>, args: &SystemArgs, has_zenoh_file: bool) -> Result<(), Failure> {
    match &args.connect {
        Some(given) => {
            *endpoints = given.split(',').map(|endpoint| endpoint.trim().to_owned()).collect();
            endpoints.iter().try_for_each(|endpoint| check_endpoint("connect", endpoint))?;
        }
        None if endpoints.is_empty() && !has_zenoh_file => *endpoints = vec![ENDPOINT.to_owned()],
        None => {}
    }
    Ok(())
}

/// Refuses an endpoint of the command line that is none.
pub fn check_endpoint(field: &str, endpoint: &str) -> Result<(), Failure> {
    endpoint_fault(endpoint).map_or(Ok(()), |fault| Err(Failure::bad_input(field, fault)))
}

/// Closes a session whose work is done: a router that is slow to say goodbye takes nothing of it back.
pub async fn close(session: Session) {
    if let Err(error) = session.close().await {
        tracing::warn!(%error, "the session did not close in time");
    }
}

/// What a robot says of itself next; says which robots there are where another one tells its state and this one does not.
///
/// That nothing at all is heard within [`PATIENCE`] says little: on a busy machine the robot may be late. Others that are heard, or a cell in which
/// nobody is alive, say that the name is wrong.
pub async fn robot_state(session: &Session, robot: &str, within: Duration) -> Result<RobotState, Failure> {
    let give_up = Instant::now() + within.min(STATE_WITHIN);
    loop {
        let wait = give_up.saturating_duration_since(Instant::now()).min(PATIENCE);
        match repose_runtime::robot_state(session, robot, wait).await {
            Err(error) if error.code == ErrorCode::Unavailable => {
                let mut around = names(session).await?;
                if let Some(heard) = around.robots.remove(robot) {
                    return Ok(heard.newest);
                }
                let is_unknown = !around.robots.is_empty() || around.workers.is_empty();
                if is_unknown || Instant::now() >= give_up {
                    let message = format!("{}; robots that do: {}", error.message, listed(around.robots.keys()));
                    return Err(Failure::Other(CallError { message, ..error }));
                }
            }
            told => return Ok(told?),
        }
    }
}

/// The robot within whose reach placements are wanted, where there is one, with where its base stands as it tells; where it does not tell, the
/// planner's configuration may.
pub async fn reaching(session: &Session, robot: Option<&str>, within: Duration) -> Option<ReachingRobot> {
    let name = robot?.to_owned();
    let told = robot_state(session, &name, within.min(PATIENCE)).await;
    Some(ReachingRobot { name, world_from_base: told.ok().and_then(|state| state.world_from_base) })
}

/// The newest scene of a camera, from the perception worker that owns it. A camera without a scene is waited for
/// during `patience` ([`PATIENCE`], or longer where it is known that one will come); then it is said which cells or cameras there are.
pub async fn newest_scene(session: &Session, camera: &str, within: Duration, patience: Duration) -> Result<SceneSummary, Failure> {
    keys::validate_chunk("camera", camera)?;
    let perception = session.caller(Service::Perception).await?;
    // A worker that is alive and has not told its load yet is called all the same, and at once.
    let is_alone = perception.workers().is_empty() && perception.wait_for_workers(1, within.min(PATIENCE)).await.is_err();
    if is_alone && perception.workers().is_empty() {
        let elsewhere = match session.is_user() {
            true => "either none runs there, or this user is not of that cell".to_owned(),
            false => format!("cells with workers: {}", listed(&names(session).await?.cells)),
        };
        let message = format!("the cell has no perception worker that is alive; {elsewhere}");
        return Err(Failure::Other(CallError { field: Some("cell".to_owned()), ..CallError::new(ErrorCode::Unavailable, message) }));
    }
    let begin = Instant::now();
    loop {
        match fetch_newest(&perception, camera, &CallOptions::within(ONE_CALL.min(within))).await {
            Ok(summary) => return Ok(summary),
            Err(error) if [ErrorCode::InvalidArgument, ErrorCode::FailedPrecondition].contains(&error.code) => return Err(error.into()),
            Err(error) if error.code == ErrorCode::NotFound && begin.elapsed() >= within.min(patience) => {
                let cameras = names(session).await?.cameras;
                let message = format!("camera {camera} has no scene; cameras that have one: {}", listed(cameras.keys()));
                return Err(CallError::not_found("camera", message).into());
            }
            Err(error) if begin.elapsed() >= within => {
                let message = format!("no scene of camera {camera} came within {} ms: {}", within.as_millis(), error.message);
                return Err(Failure::Other(CallError::new(ErrorCode::DeadlineExceeded, message)));
            }
            // A scene may still come.
            Err(_) => tokio::time::sleep(Duration::from_millis(100)).await,
        }
    }
}

/// A scene, whole, from the perception worker that made it.
pub async fn whole_scene(session: &Session, scene_id: &str, within: Duration) -> Result<Scene, Failure> {
    let perception = session.caller(Service::Perception).await?;
    Ok(fetch_scene(&perception, scene_id, &CallOptions::within(within)).await?)
}

/// The keep-out zones that the cell's motion workers heed; none where no such worker is alive.
pub async fn keep_out_zones(session: &Session) -> Result<Vec<KeepOutZone>, Failure> {
    let motion = session.caller(Service::Motion).await?;
    // A cell without motion has no zones either.
    if motion.wait_for_workers(1, PATIENCE).await.is_err() {
        return Ok(Vec::new());
    }
    Ok(motion
        .workers()
        .into_iter()
        .filter_map(|worker| worker.load)
        .find(|load| !load.keep_out.is_empty())
        .map_or_else(Vec::new, |load| load.keep_out))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn args(config: Option<&str>) -> (SystemArgs, tempfile::NamedTempFile) {
        let file = tempfile::NamedTempFile::new().expect("a file");
        std::fs::write(&file, config.unwrap_or_default()).expect("written");
        (SystemArgs { connect: None, cell: None, pool: None, config: config.map(|_| file.path().to_owned()) }, file)
    }

    fn session(config: Result<RuntimeConfig, Failure>) -> repose_runtime::SessionConfig {
        config.unwrap_or_else(|failure| panic!("{failure:?}")).session
    }

    #[test]
    fn the_configuration_holds_where_the_command_line_says_nothing() {
        let (mut shared, _file) =
            args(Some("[session]\nmode = \"client\"\ncell = \"lab\"\nconnect = [\"tcp/10.0.0.1:1\"]\nlisten = [\"tcp/0.0.0.0:2\"]\n"));
        let client = session(client_config(&shared));
        assert_eq!((client.cell.as_str(), &client.connect[..], client.listen.len()), ("lab", &["tcp/10.0.0.1:1".to_owned()][..], 0));
        let router = session(router_config(&shared));
        assert_eq!((router.mode, &router.listen[..], router.connect.len()), (SessionMode::Router, &["tcp/0.0.0.0:2".to_owned()][..], 0));
        (shared.connect, shared.cell) = (Some("tcp/10.0.0.9:9".to_owned()), Some("hall".to_owned()));
        let client = session(client_config(&shared));
        assert_eq!((client.cell.as_str(), &client.connect[..]), ("hall", &["tcp/10.0.0.9:9".to_owned()][..]));
        assert_eq!(session(router_config(&shared)).listen, ["tcp/10.0.0.9:9"]);
    }

    #[test]
    fn without_either_it_is_the_router_of_this_machine_unless_a_zenoh_file_says() {
        let (none, _file) = args(None);
        assert_eq!(session(client_config(&none)).connect, [ENDPOINT]);
        assert_eq!(session(router_config(&none)).listen, [ENDPOINT]);
        let (zenoh, _file) = args(Some("[session]\nmode = \"router\"\nzenoh_file = \"router.json5\"\nconnect = [\"tcp/10.0.0.1:1\"]\n"));
        let router = session(router_config(&zenoh));
        assert!(router.listen.is_empty());
        assert_eq!(router.connect, ["tcp/10.0.0.1:1"], "a router's own file may name another router");
    }
}
