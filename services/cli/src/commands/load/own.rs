//! A system of the run's own: a router, a simulated cell and services, each a process on this machine, which faults may be done to.

use std::collections::BTreeMap;
use std::net::{TcpListener, UdpSocket};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use repose_proto::Service;
use repose_runtime::deployment::{self, Roles};
use repose_runtime::{RuntimeConfig, Session};
use serde::{Deserialize, Serialize};
use tokio::sync::oneshot;
use tokio::task::JoinHandle;

use super::fault::{Deed, Fault, Schedule};
use crate::client::{self, SystemArgs, client_config};
use crate::failure::{CommandResult, Failure};
use crate::processes::{LabelledProcess, service_process};

/// How long the processes may take to come up.
const READY_WITHIN: Duration = Duration::from_secs(60);
/// What the router is called.
const ROUTER: &str = "router";
/// The user that asks, where there are users.
const CLIENT: &str = "asker";

/// How many processes of each kind there are.
#[derive(Debug, Clone, Copy)]
pub struct Sizes {
    /// Routers that know each other; every process reaches all of them, and uses the first that answers: half of them start at another one.
    pub routers: usize,
    /// Planner processes.
    pub planners: usize,
    /// Inference processes.
    pub inference: usize,
}

impl Sizes {
    fn of(self, service: Service) -> usize {
        match service {
            Service::Planner => self.planners,
            Service::Inference => self.inference,
            Service::Simulator | Service::Perception => 1,
            // Nothing is carried out.
            Service::Motion => 0,
        }
    }
}

/// A fault as it happened.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Happened {
    /// When, seconds from the start of the run.
    pub at_s: f64,
    /// What.
    pub what: String,
}

struct Own {
    what: String,
    /// Its number among those of its kind, from 0.
    place: usize,
    process: LabelledProcess,
    is_halted: bool,
}

impl Own {
    fn name(&self) -> String {
        name(&self.what, self.place)
    }
}

/// The processes. They end with this.
pub struct OwnSystem {
    /// Where each router listens.
    routers: Vec<String>,
    /// What the processes read.
    folder: tempfile::TempDir,
    has_users: bool,
    seed: u64,
    processes: Vec<Own>,
    /// How often a fault has taken a process of a kind: they take turns.
    turns: BTreeMap<String, usize>,
}

impl OwnSystem {
    /// Starts one and waits until it can be asked. `is_secured`: with users, certificates and access control over QUIC, as over a network.
    pub async fn start(sizes: Sizes, seed: u64, is_secured: bool) -> Result<Self, Failure> {
        let folder = tempfile::tempdir().map_err(Failure::other)?;
        let routers = (0..sizes.routers).map(|_| free_endpoint(is_secured)).collect::<Result<Vec<_>, _>>()?;
        match is_secured {
            true => write_secured(&routers[0], folder.path())?,
            false => write_routers(&routers, folder.path())?,
        }
        let mut system = Self { routers, folder, has_users: is_secured, seed, processes: Vec::new(), turns: BTreeMap::new() };
        for place in 0..sizes.routers {
            system.add(ROUTER, place)?;
        }
        for service in Service::ALL {
            for place in 0..sizes.of(service) {
                system.add(service.as_str(), place)?;
            }
        }
        let session = Session::open(system.config()?).await?;
        for service in Service::ALL {
            session.caller(service).await?.wait_for_workers(sizes.of(service), READY_WITHIN).await?;
        }
        client::close(session).await;
        Ok(system)
    }

    /// Where its first router is.
    pub fn endpoint(&self) -> &str {
        &self.routers[0]
    }

    /// What a client of it is given: where it is, its cell, whatever variables say of others, and who the client is there.
    pub fn args(&self) -> SystemArgs {
        let (connect, cell) = (self.routers.join(","), RuntimeConfig::default().session.cell);
        SystemArgs { connect: Some(connect), cell: Some(cell), pool: None, config: self.file(CLIENT) }
    }

    fn config(&self) -> Result<RuntimeConfig, Failure> {
        client_config(&self.args())
    }

