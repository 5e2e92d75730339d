//! What the cells of a pool may each have of a worker: its weight among them, and limits. A worker that serves its own cell alone knows none of this.

use std::collections::BTreeMap;
use std::sync::Arc;

use serde::{Deserialize, Serialize};

/// The cell that a call is for; none: the worker's own.
pub(crate) type ForCell = Option<Arc<str>>;

/// What a cell may have of a worker that serves several. In the share of one cell, a field that is left out is as in the share of every cell.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CellShare {
    /// The cell's calls that are taken for each one of a cell of weight 1 while both have calls waiting, 0.01 to 100; 1 where absent.
    pub weight: Option<f64>,
    /// Calls of the cell that may wait; the next is refused at once. Where absent, as many as it leaves places for others.
    pub max_waiting: Option<usize>,
    /// Calls of the cell that are computed at once; the next waits. As many as there are threads where absent.
    pub max_running: Option<usize>,
}

impl CellShare {
    /// What of a share cannot be, if anything: names the field.
    pub(crate) fn fault(&self) -> Option<&'static str> {
        if !self.weight.is_none_or(|weight| (0.01..=100.0).contains(&weight)) {
            return Some("weight: expected 0.01 to 100");
        }
        let is_none = |limit: Option<usize>| limit == Some(0);
        (is_none(self.max_waiting).then_some("max_waiting: at least 1")).or(is_none(self.max_running).then_some("max_running: at least 1"))
    }
}

/// The shares of all cells.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Shares {
    every: CellShare,
    cells: BTreeMap<String, CellShare>,
}

impl Shares {
    /// `every` for every cell, and over it what `cells` says of single ones.
    pub fn new(every: CellShare, cells: BTreeMap<String, CellShare>) -> Self {
        Self { every, cells }
    }

    pub(crate) fn weight(&self, cell: &str) -> f64 {
        self.of(cell, |share| share.weight).unwrap_or(1.0)
    }

    pub(crate) fn max_waiting(&self, cell: &str) -> usize {
        self.of(cell, |share| share.max_waiting).unwrap_or(usize::MAX)
    }

    pub(crate) fn max_running(&self, cell: &str) -> usize {
        self.of(cell, |share| share.max_running).unwrap_or(usize::MAX)
    }

    fn of<T>(&self, cell: &str, field: impl Fn(&CellShare) -> Option<T>) -> Option<T> {
        self.cells.get(cell).and_then(&field).or_else(|| field(&self.every))
    }
}

/// Whether a cell that has `held` of the places may have another one: no more than are still free, so that one that floods leaves some to the next
/// (dynamic thresholds, Choudhury and Hahne 1998). One alone gets half of them, two a third each.
pub(crate) fn leaves_room(held: usize, taken: usize, places: usize) -> bool {
    held < places.saturating_sub(taken)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cells_own_share_stands_over_that_of_every_cell_field_by_field() {
        let every = CellShare { max_waiting: Some(8), ..CellShare::default() };
        let own = CellShare { weight: Some(2.0), ..CellShare::default() };
        let shares = Shares::new(every, BTreeMap::from([("a".to_owned(), own)]));
        assert_eq!((shares.weight("a"), shares.max_waiting("a"), shares.max_running("a")), (2.0, 8, usize::MAX));
        assert_eq!((shares.weight("b"), shares.max_waiting("b")), (1.0, 8));
    }

    #[test]
    fn cells_that_flood_leave_as_many_places_as_each_takes() {
        for cells in [1, 2, 5] {
            let mut held = vec![0; cells];
            while let Some(cell) = (0..cells).min_by_key(|cell| held[*cell]).filter(|c| leaves_room(held[*c], held.iter().sum(), 60)) {
                held[cell] += 1;
            }
            assert_eq!(held, vec![60 / (cells + 1); cells]);
        }
    }
}
