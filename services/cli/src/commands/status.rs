//! `repose status`: what is there, how it does, and what is wrong, a sentence each.

use std::collections::{BTreeMap, BTreeSet};
use std::io::IsTerminal;
use std::time::Duration;

use clap::Args;
use repose_evaluation::report::text::table;
use repose_perception::PerceptionConfig;
use repose_proto::Service;
use repose_proto::load::WorkerLoad;
use repose_proto::robot::RobotState;
use repose_runtime::{CertificateExpiry, Session, Shutdown, certificates_in_use, load_config};
use serde_json::{Value, json};

use crate::cell_survey::{CameraHeard, CellListener, CellSurvey, Received, WorkerName, listed};
use crate::client::{self, SystemArgs};
use crate::clocks::{Clock, Source, wrong_with};
use crate::failure::CommandResult;
use crate::output::Output;

/// A worker that has not told its load for this long is suspect, as callers take it.
const SILENT: Duration = Duration::from_secs(1);
/// A camera whose newest scene is older is said to stand still.
const STALE: Duration = Duration::from_secs(3);
/// A stream whose newest scene is older than so many of perception's idle periods becomes none: one of them is there while nobody asks.
const IDLE_PERIODS: u32 = 3;

/// Arguments of `status`.
#[derive(Debug, Args)]
pub struct StatusArgs {
    /// The system.
    #[command(flatten)]
    pub system: SystemArgs,
    /// Repeat until interrupted.
    #[arg(long)]
    pub watch: bool,
    /// How long to listen before reporting, seconds; rates are averaged over this time.
    #[arg(long, default_value_t = 1.5, value_parser = parse_seconds)]
    pub seconds: f64,
}

fn parse_seconds(text: &str) -> Result<f64, String> {
    let seconds: f64 = text.parse().map_err(|e| format!("{e}"))?;
    if (0.5..=60.0).contains(&seconds) { Ok(seconds) } else { Err("expected 0.5 to 60".to_owned()) }
}

/// Runs the command.
pub async fn run(args: &StatusArgs, output: Output) -> CommandResult {
    let shutdown = Shutdown::on_signals()?;
    let session = client::connect(&args.system).await?;
    let watched = watch(args, &session, &shutdown, output).await;
    client::close(session).await;
    watched
}

async fn watch(args: &StatusArgs, session: &Session, shutdown: &Shutdown, output: Output) -> CommandResult {
    let within = Duration::from_secs_f64(args.seconds);
    // Whatever else is in that section is its service's to judge.
    let perception: PerceptionConfig = load_config("perception", args.system.config.as_deref()).unwrap_or_default();
    let mut observer = CellListener::new(session).await?;
    let mut heard = CellSurvey::default();
    loop {
        heard = tokio::select! {
            heard = observer.listen(within, &heard) => heard?,
            () = shutdown.requested() => return Ok(()),
        };
        let status = Status {
            heard: &heard,
            cell: session.cell().name(),
            pool: session.pool(),
            is_user: session.is_user(),
            seconds: args.seconds,
            idle_period: Duration::from_millis(perception.idle_period_ms),
            certificates: certificates_in_use(),
        };
        let is_read = output.print_more(&status.document(), || {
            let top = if args.watch && std::io::stdout().is_terminal() { "\x1b[2J\x1b[H" } else { "" };
            format!("{top}{}", status.text())
        })?;
        if !args.watch || !is_read {
            return Ok(());
        }
    }
}

/// Calls of a worker that ended, and those that it failed.
#[derive(Debug, Clone, Copy)]
struct Rates {
    calls_per_s: f64,
    errors_per_s: f64,
}

impl Rates {
    /// From the first load that was heard to the newest; none where the worker does not count its calls, or told its load once only.
    fn of(load: &Received<WorkerLoad>) -> Option<Self> {
        let seconds = load.at.duration_since(load.first_at).as_secs_f64();
        let since = |of: fn(&WorkerLoad) -> Option<u64>| of(&load.newest)?.checked_sub(of(&load.first)?);
        let (ended, failed) = (since(|load| load.ended)?, since(|load| load.failed)?);
        (seconds > 0.0).then(|| Self { calls_per_s: ended as f64 / seconds, errors_per_s: failed as f64 / seconds })
    }
}

