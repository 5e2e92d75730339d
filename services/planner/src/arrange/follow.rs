//! Objects that others stand right by. Where such a one must go there may be no place that leaves the others right where they are: then it goes where
//! its own terms have it, and those that do not stand right any more follow.

use std::collections::BTreeSet;

use repose_proto::CallError;
use repose_proto::arrange::ArrangeMove;

use crate::arrange::search::{Advance, Search, Settling, State};
use crate::arrange::stacks::above;

impl Search<'_> {
    /// Goes straight down once more, where objects may leave those that stand right by them, and these follow. Whether all was settled: the moves are
    /// then on the path.
    pub(super) fn followed(&mut self, start: &State) -> Result<bool, CallError> {
        if self.places.ended().is_some() || start.unsettled.iter().all(|object| self.followers(start, *object).is_empty()) {
            return Ok(false);
        }
        self.path.clear();
        Ok(self.left_after_straight(start.clone(), Self::led)?.unsettled.is_empty())
    }

    /// Moves an object to where its terms have it but for those of what stands right by it, which does not stand where it will from then on. None where
    /// no place is found for any.
    fn led(&mut self, state: &State) -> Result<Option<Advance>, CallError> {
        for object in self.order(state) {
            let followers = self.followers(state, object);
            // Once each: two that are placed by each other would go on for ever.
            if followers.is_empty() || self.path.iter().any(|step| step.object == object) {
                continue;
            }
            let leaving = State { scene: state.scene.clone(), unsettled: state.unsettled.union(&followers).copied().collect() };
            let others = leaving.others(object);
            let Settling::Moves(moves) = self.settling(&leaving, object, &others)? else { continue };
            if let Some(led) = self.first_of(&leaving, moves, &others)? {
                return Ok(Some(led));
            }
        }
        Ok(None)
    }

    /// The first of some moves of one object that leads to a table, with that.
    pub(super) fn first_of(
        &mut self,
        state: &State,
        moves: Vec<ArrangeMove>,
        unsettled: &BTreeSet<u16>,
    ) -> Result<Option<Advance>, CallError> {
        for step in moves {
            if let Some(after) = self.after(state, &step, unsettled)? {
                return Ok(Some((step, after)));
            }
        }
        Ok(None)
    }

    /// The table after a move; none where the object would stand on something that must move yet, or on what stands there, and be in the way, or where
    /// something that stands where it will would do so no more.
    pub(super) fn after(&mut self, state: &State, step: &ArrangeMove, unsettled: &BTreeSet<u16>) -> Result<Option<State>, CallError> {
        if !self.places.allows_tables(self.tables.prepared())? {
            return Ok(None);
        }
        let scene = self.tables.after(&state.scene, step.object, &step.placement.placed_from_observed)?;
        let others = unsettled.iter().copied().filter(|other| *other != step.object);
        let is_in_the_way = above(others, |id| scene.belief.carried(id)).contains(&step.object);
        let leaves_right = || self.goals.hold_about(step.object, unsettled, |other, terms| self.places.hold(&scene, other, terms));
        let is_right = !is_in_the_way && leaves_right();
        Ok(is_right.then(|| State { scene, unsettled: unsettled.clone() }))
    }

    /// The objects that stand where they will and have terms about an object.
    fn followers(&self, state: &State, object: u16) -> BTreeSet<u16> {
        self.goals.about(object).filter(|other| !state.unsettled.contains(other)).collect()
    }
}
