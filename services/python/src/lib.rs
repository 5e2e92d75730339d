//! The extension module behind the Python package `repose`: planning in this process, calls to a running system, the robot's side of a driver;
//! messages are JSON, arrays bytes.
//!
//! What people see (classes, types, documentation) is written in Python under `python/repose`; here is only what Python cannot do.
//! Long work runs without the interpreter lock. Every failure is a `CallError`, raised as `repose.ReposeError`.

#![allow(clippy::needless_pass_by_value, reason = "arguments come from Python as owned values")]

mod connection;
mod error;
mod frame;
mod models;
mod payload;
mod pending;
mod planning;
mod robot_side;
mod scene;
mod subscription;
mod threads;
mod waiting;

use pyo3::prelude::*;

/// The native part of `repose`; private.
#[pymodule]
mod _native {
    #[pymodule_export]
    use super::connection::Connection;
    #[pymodule_export]
    use super::frame::Frame;
    #[pymodule_export]
    use super::models::Models;
    #[pymodule_export]
    use super::pending::Pending;
    #[pymodule_export]
    use super::planning::{before_and_after, picture, plan, plan_motion, relations, score, understand};
    #[pymodule_export]
    use super::robot_side::RobotSide;
    #[pymodule_export]
    use super::scene::Scene;
    #[pymodule_export]
    use super::subscription::Subscription;
}