/// What was heard of a cell, to be told.
struct Status<'a> {
    heard: &'a CellSurvey,
    cell: &'a str,
    /// The pool that serves it.
    pool: Option<&'a str>,
    /// Whether who looks is a user, to whom access control shows no other cells.
    is_user: bool,
    /// How long was listened.
    seconds: f64,
    /// How often perception makes a scene of a stream that nobody asks about.
    idle_period: Duration,
    /// When the certificates expire that this session uses.
    certificates: Vec<CertificateExpiry>,
}

impl Status<'_> {
    fn document(&self) -> Value {
        let heard = self.heard;
        let worker = |(name, load): (&WorkerName, &Option<Received<WorkerLoad>>)| {
            let rates = load.as_ref().and_then(Rates::of);
            json!({
                "service": name.service, "cell": name.cell, "worker": name.worker,
                "silent_ms": load.as_ref().map(|l| heard.age(l.at).as_millis() as u64),
                "calls_per_s": rates.map(|rates| rates.calls_per_s), "errors_per_s": rates.map(|rates| rates.errors_per_s),
                "lag_ms": load.as_ref().and_then(|l| l.lag_ms), "load": load.as_ref().map(|l| &l.newest),
            })
        };
        let camera = |(name, camera): (&String, &CameraHeard)| {
            let newest = camera.newest(heard);
            json!({
                "camera": name, "frames_per_s": camera.frames_per_s(), "silent_ms": camera.silent(heard).map(|silent| silent.as_millis() as u64),
                "scene_id": newest.map(|newest| newest.0), "objects": newest.map(|newest| newest.1),
                "scenes_per_s": camera.scenes_per_s(self.seconds), "age_ms": newest.map(|newest| newest.2.as_millis() as u64),
                "lag_ms": camera.lag_ms(),
            })
        };
        let robot = |(name, state): (&String, &Received<RobotState>)| json!({"robot": name, "states_per_s": state.count as f64 / self.seconds, "age_ms": heard.age(state.at).as_millis() as u64, "lag_ms": state.lag_ms, "state": state.newest});
        json!({
            "cell": self.cell, "pool": self.pool, "cells": heard.cells,
            "workers": heard.workers.iter().map(worker).collect::<Vec<_>>(),
            "cameras": heard.cameras.iter().map(camera).collect::<Vec<_>>(),
            "robots": heard.robots.iter().map(robot).collect::<Vec<_>>(),
            "certificates": self.certificates,
            "wrong": self.wrong(),
        })
    }

    fn text(&self) -> String {
        let others: BTreeSet<String> = self.heard.cells.iter().filter(|cell| *cell != self.cell).cloned().collect();
        let pool = self.pool.map_or_else(String::new, |pool| format!(", served by the pool {pool}"));
        let others = if self.is_user { String::new() } else { format!("; other cells with workers: {}", listed(&others)) };
        let mut text = format!("cell {}{pool}{others}", self.cell);
        if !self.heard.workers.is_empty() {
            text += &format!("\n{}", self.workers());
        }
        for (name, camera) in &self.heard.cameras {
            let frames = camera.frames_per_s().map_or_else(String::new, |rate| format!("{rate:.1} frames/s, "));
            let newest = match camera.newest(self.heard) {
                Some((_, objects, age)) => format!("newest has {objects} objects, {}", ago(age)),
                None => "none was made yet".to_owned(),
            };
            let scenes = match camera.scenes_per_s(self.seconds) {
                0.0 if camera.frames_per_s().is_some_and(|rate| rate > 0.0) => "nobody asks for its scenes".to_owned(),
                rate => format!("{rate:.1} scenes/s"),
            };
            text += &format!("\ncamera {name}: {frames}{scenes}, {newest}");
        }
        for (name, robot) in &self.heard.robots {
            let rate = robot.count as f64 / self.seconds;
            text += &format!("\nrobot {name}: {}, {rate:.0} states/s", of_robot(&robot.newest));
        }
        let wrong = self.wrong();
        match wrong.is_empty() {
            true => text + "\nnothing is wrong",
            false => text + &wrong.iter().map(|sentence| format!("\n! {sentence}")).collect::<String>(),
        }
    }

    fn workers(&self) -> String {
        let mut table =
            table(["service", "worker", "version", "waiting", "running", "calls/s", "errors/s", "ms a call", "weights", "kernel", ""]);
        for (name, load) in &self.heard.workers {
            let mut cells = vec![name.service.to_string(), self.worker(name)];
            let rates = load.as_ref().and_then(Rates::of);
            let rate = |of: fn(Rates) -> f64| rates.map_or_else(|| "?".to_owned(), |rates| format!("{:.1}", of(rates)));
            match load.as_ref().map(|heard| &heard.newest) {
                Some(load) => cells.extend([
                    load.version.clone().unwrap_or_else(|| "?".to_owned()),
                    format!("{} of {}", load.queue_depth, load.queue_capacity),
                    load.in_flight.to_string(),
                    rate(|rates| rates.calls_per_s),
                    rate(|rates| rates.errors_per_s),
                    format!("{:.1}", load.service_ms),
                    short(&load.weights_hash),
                    load.kernel.clone(),
                    if load.draining { "draining".to_owned() } else { String::new() },
                ]),
                None => cells.extend(["?", "?", "?", "?", "?", "?", "", "", "silent"].map(str::to_owned)),
            }
            table.add_row(cells);
        }
        table.to_string()
    }

    /// What a worker is called: one of the pool with where it is.
    fn worker(&self, name: &WorkerName) -> String {
        let WorkerName { cell, worker, .. } = name;
        if cell == self.cell { worker.clone() } else { format!("{worker} of {cell}") }
    }

    /// What is wrong now, a sentence each.
    fn wrong(&self) -> Vec<String> {
        let heard = self.heard;
        let expiring = self.certificates.iter().filter_map(CertificateExpiry::warning);
        let mut wrong: Vec<String> = [Service::Perception, Service::Inference, Service::Planner, Service::Motion]
            .into_iter()
            .filter(|service| self.called(*service).next().is_none())
            .map(|service| match self.pool_of(service) {
                Some(pool) => format!("no {service} worker of the pool {pool} is alive"),
                None => format!("no {service} worker is alive"),
            })
            .collect();
        for (name, load) in &heard.workers {
            let (service, worker) = (name.service, self.worker(name));
            match load {
                Some(load) if heard.age(load.at) > SILENT => {
                    wrong.push(format!("{service} {worker} told its load {} and is taken for suspect", ago(heard.age(load.at))));
                }
                Some(load) if load.newest.queue_capacity > 0 && load.newest.queue_depth >= load.newest.queue_capacity => {
                    wrong.push(format!("the queue of {service} {worker} is full: calls are refused"));
                }
                Some(_) => {}
                None => wrong.push(format!("{service} {worker} is alive and does not tell its load")),
            }
            if let Some(rates) = load.as_ref().and_then(Rates::of).filter(|rates| rates.errors_per_s > 0.0) {
                let Rates { calls_per_s, errors_per_s } = rates;
                wrong.push(format!("{service} {worker} fails {errors_per_s:.1} of {calls_per_s:.1} calls a second; its log says why"));
            }
        }
        let versions: BTreeSet<&str> = heard.workers.values().flatten().filter_map(|load| load.newest.version.as_deref()).collect();
        if versions.len() > 1 {
            wrong.push(format!("workers are of several versions: {}", Vec::from_iter(versions).join(", ")));
        }
        let mut weights: BTreeMap<&str, usize> = BTreeMap::new();
        for load in self.called(Service::Inference).filter_map(|(_, load)| load.as_ref()) {
            *weights.entry(load.newest.weights_hash.as_str()).or_default() += 1;
        }
        if weights.len() > 1 {
            let counts: Vec<String> = weights.iter().map(|(hash, count)| format!("{} by {count}", short(hash))).collect();
            wrong.push(format!("inference workers serve different weights: {}", counts.join(", ")));
        }
        if self.is_user && heard.workers.is_empty() && heard.cameras.is_empty() && heard.robots.is_empty() {
            let nothing = format!("nothing of the cell {} is seen: either nothing runs there, or this user is not of that cell", self.cell);
            return std::iter::once(nothing).chain(expiring).collect();
        }
        if heard.cameras.is_empty() {
            wrong.push("no camera showed anything while this was listened to".to_owned());
        }
        let silent = heard.cameras.iter().filter_map(|(name, camera)| Some((name, camera.silent(heard).filter(|silent| *silent > STALE)?)));
        wrong.extend(silent.map(|(name, silent)| format!("camera {name} has shown nothing for {:.1} s", silent.as_secs_f64())));
        wrong.extend(heard.cameras.iter().filter_map(|(name, camera)| self.without_scenes(name, camera)));
        if heard.robots.is_empty() && self.called(Service::Motion).next().is_some() {
            wrong.push("no robot told its state while this was listened to".to_owned());
        }
        for (name, robot) in &heard.robots {
            if let Some(stop) = &robot.newest.stop {
                wrong.push(format!(
                    "robot {name} is stopped: {} ({}); `repose robot reset --robot {name}` lets it go on",
                    stop.reason, stop.kind
                ));
            }
            if heard.age(robot.at) > SILENT {
                wrong.push(format!("robot {name} told its state {}", ago(heard.age(robot.at))));
            }
        }
        wrong.extend(wrong_with(&self.clocks()));
        wrong.extend(expiring);
        wrong
    }

    /// The pool that calls of a service go to, in place of the cell.
    fn pool_of(&self, service: Service) -> Option<&str> {
        self.pool.filter(|_| service.is_poolable())
    }

    /// The workers of a service that calls go to: where a pool serves the cell, none of the cell's own.
    fn called(&self, service: Service) -> impl Iterator<Item = (&WorkerName, &Option<Received<WorkerLoad>>)> {
        let home = self.pool_of(service).unwrap_or(self.cell);
        self.heard.workers.iter().filter(move |(name, _)| name.service == service && name.cell == home)
    }

    /// What is wrong with a camera whose frames come to perception and become no scene.
    fn without_scenes(&self, name: &str, camera: &CameraHeard) -> Option<String> {
        camera.told.as_ref()?;
        camera.silent(self.heard).filter(|silent| *silent <= STALE)?;
        let newest = match camera.newest(self.heard) {
            Some((.., age)) if age <= STALE.max(self.idle_period * IDLE_PERIODS) => return None,
            Some((.., age)) => format!("the newest is from {}", ago(age)),
            None => "none was made yet".to_owned(),
        };
        Some(format!("camera {name} shows frames that become no scene: {newest}; perception's log says why"))
    }

    /// The clocks of those that were heard.
    fn clocks(&self) -> Vec<Clock> {
        let heard = self.heard;
        let clock = |of, lag_ms: Option<f64>| lag_ms.map(|lag_ms| Clock { of, lag_ms });
        let robots = heard.robots.iter().map(|(name, robot)| clock(Source::Robot(name.clone()), robot.lag_ms));
        let cameras = heard.cameras.iter().map(|(name, camera)| clock(Source::Camera(name.clone()), camera.lag_ms()));
        let workers = heard.workers.iter().map(|(name, load)| {
            clock(Source::Worker(format!("{} {}", name.service, self.worker(name))), load.as_ref().and_then(|load| load.lag_ms))
        });
        robots.chain(cameras).chain(workers).flatten().collect()
    }
}

