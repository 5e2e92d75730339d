//! Processes die and people interrupt while the simulated robot carries out a placement: whatever commands it is lost with them, the robot
//! latches a stop, and `repose robot reset`, `open`, `retreat` and `home` bring it back. Other deaths leave the execution as it is.

#[path = "../common/mod.rs"]
mod common;

use std::process::{Child, Output, Stdio};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use common::link::Link;
use common::{Deployment, PATIENCE, Process, newest_scene};
use repose_proto::robot::{RobotMode, RobotState};
use repose_proto::simulator::{Truth, WorldResetRequest};
use repose_proto::{Payload, Service};
use repose_runtime::{CallOptions, Session};
use serde_json::Value;

/// Moments of an execution at which the long test kills or cuts, …
const MOMENTS: u32 = 40;
/// … of the robot's clock, apart: an execution takes about 15 s.
const MOMENT_MS: f64 = 350.0;
/// How soon the robot has to latch, by its own clock: the time to live of a command, and room for two busy cores.
const LATCHES_WITHIN_MS: f64 = 5000.0;

/// How long the robot's link is cut: longer than a command lives, shorter than the network takes to give the link up.
const CUT: Duration = Duration::from_secs(4);

/// All services but the simulator's, which has a link of its own.
const OTHERS: [(Service, usize); 4] = [(Service::Perception, 1), (Service::Inference, 1), (Service::Planner, 1), (Service::Motion, 1)];

/// A cell with one robot, and what is asked of it.
struct Trial {
    deployment: Deployment,
    /// The robot's, and its camera's.
    link: Link,
    session: Session,
}

impl Trial {
    async fn start() -> Self {
        Self::start_with(Deployment::start(&OTHERS).await).await
    }

    /// Where a commander that is lost is missed soon.
    async fn start_impatient() -> Self {
        Self::start_with(Deployment::start_impatient(&OTHERS).await).await
    }

    async fn start_with(mut deployment: Deployment) -> Self {
        let link = Link::to(deployment.endpoint());
        deployment.add_at(Service::Simulator, link.endpoint(), 1);
        let session = deployment.session().await;
        let trial = Self { deployment, link, session };
        trial.served(&[Service::Simulator]).await;
        trial
    }

    /// Waits for a worker of each service.
    async fn served(&self, services: &[Service]) {
        for service in services {
            self.session.caller(*service).await.expect("a caller").wait_for_workers(1, PATIENCE).await.expect("it is back");
        }
    }

    /// A fresh scene in front of a ready arm.
    async fn reset_world(&self, seed: u64) {
        let simulator = self.session.caller(Service::Simulator).await.expect("a caller");
        let request = Payload::json(&WorldResetRequest { seed }).expect("a request");
        let answer = simulator.call("reset", request, CallOptions::at_most_once(PATIENCE)).await.expect("a fresh scene");
        let truth: Truth = answer.payload.decode_json().expect("its truth");
        assert!(truth.objects.len() > 1);
        // A scene of a frame that was taken from now on shows the new world.
        let from_ns = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as u64);
        let give_up = Instant::now() + PATIENCE;
        while newest_scene(&self.session).await.stamp_ns < from_ns {
            assert!(Instant::now() < give_up, "the new scene is never seen");
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    }

    fn place(&self) -> Placing {
        let mut command = self.deployment.command();
        command.args(["--json", "place", "--connect", self.deployment.endpoint(), "--move", "1", "--goal", "behind:2"]);
        command.args(["--variant", "geometric", "--execute"]).stdout(Stdio::piped()).stderr(Stdio::piped());
        Placing(Some(Process(command.spawn().expect("place starts"))))
    }

    fn robot(&self, action: &str) -> Output {
        let mut command = self.deployment.command();
        command.args(["--json", "robot", action, "--connect", self.deployment.endpoint()]);
        command.output().expect("the program runs")
    }

    /// The first state of the robot of which something holds.
    async fn state_where(&self, what: &str, mut holds: impl FnMut(&RobotState) -> bool) -> RobotState {
        let mut states = self.session.subscribe_latest(&self.session.cell().robot_state("panda")).await.expect("states");
        let (mut last, mut heard, mut heard_at, mut silence) = (None, 0, Instant::now(), Duration::ZERO);
        let found = tokio::time::timeout(PATIENCE, async {
            while let Some(sample) = states.recv().await {
                let state: RobotState = sample.payload.decode_json().expect("a state");
                (heard, silence) = (heard + 1, silence.max(heard_at.elapsed()));
                heard_at = Instant::now();
                if holds(&state) {
                    return Some(state);
                }
                last = Some(state);
            }
            None
        });
        match found.await {
            Ok(Some(state)) => state,
            _ => panic!("never {what} in {heard} states, at most {silence:?} apart: {last:?}"),
        }
    }

    async fn executing(&self, placing: &mut Placing) -> RobotState {
        placing.comes_to(self.state_where("executing", |state| state.open_task().is_some())).await
    }

