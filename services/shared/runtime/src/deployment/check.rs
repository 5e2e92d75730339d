//! The trial of a deployment's access control: every user tries every verb at every key, through a running router, and somebody at the other end
//! tells whether it came through.
//!
//! The other end is a user that may do the counterpart, in a session of its own. Where nobody may, nothing can be harmed, and nothing is tried.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use futures::StreamExt;
use futures::future::join_all;
use repose_proto::{Cell, Payload, Priority, Service};
use tokio::time::{Instant, sleep, timeout};

use super::access::{Verb, may};
use super::roles::Roles;
use crate::transport::{IncomingQueries, OutgoingQuery, ReplyEvent, Traffic, Transport};
use crate::{RuntimeConfig, RuntimeError, Session, SessionMode};

/// How long what is allowed may take to come through.
const PATIENCE: Duration = Duration::from_secs(5);
/// How long what is denied is waited for, once what is allowed has come through.
const DENIAL: Duration = Duration::from_millis(250);
/// How often what is tried is repeated.
const PERIOD: Duration = Duration::from_millis(50);
/// Keys tried at once: a trial mostly waits, and those of different keys do not hear each other.
const AT_ONCE: usize = 64;

/// One thing that came out otherwise than the roles say.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Trial {
    /// Who tried.
    pub user: String,
    /// What.
    pub verb: Verb,
    /// Where.
    pub key: String,
    /// Whether the roles allow it.
    pub expected: bool,
}

impl std::fmt::Display for Trial {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { user, verb, key, expected } = self;
        let verb = format!("{verb:?}").to_lowercase();
        match expected {
            true => write!(f, "{user} may {verb} at {key}, and it did not come through"),
            false => write!(f, "{user} may not {verb} at {key}, and it came through"),
        }
    }
}

/// What the trial found.
#[derive(Debug, Default, serde::Serialize)]
pub struct CheckReport {
    /// Combinations of user, verb and key that were tried.
    pub tried: usize,
    /// Those of them that are allowed.
    pub allowed: usize,
    /// Combinations that nobody is at the other end of.
    pub untried: usize,
    /// What came out otherwise than the roles say.
    pub wrong: Vec<Trial>,
}

impl CheckReport {
    fn add(&mut self, other: Self) {
        self.tried += other.tried;
        self.allowed += other.allowed;
        self.untried += other.untried;
        self.wrong.extend(other.wrong);
    }
}

/// Two sessions of every user: one that tries, and one at the other end.
type Ends = BTreeMap<String, (Arc<dyn Transport>, Arc<dyn Transport>)>;

/// Which router is tried.
#[derive(Debug, Clone, Default)]
pub struct TrialOptions {
    /// Its endpoint; the roles file's where absent.
    pub connect: Option<String>,
    /// A router of our own with the same configuration, on a loopback port.
    pub apart: bool,
}

/// Tries everything, with the users' files in `deployment`, which [`super::write`] wrote.
///
/// # Errors
/// When a user is not let in, or a cell is in operation: its robots would act on what is tried.
pub async fn check(roles: &Roles, deployment: &Path, options: &TrialOptions) -> Result<CheckReport, RuntimeError> {
    // Sessions read their configuration from files, and the users' name files by where they will be installed.
    let files = deployment.join(".check");
    let _removed = RemoveOnDrop(&files);
    super::files::write_trial(roles, deployment, &files).map_err(|e| RuntimeError::transport("preparing the trial", e))?;
    try_all(roles, &files, options).await
}

/// Takes a folder with secrets away.
struct RemoveOnDrop<'a>(&'a Path);

impl Drop for RemoveOnDrop<'_> {
    fn drop(&mut self) {
        if let Err(error) = std::fs::remove_dir_all(self.0) {
            tracing::warn!(folder = %self.0.display(), %error, "could not be removed");
        }
    }
}

/// A session with a Zenoh file.
async fn open(mode: SessionMode, endpoint: &str, file: PathBuf) -> Result<Session, RuntimeError> {
    let mut config = RuntimeConfig::default();
    config.session.mode = mode;
    config.session.zenoh_file = Some(file);
    match mode {
        SessionMode::Router => config.session.listen = vec![endpoint.to_owned()],
        _ => config.session.connect = vec![endpoint.to_owned()],
    }
    Session::open(config).await
}

