//! Tops that other objects cover: most of such a top the view may not show, and then nothing can be placed there in any order. What covers it is
//! set aside; where the top is known well enough the plan goes on, and where it is not, it ends with that a view is needed.

use repose_proto::{CallError, Relation};

use crate::arrange::search::{Advance, Part, Search, State};
use crate::arrange::stacks::bare_above;

impl Search<'_> {
    /// Goes straight down once more, and sets aside what covers the tops that others must go to. Whether all was settled: the moves are then on the
    /// path. If not, and it is for a top that was uncovered, these are the moves before a view ([`Search::before_a_view`]).
    pub(super) fn uncovered(&mut self, start: &State) -> Result<bool, CallError> {
        if self.places.ended().is_some() || self.covering(start).is_empty() {
            return Ok(false);
        }
        self.path.clear();
        let left = self.left_after_straight(start.clone(), Self::covering_cleared)?;
        if left.unsettled.is_empty() {
            return Ok(true);
        }
        let was_covered = |top: &u16| !start.scene.belief.carried(*top).is_empty();
        let is_bare = |top: &u16| left.scene.belief.carried(*top).is_empty();
        let needs_view: Vec<u16> = self.tops(&left).into_iter().filter(|top| was_covered(top) && is_bare(top)).collect();
        if !needs_view.is_empty() && self.places.ended().is_none() && self.uncovering.is_none() {
            let open = left.unsettled.iter().copied().collect();
            self.uncovering = Some(Part { moves: self.path.clone(), open, needs_view });
        }
        Ok(false)
    }

    /// Sets something aside that covers a top that others must go to. None where nothing does or no place is found for it.
    fn covering_cleared(&mut self, state: &State) -> Result<Option<Advance>, CallError> {
        let covering = self.covering(state);
        self.cleared(state, &covering)
    }

    /// What stands on tops that others must go to, and carries nothing itself.
    fn covering(&self, state: &State) -> Vec<u16> {
        let belief = &state.scene.belief;
        bare_above(self.tops(state), |id| belief.carried(id))
    }

    /// The objects on top of which others must go that can be moved and stand elsewhere.
    fn tops(&self, state: &State) -> Vec<u16> {
        let belief = &state.scene.belief;
        let mut tops: Vec<u16> = Vec::new();
        for object in self.order(state).into_iter().filter(|object| belief.carried(*object).is_empty()) {
            for term in self.goals.of(object, &state.others(object)) {
                let is_top = term.holds && term.relation == Relation::Above && !belief.carried(term.anchor).contains(&object);
                if is_top && !tops.contains(&term.anchor) {
                    tops.push(term.anchor);
                }
            }
        }
        tops
    }
}