    /// What a process reads, where it reads something.
    fn file(&self, of: &str) -> Option<PathBuf> {
        let folder = self.folder.path();
        match (self.has_users, of.strip_prefix(ROUTER)) {
            (true, Some(_)) => Some(folder.join("router/router.toml")),
            (true, None) => Some(folder.join("users").join(of).join("repose.toml")),
            (false, Some(_)) => Some(folder.join(format!("{of}.toml"))),
            (false, None) => None,
        }
    }

    /// Starts a process. A service begins at the router whose turn it is, and knows the others.
    fn add(&mut self, what: &str, place: usize) -> CommandResult {
        let name = name(what, place);
        let (endpoint, file) = match what {
            ROUTER => (self.routers[place].clone(), self.file(&name)),
            _ => {
                let mut routers = self.routers.clone();
                routers.rotate_left(self.processes.len() % self.routers.len());
                (routers.join(","), self.file(what))
            }
        };
        let mut command = service_process(&endpoint, &RuntimeConfig::default().session.cell, file.as_deref(), what)?;
        if what == Service::Simulator.as_str() {
            command.env("REPOSE_SIMULATOR__SEED", self.seed.to_string());
        }
        let process =
            LabelledProcess::spawn(&mut command, &name).map_err(|e| Failure::other(format!("{name} could not be started: {e}")))?;
        self.processes.push(Own { what: what.to_owned(), place, process, is_halted: false });
        Ok(())
    }

    fn signal(own: &Own, signal: i32) {
        if let Some(id) = own.process.child.id().and_then(|id| i32::try_from(id).ok()) {
            // SAFETY: a plain system call on a child that has not been waited for, so its id is still its own.
            unsafe { libc::kill(id, signal) };
        }
    }

    /// Does a deed; says what it was, where there was somebody to do it to.
    async fn perform(&mut self, deed: Deed) -> Result<Option<String>, Failure> {
        match deed {
            Deed::Restart(service) => {
                let Some(mut own) = self.next_of(service.as_str()).map(|place| self.processes.remove(place)) else { return Ok(None) };
                own.process.child.kill().await.map_err(Failure::other)?;
                self.add(service.as_str(), own.place)?;
                Ok(Some(format!("kill {}", own.name())))
            }
            Deed::Halt(service) => {
                let Some(place) = self.next_of(service.as_str()) else { return Ok(None) };
                let own = &mut self.processes[place];
                own.is_halted = true;
                Self::signal(own, libc::SIGSTOP);
                Ok(Some(format!("stop {}", own.name())))
            }
            Deed::Resume => {
                let Some(own) = self.processes.iter_mut().find(|own| own.is_halted) else { return Ok(None) };
                own.is_halted = false;
                Self::signal(own, libc::SIGCONT);
                Ok(Some(format!("resume {}", own.name())))
            }
            Deed::KillRouter => {
                let Some(mut own) = self.next_of(ROUTER).map(|place| self.processes.remove(place)) else { return Ok(None) };
                own.process.child.kill().await.map_err(Failure::other)?;
                Ok(Some(format!("kill {}", own.name())))
            }
            Deed::StartRouter => {
                let runs = |place: &usize| self.processes.iter().any(|own| own.what == ROUTER && own.place == *place);
                let Some(place) = (0..self.routers.len()).find(|place| !runs(place)) else { return Ok(None) };
                self.add(ROUTER, place)?;
                Ok(Some(format!("start {}", name(ROUTER, place))))
            }
        }
    }

    /// The process of a kind whose turn it is. Those that hang are left alone.
    fn next_of(&mut self, what: &str) -> Option<usize> {
        let places: Vec<usize> =
            (0..self.processes.len()).filter(|i| self.processes[*i].what == what && !self.processes[*i].is_halted).collect();
        let turn = self.turns.entry(what.to_owned()).or_default();
        *turn += 1;
        places.get(*turn % places.len().max(1)).copied()
    }

