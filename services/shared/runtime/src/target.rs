//! Whom a caller calls.

use std::sync::Arc;

use repose_proto::{Cell, Service};

/// The workers of one service, and the cell that they are called for.
#[derive(Debug, Clone)]
pub struct Target {
    /// The cell that the workers are in.
    pub workers_in: Cell,
    /// Their service.
    pub service: Service,
    /// The cell that they serve as its pool's; none where it is their own.
    pub on_behalf_of: Option<Arc<str>>,
}

impl Target {
    /// The key of a call to one of them, for `cell` where that is given. `operates`: by the worker's key for what moves something.
    pub(crate) fn call(&self, worker: &str, operates: bool, cell: Option<&str>) -> String {
        let cell = cell.or(self.on_behalf_of.as_deref()).filter(|cell| self.service.is_poolable() && *cell != self.workers_in.name());
        match (cell, operates) {
            (Some(cell), _) => self.workers_in.call_for(self.service, worker, cell),
            (None, true) => self.workers_in.operate(self.service, worker),
            (None, false) => self.workers_in.call(self.service, worker),
        }
    }
}

impl std::fmt::Display for Target {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let what = if self.on_behalf_of.is_some() { "pool" } else { "cell" };
        write!(f, "{} in the {what} {}", self.service, self.workers_in.name())
    }
}
