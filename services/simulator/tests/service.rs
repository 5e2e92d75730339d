//! The cell as others see it: frames and states come, commands move the arm, stops latch, `reset` and `truth` answer.

use std::time::Duration;

use repose_panda::READY;
use repose_proto::robot::{EmergencyStop, Owner, RobotCommand, RobotMode, RobotState, SetPoint};
use repose_proto::simulator::{Truth, TruthRequest, WorldResetRequest};
use repose_proto::{Frame, Payload, Service};
use repose_runtime::{CallOptions, Caller, Session, Shutdown, Subscription, Traffic, emergency_stop};
use repose_simulator::{SimulatorConfig, run};

const PATIENCE: Duration = Duration::from_secs(20);

async fn state_where(states: &mut Subscription, what: &str, holds: impl Fn(&RobotState) -> bool) -> RobotState {
    let found = async {
        loop {
            let sample = states.recv().await.expect("states go on");
            let state: RobotState = sample.payload.decode_json().expect("a state");
            if holds(&state) {
                return state;
            }
        }
    };
    tokio::time::timeout(PATIENCE, found).await.unwrap_or_else(|_| panic!("no state {what}"))
}

async fn truth(caller: &Caller) -> Truth {
    let request = Payload::json(&TruthRequest::default()).expect("small");
    caller.call("truth", request, CallOptions::within(PATIENCE)).await.expect("answered").payload.decode_json().expect("a truth")
}

/// Joint 0 to `to_rad` in a second and back, in one stream.
fn swing(seq: u64) -> RobotCommand {
    let point = |k: usize| {
        let s = k as f64 / 100.0;
        let mut point = SetPoint { t_ms: k as f64 * 20.0, q_rad: READY, dq_rad_s: [0.0; 7] };
        let turn = std::f64::consts::TAU * s;
        point.q_rad[0] += 0.2 * (1.0 - turn.cos());
        point.dq_rad_s[0] = 0.2 * turn.sin() * std::f64::consts::PI;
        point
    };
    RobotCommand {
        v: 1,
        seq,
        owner: Owner { id: "test".to_owned(), epoch: 1 },
        ttl_ms: 10_000,
        starts_stream: true,
        ends_stream: true,
        set_points: (0..=100).map(point).collect(),
        gripper: None,
        clear_stop: false,
        clears: None,
        task: None,
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_cell_serves_frames_states_commands_stops_and_truth() {
    let session = Session::embedded().await.expect("a session");
    let shutdown = Shutdown::new();
    let config = SimulatorConfig { seed: 3, ..SimulatorConfig::default() };
    let mut states = session.subscribe_latest(&session.cell().robot_state(&config.robot)).await.expect("subscribed");
    let mut frames = session.subscribe_latest(&session.cell().camera_frame(&config.camera)).await.expect("subscribed");
    let (command_key, stop_key) = (session.cell().robot_command(&config.robot), session.cell().robot_estop(&config.robot));
    let served = tokio::spawn(run(session.clone(), config.clone(), shutdown.clone()));

    let sample = tokio::time::timeout(PATIENCE, frames.recv()).await.expect("in time").expect("a frame");
    let frame = Frame::from_bulk(&sample.payload.decode_bulk(Frame::SCHEMA).expect("bulk")).expect("a frame");
    assert_eq!((frame.camera.width, frame.camera.height), (640, 480));
    let caller = session.caller(Service::Simulator).await.expect("a caller");
    let before = truth(&caller).await;
    let labels = frame.labels.expect("labels");
    for object in &before.objects {
        assert!(labels.iter().filter(|l| **l == object.id).count() > 50, "object {} can be seen", object.id);
    }
    assert_eq!(before.relations.len(), before.objects.len() * (before.objects.len() - 1));

    session.put(&command_key, Payload::json(&swing(1)).expect("small"), Traffic::RobotCommand).await.expect("put");
    state_where(&mut states, "that moves", |s| s.mode == RobotMode::Moving && s.q_rad[0] > 0.3).await;
    let ended = state_where(&mut states, "that ended", |s| s.mode == RobotMode::Idle && s.last_command == Some(1)).await;
    assert!(ended.q_rad[0].abs() < 1e-6 && ended.stop.is_none());

    session.put(&command_key, Payload::json(&swing(2)).expect("small"), Traffic::RobotCommand).await.expect("put");
    state_where(&mut states, "that moves again", |s| s.mode == RobotMode::Moving).await;
    let stop = EmergencyStop { v: 1, id: "stop-1".to_owned(), source: "test".to_owned(), reason: "enough".to_owned(), stamp_ns: 0 };
    session.put(&stop_key, Payload::json(&stop).expect("small"), Traffic::EmergencyStop).await.expect("put");
    let stopped = state_where(&mut states, "that is stopped", |s| s.mode == RobotMode::Stopped && s.dq_rad_s == [0.0; 7]).await;
    assert_eq!(stopped.stop.and_then(|s| s.estop_id).as_deref(), Some("stop-1"));

    // Others who stop it too, at the same time: each sees a stop of its own, and what clears the first clears none of them.
    let both =
        async { tokio::join!(emergency_stop(&session, &config.robot, "a", "too"), emergency_stop(&session, &config.robot, "b", "too")) };
    let (a, b) = tokio::time::timeout(PATIENCE, both).await.expect("neither waits for ever");
    let [a, b] = [a, b].map(|shown| shown.expect("stopped").stop.and_then(|stop| stop.estop_id));
    assert!(a != b && a.as_deref() != Some("stop-1") && b.as_deref() != Some("stop-1"), "{a:?} {b:?}");

    let request = Payload::json(&WorldResetRequest { seed: 4 }).expect("small");
    let answer = caller.call("reset", request, CallOptions::within(PATIENCE)).await.expect("answered");
    let after: Truth = answer.payload.decode_json().expect("a truth");
    assert!(after.seed == 4 && after.objects != before.objects);
    let still = state_where(&mut states, "after the reset", |s| s.q_rad == READY).await;
    assert_eq!(still.mode, RobotMode::Stopped, "a new scene does not clear a latched stop");

    // Whatever is put on the stop's key latches, and says what could be read of it.
    let json = br#"{"id": "stop-2", "source": "panel", "reason": "button", "colour": "red"}"#;
    for (seq, bytes, id) in [(3, &b""[..], None), (4, &json[..], Some("stop-2"))] {
        let clear = RobotCommand { seq, clear_stop: true, starts_stream: false, ends_stream: false, set_points: Vec::new(), ..swing(seq) };
        session.put(&command_key, Payload::json(&clear).expect("small"), Traffic::RobotCommand).await.expect("put");
        state_where(&mut states, "that is ready again", |s| s.mode == RobotMode::Idle).await;
        let stop = Payload { encoding: "zenoh/bytes".to_owned(), bytes: bytes.to_vec().into() };
        session.put(&stop_key, stop, Traffic::EmergencyStop).await.expect("put");
        let stopped = state_where(&mut states, "that is stopped by anything", |s| s.mode == RobotMode::Stopped).await.stop.expect("a stop");
        assert_eq!(stopped.kind, "estop");
        assert!(id.is_none_or(|id| stopped.estop_id.as_deref() == Some(id)), "{stopped:?}");
    }

    shutdown.trigger();
    served.await.expect("joined").expect("served");
    session.close().await.expect("closed");
}
