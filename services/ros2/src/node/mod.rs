//! A node of ROS 2, as others see it: endpoints with their tokens on a session that is not the cell's.

mod action;
mod endpoints;
mod graph;
mod service;

pub use action::{ALL_GOALS, ActionClient, ActionTypes, Canceled, GoalHandle, Heard};
pub use endpoints::{Node, RosPublisher, RosSubscription};
pub use graph::{Graph, mismatch};
pub use service::{RosClient, RosRequest, RosServer};
