//! Asking: what each request is, and the loops in which they are asked.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use repose_proto::arrange::ObjectGoal;
use repose_proto::place::{Budget, Outcome as Found};
use repose_proto::{
    ArrangeRequest, ArrangeResult, CallError, Frame, GoalTerm, Payload, PlaceRequest, PlaceResult, Relation, Scene, Service,
};
use repose_runtime::{Answer, CallOptions, Caller, Session};
use tokio::sync::mpsc;
use tokio::task::JoinSet;

use super::LoadArgs;
use super::light::{self, Rates};
use super::light_cells::LightCells;
use super::mix::{Kind, Method, kind_of};
use super::report::{self, Asked, Ended, Report};
use crate::client::{self, SystemArgs};
use crate::failure::Failure;

/// The relations asked for, in turn.
const RELATIONS: [Relation; 4] = [Relation::LeftOf, Relation::RightOf, Relation::InFrontOf, Relation::Behind];
/// What a loaded machine may take to tell a caller that its time is up.
const LATE_GRACE: Duration = Duration::from_millis(500);
/// Requests of an open loop that may be under way at once; further ones are dropped and counted, as the machine that asks would be at its end.
const MOST_UNDER_WAY: usize = 4096;
/// How long a camera's next frame may take.
const FRAME_WITHIN: Duration = Duration::from_secs(5);

/// A cell that is asked.
struct Target {
    planner: Caller,
    perception: Caller,
    /// Its camera's. That of a light cell is hardly another.
    scene: Arc<Scene>,
    scene_id: String,
    /// Its number, where it is a light cell.
    light: Option<usize>,
    /// A frame of its camera; none where nobody wants one.
    frame: Option<Payload>,
}

/// Which of a run's requests one process asks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Slice {
    /// Its number, from 0.
    pub of: usize,
    /// How many processes there are.
    pub all: usize,
}

impl Slice {
    /// All of them.
    pub const WHOLE: Self = Self { of: 0, all: 1 };

    /// How many of so many.
    pub fn count(self, requests: usize) -> usize {
        (requests + self.all - 1 - self.of) / self.all
    }
}

/// What every client of a run shares.
#[derive(Clone)]
pub struct Asking {
    /// The run's arguments.
    pub args: Arc<LoadArgs>,
    kinds: Arc<[Kind]>,
    targets: Arc<BTreeMap<String, Target>>,
    /// The cell of kinds that name none.
    cell: String,
    slice: Slice,
    light: Option<Arc<LightCells>>,
}

impl Asking {
    /// Makes everything ready that requests need, so that none of it is in their latency.
    pub async fn prepare(session: &Session, args: &LoadArgs, system: &SystemArgs, slice: Slice) -> Result<Self, Failure> {
        let kinds = if args.mix.is_empty() { vec![Kind::default()] } else { args.mix.clone() };
        if let Some(cells) = args.cells {
            return Self::light(session, args, system, &kinds, cells).await;
        }
        let kinds: Arc<[Kind]> = kinds.into();
        let (cell, mut targets) = (session.cell().name().to_owned(), BTreeMap::new());
        for kind in kinds.iter() {
            let name = kind.cell.clone().unwrap_or_else(|| cell.clone());
            let wants_frame = kinds.iter().any(|kind| kind.method == Method::Segment);
            if let Entry::Vacant(vacant) = targets.entry(name) {
                let target = Target::of(&session.in_cell(vacant.key())?, args, wants_frame).await?;
                vacant.insert(target);
            }
        }
        Ok(Self { args: Arc::new(args.clone()), kinds, targets: Arc::new(targets), cell, slice, light: None })
    }