    /// Those that have ended without being asked to.
    fn ended(&mut self) -> Vec<String> {
        let ended = self.processes.iter_mut().filter_map(|own| {
            let status = own.process.child.try_wait().ok()??;
            Some(format!("{} ended by itself: {status}", own.name()))
        });
        ended.collect()
    }
}

/// What a process is called.
fn name(what: &str, place: usize) -> String {
    format!("{what}-{}", place + 1)
}

/// An address on this machine at which nothing listens yet.
fn free_endpoint(is_secured: bool) -> Result<String, Failure> {
    let address = match is_secured {
        true => UdpSocket::bind("127.0.0.1:0").and_then(|socket| socket.local_addr()),
        false => TcpListener::bind("127.0.0.1:0").and_then(|socket| socket.local_addr()),
    };
    Ok(format!("{}/{}", if is_secured { "quic" } else { "tcp" }, address.map_err(Failure::other)?))
}

/// A file for each router, which names the others.
fn write_routers(routers: &[String], folder: &Path) -> CommandResult {
    for (place, own) in routers.iter().enumerate() {
        let others: Vec<&String> = routers.iter().filter(|other| *other != own).collect();
        let text = format!("[session]\nmode = \"router\"\nconnect = {others:?}\n");
        std::fs::write(folder.join(format!("{}.toml", name(ROUTER, place))), text).map_err(Failure::other)?;
    }
    Ok(())
}

/// The configuration of a router and of a user for each service, in a folder.
fn write_secured(router: &str, folder: &Path) -> CommandResult {
    let mut text = format!(
        "router = \"{}\"\ncells = [\"{}\"]\n[users.{CLIENT}]\nrole = \"planner\"\nframes = true\n",
        router.trim_start_matches("quic/"),
        RuntimeConfig::default().session.cell
    );
    for service in Service::ALL {
        text += &format!("[users.{service}]\nrole = \"service\"\nservice = \"{service}\"\n");
    }
    let written = deployment::write(&Roles::parse(&text)?, folder, folder);
    written.map(drop).map_err(|e| Failure::bad_input(&e.path.display().to_string(), e.message))
}

/// Faults being done to a system.
pub struct Troubled {
    enough: oneshot::Sender<()>,
    doing: JoinHandle<(OwnSystem, Result<Vec<Happened>, Failure>)>,
}

impl Troubled {
    /// Begins to do faults to a system.
    pub fn begin(mut system: OwnSystem, faults: &[Fault]) -> Self {
        let (enough, mut stop) = oneshot::channel();
        let (began, mut schedule) = (Instant::now(), Schedule::new(faults));
        let doing = tokio::spawn(async move {
            let mut happened = Vec::new();
            loop {
                let Some((at, deed)) = schedule.next() else {
                    let _told = (&mut stop).await;
                    break;
                };
                tokio::select! {
                    () = tokio::time::sleep_until((began + at).into()) => {}
                    _told = &mut stop => break,
                }
                match system.perform(deed).await {
                    Ok(what) => happened.extend(what.map(|what| Happened { at_s: began.elapsed().as_secs_f64(), what })),
                    Err(failure) => return (system, Err(failure)),
                }
            }
            let at_s = began.elapsed().as_secs_f64();
            happened.extend(system.ended().into_iter().map(|what| Happened { at_s, what }));
            (system, Ok(happened))
        });
        Self { enough, doing }
    }

    /// Ends the faults: the system, and what happened to it.
    pub async fn end(self) -> Result<(OwnSystem, Vec<Happened>), Failure> {
        // It has ended already where there was nothing to do.
        let _unheard = self.enough.send(());
        let (system, happened) = self.doing.await.map_err(Failure::other)?;
        Ok((system, happened?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_client_is_told_the_cell_that_the_processes_are_told() {
        let folder = tempfile::tempdir().expect("a folder");
        let routers = vec!["tcp/127.0.0.1:1".to_owned()];
        let system = OwnSystem { routers, folder, has_users: false, seed: 0, processes: Vec::new(), turns: BTreeMap::new() };
        assert_eq!(system.args().cell, Some(RuntimeConfig::default().session.cell));
    }
}
