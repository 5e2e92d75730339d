//! A cell joined to a ROS 2 system that speaks Zenoh (`rmw_zenoh`, Jazzy and later), without ROS installed.
//!
//! [`wire`] is that system's wire form: types and their hashes, keys, tokens, attachments. [`node`] is a node of it. [`camera`] makes frames of
//! a camera's topics, [`robot`] is the robot's side of the cell's keys for controllers of ROS, [`show`] publishes what the cell sees,
//! `services` is what ROS clients may ask for; a bridge that is to end waits for the `moves` that it has begun for them. Two sessions: the cell's, and
//! one on the ROS system's router.

pub mod camera;
mod config;
mod error;
pub mod node;
pub mod report;
pub mod robot;
mod services;
pub mod show;
pub mod transforms;
pub mod tree;
pub mod wire;

use std::sync::Arc;
use std::time::Duration;

use repose_ros_messages::DiagnosticArray;
use repose_runtime::{Moves, RuntimeError, Session, Shutdown, now_ns};
use tokio::sync::watch;
use tokio::task::{JoinError, JoinSet};

pub use config::{CameraConfig, RobotConfig, Ros2Config};
pub use error::BridgeError;

use config::is_packed;
use node::{Graph, Node, mismatch};
use report::Reports;
use tree::{Tree, TreeSource};
use wire::names::Qos;
use wire::token::EntityKind;
use wire::type_hash::type_named;

/// Between two diagnostics.
const DIAGNOSTICS: Duration = Duration::from_secs(1);
/// How long robots may take to come to rest.
const REST: Duration = Duration::from_secs(3);
/// How long closing may take.
const CLOSE: Duration = Duration::from_secs(2);

/// Runs the bridge until `shutdown`, and then until what it has robots do for clients of ROS is over, at most for `drain`. What others have an arm do
/// is canceled after that: nobody would be left to stop it.
///
/// # Errors
/// When the configuration is unusable, the ROS system's router cannot be reached, or a part of the bridge cannot go on.
pub async fn run(session: Session, config: Ros2Config, drain: Duration, shutdown: Shutdown) -> Result<(), BridgeError> {
    config.validate()?;
    let joined = Node::join(&config.session, config.domain, &config.namespace, &config.node).await;
    let node = joined.map_err(|error| match error {
        BridgeError::Runtime(refused @ RuntimeError::Transport { .. }) => BridgeError::RosSession(refused),
        other => other,
    })?;
    tracing::info!(domain = config.domain, node = config.node, "joined the ROS 2 system");
    let config = Arc::new(config);
    let (reports, tree) = (Reports::default(), Tree::default());
    let (come, publishers) = watch::channel(0);
    let (mut parts, mut robots, ending) = (JoinSet::new(), JoinSet::new(), Shutdown::new());
    let moves = Moves::of("the bridge");
    parts.spawn(TreeSource::of(&node).await?.run(tree.clone(), publishers, reports.clone()));
    parts.spawn(follow_graph(node.clone(), config.clone(), come, reports.clone()));
    parts.spawn(tell(node.clone(), reports.clone()));
    for camera in &config.cameras {
        parts.spawn(camera::link::run(session.clone(), node.clone(), config.clone(), camera.clone(), tree.clone(), reports.clone()));
        if config.publish_scenes {
            parts.spawn(show::link::run(session.clone(), node.clone(), config.clone(), camera.name.clone(), reports.clone()));
        }
    }
    for robot in &config.robots {
        let (tree, reports, ending) = (tree.clone(), reports.clone(), ending.clone());
        robots.spawn(robot::link::run(session.clone(), node.clone(), config.clone(), robot.clone(), tree, reports, ending));
    }
    if config.offer_services {
        parts.spawn(services::run(session.clone(), node.clone(), config.clone(), moves.clone()));
    }
    let ended = tokio::select! {
        () = end(&moves, drain, &shutdown) => Ok(()),
        // A part ends by itself only when it cannot go on, and half a bridge is none.
        Some(ended) = parts.join_next() => outcome(ended),
        Some(ended) = robots.join_next() => outcome(ended),
    };
    ending.trigger();
    bring_to_rest(robots).await;
    parts.shutdown().await;
    if let Err(error) = node.session().close(CLOSE).await {
        tracing::warn!(%error, "the ROS session did not close");
    }
    ended
}

