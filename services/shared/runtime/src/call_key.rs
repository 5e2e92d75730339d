//! The keys by which calls come to a worker, and the cell that a call is for: access control sees keys, so that both can be believed.

use repose_proto::{CallError, Cell, Service, keys};

use crate::shares::ForCell;

/// The key that a call arrived on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum CallKey {
    /// `call`.
    Call,
    /// `operate`.
    Operate,
    /// `call/CELL`: for another cell than the worker's.
    ForOthers,
}

impl CallKey {
    /// Whether a method may be called on this key. `operate_only`: methods that move a robot or change the world have a key of their own.
    pub(crate) fn takes(self, method: &str, service: Service, operate_only: bool) -> Result<(), CallError> {
        match (self, service.operates(method)) {
            (Self::Operate, false) => {
                Err(CallError::invalid("method", format!("{method:?} moves nothing: it is called by this worker's key `call`")))
            }
            (Self::Call, true) if operate_only => {
                let message = format!("{method:?} is for operators: it is called by this worker's key `operate`");
                Err(CallError::precondition(message).at("method"))
            }
            _ => Ok(()),
        }
    }

    /// The cell that a call on this key is for, where that is not the worker's.
    pub(crate) fn cell(self, key: &str, own: &Cell) -> Result<ForCell, CallError> {
        let cell = keys::last_chunk(key);
        if self != Self::ForOthers || cell == own.name() {
            return Ok(None);
        }
        keys::validate_chunk("cell", cell).map(|()| Some(cell.into()))
    }
}
