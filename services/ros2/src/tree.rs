//! The frames of the ROS system, followed: `/tf` and `/tf_static`, shared by cameras and robots.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use nalgebra::Isometry3;
use repose_ros_messages::TfMessage;
use tokio::sync::watch;

use crate::error::BridgeError;
use crate::node::{Node, RosSubscription};
use crate::report::Reports;
use crate::transforms::Transforms;
use crate::wire::names::Qos;

/// How many messages may wait.
const MOVING: Qos = Qos { depth: 100, ..Qos::DEFAULT };

/// The frames, shared. Cheap to clone.
#[derive(Clone, Default)]
pub struct Tree {
    transforms: Arc<Mutex<Transforms>>,
    changed: watch::Sender<u64>,
}

/// What tells of the frames.
pub struct TreeSource {
    moving: RosSubscription<TfMessage>,
    fixed: RosSubscription<TfMessage>,
}

impl TreeSource {
    /// Subscribes, fixed transforms of before included.
    ///
    /// # Errors
    /// When the network refuses.
    pub async fn of(node: &Node) -> Result<Self, BridgeError> {
        let name = "tf2_msgs/msg/TFMessage";
        Ok(Self { moving: node.subscribe("/tf", name, MOVING).await?, fixed: node.subscribe("/tf_static", name, Qos::KEPT).await? })
    }

    /// Takes what comes until the session closes; `publishers` tells whenever somebody has come.
    ///
    /// # Errors
    /// When the network refuses.
    pub async fn run(mut self, tree: Tree, mut publishers: watch::Receiver<u64>, reports: Reports) -> Result<(), BridgeError> {
        loop {
            let (message, is_static) = tokio::select! {
                message = self.moving.recv() => (message, false),
                message = self.fixed.recv() => (message, true),
                changed = publishers.changed() => {
                    if changed.is_err() {
                        return Ok(());
                    }
                    // One that has come may have told before it was seen.
                    self.fixed.recall().await?;
                    continue;
                }
            };
            match message {
                None => return Ok(()),
                Some(Err(error)) => reports.warn("tf", "message", error.to_string()),
                Some(Ok(message)) => {
                    let mut held = tree.held();
                    let refused = message.transforms.iter().filter(|told| !held.take(told, is_static)).count();
                    drop(held);
                    tree.changed.send_modify(|count| *count += 1);
                    if refused > 0 {
                        reports.warn("tf", "transforms", format!("{refused} transforms are no rigid motions between two frames"));
                    }
                }
            }
        }
    }
}

impl Tree {
    /// The frames now.
    pub fn held(&self) -> MutexGuard<'_, Transforms> {
        self.transforms.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Tells whenever transforms have come.
    pub fn changes(&self) -> watch::Receiver<u64> {
        self.changed.subscribe()
    }

    /// Where a frame that does not move is in another; none while nobody has said.
    pub fn newest(&self, to: &str, of: &str) -> Option<Isometry3<f64>> {
        self.held().lookup(to, of, u64::MAX).ok()
    }
}