/// The beginning of a hash, as another program tells it: enough to tell two apart.
fn short(hash: &str) -> String {
    hash.chars().take(12).collect()
}

fn of_robot(state: &RobotState) -> String {
    let mode = serde_json::to_value(state.mode).ok().and_then(|v| v.as_str().map(str::to_owned)).unwrap_or_default();
    let owner = state.owner.as_ref().map_or_else(|| "nobody commands it".to_owned(), |owner| format!("commanded by {}", owner.id));
    format!(
        "{mode}, {owner}, fingers {:.0} mm apart{}",
        state.gripper_width_m * 1e3,
        if state.gripper_holding { " and holding" } else { "" }
    )
}

fn ago(age: Duration) -> String {
    format!("{:.1} s ago", age.as_secs_f64())
}

#[cfg(test)]
mod tests {
    use repose_proto::load::{CameraLoad, NewestSceneLoad};
    use tokio::time::Instant;

    use super::*;

    fn status<'a>(heard: &'a CellSurvey, pool: Option<&'a str>) -> Status<'a> {
        let idle_period = Duration::from_secs(10);
        Status { heard, cell: "cell", pool, is_user: false, seconds: 1.0, idle_period, certificates: Vec::new() }
    }

    fn received<T: Clone>(newest: T) -> Received<T> {
        let at = Instant::now();
        Received { first: newest.clone(), first_at: at, newest, at, count: 1, lag_ms: None }
    }