    /// The same for light cells, each of which asks every kind.
    async fn light(session: &Session, args: &LoadArgs, system: &SystemArgs, kinds: &[Kind], cells: usize) -> Result<Self, Failure> {
        if session.in_cell(&light::name(1))?.pool().is_none() {
            return Err(Failure::bad_input("pool", "light cells have no planner: give the pool that serves them"));
        }
        if kinds.iter().any(|kind| kind.method == Method::Segment) {
            return Err(Failure::bad_input("mix", "light cells have no camera: segment is not available"));
        }
        if kinds.iter().any(|kind| kind.cell.is_some()) {
            return Err(Failure::bad_input("mix", "every kind is asked in every light cell: cell is not available"));
        }
        let camera = Target::of(session, args, false).await?;
        let rates = Rates { states_per_s: args.states, summaries_per_s: args.summaries };
        let light = LightCells::start(cells, camera.scene.clone(), &client::client_config(system)?, rates).await?;
        let mut targets = BTreeMap::new();
        for k in 1..=cells {
            let cell = &light.cells[&light::name(k)];
            let (planner, perception) = (cell.session.caller(Service::Planner).await?, cell.session.caller(Service::Perception).await?);
            let (scene, scene_id) = (camera.scene.clone(), cell.scene_id.clone());
            targets.insert(light::name(k), Target { planner, perception, scene, scene_id, light: Some(k), frame: None });
        }
        let kinds = (1..=cells).flat_map(|k| kinds.iter().map(move |kind| kind.in_cell(light::name(k)))).collect();
        let (args, targets, cell) = (Arc::new(args.clone()), Arc::new(targets), session.cell().name().to_owned());
        Ok(Self { args, kinds, targets, cell, slice: Slice::WHOLE, light: Some(Arc::new(light)) })
    }

    /// Ends what it has started.
    pub async fn close(self) {
        let Self { targets, light, .. } = self;
        // Callers go before their sessions.
        drop(targets);
        if let Some(light) = light.and_then(Arc::into_inner) {
            light.close().await;
        }
    }

    /// The kinds of requests, by what the report calls them.
    fn kind_names(&self) -> Vec<String> {
        self.kinds.iter().map(|kind| kind.name.clone()).collect()
    }

    fn duplicates(&self) -> u64 {
        self.targets.values().map(|target| target.planner.duplicates() + target.perception.duplicates()).sum()
    }

    /// Asks this process's share of so many requests, in a closed loop or at a rate of all processes together.
    pub async fn ask(&self, requests: usize, rate: Option<f64>) -> Result<Asked, Failure> {
        let before = self.duplicates();
        let started = Instant::now();
        let (ended, dropped) = match rate {
            None => (self.closed_loop(requests, started).await?, 0),
            Some(rate) => self.open_loop(requests, rate, started).await?,
        };
        let elapsed = started.elapsed();
        Ok(Asked { ended, dropped, duplicates: (self.duplicates() - before) as usize, elapsed })
    }

    /// The report of what was asked.
    pub fn report(&self, asked: &Asked, rate: Option<f64>) -> Result<Report, Failure> {
        let report = Report::new(asked, rate, &self.kind_names())?;
        let light = self.light.as_ref().map(|light| light.report(&report.kinds));
        Ok(Report { light, ..report })
    }

    async fn closed_loop(&self, requests: usize, started: Instant) -> Result<Vec<Ended>, Failure> {
        let (next, ours) = (Arc::new(AtomicUsize::new(0)), self.slice.count(requests));
        let mut clients = JoinSet::new();
        for client in 0..self.slice.count(self.args.clients).min(ours) {
            let (asking, next) = (self.clone(), next.clone());
            clients.spawn(async move {
                let mut ended = Vec::new();
                loop {
                    let k = next.fetch_add(1, Ordering::Relaxed);
                    if k >= ours {
                        return ended;
                    }
                    let i = asking.slice.of + k * asking.slice.all;
                    ended.push(asking.one(i, asking.kind(i, client), started, Instant::now()).await);
                }
            });
        }
        let mut ended = Vec::new();
        while let Some(of_client) = clients.join_next().await {
            ended.extend(of_client.map_err(Failure::other)?);
        }
        Ok(ended)
    }

    /// The kind of a request of a client in a closed loop. Among light cells each client asks in one, so that all have the same load.
    fn kind(&self, i: usize, client: usize) -> usize {
        let Some(light) = &self.light else { return kind_of(&self.kinds, self.args.seed, i) };
        let of_cell = self.kinds.len() / light.cells.len();
        let first = client % light.cells.len() * of_cell;
        first + kind_of(&self.kinds[first..first + of_cell], self.args.seed, i)
    }

