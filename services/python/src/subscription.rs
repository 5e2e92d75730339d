//! Messages of a key, as they come.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::threads::Threads;

/// How long a wait goes on before it looks for Ctrl-C.
const SLICE: Duration = Duration::from_millis(50);

/// Key, schema and bytes.
type Message<'py> = (String, String, Bound<'py, PyBytes>);

/// A subscription; it ends when it is dropped.
#[pyclass(frozen, module = "repose._native")]
pub struct Subscription {
    threads: Arc<Threads>,
    messages: Mutex<Option<repose_runtime::Subscription>>,
    ended: AtomicBool,
}

impl Subscription {
    /// Follows what comes.
    pub fn new(threads: Arc<Threads>, messages: repose_runtime::Subscription) -> Self {
        Self { threads, messages: Mutex::new(Some(messages)), ended: AtomicBool::new(false) }
    }
}

#[pymethods]
impl Subscription {
    /// The next message; `None` when none comes within `timeout_s`, or ever again.
    #[pyo3(signature = (timeout_s = None))]
    fn recv<'py>(&self, py: Python<'py>, timeout_s: Option<f64>) -> PyResult<Option<Message<'py>>> {
        let give_up = timeout_s.and_then(|s| Duration::try_from_secs_f64(s).ok()).map(|within| Instant::now() + within);
        let Some(handle) = self.threads.handle() else {
            self.ended.store(true, Ordering::Release);
            return Ok(None);
        };
        loop {
            let slice = give_up.map_or(SLICE, |at| at.saturating_duration_since(Instant::now()).min(SLICE));
            let next = py.detach(|| {
                let mut messages = self.messages.lock().unwrap_or_else(PoisonError::into_inner);
                let messages = messages.as_mut()?;
                Some(handle.block_on(async { tokio::time::timeout(slice, messages.recv()).await }))
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
            if give_up.is_some_and(|at| Instant::now() >= at) {
                return Ok(None);
            }
        }
    }

    /// Whether nothing comes any more.
    #[getter]
    fn ended(&self) -> bool {
        self.ended.load(Ordering::Acquire)
    }

    /// Ends it.
    fn close(&self) {
        self.messages.lock().unwrap_or_else(PoisonError::into_inner).take();
    }
}