    /// An arm that carries something.
    async fn carrying(&self, placing: &mut Placing) -> RobotState {
        let is_carrying = |state: &RobotState| state.gripper_holding && state.mode == RobotMode::Moving && state.open_task().is_some();
        placing.comes_to(self.state_where("carrying", is_carrying)).await
    }

    async fn latched(&self) -> RobotState {
        let mut first_ms = None;
        let is_latched = |state: &RobotState| {
            first_ms = first_ms.or(Some(state.robot_ms));
            state.mode == RobotMode::Stopped
        };
        let state = self.state_where("latched", is_latched).await;
        // A robot's side that waits for a core is late by every clock but its own, by which it misses its commander.
        let took_ms = first_ms.map_or(0.0, |first_ms| state.robot_ms - first_ms);
        assert!(took_ms < LATCHES_WITHIN_MS, "it took {took_ms} ms to latch");
        self.state_where("at rest", |state| state.mode == RobotMode::Stopped && state.dq_rad_s.iter().all(|v| *v == 0.0)).await;
        state
    }

    /// At rest after an outage: latched, or with its task closed and nothing in its hand, so that there is nothing to bring back: where motion
    /// reached the robot again before that missed it, or had just finished. Whether it is latched.
    async fn safe(&self) -> bool {
        let is_safe = |state: &RobotState| {
            let is_closed = state.mode == RobotMode::Idle && state.open_task().is_none() && !state.gripper_holding;
            (state.mode == RobotMode::Stopped || is_closed) && state.dq_rad_s.iter().all(|v| *v == 0.0)
        };
        self.state_where("safe", is_safe).await.mode == RobotMode::Stopped
    }

    /// Cuts the robot's link for a while.
    async fn cut_off(&self) {
        self.link.cut();
        tokio::time::sleep(CUT).await;
        self.link.mend();
    }

    /// What an operator does to a latched robot.
    async fn brought_back(&self) {
        let refused = self.robot("home");
        assert!(!refused.status.success() && said(&refused).contains("reset"), "{}", said(&refused));
        for action in ["reset", "open", "retreat", "home"] {
            // In free space there may be no room behind the hand, or no need for it.
            let is_optional = action == "retreat";
            // What is refused moves nothing, and an operator asks again: nothing may have been seen yet since services came back, or not in time.
            let give_up = Instant::now() + PATIENCE;
            loop {
                let output = self.robot(action);
                if output.status.success() || is_optional {
                    break;
                }
                assert!(Instant::now() < give_up, "{action}: {}", said(&output));
                println!("{action} is asked again: {}", said(&output));
                tokio::time::sleep(Duration::from_millis(500)).await;
            }
        }
        let state = self.state_where("ready", |state| state.mode == RobotMode::Idle).await;
        assert!(!state.gripper_holding && state.open_task().is_none(), "{state:?}");
    }
}

/// `place --execute` on its way.
struct Placing(Option<Process>);

impl Placing {
    /// What it should bring about; fails with what it says where it ends before that.
    async fn comes_to<T>(&mut self, awaited: impl Future<Output = T>) -> T {
        tokio::pin!(awaited);
        loop {
            tokio::select! {
                found = &mut awaited => return found,
                () = tokio::time::sleep(Duration::from_millis(100)) => {}
            }
            if self.0.as_mut().is_some_and(|process| process.0.try_wait().expect("a process").is_some()) {
                panic!("over too soon: {:?}", Placing(self.0.take()).ended());
            }
        }
    }

    fn signal(&self, signal: i32) {
        if let Some(process) = &self.0 {
            process.signal(signal);
        }
    }

    /// Its exit code and what it printed, once it ends.
    fn ended(mut self) -> (Option<i32>, Value, String) {
        let Some(mut process) = self.0.take() else { unreachable!("it is taken once") };
        let child: &mut Child = &mut process.0;
        let read = |from: Option<&mut dyn std::io::Read>| {
            let mut text = String::new();
            from.map_or(Ok(0), |from| from.read_to_string(&mut text)).expect("text");
            text
        };
        let printed = read(child.stdout.as_mut().map(|s| s as &mut dyn std::io::Read));
        let log = read(child.stderr.as_mut().map(|s| s as &mut dyn std::io::Read));
        let status = child.wait().expect("it ends");
        (status.code(), serde_json::from_str(&printed).unwrap_or(Value::Null), log)
    }
}

fn said(output: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}