    /// What ended, and how many could not even begin.
    async fn open_loop(&self, requests: usize, rate: f64, started: Instant) -> Result<(Vec<Ended>, usize), Failure> {
        let (mut under_way, mut ended, mut dropped) = (JoinSet::new(), Vec::new(), 0);
        let mut due = self.due(requests, rate, started);
        while let Some((i, due)) = due.recv().await {
            while let Some(one) = under_way.try_join_next() {
                ended.push(one.map_err(Failure::other)?);
            }
            if under_way.len() >= MOST_UNDER_WAY {
                dropped += 1;
                continue;
            }
            let asking = self.clone();
            under_way.spawn(async move { asking.one(i, kind_of(&asking.kinds, asking.args.seed, i), started, due).await });
        }
        while let Some(one) = under_way.join_next().await {
            ended.push(one.map_err(Failure::other)?);
        }
        Ok((ended, dropped))
    }

    /// This process's share of so many requests, each when it is due. A thread of its own keeps the time: the runtime's timers are late by a millisecond or
    /// two, which would be in every latency.
    fn due(&self, requests: usize, rate: f64, started: Instant) -> mpsc::Receiver<(usize, Instant)> {
        let (tell, due) = mpsc::channel(MOST_UNDER_WAY);
        let (args, slice) = (self.args.clone(), self.slice);
        std::thread::spawn(move || {
            let due_s = args.arrivals.due_s(rate, args.seed).take(requests).enumerate();
            for (i, due_s) in due_s.skip(slice.of).step_by(slice.all) {
                let due = started + Duration::from_secs_f64(due_s);
                std::thread::sleep(due.saturating_duration_since(Instant::now()));
                if tell.blocking_send((i, due)).is_err() {
                    // The run was given up.
                    return;
                }
            }
        });
        due
    }

    /// Asks once. Latency counts from when the request was due, so that a slow system cannot hide by slowing its clients down.
    async fn one(&self, i: usize, number: usize, started: Instant, due: Instant) -> Ended {
        let kind = &self.kinds[number];
        let deadline = Duration::from_millis(kind.deadline_ms.unwrap_or(self.args.connect.deadline_ms));
        let priority = kind.priority.unwrap_or_else(|| self.args.arrivals.priority(self.args.interactive, self.args.seed, i));
        let options = CallOptions { priority, ..CallOptions::within(deadline) };
        let sent = Instant::now();
        let ends = tokio::time::timeout(deadline + 2 * LATE_GRACE, self.call(kind, i, options)).await;
        let (took, on_the_wire) = (due.elapsed(), sent.elapsed());
        tracing::debug!(request = i, ms = took.as_millis() as u64, "request ended");
        let late = on_the_wire > deadline + LATE_GRACE;
        let mut end = Ended { kind: number, priority, due: due.saturating_duration_since(started), took, late, ..Ended::lost() };
        match ends {
            Err(_) => {}
            Ok(Ok((found, answer))) => {
                end.outcome = if found == Found::None { "none" } else { "result" }.to_owned();
                end.stages_ms = report::stages(took, on_the_wire, &answer.timing_ms);
                end.worker = Some(answer.worker);
            }
            Ok(Err(error)) => error.code.as_str().clone_into(&mut end.outcome),
        }
        end
    }

    async fn call(&self, kind: &Kind, i: usize, options: CallOptions) -> Result<(Found, Answer), CallError> {
        let target = &self.targets[kind.cell.as_ref().unwrap_or(&self.cell)];
        let enclosed = kind.is_whole.then(|| target.whole_scene());
        match kind.method {
            Method::Place => {
                let request = self.place(kind, target, i);
                let encode = |scene: Option<&Scene>| Payload::with_scene(&request, scene.or(enclosed.as_ref()));
                let answer = target.planner.call_with_scene("place", target.at_hand(), encode, options).await?;
                Ok((answer.payload.decode_json::<PlaceResult>()?.outcome, answer))
            }
            Method::Arrange => {
                let request = self.arrange(kind, target, i);
                let encode = |scene: Option<&Scene>| Payload::with_scene(&request, scene.or(enclosed.as_ref()));
                let answer = target.planner.call_with_scene("arrange", target.at_hand(), encode, options).await?;
                Ok((answer.payload.decode_json::<ArrangeResult>()?.outcome, answer))
            }
            Method::Segment => {
                let frame = target.frame.clone().ok_or_else(|| CallError::internal("no frame was taken"))?;
                let answer = target.perception.call("segment", frame, options).await?;
                Scene::from_bulk(&answer.payload.decode_bulk(Scene::SCHEMA)?)?;
                Ok((Found::Found, answer))
            }
        }
    }

