//! Messages of a key, as they come.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use pyo3::prelude::*;
use pyo3::types::PyBytes;
use repose_runtime::CancellationToken;

use crate::error::raised;
use crate::threads::Threads;
use crate::waiting::{over_at, slice_before};

/// Key, schema and bytes.
type Message<'py> = (String, String, Bound<'py, PyBytes>);

/// A subscription; it ends when it is dropped.
#[pyclass(frozen, module = "repose._native")]
pub struct Subscription {
    threads: Arc<Threads>,
    messages: Mutex<Option<repose_runtime::Subscription>>,
    ended: AtomicBool,
    /// Triggered by whoever closes it, for a thread that waits for a message.
    closed: CancellationToken,
}

impl Subscription {
    /// Follows what comes.
    pub fn new(threads: Arc<Threads>, messages: repose_runtime::Subscription) -> Self {
        Self { threads, messages: Mutex::new(Some(messages)), ended: AtomicBool::new(false), closed: CancellationToken::new() }
    }
}

#[pymethods]
impl Subscription {
    /// The next message; `None` when none comes within `timeout_s`, or ever again.
    #[pyo3(signature = (timeout_s = None))]
    fn recv<'py>(&self, py: Python<'py>, timeout_s: Option<f64>) -> PyResult<Option<Message<'py>>> {
        let over = over_at(timeout_s);
        let handle = self.threads.handle().map_err(raised)?;
        loop {
            let slice = slice_before(over);
            let next = py.detach(|| {
                let mut messages = self.messages.lock().unwrap_or_else(PoisonError::into_inner);
                let messages = messages.as_mut()?;
                Some(handle.block_on(async {
                    tokio::select! {
                        biased;
                        () = self.closed.cancelled() => Ok(None),
                        next = tokio::time::timeout(slice, messages.recv()) => next,
                    }
                }))
            });
            match next {
                None | Some(Ok(None)) => {
                    self.ended.store(true, Ordering::Release);
                    return Ok(None);
                }
                Some(Ok(Some(sample))) => {
                    let bytes = PyBytes::new(py, &sample.payload.bytes);
                    return Ok(Some((sample.key, sample.payload.schema().to_owned(), bytes)));
                }
                Some(Err(_)) => py.check_signals()?,
            }
            if over.is_some_and(|at| Instant::now() >= at) {
                return Ok(None);
            }
        }
    }

    /// Whether nothing comes any more.
    #[getter]
    fn ended(&self) -> bool {
        self.ended.load(Ordering::Acquire)
    }

    /// Ends it: a thread that waits for a message stops waiting.
    fn close(&self, py: Python<'_>) {
        self.closed.cancel();
        // Without the interpreter lock, which that thread may want before it lets go of this one.
        py.detach(|| drop(self.messages.lock().unwrap_or_else(PoisonError::into_inner).take()));
    }
}