async fn try_all(roles: &Roles, files: &Path, options: &TrialOptions) -> Result<CheckReport, RuntimeError> {
    let mut opened = Vec::new();
    let mut endpoint = options.connect.clone().unwrap_or_else(|| roles.endpoint());
    if options.apart {
        let router = open(SessionMode::Router, "quic/127.0.0.1:0", files.join("router.json5")).await?;
        endpoint = router.locators().await.into_iter().next().ok_or_else(|| RuntimeError::transport("starting a router", "no port"))?;
        opened.push(router);
    }
    let mut ends = Ends::new();
    for name in roles.users.keys() {
        let session = || open(SessionMode::Client, &endpoint, files.join(format!("{name}.json5")));
        let (tries, witness) = (session().await?, session().await?);
        ends.insert(name.clone(), (tries.transport(), witness.transport()));
        opened.extend([tries, witness]);
    }
    refuse_cells_in_operation(roles, &ends).await?;
    // What is tried at one key would be heard by what is tried at another that it matches, so those that stand for several come last, alone.
    let (plain, broad): (Vec<Probe>, Vec<Probe>) = probes(roles).into_iter().partition(|probe| probe.key == probe.heard_at);
    let mut reports: Vec<_> =
        futures::stream::iter(plain).map(|probe| try_key(roles, &ends, probe)).buffer_unordered(AT_ONCE).collect().await;
    for probe in broad {
        reports.push(try_key(roles, &ends, probe).await);
    }
    let mut sum = CheckReport::default();
    for report in reports {
        sum.add(report?);
    }
    sum.wrong.sort_by(|a, b| (&a.user, a.verb, &a.key).cmp(&(&b.user, b.verb, &b.key)));
    // Those that tried before the router.
    for session in opened.iter().rev() {
        if let Err(error) = session.close().await {
            tracing::debug!(%error, "a session of the trial did not close in time");
        }
    }
    Ok(sum)
}

/// A key to try, and the one to listen at where it stands for several.
#[derive(Debug, Clone)]
struct Probe {
    key: String,
    heard_at: String,
}

/// Every kind of key with the names that the roles bind, and with one that they do not.
fn probes(roles: &Roles) -> Vec<Probe> {
    let users = || roles.users.values();
    let named = |names: Vec<&str>, other: &str| names.into_iter().chain([other]).map(str::to_owned).collect::<BTreeSet<String>>();
    let robots = named(users().filter_map(|u| u.robot.as_deref()).collect(), "check-robot");
    let cameras = named(users().flat_map(|u| u.cameras.iter().map(String::as_str)).collect(), "check-camera");
    let workers = named(users().filter_map(|u| u.worker.as_deref()).collect(), "check-worker");
    let mut keys = BTreeSet::new();
    let cells: BTreeSet<&String> = users().flat_map(|u| &u.cells).collect();
    for cell in cells.into_iter().filter_map(|name| Cell::new(name).ok()) {
        for robot in &robots {
            keys.extend([cell.robot_state(robot), cell.robot_command(robot), cell.robot_estop(robot)]);
        }
        keys.insert(cell.live_client("check"));
        for camera in &cameras {
            keys.extend([cell.camera_frame(camera), cell.scene(camera)]);
        }
        for (service, worker) in Service::ALL.into_iter().flat_map(|s| workers.iter().map(move |w| (s, w))) {
            keys.extend([cell.call(service, worker), cell.load(service, worker), cell.cancel(service, worker, "check")]);
            keys.extend([cell.live(service, worker), cell.operate(service, worker)]);
        }
    }
    let mut probes: Vec<Probe> = keys.into_iter().map(|key| Probe { heard_at: key.clone(), key }).collect();
    // One put that would stop every cell at once.
    let everywhere = probes.iter().find(|probe| probe.key.ends_with("@estop")).map(|probe| {
        let chunks: Vec<&str> = probe.key.split('/').enumerate().map(|(i, chunk)| if i == 2 { "*" } else { chunk }).collect();
        Probe { key: chunks.join("/"), heard_at: probe.key.clone() }
    });
    probes.extend(everywhere);
    probes
}

async fn refuse_cells_in_operation(roles: &Roles, ends: &Ends) -> Result<(), RuntimeError> {
    for (name, user) in &roles.users {
        for cell in user.cells.iter().filter_map(|cell| Cell::new(cell).ok()) {
            for service in Service::ALL.into_iter().filter(|service| may(user, Verb::Watch, &cell.lives(*service))) {
                if let Some(alive) = ends[name].0.watch_alive(&cell.lives(service)).await?.current().first() {
                    let message = format!("{alive} is alive: robots there would act on what is tried; stop it, or try on a router apart");
                    return Err(RuntimeError::transport("checking a cell in operation", message));
                }
            }
        }
    }
    Ok(())
}

