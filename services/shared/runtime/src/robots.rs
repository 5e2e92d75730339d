//! What every client that moves a robot does alike: hear its state, call with a token that says the caller is there, and stop it.

use std::collections::BTreeSet;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use repose_proto::place::ReachingRobot;
use repose_proto::robot::{EmergencyStop, PANDA_LIKE, RobotState};
use repose_proto::{CallError, ErrorCode, Message, Payload, keys, limits};

use crate::{Answer, CallOptions, Caller, Sample, Session, Traffic};

/// Between two puts of an emergency stop.
const REPEAT: Duration = Duration::from_millis(20);
/// After so long another's emergency stop that a state shows will do: a robot's side may keep showing the first.
const ANOTHERS: Duration = Duration::from_secs(1);
/// Faults of robots' states that a process says: whoever may tell states may do so under any number of names.
const FAULTS_SAID: usize = 256;

/// The state that a robot's side has told: all that hear of robots read it here. One that cannot be read, or that no robot can be in, counts as if
/// nothing had been told. That is said once for each robot and field, for states come up to a thousand times a second.
///
/// # Errors
/// What is wrong with it, on the field at fault.
pub fn read_robot_state(sample: &Sample) -> Result<RobotState, CallError> {
    sample.payload.decode_json::<RobotState>().inspect_err(|error| {
        let field = error.field.as_deref().unwrap_or_default();
        if is_first_fault(&sample.key, field) {
            let robot = keys::worker_of(&sample.key).unwrap_or_default();
            tracing::warn!(robot, field, why = error.message, "what this robot tells of itself counts as nothing, which is said once");
        }
    })
}

/// A state with whatever numbers it has.
#[derive(serde::Deserialize)]
#[serde(transparent)]
struct Unchecked(RobotState);

impl Message for Unchecked {
    const SCHEMA: &'static str = RobotState::SCHEMA;
}

/// As [`read_robot_state`], for those who go by whether a robot moves or is stopped: that counts also beside a number that no robot can have. A hand
/// whose sensor has failed hides neither a stop nor an arm that moves.
///
/// # Errors
/// What is wrong with a state that cannot be read at all.
pub fn read_robot_mode(sample: &Sample) -> Result<RobotState, CallError> {
    read_robot_state(sample).or_else(|_| sample.payload.decode_json::<Unchecked>().map(|told| told.0))
}

fn is_first_fault(key: &str, field: &str) -> bool {
    static SAID: Mutex<BTreeSet<(String, String)>> = Mutex::new(BTreeSet::new());
    let mut said = SAID.lock().unwrap_or_else(PoisonError::into_inner);
    said.len() < FAULTS_SAID && said.insert((key.to_owned(), field.to_owned()))
}

/// How long a robot may take to tell its state where nothing says that it is not there. States come twenty times a second or more often, but on a machine
/// that has too much to do they are late by seconds, and whoever gave up sooner would say that there is no robot.
pub const STATE_WITHIN: Duration = Duration::from_secs(10);

/// What a robot says of itself next that can be read.
///
/// # Errors
/// `unavailable` on `robot` when it says no such thing in time: what a robot's side says is no fault of whoever asks.
pub async fn robot_state(session: &Session, robot: &str, within: Duration) -> Result<RobotState, CallError> {
    let mut states = session.subscribe_latest(&session.cell().robot_state(robot)).await?;
    let mut unread = None;
    let readable = async {
        loop {
            match read_robot_state(&states.recv().await.ok_or_else(closed)?) {
                Ok(state) => return Ok::<_, CallError>(state),
                Err(error) => unread = Some(error),
            }
        }
    };
    let told = tokio::time::timeout(within, readable).await;
    told.unwrap_or_else(|_| {
        let silent = || format!("robot {robot} does not tell its state");
        let message = unread.map_or_else(silent, |error| format!("robot {robot} tells no state that can be read: {error}"));
        Err(CallError::new(ErrorCode::Unavailable, message).at("robot"))
    })
}

/// How long it is listened for another driver of the same robot: states come twenty times a second or more often.
const LISTEN: Duration = Duration::from_millis(300);

/// Listens whether another driver tells the state of a robot: two of them would move it against each other.
///
/// # Errors
/// `failed_precondition` on `name` when there is one.
pub async fn refuse_a_second_driver(session: &Session, robot: &str) -> Result<(), CallError> {
    let mut others = session.subscribe_latest(&session.cell().robot_state(robot)).await?;
    if tokio::time::timeout(LISTEN, others.recv()).await.is_err() {
        return Ok(());
    }
    let message = format!("another driver tells the state of robot {robot} in this cell: end it, or take another name");
    Err(CallError::precondition(message).at("name"))
}

/// A robot whose reach is to be a constraint: one that tells where its base stands, and whose reach is known.
pub fn reaching_robot(robot: &str, state: &RobotState) -> Option<ReachingRobot> {
    let is_known = state.model.as_deref().is_none_or(|model| PANDA_LIKE.contains(&model));
    let pose = state.world_from_base.filter(|_| is_known)?;
    Some(ReachingRobot { name: robot.to_owned(), world_from_base: Some(pose) })
}

