//! The search over moves: straight down first, then depth first over orders and alternative places, with one move more allowed in each round.
//!
//! Going straight down, each object takes its best place; whoever finds no room goes first the next time. That solves most tables in as many
//! searches as there are moves, where going back step by step would first try every other place of those that came last.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::ControlFlow;
use std::sync::Arc;

use repose_geometry::ViewerFrame;
use repose_proto::arrange::{ArrangeMove, ArrangeRequest, Purpose};
use repose_proto::place::Placement;
use repose_proto::{CallError, GoalTerm};

use crate::arrange::dead_end::DeadEnd;
use crate::arrange::goals::Goals;
use crate::arrange::parking::places_aside;
use crate::arrange::places::{Places, PlacesEnd};
use crate::arrange::stacks::bare_above;
use crate::arrange::tables::Tables;
use crate::learned::models::PlacementModels;
use crate::plan::SearchStep;
use crate::scene::prepared::PreparedScene;
use crate::search::stop::StopReason;

/// A move is sure where its success is said to be likelier than this. Chosen on validation tasks: two objects beside each other on one top, which
/// a place aside would spare, are said to succeed in .5 to .6 of cases.
const SURE: f64 = 0.6;
/// The share of the searches in which a way of sure moves alone is looked for.
const SURE_SHARE: f64 = 0.5;
/// Alternative places aside that are gone on with.
const ASIDE: usize = 2;

/// The table between two moves.
#[derive(Debug, Clone)]
pub(super) struct State {
    pub(super) scene: Arc<PreparedScene>,
    /// Objects that do not stand where they will.
    pub(super) unsettled: BTreeSet<u16>,
}

impl State {
    /// The objects but one that do not stand where they will.
    pub(super) fn others(&self, object: u16) -> BTreeSet<u16> {
        self.unsettled.iter().copied().filter(|other| *other != object).collect()
    }
}

/// An object for which no place was found, with what a place must satisfy.
type WithoutRoom = (u16, Vec<GoalTerm>);

/// A move, and where it leads.
pub(super) type Advance = (ArrangeMove, State);

/// How an object can be settled.
pub(super) enum Settling {
    /// Where it stands.
    Stays,
    /// By one of these moves, best first.
    Moves(Vec<ArrangeMove>),
    /// Not yet: it must move and carries something, or it waits for others.
    Waits,
}

/// A search and what it has found out.
pub struct Search<'a> {
    pub(super) goals: Goals,
    pub(super) places: Places<'a>,
    pub(super) tables: Tables,
    /// Whether only sure moves count now, and whether others were left out for that.
    sure_only: bool,
    left_out: bool,
    /// How often an object found no room on the way straight down.
    crowded: BTreeMap<u16, u32>,
    pub(super) path: Vec<ArrangeMove>,
    /// Moves on a path, those that are still needed at least among them.
    most_moves: usize,
    dead_ends: BTreeSet<DeadEnd>,
    best: Part,
    /// Moves after which a view is needed, if any were found.
    pub(super) uncovering: Option<Part>,
}

/// Moves that settle some of the objects.
#[derive(Debug, Clone, Default)]
pub struct Part {
    /// The moves.
    pub moves: Vec<ArrangeMove>,
    /// The objects that they leave unsettled.
    pub open: Vec<u16>,
    /// The objects whose tops they uncover for those.
    pub needs_view: Vec<u16>,
}

impl<'a> Search<'a> {
    /// A search for goals.
    pub fn new(
        goals: &Goals,
        request: &'a ArrangeRequest,
        viewer: ViewerFrame,
        models: &'a dyn PlacementModels,
        control: &'a mut dyn FnMut(SearchStep) -> ControlFlow<StopReason>,
    ) -> Self {
        Self {
            goals: goals.clone(),
            places: Places::new(request, viewer, models, control),
            tables: Tables::new(request.variant),
            sure_only: false,
            left_out: false,
            crowded: BTreeMap::new(),
            path: Vec::new(),
            most_moves: 0,
            dead_ends: BTreeSet::new(),
            best: Part::default(),
            uncovering: None,
        }
    }