/// Tries the verbs at a key one after the other: together they would hear each other.
async fn try_key(roles: &Roles, ends: &Ends, probe: Probe) -> Result<CheckReport, RuntimeError> {
    let mut sum = CheckReport::default();
    for verb in Verb::ALL {
        sum.add(try_everyone(roles, ends, verb, &probe).await?);
    }
    Ok(sum)
}

async fn try_everyone(roles: &Roles, ends: &Ends, verb: Verb, probe: &Probe) -> Result<CheckReport, RuntimeError> {
    let names: Vec<&String> = roles.users.keys().collect();
    let Some(witness) = names.iter().find(|name| may(&roles.users[**name], verb.counterpart(), &probe.heard_at)) else {
        return Ok(CheckReport { untried: names.len(), ..CheckReport::default() });
    };
    if verb != Verb::Put && probe.key != probe.heard_at {
        return Ok(CheckReport::default());
    }
    let expected: BTreeSet<String> =
        names.iter().filter(|name| may(&roles.users[**name], verb, &probe.key)).map(|n| (*n).clone()).collect();
    let trial = Attempts { ends, witness: ends[*witness].1.as_ref(), probe, expected: &expected };
    let came_through = match verb {
        Verb::Put => trial.put().await?,
        Verb::Subscribe => trial.subscribe().await?,
        Verb::Query => trial.query().await?,
        Verb::Serve => trial.serve().await?,
        Verb::Token => trial.token().await?,
        Verb::Watch => trial.watch().await?,
    };
    let wrong = came_through.symmetric_difference(&expected);
    let wrong = wrong.map(|user| Trial { user: user.clone(), verb, key: probe.key.clone(), expected: expected.contains(user) }).collect();
    Ok(CheckReport { tried: names.len(), allowed: expected.len(), untried: 0, wrong })
}

/// One verb at one key, tried by everyone.
struct Attempts<'a> {
    ends: &'a Ends,
    witness: &'a dyn Transport,
    probe: &'a Probe,
    expected: &'a BTreeSet<String>,
}

/// When to stop trying: a while after all that is expected came through.
struct Patience {
    give_up: Instant,
    settled: Option<Instant>,
}

impl Patience {
    fn new() -> Self {
        Self { give_up: Instant::now() + PATIENCE, settled: None }
    }

    /// Waits a little; whether to go on.
    async fn goes_on(&mut self, is_complete: bool) -> bool {
        sleep(PERIOD).await;
        if is_complete {
            self.settled.get_or_insert_with(|| Instant::now() + DENIAL);
        }
        Instant::now() < self.settled.unwrap_or(self.give_up)
    }
}

fn note(text: &str) -> Payload {
    Payload { encoding: String::new(), bytes: Bytes::copy_from_slice(text.as_bytes()) }
}

/// A priority of its own, so that nothing of it waits behind anything.
const TRAFFIC: Traffic = Traffic::Call(Priority::Interactive);