    /// The object that the `i`-th request moves, its goal, and the object after its anchor.
    fn goal(&self, target: &Target, i: usize) -> (u16, GoalTerm, u16) {
        let objects = &target.scene.meta.objects;
        let id = |k: usize| objects[k % objects.len()].id;
        let relation = RELATIONS[i / objects.len() % RELATIONS.len()];
        (id(i), GoalTerm { relation, anchor: id(i + 1), holds: true }, id(i + 2))
    }

    fn place(&self, kind: &Kind, target: &Target, i: usize) -> PlaceRequest {
        let (query, term, _) = self.goal(target, i);
        let (iterations, batch) = (kind.iterations.unwrap_or(self.args.iterations), kind.batch.unwrap_or(self.args.batch));
        PlaceRequest {
            seed: self.args.seed + i as u64,
            variant: kind.variant.unwrap_or(self.args.variant),
            count: kind.count.unwrap_or(1),
            budget: Budget { iterations: Some(iterations), batch: Some(batch), ..Budget::default() },
            ..PlaceRequest::new(target.scene_id.clone(), query, vec![term])
        }
    }

    /// One object beside a second, and where there is a third, that one beside the second, too.
    fn arrange(&self, kind: &Kind, target: &Target, i: usize) -> ArrangeRequest {
        let (first, term, third) = self.goal(target, i);
        let other = GoalTerm { relation: Relation::Near, ..term };
        let mut goals = vec![ObjectGoal { object: first, terms: vec![term] }];
        if third != first && third != other.anchor {
            goals.push(ObjectGoal { object: third, terms: vec![other] });
        }
        let (seed, variant) = (self.args.seed + i as u64, kind.variant.unwrap_or(self.args.variant));
        ArrangeRequest { seed, variant, ..ArrangeRequest::new(target.scene_id.clone(), goals) }
    }
}

impl Target {
    async fn of(session: &Session, args: &LoadArgs, wants_frame: bool) -> Result<Self, Failure> {
        let within = Duration::from_millis(args.connect.deadline_ms);
        // A system of the run's own has only just begun to look.
        let patience = if args.up { within } else { client::PATIENCE };
        let summary = client::newest_scene(session, &args.connect.camera, within, patience).await?;
        if summary.objects.len() < 2 {
            return Err(Failure::bad_input("camera", format!("the newest scene has {} objects, two are needed", summary.objects.len())));
        }
        let scene = client::whole_scene(session, &summary.scene_id, within).await?;
        let (planner, perception) = (session.caller(Service::Planner).await?, session.caller(Service::Perception).await?);
        let frame = if wants_frame { Some(newest_frame(session, &args.connect.camera).await?) } else { None };
        Ok(Self { planner, perception, scene: Arc::new(scene), scene_id: summary.scene_id, light: None, frame })
    }

    /// The scene for a worker that lacks it. A light cell gives its scene itself, to the planner that asks for it.
    fn at_hand(&self) -> Option<&Scene> {
        self.light.is_none().then_some(&*self.scene)
    }

    fn whole_scene(&self) -> Scene {
        match self.light {
            Some(k) => light::scene_of(k, &self.scene),
            None => Scene::clone(&self.scene),
        }
    }
}

async fn newest_frame(session: &Session, camera: &str) -> Result<Payload, Failure> {
    let mut frames = session.subscribe_latest(&session.cell().camera_frame(camera)).await?;
    let frame = tokio::time::timeout(FRAME_WITHIN, frames.recv()).await.ok().flatten();
    let frame = frame
        .ok_or_else(|| Failure::bad_input("camera", format!("camera {camera} sent no frame; check that this user may read frames")))?;
    // As a call's payload it is the same message.
    frame.payload.decode_bulk(Frame::SCHEMA)?;
    Ok(frame.payload)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slices_of_a_run_are_all_of_it() {
        for (requests, all) in [(10, 1), (10, 3), (2, 4), (7, 7)] {
            let counts: Vec<usize> = (0..all).map(|of| Slice { of, all }.count(requests)).collect();
            assert_eq!(counts.iter().sum::<usize>(), requests, "{counts:?}");
            assert!(counts.iter().max().zip(counts.iter().min()).is_some_and(|(most, least)| most - least <= 1), "{counts:?}");
        }
    }
}