/// Waits for the shutdown, and then for what was begun for clients of ROS.
async fn end(moves: &Moves, drain: Duration, shutdown: &Shutdown) {
    shutdown.requested().await;
    moves.ended(drain).await;
}

fn outcome(ended: Result<Result<(), BridgeError>, JoinError>) -> Result<(), BridgeError> {
    ended.unwrap_or_else(|failure| Err(repose_proto::CallError::internal(failure.to_string()).into()))
}

/// Waits for robots that are ending: a controller goes on with what it has, whether or not anybody is left to stop it.
async fn bring_to_rest(mut robots: JoinSet<Result<(), BridgeError>>) {
    let ends = async {
        while let Some(ended) = robots.join_next().await {
            if let Err(error) = outcome(ended) {
                tracing::warn!(%error, "a robot's part of the bridge ended");
            }
        }
    };
    if tokio::time::timeout(REST, ends).await.is_err() {
        tracing::warn!("a controller has not ended what it carries out: an arm may still move");
    }
    robots.shutdown().await;
}

/// Watches who comes and goes, and warns of ends of other types: nothing would come from them, and nobody would say why.
async fn follow_graph(node: Node, config: Arc<Ros2Config>, come: watch::Sender<u64>, reports: Reports) -> Result<(), BridgeError> {
    let expected = expected(&config);
    let mut graph = Graph::follow(&node).await?;
    let mut publishers = std::collections::BTreeSet::new();
    loop {
        let endpoints = graph.endpoints();
        for (part, kind, name, type_name) in &expected {
            // Beside what else there may be to say of the same topic.
            reports.standing(part, &format!("type of {name}"), mismatch(&endpoints, *kind, name, &type_named(type_name)?));
        }
        let now: std::collections::BTreeSet<_> =
            endpoints.into_iter().filter(|e| e.kind == EntityKind::Publisher && e.topic == "/tf_static").collect();
        if !now.is_subset(&publishers) {
            come.send_modify(|count| *count += 1);
        }
        publishers = now;
        if !graph.changed().await {
            return Ok(());
        }
    }
}

/// Which ends the configuration expects of others, and for which part of the bridge.
fn expected(config: &Ros2Config) -> Vec<(&str, EntityKind, String, &'static str)> {
    let picture = |topic: &str| if is_packed(topic) { "sensor_msgs/msg/CompressedImage" } else { "sensor_msgs/msg/Image" };
    let mut all = Vec::new();
    for camera in &config.cameras {
        let part = camera.name.as_str();
        let depth = camera.depth_source();
        all.push((part, EntityKind::Publisher, depth.topic().to_owned(), depth.type_name()));
        all.extend(camera.info.iter().map(|info| (part, EntityKind::Publisher, info.clone(), "sensor_msgs/msg/CameraInfo")));
        all.extend(camera.color.iter().map(|color| (part, EntityKind::Publisher, color.clone(), picture(color))));
    }
    for robot in &config.robots {
        let part = robot.name.as_str();
        all.push((part, EntityKind::Publisher, robot.joint_states.clone(), "sensor_msgs/msg/JointState"));
        let send = |action: &str| format!("{action}/_action/send_goal");
        all.push((part, EntityKind::Service, send(&robot.trajectory_action), node::ActionTypes::FOLLOW_JOINT_TRAJECTORY.send_goal));
        let hand = robot
            .gripper_action
            .iter()
            .map(|action| (part, EntityKind::Service, send(action), node::ActionTypes::GRIPPER_COMMAND.send_goal));
        all.extend(hand);
    }
    all
}

/// Publishes the reports.
async fn tell(node: Node, reports: Reports) -> Result<(), BridgeError> {
    let diagnostics = node.publisher::<DiagnosticArray>("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", Qos::DEFAULT).await?;
    let mut due = tokio::time::interval(DIAGNOSTICS);
    let name = node.own("").trim_matches('/').to_owned();
    loop {
        due.tick().await;
        diagnostics.publish(&reports.array(&name, now_ns())).await?;
    }
}