    fn add_worker(heard: &mut CellSurvey, cell: &str, service: Service, weights: &str) {
        let name = WorkerName { service, cell: cell.to_owned(), worker: format!("{service}-{}", heard.workers.len()) };
        heard.workers.insert(name, Some(received(WorkerLoad { weights_hash: weights.to_owned(), ..WorkerLoad::default() })));
    }

    /// Whether something that is said to be wrong has these words.
    fn says(status: &Status<'_>, words: &str) -> bool {
        status.wrong().iter().any(|sentence| sentence.contains(words))
    }

    #[test]
    fn certificates_that_have_expired_are_wrong_whatever_else_is_seen() {
        let old = CertificateExpiry { file: "anna/certificate.pem".into(), expires_on: "1970-01-01".to_owned(), expires_s: 0 };
        let good = CertificateExpiry { file: "anna/authority.pem".into(), expires_on: "9999-12-31".to_owned(), expires_s: 253_402_214_400 };
        let heard = CellSurvey::default();
        for is_user in [true, false] {
            let certificates = vec![old.clone(), good.clone()];
            let status = Status { is_user, certificates, ..status(&heard, None) };
            let said = status.wrong().into_iter().filter(|sentence| sentence.contains("anna/"));
            assert_eq!(said.collect::<Vec<_>>(), ["the certificate anna/certificate.pem has expired, on 1970-01-01"]);
            assert_eq!(status.document()["certificates"][1]["expires_on"], "9999-12-31");
        }
    }

