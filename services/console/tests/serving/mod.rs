//! A console that serves a cell, and a viewer's socket to it.

use std::net::SocketAddr;
use std::time::Duration;

use futures::{SinkExt, StreamExt};
use repose_console::{Console, ConsoleConfig, ConsoleError};
use repose_proto::Payload;
use repose_proto::robot::{EmergencyStop, RobotMode, RobotState, StopState};
use repose_runtime::{Session, Shutdown, Traffic};
use serde_json::{Value, json};
use tokio::net::TcpStream;
use tokio::task::JoinHandle;
use tokio_tungstenite::tungstenite::client::IntoClientRequest;
use tokio_tungstenite::tungstenite::http::HeaderValue;
use tokio_tungstenite::tungstenite::{Error, Message};
use tokio_tungstenite::{MaybeTlsStream, WebSocketStream, connect_async};

/// How long anything may take.
pub const WITHIN: Duration = Duration::from_secs(20);

/// A console that runs until this is dropped.
pub struct Running {
    pub session: Session,
    pub address: SocketAddr,
    pub shutdown: Shutdown,
    pub serving: JoinHandle<Result<(), ConsoleError>>,
}

impl Running {
    /// Waits until it has ended.
    pub async fn ended(&mut self) {
        let served = tokio::time::timeout(WITHIN, &mut self.serving).await.expect("in time");
        served.expect("no panic").expect("served");
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.shutdown.trigger();
    }
}

pub async fn start(config: ConsoleConfig) -> Running {
    start_draining(config, WITHIN).await
}

/// One that waits so long for what it has robots do, when it is to end.
pub async fn start_draining(config: ConsoleConfig, drain: Duration) -> Running {
    let session = Session::embedded().await.expect("a session");
    let config = ConsoleConfig { listen: "127.0.0.1:0".parse().expect("an address"), ..config };
    let console = Console::open(session.clone(), config).await.expect("a console");
    let (address, shutdown) = (console.address(), Shutdown::new());
    let serving = tokio::spawn(console.serve(drain, shutdown.clone()));
    Running { session, address, shutdown, serving }
}

pub type Socket = WebSocketStream<MaybeTlsStream<TcpStream>>;

pub async fn socket(address: SocketAddr, headers: &[(&'static str, &str)]) -> Result<Socket, Error> {
    let mut request = format!("ws://{address}/socket").into_client_request()?;
    for (name, value) in headers {
        request.headers_mut().insert(*name, HeaderValue::from_str(value).expect("a header"));
    }
    Ok(connect_async(request).await?.0)
}

pub async fn ask(socket: &mut Socket, request: Value) {
    socket.send(Message::text(request.to_string())).await.expect("sent");
}

/// The first message that passes.
pub async fn heard(socket: &mut Socket, passes: impl Fn(&Value) -> bool) -> Value {
    let hearing = async {
        loop {
            let message = socket.next().await.expect("the socket is open").expect("a message");
            let Message::Text(text) = message else { continue };
            let value: Value = serde_json::from_str(&text).expect("JSON");
            if passes(&value) {
                return value;
            }
        }
    };
    tokio::time::timeout(WITHIN, hearing).await.expect("heard in time")
}

fn state(seq: u64, gripper_width_m: f64, stop: Option<&StopState>) -> RobotState {
    let mode = if stop.is_some() { RobotMode::Stopped } else { RobotMode::Idle };
    let still = [0.0; 7];
    serde_json::from_value(json!({
        "v": 1, "seq": seq, "stamp_ns": 0, "robot_ms": 0.0, "q_rad": repose_panda::READY, "dq_rad_s": still, "gripper_width_m": gripper_width_m,
        "gripper_settled": true, "gripper_holding": false, "mode": mode, "stop": stop, "owner": null, "last_command": null, "stream_ms": null
    }))
    .expect("a state")
}

/// A robot that tells its state and latches stops, until the session closes.
pub async fn robot(session: &Session) {
    robot_named(session, "panda", 0.04).await;
}

/// The same of any name, and with whatever it tells of its hand.
pub async fn robot_named(session: &Session, name: &str, gripper_width_m: f64) {
    let mut stops = session.subscribe_queue(&session.cell().robot_estop(name), 16).await.expect("a subscription");
    let states = session.publisher(session.cell().robot_state(name), Traffic::RobotState);
    tokio::spawn(async move {
        let (mut stop, mut tick) = (None, tokio::time::interval(Duration::from_millis(10)));
        for seq in 0.. {
            tokio::select! {
                _ = tick.tick() => {}
                Some(sample) = stops.recv() => {
                    let EmergencyStop { id, reason, .. } = EmergencyStop::read(&sample.payload.bytes);
                    stop = Some(StopState { kind: "estop".to_owned(), reason, estop_id: Some(id) });
                }
            }
            if states.put(Payload::json(&state(seq, gripper_width_m, stop.as_ref())).expect("encoded")).await.is_err() {
                return;
            }
        }
    });
}
