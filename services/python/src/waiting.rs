//! Waits and long work that leave the interpreter to others, and end where somebody presses Ctrl-C.
//!
//! Python's own handler of signals only notes them; its main thread must ask. Whoever waits here asks twenty times a second.

use std::cell::Cell;
use std::future::Future;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use pyo3::prelude::*;
use repose_proto::CallError;
use tokio::runtime::Handle;

use crate::error::raised;

/// How long a wait goes on before it looks for Ctrl-C.
pub const SLICE: Duration = Duration::from_millis(50);

/// When a wait of so many seconds is over: at once where that is negative, never where it is not limited.
pub fn over_at(timeout_s: Option<f64>) -> Option<Instant> {
    let within = Duration::try_from_secs_f64(timeout_s?.max(0.0)).ok()?;
    Instant::now().checked_add(within)
}

/// How long to wait before looking for Ctrl-C, in a wait that is over then.
pub fn slice_before(over: Option<Instant>) -> Duration {
    over.map_or(SLICE, |at| at.saturating_duration_since(Instant::now()).min(SLICE))
}

/// Waits for what the network does. Ctrl-C gives it up, and is raised.
pub fn wait_for<T: Send, F: Future<Output = T>>(py: Python<'_>, handle: &Handle, start: impl FnOnce() -> F + Send) -> PyResult<T> {
    py.detach(|| {
        handle.block_on(async {
            let mut waited = std::pin::pin!(start());
            loop {
                if let Ok(done) = tokio::time::timeout(SLICE, waited.as_mut()).await {
                    return Ok(done);
                }
                Python::attach(|py| py.check_signals())?;
            }
        })
    })
}

/// Does work that asks between its steps whether it is to stop. Ctrl-C stops it, and is raised.
pub fn compute<T: Send>(py: Python<'_>, work: impl FnOnce(&dyn Fn() -> bool) -> Result<T, CallError> + Send) -> PyResult<T> {
    let interrupt: Mutex<Option<PyErr>> = Mutex::new(None);
    let ended = py.detach(|| {
        let looked = Cell::new(Instant::now());
        work(&|| {
            let mut interrupt = interrupt.lock().unwrap_or_else(PoisonError::into_inner);
            if interrupt.is_none() && looked.get().elapsed() >= SLICE {
                looked.set(Instant::now());
                *interrupt = Python::attach(|py| py.check_signals()).err();
            }
            interrupt.is_some()
        })
    });
    match interrupt.into_inner().unwrap_or_else(PoisonError::into_inner) {
        Some(interrupt) => Err(interrupt),
        None => ended.map_err(raised),
    }
}
