//! Errors as Python exceptions.

use pyo3::prelude::*;
use repose_proto::CallError;

/// The Python exception for an error, with its code and field.
pub fn raised(error: CallError) -> PyErr {
    Python::attach(|py| {
        let made = py.import("repose.errors").and_then(|errors| {
            let CallError { code, message, field, retryable, retry_after_ms } = error;
            errors.call_method1("error_of", (code.as_str(), message, field, retryable, retry_after_ms))
        });
        made.map_or_else(|e| e, PyErr::from_value)
    })
}

/// JSON as the command prints it.
pub fn pretty<T: serde::Serialize>(document: &T) -> PyResult<String> {
    serde_json::to_string_pretty(document).map_err(|e| raised(CallError::internal(e.to_string())))
}