/// Calls a method that moves a robot, at most once, whatever `options` say of that. Meanwhile a liveliness token says that this process is
/// there: where it dies, the motion service does what it is configured to (`on_client_loss`).
///
/// # Errors
/// Those of [`Caller::call`].
pub async fn call_moving(
    session: &Session,
    motion: &Caller,
    method: &str,
    payload: Payload,
    options: CallOptions,
) -> Result<Answer, CallError> {
    let id = options.id.clone().unwrap_or_else(|| uuid::Uuid::new_v4().to_string());
    let _alive = session.transport().declare_alive(&session.cell().live_client(&id)).await?;
    motion.call(method, payload, CallOptions { id: Some(id), idempotent: false, ..options }).await
}

/// Puts an emergency stop until a state shows it. One that was latched before does not do at first, for whoever clears that does not know of this
/// one: a robot's side of ours shows the newest that it was put, so of several senders each is shown in its turn. Another side may go on showing the
/// first; it is stopped all the same. Does not end before that: bound it in time.
///
/// # Errors
/// When the network refuses.
pub async fn emergency_stop(session: &Session, robot: &str, source: &str, reason: &str) -> Result<RobotState, CallError> {
    let mut states = session.subscribe_latest(&session.cell().robot_state(robot)).await?;
    let (id, source, reason) = (uuid::Uuid::new_v4().to_string(), source.to_owned(), reason.to_owned());
    let wanted = Payload::json(&EmergencyStop { v: limits::VERSION, id: id.clone(), source, reason, stamp_ns: now_ns() })?;
    let key = session.cell().robot_estop(robot);
    let (mut again, began) = (tokio::time::interval(REPEAT), tokio::time::Instant::now());
    loop {
        tokio::select! {
            _ = again.tick() => session.put(&key, wanted.clone(), Traffic::EmergencyStop).await?,
            sample = states.recv() => {
                // What cannot be read shows nothing.
                let Ok(state) = read_robot_mode(&sample.ok_or_else(closed)?) else { continue };
                let shown = state.stop.as_ref().and_then(|stop| stop.estop_id.as_ref());
                if shown == Some(&id) || (shown.is_some() && began.elapsed() > ANOTHERS) {
                    return Ok(state);
                }
            }
        }
    }
}

/// Puts an emergency stop until a state shows it, and no longer than `within`. It goes on when whoever waits for it is gone: a server drops what
/// it does for a client whose connection is lost, and a stop is not to end with that.
///
/// # Errors
/// `deadline_exceeded` when the robot has not shown it in time; as [`emergency_stop`].
pub async fn emergency_stop_within(
    session: &Session,
    robot: &str,
    source: &str,
    reason: &str,
    within: Duration,
) -> Result<RobotState, CallError> {
    let (session, robot, source, reason) = (session.clone(), robot.to_owned(), source.to_owned(), reason.to_owned());
    let stopping = tokio::spawn(async move {
        let unheard = |_| {
            let message = format!("robot {robot} has not shown the stop in {} ms", within.as_millis());
            CallError::new(ErrorCode::DeadlineExceeded, message)
        };
        tokio::time::timeout(within, emergency_stop(&session, &robot, &source, &reason)).await.map_err(unheard)?
    });
    stopping.await.map_err(|e| CallError::internal(format!("the stop was lost: {e}")))?
}

/// The time of day as messages are stamped with, nanoseconds since the Unix epoch.
pub fn now_ns() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as u64)
}

fn closed() -> CallError {
    CallError::new(ErrorCode::Unavailable, "the session has closed")
}

#[cfg(test)]
mod tests {
    use repose_proto::robot::RobotMode;

    use super::*;