impl Attempts<'_> {
    fn is_complete(&self, came_through: &BTreeSet<String>) -> bool {
        self.expected.is_subset(came_through)
    }

    async fn put(&self) -> Result<BTreeSet<String>, RuntimeError> {
        let mut heard = self.witness.subscribe(&self.probe.heard_at, 256).await?;
        let (mut came_through, mut patience) = (BTreeSet::new(), Patience::new());
        loop {
            for (name, (tries, _)) in self.ends {
                tries.put(&self.probe.key, note(name), TRAFFIC).await?;
            }
            let goes_on = patience.goes_on(self.is_complete(&came_through)).await;
            while let Some(sample) = heard.try_recv() {
                came_through.insert(String::from_utf8_lossy(&sample.payload.bytes).into_owned());
            }
            if !goes_on {
                return Ok(came_through);
            }
        }
    }

    async fn subscribe(&self) -> Result<BTreeSet<String>, RuntimeError> {
        let mut listeners = Vec::new();
        for (name, (tries, _)) in self.ends {
            listeners.push((name, tries.subscribe(&self.probe.key, 1).await?));
        }
        let (mut came_through, mut patience) = (BTreeSet::new(), Patience::new());
        loop {
            self.witness.put(&self.probe.key, note("witness"), TRAFFIC).await?;
            let goes_on = patience.goes_on(self.is_complete(&came_through)).await;
            for (name, heard) in &mut listeners {
                // Other trials put to other keys only: whatever comes is the witness's.
                if heard.try_recv().is_some() {
                    came_through.insert((*name).clone());
                }
            }
            if !goes_on {
                return Ok(came_through);
            }
        }
    }

    async fn query(&self) -> Result<BTreeSet<String>, RuntimeError> {
        let served = self.witness.serve(&self.probe.key, 64).await?;
        let answering = answer("witness", served);
        let asking = async {
            let (mut came_through, mut patience) = (BTreeSet::new(), Patience::new());
            loop {
                let asked = self
                    .ends
                    .iter()
                    .map(|(name, (tries, _))| async move { Ok::<_, RuntimeError>((name, ask(tries.as_ref(), &self.probe.key).await?)) });
                for answered in join_all(asked).await {
                    let (name, reply) = answered?;
                    came_through.extend(reply.map(|_| name.clone()));
                }
                if !patience.goes_on(self.is_complete(&came_through)).await {
                    return Ok::<_, RuntimeError>(came_through);
                }
            }
        };
        tokio::select! {
            asked = asking => asked,
            () = answering => Err(RuntimeError::transport("serving a trial", "the session has closed")),
        }
    }

    async fn serve(&self) -> Result<BTreeSet<String>, RuntimeError> {
        let mut came_through = BTreeSet::new();
        for (name, (tries, _)) in self.ends {
            let answering = answer(name, tries.serve(&self.probe.key, 64).await?);
            let asking = async {
                let mut patience = Patience::new();
                loop {
                    let replied = ask(self.witness, &self.probe.key).await?.is_some_and(|by| by == *name);
                    if replied || !patience.goes_on(!self.expected.contains(name)).await {
                        return Ok::<_, RuntimeError>(replied);
                    }
                }
            };
            let replied = tokio::select! {
                asked = asking => asked?,
                () = answering => false,
            };
            if replied {
                came_through.insert(name.clone());
            }
        }
        Ok(came_through)
    }

    async fn token(&self) -> Result<BTreeSet<String>, RuntimeError> {
        let mut watched = self.witness.watch_alive(&self.probe.key).await?;
        let mut came_through = BTreeSet::new();
        for (name, (tries, _)) in self.ends {
            let token = tries.declare_alive(&self.probe.key).await?;
            let bound = if self.expected.contains(name) { PATIENCE } else { DENIAL };
            let seen = async { while watched.current().is_empty() && watched.changed().await {} };
            if timeout(bound, seen).await.is_ok() {
                came_through.insert(name.clone());
            }
            drop(token);
            let gone = async { while !watched.current().is_empty() && watched.changed().await {} };
            timeout(PATIENCE, gone).await.map_err(|_| RuntimeError::transport("taking a token back", "it stays"))?;
        }
        Ok(came_through)
    }

    async fn watch(&self) -> Result<BTreeSet<String>, RuntimeError> {
        let watching = self
            .ends
            .iter()
            .map(|(name, (tries, _))| async move { Ok::<_, RuntimeError>((name, tries.watch_alive(&self.probe.key).await?)) });
        let mut watching = join_all(watching).await.into_iter().collect::<Result<Vec<_>, _>>()?;
        let _token = self.witness.declare_alive(&self.probe.key).await?;
        let (mut came_through, mut patience) = (BTreeSet::new(), Patience::new());
        loop {
            let goes_on = patience.goes_on(self.is_complete(&came_through)).await;
            for (name, watched) in &mut watching {
                if !watched.current().is_empty() {
                    came_through.insert((*name).clone());
                }
            }
            if !goes_on {
                return Ok(came_through);
            }
        }
    }
}

/// Answers every query with a name.
async fn answer(name: &str, mut served: IncomingQueries) {
    while let Some(query) = served.next().await {
        // Who is not let through sees no reply, which is what is tried.
        drop(query.replier.reply(note(name), Bytes::new()).await);
    }
}

/// Who answers at a key, if anyone does in time.
async fn ask(transport: &dyn Transport, key: &str) -> Result<Option<String>, RuntimeError> {
    let query = OutgoingQuery { payload: note("?"), attachment: Bytes::new(), priority: Priority::Interactive, timeout: DENIAL };
    let mut replies = transport.query(key, query).await?;
    // The first event decides. A stream whose query was given up does not end by itself: it is held open by the means to forget the query.
    match timeout(DENIAL * 2, replies.next()).await {
        Ok(Some(ReplyEvent::Reply { payload, .. })) => Ok(Some(String::from_utf8_lossy(&payload.bytes).into_owned())),
        Ok(Some(ReplyEvent::TimedOut) | None) | Err(_) => Ok(None),
    }
}
