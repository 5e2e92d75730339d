//! Checks of single settings, whose errors name the field.

use repose_proto::{RigidTransform, keys};

use crate::error::BridgeError;
use crate::wire::names;

pub(super) fn check_name(field: &str, name: &str) -> Result<(), BridgeError> {
    names::check(name).map_err(|e| BridgeError::config(field, e.to_string()))
}

pub(super) fn check_chunk(field: &str, name: &str) -> Result<(), BridgeError> {
    keys::validate_chunk(field, name).map_err(|e| BridgeError::config(field, e.message))
}

pub(super) fn check_pose(field: &str, pose: Option<&RigidTransform>) -> Result<(), BridgeError> {
    pose.map_or(Ok(()), |pose| pose.validate(field)).map_err(|e| BridgeError::config(field, e.message))
}

pub(super) fn within(field: &str, value: f64, low: f64, high: f64) -> Result<(), BridgeError> {
    if (low..=high).contains(&value) { Ok(()) } else { Err(BridgeError::config(field, format!("expected {low} to {high}, got {value}"))) }
}