    /// What was asked for places.
    pub fn asked(&self) -> &Places<'a> {
        &self.places
    }

    /// The moves that left the fewest objects unsettled.
    pub fn best_so_far(&self) -> &Part {
        &self.best
    }

    /// The moves after which a view is needed, where [`Search::arranged`] found no others: there is no use in more searches before it.
    pub fn before_a_view(&self) -> Option<&Part> {
        self.uncovering.as_ref()
    }

    /// Does something with other goals in place of these. What is known of placements stays.
    pub fn with_goals<T>(&mut self, goals: &Goals, work: impl FnOnce(&mut Self) -> T) -> T {
        let before = std::mem::replace(&mut self.goals, goals.clone());
        let done = work(self);
        self.goals = before;
        done
    }

    /// The moves after which all goals hold; none where there are none, or where it was ended ([`Places::ended`]). A way of sure moves goes before
    /// a shorter one that takes its chances.
    ///
    /// # Errors
    /// What the models answer, and `cancelled`.
    pub fn arranged(&mut self, scene: &Arc<PreparedScene>, unsettled: BTreeSet<u16>) -> Result<Option<Vec<ArrangeMove>>, CallError> {
        self.best = Part { open: unsettled.iter().copied().collect(), ..Part::default() };
        self.uncovering = None;
        let state = State { scene: scene.clone(), unsettled };
        (self.sure_only, self.left_out) = (true, false);
        self.places.allow(SURE_SHARE);
        let sure = self.found(&state)?;
        let is_through = self.places.ended().is_none() && !self.left_out;
        if sure.is_some() || is_through || self.places.ended() == Some(PlacesEnd::Time) {
            return Ok(sure);
        }
        // What the view leaves open the next one will show.
        if self.places.request().fresh_views && self.uncovering.is_some() {
            return Ok(None);
        }
        self.sure_only = false;
        self.places.allow(1.0);
        self.found(&state)
    }

    /// The moves after which all goals hold, with the fewest moves, but that a way straight down goes first.
    fn found(&mut self, state: &State) -> Result<Option<Vec<ArrangeMove>>, CallError> {
        self.crowded.clear();
        self.dead_ends.clear();
        if self.straight(state)? || self.uncovered(state)? {
            return Ok(Some(std::mem::take(&mut self.path)));
        }
        // Orders and places aside show nothing of a top that nobody has seen.
        if self.uncovering.is_some() {
            return Ok(None);
        }
        if self.followed(state)? {
            return Ok(Some(std::mem::take(&mut self.path)));
        }
        let fewest = state.unsettled.len();
        // An object set down aside costs a move, and one that stood where it should and made room another.
        for more in 0..=2 * self.places.request().max_parkings as usize {
            self.path.clear();
            self.most_moves = fewest + more;
            if self.solved(state, self.places.request().max_parkings.min(more as u32))? {
                return Ok(Some(std::mem::take(&mut self.path)));
            }
            if self.places.ended().is_some() {
                break;
            }
        }
        Ok(None)
    }

    /// Goes straight down a few times: whether all was settled; the moves are then on the path.
    fn straight(&mut self, start: &State) -> Result<bool, CallError> {
        for _ in 0..=start.unsettled.len() {
            self.path.clear();
            let before = self.order(start);
            let stuck = self.left_after_straight(start.clone(), |_, _| Ok(None))?.unsettled;
            if stuck.is_empty() || self.places.ended().is_some() {
                return Ok(stuck.is_empty());
            }
            for object in stuck {
                *self.crowded.entry(object).or_default() += 1;
            }
            if self.order(start) == before {
                break;
            }
        }
        Ok(false)
    }

    /// Settles one object after the other, each as well as can be; where none can be it sets aside what stands on those that must move, or does what else
    /// it may. What is left over.
    pub(super) fn left_after_straight(
        &mut self,
        mut state: State,
        or_else: fn(&mut Self, &State) -> Result<Option<Advance>, CallError>,
    ) -> Result<State, CallError> {
        loop {
            self.keep_if_best(&state);
            let mut next = None;
            for object in self.order(&state) {
                let others = state.others(object);
                match self.settling(&state, object, &others)? {
                    Settling::Stays => next = Some((None, State { scene: state.scene.clone(), unsettled: others })),
                    Settling::Moves(moves) => next = self.first_of(&state, moves, &others)?.map(|(step, after)| (Some(step), after)),
                    Settling::Waits => {}
                }
                if next.is_some() {
                    break;
                }
            }
            if next.is_none() && !state.unsettled.is_empty() {
                let cleared = self.cleared(&state, &standing_on_unsettled(&state))?;
                let found = if cleared.is_some() { cleared } else { or_else(self, &state)? };
                next = found.map(|(step, after)| (Some(step), after));
            }
            let Some((step, after)) = next else { return Ok(state) };
            self.path.extend(step);
            state = after;
        }
    }

    /// Whether all that is unsettled can be settled from here; the moves are then on the path.
    fn solved(&mut self, state: &State, parkings: u32) -> Result<bool, CallError> {
        self.keep_if_best(state);
        let open = state.unsettled.len();
        if open == 0 {
            return Ok(true);
        }
        if self.path.len() + open > self.most_moves {
            return Ok(false);
        }
        // Orders of moves that have nothing to do with each other lead to the same table.
        let here = DeadEnd::new(&self.path, &state.unsettled, parkings, self.most_moves);
        if self.dead_ends.contains(&here) {
            return Ok(false);
        }
        let solved = self.solved_from(state, parkings)?;
        // Where a limit ended it, nobody knows.
        if !solved && self.places.ended().is_none() {
            self.dead_ends.insert(here);
        }
        Ok(solved)
    }

    fn solved_from(&mut self, state: &State, parkings: u32) -> Result<bool, CallError> {
        let mut without_room: Vec<WithoutRoom> = Vec::new();
        for object in self.order(state) {
            let others = state.others(object);
            match self.settling(state, object, &others)? {
                Settling::Waits => {}
                Settling::Stays => {
                    if self.solved(&State { scene: state.scene.clone(), unsettled: others }, parkings)? {
                        return Ok(true);
                    }
                }
                Settling::Moves(moves) => {
                    let mut found = false;
                    for step in moves {
                        let Some(after) = self.after(state, &step, &others)? else { continue };
                        found = true;
                        if self.solved_after(step, &after, parkings)? {
                            return Ok(true);
                        }
                    }
                    if !found {
                        without_room.push((object, self.goals.of(object, &others)));
                    }
                }
            }
        }
        if parkings > 0 && self.places.ended().is_none() { self.solved_aside(state, &without_room, parkings) } else { Ok(false) }
    }

    fn keep_if_best(&mut self, state: &State) {
        if state.unsettled.len() < self.best.open.len() {
            self.best = Part { moves: self.path.clone(), open: state.unsettled.iter().copied().collect(), needs_view: Vec::new() };
        }
    }

    /// How an object can be settled while the others are not.
    pub(super) fn settling(&mut self, state: &State, object: u16, others: &BTreeSet<u16>) -> Result<Settling, CallError> {
        let terms = self.goals.of(object, others);
        // Whatever it carries may stay on it.
        if self.stays(state, object, &terms) {
            return Ok(Settling::Stays);
        }
        if !state.scene.belief.carried(object).is_empty() {
            return Ok(Settling::Waits);
        }
        let goals = self.positive(state, object, &terms, others);
        if goals.is_empty() {
            return Ok(Settling::Waits);
        }
        for goal in goals {
            let places = self.places(&state.scene, object, &goal, self.places.request().alternatives)?;
            if !places.is_empty() {
                let step = |p: &Placement| ArrangeMove { object, purpose: Purpose::Goal, goal: goal.clone(), placement: p.clone() };
                return Ok(Settling::Moves(places.iter().map(step).collect()));
            }
        }
        Ok(Settling::Moves(Vec::new()))
    }

    /// Places for an object, of which those that are not sure are left out where only sure ones count.
    fn places(&mut self, scene: &Arc<PreparedScene>, object: u16, terms: &[GoalTerm], count: u32) -> Result<Vec<Placement>, CallError> {
        let all = self.places.of(scene, object, terms, count)?;
        let is_sure = |p: &&Placement| p.success.is_none_or(|success| success > SURE);
        let kept: Vec<Placement> = all.iter().filter(|p| !self.sure_only || is_sure(p)).cloned().collect();
        self.left_out |= kept.len() < all.len();
        Ok(kept)
    }

    /// Whether an object needs no move: it and those that it waits for wait for each other; or all that is asked of it holds where it is.
    fn stays(&self, state: &State, object: u16, terms: &[GoalTerm]) -> bool {
        match terms.is_empty() {
            true => self.goals.waits_in_circle(object, &state.unsettled),
            // One that was set down aside, or had to give way, may well stand where it should.
            false => self.goals.waits_for(object, &state.unsettled).is_empty() && self.places.hold(&state.scene, object, terms),
        }
    }

    /// The goals to try for an object: its terms, and where none of them must hold, beside something.
    fn positive(&self, state: &State, object: u16, terms: &[GoalTerm], others: &BTreeSet<u16>) -> Vec<Vec<GoalTerm>> {
        if terms.iter().any(|t| t.holds) {
            return vec![terms.to_vec()];
        }
        if terms.is_empty() {
            return Vec::new();
        }
        let beside = places_aside(&state.scene, object, others, &BTreeSet::new());
        beside.into_iter().map(|side| [side, terms.to_vec()].concat()).collect()
    }

    /// Who is tried first: whoever others wait for comes before them, then those who found no room before, then those who carry something: of a circle
    /// they are to stay. Equals are in the order of the goals.
    pub(super) fn order(&self, state: &State) -> Vec<u16> {
        let mut order: Vec<u16> = self.goals.objects().iter().copied().filter(|o| state.unsettled.contains(o)).collect();
        let crowded = |object: u16| self.crowded.get(&object).copied().unwrap_or(0);
        let is_bare = |object: u16| state.scene.belief.carried(object).is_empty();
        order.sort_by_cached_key(|object| {
            (self.goals.waits_for(*object, &state.unsettled).len(), Reverse(crowded(*object)), is_bare(*object))
        });
        order
    }

    /// Sets one of these objects aside: no order spares that where they stand on something that must move. None where no place is found for any.
    pub(super) fn cleared(&mut self, state: &State, in_the_way: &[u16]) -> Result<Option<Advance>, CallError> {
        let aside = self.path.iter().filter(|step| step.purpose == Purpose::Aside).count();
        if aside >= self.places.request().max_parkings as usize {
            return Ok(None);
        }
        let awaited = state.unsettled.iter().flat_map(|object| self.goals.of(*object, &state.others(*object)));
        let anchors: BTreeSet<u16> = awaited.filter(|t| t.holds).map(|t| t.anchor).collect();
        for object in in_the_way.iter().copied() {
            let unsettled = self.unsettled_without(state, object);
            for goal in places_aside(&state.scene, object, &unsettled, &anchors) {
                for placement in self.places(&state.scene, object, &goal, 1)? {
                    let step = ArrangeMove { object, purpose: Purpose::Aside, goal: goal.clone(), placement };
                    if let Some(after) = self.after(state, &step, &unsettled)? {
                        return Ok(Some((step, after)));
                    }
                }
            }
        }
        Ok(None)
    }

    /// What does not stand where it will once an object is taken from its place.
    fn unsettled_without(&self, state: &State, object: u16) -> BTreeSet<u16> {
        // Goals about it may not hold any more; those that do are seen to when their turn comes.
        let about = self.goals.about(object).filter(|other| *other != object);
        let own = self.goals.has(object).then_some(object);
        state.unsettled.iter().copied().chain(about).chain(own).collect()
    }

    /// Sets one object down aside, and goes on.
    fn solved_aside(&mut self, state: &State, without_room: &[WithoutRoom], parkings: u32) -> Result<bool, CallError> {
        let anchors = without_room.iter().flat_map(|(_, terms)| terms.iter().filter(|t| t.holds).map(|t| t.anchor)).collect();
        let mut tried: BTreeSet<u16> = BTreeSet::new();
        for (other, for_whom) in self.in_the_way(state, without_room) {
            if self.places.ended().is_some() {
                return Ok(false);
            }
            if tried.contains(&other) || !self.makes_room(state, other, for_whom)? {
                continue;
            }
            tried.insert(other);
            if self.solved_with_aside(state, other, &anchors, parkings)? {
                return Ok(true);
            }
        }
        Ok(false)
    }

    /// Sets this object down aside, here or there, and goes on.
    fn solved_with_aside(&mut self, state: &State, object: u16, anchors: &BTreeSet<u16>, parkings: u32) -> Result<bool, CallError> {
        let unsettled = self.unsettled_without(state, object);
        let others = unsettled.iter().copied().filter(|other| *other != object).collect();
        let mut kept = 0;
        for goal in places_aside(&state.scene, object, &others, anchors) {
            let places = self.places(&state.scene, object, &goal, 1)?;
            for placement in &places {
                let step = ArrangeMove { object, purpose: Purpose::Aside, goal: goal.clone(), placement: placement.clone() };
                let Some(after) = self.after(state, &step, &unsettled)? else { continue };
                if self.solved_after(step, &after, parkings - 1)? {
                    return Ok(true);
                }
                kept += 1;
            }
            if kept >= ASIDE || self.places.ended().is_some() {
                break;
            }
        }
        Ok(false)
    }

    /// The objects that may keep others from their places, likeliest first, each with whom it may keep from which: those that stand on what must
    /// move, and then everything that can be moved, for what carries them may yet stay where it is.
    fn in_the_way<'g>(&self, state: &State, without_room: &'g [WithoutRoom]) -> Vec<(u16, Option<&'g WithoutRoom>)> {
        let free = |id: &u16| state.scene.belief.carried(*id).is_empty();
        let standing = standing_on_unsettled(state).into_iter().map(|object| (object, None));
        let mut likely: Vec<((bool, bool), u16, Option<&'g WithoutRoom>)> = Vec::new();
        for whom in without_room.iter().filter(|(_, terms)| terms.iter().any(|t| t.holds)) {
            let (object, terms) = whom;
            let is_anchor = |id: &u16| terms.iter().any(|t| t.anchor == *id);
            for other in state.scene.belief.objects.keys().copied().filter(|id| id != object && !is_anchor(id)).filter(free) {
                // What stands where this one must go comes first, then what moves anyway.
                let stands_there = self.places.hold(&state.scene, other, terms);
                likely.push(((!stands_there, !state.unsettled.contains(&other)), other, Some(whom)));
            }
        }
        likely.sort_by_key(|(rank, ..)| *rank);
        standing.chain(likely.into_iter().map(|(_, other, whom)| (other, whom))).collect()
    }

    /// Whether there would be room for whoever has none, if this object were not there.
    fn makes_room(&mut self, state: &State, other: u16, for_whom: Option<&WithoutRoom>) -> Result<bool, CallError> {
        let Some((object, terms)) = for_whom else { return Ok(true) };
        if !self.places.allows_tables(self.tables.prepared())? {
            return Ok(false);
        }
        let scene = self.tables.without(&state.scene, other);
        Ok(!self.places(&scene, *object, terms, 1)?.is_empty())
    }

    /// Whether all can be settled after a move, which led to a state.
    fn solved_after(&mut self, step: ArrangeMove, state: &State, parkings: u32) -> Result<bool, CallError> {
        self.path.push(step);
        let solved = self.solved(state, parkings)?;
        if !solved {
            self.path.pop();
        }
        Ok(solved)
    }
}

/// What stands on objects that must move, or on others that stand on them, and carries nothing itself.
fn standing_on_unsettled(state: &State) -> Vec<u16> {
    let belief = &state.scene.belief;
    let mut standing = bare_above(state.unsettled.iter().copied(), |id| belief.carried(id));
    standing.sort_unstable();
    standing
}