    #[test]
    fn a_robot_is_missed_where_somebody_would_move_it() {
        let mut heard = CellSurvey::default();
        assert!(!says(&status(&heard, None), "no robot"));
        add_worker(&mut heard, "cell", Service::Motion, "");
        assert!(says(&status(&heard, None), "no robot told its state while this was listened to"));
    }

    #[test]
    fn workers_of_the_cell_do_not_stand_in_for_those_of_its_pool() {
        let mut heard = CellSurvey::default();
        for service in [Service::Planner, Service::Inference] {
            add_worker(&mut heard, "cell", service, "0001");
        }
        assert!(!says(&status(&heard, None), "no planner worker"));
        assert!(says(&status(&heard, Some("rack")), "no planner worker of the pool rack is alive"));
        add_worker(&mut heard, "rack", Service::Planner, "");
        add_worker(&mut heard, "rack", Service::Inference, "0002");
        assert!(!says(&status(&heard, Some("rack")), "no planner worker") && !says(&status(&heard, Some("rack")), "no inference worker"));
        assert!(!says(&status(&heard, Some("rack")), "different weights"), "nobody calls the cell's own");
        add_worker(&mut heard, "rack", Service::Inference, "0003");
        assert!(says(&status(&heard, Some("rack")), "different weights: 0002 by 1, 0003 by 1"));
        add_worker(&mut heard, "cell", Service::Perception, "");
        assert!(!says(&status(&heard, Some("rack")), "no perception worker"), "a pool has none");
    }

    #[test]
    fn frames_that_become_no_scene_are_said_to() {
        let said = |frame_age_ms, newest_age_ms: Option<u64>| {
            let of_scene = |age_ms| NewestSceneLoad { scene_id: "scene".to_owned(), objects: 0, age_ms, lag_ms: 0.0 };
            let load = CameraLoad { camera: "front".to_owned(), frames: 100, frame_age_ms, newest: newest_age_ms.map(of_scene) };
            let mut heard = CellSurvey::default();
            heard.cameras.insert("front".to_owned(), CameraHeard { scenes: None, told: Some(received(load)) });
            let wrong = status(&heard, None).wrong();
            wrong.into_iter().find(|sentence| sentence.contains("become no scene"))
        };
        assert_eq!(said(100, Some(10_500)), None, "while nobody asks there is one every ten seconds");
        assert!(said(100, Some(60_000)).is_some_and(|words| words.contains("camera front") && words.contains("60.0 s ago")));
        assert!(said(100, None).is_some_and(|words| words.contains("none was made yet")));
        assert_eq!(said(60_000, Some(60_000)), None, "one that shows nothing is said to show nothing");
    }

    #[test]
    fn a_hash_is_cut_off_whatever_it_is_made_of() {
        assert_eq!(
            (short("0123456789abcdef"), short("0"), short("0123456789aéé")),
            ("0123456789ab".to_owned(), "0".to_owned(), "0123456789aé".to_owned())
        );
    }
}