#[tokio::test(flavor = "multi_thread")]
async fn a_robot_that_carries_something_latches_when_its_commander_is_lost_and_is_brought_back() {
    let mut trial = Trial::start_impatient().await;
    trial.reset_world(1).await;
    let mut placing = trial.place();
    let state = trial.carrying(&mut placing).await;
    assert_eq!(state.held.as_ref().map(|held| held.object), Some(1), "it says what it holds");
    trial.deployment.kill(Service::Motion);
    let state = trial.latched().await;
    assert!(state.gripper_holding && state.stop.is_some_and(|stop| stop.kind == "commander_silent"));
    assert_ne!(placing.ended().0, Some(0), "nobody takes it for done");
    trial.deployment.add(Service::Motion);
    trial.served(&[Service::Motion]).await;
    trial.brought_back().await;

    trial.reset_world(2).await;
    let mut placing = trial.place();
    trial.carrying(&mut placing).await;
    trial.deployment.kill_router();
    assert_ne!(placing.ended().0, Some(0), "nobody takes it for done");
    trial.deployment.start_router();
    trial.session = trial.deployment.session().await;
    trial.latched().await;
    trial.served(&[Service::Motion, Service::Perception]).await;
    trial.brought_back().await;

    trial.reset_world(3).await;
    let mut placing = trial.place();
    trial.carrying(&mut placing).await;
    trial.cut_off().await;
    // Set-points that were on their way all the while arrive now, and move nothing.
    let state = trial.latched().await;
    assert!(state.stop.is_some_and(|stop| stop.kind == "commander_silent"));
    assert_ne!(placing.ended().0, Some(0), "nobody takes it for done");
    trial.brought_back().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn an_interrupted_or_killed_client_stops_the_robot_and_other_deaths_do_not() {
    let mut trial = Trial::start().await;
    trial.reset_world(1).await;
    let mut placing = trial.place();
    trial.executing(&mut placing).await;
    for service in [Service::Planner, Service::Inference, Service::Perception] {
        trial.deployment.kill(service);
    }
    let state = trial.state_where("done with its task", |state| state.open_task().is_none()).await;
    assert_eq!(state.mode, RobotMode::Idle, "the execution went on to its end: {:?}", state.stop);
    placing.signal(libc::SIGKILL);
    for service in [Service::Planner, Service::Inference, Service::Perception] {
        trial.deployment.add(service);
    }
    trial.served(&[Service::Planner, Service::Inference, Service::Perception]).await;

    // Ctrl-C: on the path, and with an object in its hand it latches.
    trial.reset_world(2).await;
    let mut placing = trial.place();
    trial.carrying(&mut placing).await;
    placing.signal(libc::SIGINT);
    let (code, document, log) = placing.ended();
    assert_eq!(code, Some(1), "{document} {log}");
    let message = document["error"]["message"].as_str().unwrap_or_default();
    assert!(message.contains("interrupted") && message.contains("holds object 1") && message.contains("repose robot reset"), "{document}");
    let state = trial.latched().await;
    assert_eq!(state.stop.map(|stop| stop.kind), Some("task_unfinished".to_owned()));
    trial.brought_back().await;

    // Twice: the emergency stop.
    trial.reset_world(3).await;
    let mut placing = trial.place();
    trial.executing(&mut placing).await;
    trial.state_where("moving", |state| state.mode == RobotMode::Moving).await;
    placing.signal(libc::SIGINT);
    // Two signals that arrive together are one.
    tokio::time::sleep(Duration::from_millis(20)).await;
    placing.signal(libc::SIGINT);
    let (code, document, _) = placing.ended();
    assert_eq!(code, Some(1), "{document}");
    let state = trial.state_where("at rest", |state| state.mode != RobotMode::Moving).await;
    if document["error"]["message"].as_str().is_some_and(|message| message.contains("twice")) {
        assert_eq!(state.stop.map(|stop| stop.kind), Some("estop".to_owned()));
        trial.brought_back().await;
    }

    // A client that dies is missed.
    trial.reset_world(1).await;
    let mut placing = trial.place();
    trial.carrying(&mut placing).await;
    placing.signal(libc::SIGKILL);
    let state = trial.latched().await;
    assert_eq!(state.stop.map(|stop| stop.kind), Some("task_unfinished".to_owned()));
    trial.brought_back().await;
}

#[tokio::test(flavor = "multi_thread")]
#[ignore = "a quarter of an hour: a process dies, or the robot's link is cut, at each of 40 moments of an execution; run it with --ignored after changes to motion or the robot's side"]
async fn whenever_the_commander_is_lost_the_robot_latches_and_is_brought_back() {
    let mut trial = Trial::start_impatient().await;
    for moment in 0..MOMENTS {
        trial.reset_world(1 + u64::from(moment % 3)).await;
        let mut placing = trial.place();
        let begun = trial.executing(&mut placing).await;
        let until_ms = begun.robot_ms + f64::from(moment) * MOMENT_MS;
        let state = trial.state_where("so far", |state| state.robot_ms >= until_ms).await;
        if state.open_task().is_none() {
            assert_eq!(placing.ended().0, Some(0), "over before the moment came");
            continue;
        }
        match moment % 3 {
            0 => {
                trial.deployment.kill(Service::Motion);
                trial.deployment.add(Service::Motion);
            }
            1 => {
                trial.deployment.kill_router();
                trial.deployment.start_router();
                trial.session = trial.deployment.session().await;
            }
            _ => trial.cut_off().await,
        }
        let is_latched = trial.safe().await;
        let ended = placing.ended().0;
        assert!(!is_latched || ended != Some(0), "moment {moment}: nobody takes it for done");
        trial.served(&[Service::Motion, Service::Perception, Service::Simulator]).await;
        if is_latched {
            trial.brought_back().await;
        }
        println!("moment {moment}: {}", if is_latched { "latched and brought back" } else { "closed with an empty hand" });
    }
}