    #[tokio::test(flavor = "multi_thread")]
    async fn a_stop_goes_on_when_whoever_asked_for_it_is_gone_and_ends_in_its_time() {
        let session = Session::embedded().await.expect("a session");
        let mut stops = session.subscribe_queue(&session.cell().robot_estop("panda"), 256).await.expect("a subscription");
        // It tells no state: the stop is put until its time is over, long after this test.
        let within = Duration::from_secs(20);
        let mut asked = Box::pin(emergency_stop_within(&session, "panda", "a test", "now", within));
        tokio::select! {
            biased;
            ended = &mut asked => panic!("nobody shows the stop: {ended:?}"),
            first = stops.recv() => assert!(first.is_some(), "a first put"),
        }
        drop(asked);
        for _ in 0..20 {
            let next = tokio::time::timeout(within, stops.recv()).await;
            assert!(matches!(next, Ok(Some(_))), "the stop has ended with whoever asked for it");
        }
        let unheard = emergency_stop_within(&session, "panda", "a test", "now", Duration::from_millis(50)).await;
        assert_eq!(unheard.expect_err("nobody shows it").code, ErrorCode::DeadlineExceeded);
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_state_that_cannot_be_read_is_the_robots_fault_and_not_that_of_whoever_asks() {
        let session = Session::embedded().await.expect("a session");
        let states = session.publisher(session.cell().robot_state("panda"), Traffic::RobotState);
        let encoding = "application/json;repose.RobotState.v1".to_owned();
        let of_later = Payload { encoding, bytes: br#"{"v": 1, "mode": "dancing"}"#.to_vec().into() };
        let telling = tokio::spawn(async move {
            loop {
                states.put(of_later.clone()).await.expect("put");
                tokio::time::sleep(REPEAT).await;
            }
        });
        let refused = robot_state(&session, "panda", 25 * REPEAT).await.expect_err("nobody can read it");
        telling.abort();
        assert_eq!((refused.code, refused.field.as_deref()), (ErrorCode::Unavailable, Some("robot")), "{refused}");
    }

    #[test]
    fn a_state_that_no_robot_can_be_in_counts_as_none_and_is_said_once() {
        let still = [0.0; 7];
        let state = |width_m: f64| {
            let state = serde_json::json!({
                "v": 1, "seq": 0, "stamp_ns": 0, "robot_ms": 0.0, "q_rad": still, "dq_rad_s": still, "gripper_width_m": width_m,
                "gripper_settled": true, "gripper_holding": false, "mode": "idle"
            });
            let encoding = "application/json;repose.RobotState.v1".to_owned();
            let payload = Payload { encoding, bytes: state.to_string().into_bytes().into() };
            Sample { key: "repose/v1/cell/robot/in-millimetres/state".to_owned(), payload }
        };
        assert_eq!(read_robot_state(&state(0.08)).expect("a state").gripper_width_m, 0.08);
        for _ in 0..3 {
            let refused = read_robot_state(&state(80.0)).expect_err("no hand opens so far");
            assert_eq!(refused.field.as_deref(), Some("gripper_width_m"), "{refused}");
        }
        assert_eq!(read_robot_mode(&state(80.0)).expect("it says what it does").mode, RobotMode::Idle);
        let key = state(80.0).key;
        assert!(!is_first_fault(&key, "gripper_width_m"), "that is said already");
        assert!(is_first_fault(&key, "q_rad[1]") && is_first_fault("repose/v1/cell/robot/another/state", "gripper_width_m"));
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_stop_is_seen_beside_a_width_that_no_hand_has() {
        let session = Session::embedded().await.expect("a session");
        let states = session.publisher(session.cell().robot_state("panda"), Traffic::RobotState);
        let mut stops = session.subscribe_queue(&session.cell().robot_estop("panda"), 256).await.expect("a subscription");
        let telling = tokio::spawn(async move {
            let still = [0.0; 7];
            while let Some(sample) = stops.recv().await {
                let stop = EmergencyStop::read(&sample.payload.bytes);
                let state = serde_json::json!({
                    "v": 1, "seq": 0, "stamp_ns": 0, "robot_ms": 0.0, "q_rad": still, "dq_rad_s": still, "gripper_width_m": -1.0,
                    "gripper_settled": true, "gripper_holding": false, "mode": "stopped",
                    "stop": {"kind": "estop", "reason": stop.reason, "estop_id": stop.id}
                });
                let state = serde_json::from_value::<RobotState>(state).expect("a state");
                states.put(Payload::json(&state).expect("encoded")).await.expect("put");
            }
        });
        let state = emergency_stop_within(&session, "panda", "a test", "now", 10 * ANOTHERS).await.expect("it is stopped");
        telling.abort();
        assert_eq!(state.mode, RobotMode::Stopped);
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_side_that_goes_on_showing_the_first_stop_is_stopped_by_the_second_too() {
        let session = Session::embedded().await.expect("a session");
        let states = session.publisher(session.cell().robot_state("panda"), Traffic::RobotState);
        let mut stops = session.subscribe_queue(&session.cell().robot_estop("panda"), 256).await.expect("a subscription");
        let still = [0.0; 7];
        let first = serde_json::json!({
            "v": 1, "seq": 0, "stamp_ns": 0, "robot_ms": 0.0, "q_rad": still, "dq_rad_s": still, "gripper_width_m": 0.04, "gripper_settled": true,
            "gripper_holding": false, "mode": "stopped", "stop": {"kind": "estop", "reason": "first", "estop_id": "first"}, "owner": null,
            "last_command": null, "stream_ms": null
        });
        let first = Payload::json(&serde_json::from_value::<RobotState>(first).expect("a state")).expect("encoded");
        let telling = tokio::spawn(async move {
            loop {
                states.put(first.clone()).await.expect("put");
                tokio::time::sleep(REPEAT).await;
            }
        });
        let state = emergency_stop_within(&session, "panda", "a test", "now", 10 * ANOTHERS).await.expect("it is stopped");
        telling.abort();
        assert_eq!(state.stop.and_then(|stop| stop.estop_id).as_deref(), Some("first"));
        let mut puts = 0;
        while let Ok(Some(_)) = tokio::time::timeout(REPEAT, stops.recv()).await {
            puts += 1;
        }
        assert!(puts > 10, "it was put again and again before that: {puts}");
    }
}
