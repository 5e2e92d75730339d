//! Tables from which nothing was found, so that other orders of the same moves are not gone through again.

use std::collections::{BTreeMap, BTreeSet};

use repose_proto::arrange::ArrangeMove;

/// A table as moves have left it, whatever their order was, with what is left to do and how: where nothing was found from it, nothing is again.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct DeadEnd {
    /// The objects that were moved, and where they were last set down, to the bit.
    moved: BTreeMap<u16, [u64; 16]>,
    unsettled: BTreeSet<u16>,
    parkings: u32,
    moves_left: usize,
}

impl DeadEnd {
    /// Where a path leads, of `most_moves` at most.
    pub fn new(path: &[ArrangeMove], unsettled: &BTreeSet<u16>, parkings: u32, most_moves: usize) -> Self {
        let moved = path.iter().map(|step| (step.object, step.placement.placed_from_observed.0.map(f64::to_bits))).collect();
        Self { moved, unsettled: unsettled.clone(), parkings, moves_left: most_moves.saturating_sub(path.len()) }
    }
}
