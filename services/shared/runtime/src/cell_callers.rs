//! Callers of one service in every cell that a pool's worker has calls for.

use std::num::NonZeroUsize;
use std::sync::{Arc, Mutex, PoisonError};

use lru::LruCache;
use repose_proto::{CallError, Service};
use tokio::sync::OnceCell;

use crate::{Call, Caller, Session};

/// Cells whose workers are followed at once; the least recently called for is forgotten first.
const MOST_CELLS: NonZeroUsize = NonZeroUsize::new(256).unwrap();

/// Callers of one service by cell. A cell's workers are followed from the first call for it on.
pub struct CellCallers {
    session: Session,
    service: Service,
    callers: Mutex<LruCache<String, Arc<OnceCell<Caller>>>>,
}

impl CellCallers {
    /// None yet.
    pub fn new(session: Session, service: Service) -> Self {
        Self { session, service, callers: Mutex::new(LruCache::new(MOST_CELLS)) }
    }

    /// The caller in the cell that a call is for.
    ///
    /// # Errors
    /// When the network refuses.
    pub async fn of(&self, call: &Call) -> Result<Caller, CallError> {
        self.in_cell(call.cell.as_deref()).await
    }

    /// The caller in a cell of that name; none is the session's own.
    ///
    /// # Errors
    /// When the network refuses, or the name is none.
    pub async fn in_cell(&self, cell: Option<&str>) -> Result<Caller, CallError> {
        let cell = cell.unwrap_or(self.session.cell().name());
        let caller = {
            let mut callers = self.callers.lock().unwrap_or_else(PoisonError::into_inner);
            callers.get_or_insert(cell.to_owned(), Arc::default).clone()
        };
        // Outside the lock: a cell that is slow to answer keeps no other one waiting.
        let follow = async { Ok::<_, CallError>(self.session.in_cell(cell)?.caller(self.service).await?) };
        caller.get_or_try_init(|| follow).await.cloned()
    }
}
