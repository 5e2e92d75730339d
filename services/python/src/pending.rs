//! A call that is under way.

use std::future::Future;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use pyo3::prelude::*;
use pyo3::types::PyBytes;
use repose_proto::{CallError, Payload};
use repose_runtime::{Answer, CancellationToken};
use tokio::sync::mpsc;

use crate::error::raised;
use crate::threads::Threads;
use crate::waiting::{SLICE, over_at, slice_before};

/// How long whoever gives calls up waits for them to end. Their workers have been told by then: what follows may end the process.
pub const GIVEN_UP_WITHIN: Duration = Duration::from_millis(500);

#[derive(Default)]
struct State {
    ended: Option<Result<Answer, CallError>>,
    callbacks: Vec<Py<PyAny>>,
}

#[derive(Default)]
struct Shared {
    state: Mutex<State>,
    ended: Condvar,
}

impl Shared {
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn end(&self, result: Result<Answer, CallError>) {
        let callbacks = {
            let mut state = self.state();
            state.ended = Some(result);
            std::mem::take(&mut state.callbacks)
        };
        self.ended.notify_all();
        if callbacks.is_empty() {
            return;
        }
        // None when the interpreter is going: nobody waits any more.
        let _ = Python::try_attach(|py| {
            for callback in callbacks {
                if let Err(error) = callback.call0(py) {
                    error.write_unraisable(py, Some(callback.bind(py)));
                }
            }
        });
    }
}

/// Schema, whether it is in bulk form, bytes, worker, attempts, milliseconds by stage.
type Answered<'py> = (String, bool, Bound<'py, PyBytes>, String, u32, std::collections::BTreeMap<String, f64>);

/// A call that ends exactly once, within its deadline.
#[pyclass(frozen, module = "repose._native")]
pub struct Pending {
    threads: Arc<Threads>,
    shared: Arc<Shared>,
    cancel: CancellationToken,
    progress: Mutex<mpsc::Receiver<Payload>>,
}

impl Pending {
    /// Starts a call on the network's threads.
    pub fn start(
        threads: &Arc<Threads>,
        answer: impl Future<Output = Result<Answer, CallError>> + Send + 'static,
        cancel: CancellationToken,
        progress: mpsc::Receiver<Payload>,
    ) -> PyResult<Self> {
        let handle = threads.handle().map_err(raised)?;
        let shared = Arc::new(Shared::default());
        let ending = shared.clone();
        handle.spawn(async move {
            let ended = answer.await;
            // Callbacks take the interpreter lock, which may be held for long.
            let _ = tokio::task::spawn_blocking(move || ending.end(ended)).await;
        });
        Ok(Self { threads: threads.clone(), shared, cancel, progress: Mutex::new(progress) })
    }

    /// Waits for the end; `None` when it has not come by then.
    fn ended(&self, py: Python<'_>, over: Option<Instant>) -> PyResult<Option<Result<Answer, CallError>>> {
        if !self.done() {
            self.threads.handle().map_err(raised)?;
        }
        loop {
            let ended = py.detach(|| {
                let (state, slice) = (self.shared.state(), slice_before(over));
                let waiting = |state: &mut State| state.ended.is_none();
                let (state, _) = self.shared.ended.wait_timeout_while(state, slice, waiting).unwrap_or_else(PoisonError::into_inner);
                state.ended.clone()
            });
            if ended.is_some() {
                return Ok(ended);
            }
            py.check_signals()?;
            if over.is_some_and(|at| Instant::now() >= at) {
                return Ok(None);
            }
        }
    }
}

#[pymethods]
impl Pending {
    /// Waits for the end; `None` when that takes longer than `timeout_s`.
    #[pyo3(signature = (timeout_s = None))]
    fn wait<'py>(&self, py: Python<'py>, timeout_s: Option<f64>) -> PyResult<Option<Answered<'py>>> {
        let Some(ended) = self.ended(py, over_at(timeout_s))? else { return Ok(None) };
        let answer = ended.map_err(raised)?;
        let bytes = PyBytes::new(py, &answer.payload.bytes);
        let (schema, bulk) = (answer.payload.schema().to_owned(), answer.payload.is_bulk());
        Ok(Some((schema, bulk, bytes, answer.worker, answer.attempts, answer.timing_ms)))
    }

    /// The next progress reply; `None` once there will be no more.
    fn next_progress<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyBytes>>> {
        let handle = self.threads.handle().map_err(raised)?;
        loop {
            let next = py.detach(|| {
                let mut progress = self.progress.lock().unwrap_or_else(PoisonError::into_inner);
                handle.block_on(async { tokio::time::timeout(SLICE, progress.recv()).await })
            });
            match next {
                Ok(next) => return Ok(next.map(|payload| PyBytes::new(py, &payload.bytes))),
                Err(_) => py.check_signals()?,
            }
        }
    }

    /// Calls back without arguments once the call has ended, from another thread; at once if it has.
    fn on_done(&self, py: Python<'_>, callback: Py<PyAny>) -> PyResult<()> {
        {
            let mut state = self.shared.state();
            if state.ended.is_none() {
                state.callbacks.push(callback);
                return Ok(());
            }
        }
        callback.call0(py).map(drop)
    }

    /// Whether it has ended.
    fn done(&self) -> bool {
        self.shared.state().ended.is_some()
    }

    /// Ends the call with `cancelled`, and tells its worker.
    fn cancel(&self) {
        self.cancel.cancel();
    }

    /// The same, and waits a moment until the worker has been told.
    fn give_up(&self, py: Python<'_>) -> PyResult<()> {
        self.cancel.cancel();
        self.ended(py, Some(Instant::now() + GIVEN_UP_WITHIN)).map(drop)
    }
}
