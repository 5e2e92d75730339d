//! What the networks refuse, as the contract's errors.

use repose_networks::InputError;
use repose_proto::{CallError, ErrorCode};

/// The contract's error for a question that the networks cannot take; `anchor_field` is what the request calls its anchors.
pub(crate) fn wire_error(error: &InputError, anchor_field: &str) -> CallError {
    let message = error.to_string();
    match error {
        InputError::UnknownObject { field: "query", .. } => CallError::not_found("query", message),
        InputError::UnknownObject { .. } => CallError::not_found(anchor_field, message),
        InputError::AnchorIsQuery { .. } => CallError::invalid(anchor_field, message),
        InputError::NoOutcomeNetwork => CallError::new(ErrorCode::FailedPrecondition, message).at("realism_by"),
        InputError::NotFinite { field, index } => CallError::invalid(format!("{field}[{index}]"), message),
        InputError::LabelCount { .. } => CallError::invalid("labels", message),
    }
}
