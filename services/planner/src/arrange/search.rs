//! The search over moves: depth first over orders and alternative places, with one move more allowed in each round.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::{Duration, Instant};

use repose_geometry::ViewerFrame;
use repose_geometry::transform::from_row_major;
use repose_proto::arrange::{ArrangeMove, ArrangeRequest, Purpose};
use repose_proto::place::Placement;
use repose_proto::{CallError, ErrorCode, GoalTerm, PlaceRequest, Scene};

use crate::arrange::goals::{Goals, all_hold};
use crate::arrange::moved::{moved, without};
use crate::arrange::parking::places_aside;
use crate::learned::models::PlacementModels;
use crate::plan::{SearchStep, plan};
use crate::scene::prepared::PreparedScene;
use crate::search::stop::StopReason;

/// Alternative places aside that are gone on with.
const ASIDE: usize = 2;

/// What ended a search before it was through.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Ended {
    /// As many placements as may be searched were.
    Budget,
    /// Its time.
    Time,
}

/// The table between two moves.
#[derive(Debug, Clone)]
struct State {
    scene: Arc<PreparedScene>,
    /// Objects that do not stand where they will.
    unsettled: BTreeSet<u16>,
}

/// Searched placements by scene, object and terms.
type Known = BTreeMap<(String, u16, String), Arc<Vec<Placement>>>;

/// A search and what it has found out.
pub struct Search<'a> {
    goals: Goals,
    request: &'a ArrangeRequest,
    viewer: ViewerFrame,
    models: &'a dyn PlacementModels,
    control: &'a mut dyn FnMut(SearchStep) -> ControlFlow<StopReason>,
    started: Instant,
    searches: u32,
    ended: Option<Ended>,
    weights_hash: String,
    known: Known,
    path: Vec<ArrangeMove>,
    /// Moves on a path, those that are still needed at least among them.
    most_moves: usize,
    best: Option<(Vec<ArrangeMove>, Vec<u16>)>,
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
            request,
            viewer,
            models,
            control,
            started: Instant::now(),
            searches: 0,
            ended: None,
            weights_hash: String::new(),
            known: Known::new(),
            path: Vec::new(),
            most_moves: 0,
            best: None,
        }
    }

    /// The viewer of all relations.
    pub fn viewer(&self) -> &ViewerFrame {
        &self.viewer
    }

    /// Placements searched for so far.
    pub fn searches(&self) -> u32 {
        self.searches
    }

    /// What ended it early, if anything.
    pub fn ended(&self) -> Option<Ended> {
        self.ended
    }

    /// The weights that answered; empty where no network was asked.
    pub fn weights_hash(&self) -> &str {
        &self.weights_hash
    }

    /// The moves that left the fewest objects unsettled, and those objects.
    pub fn best_so_far(&self) -> (Vec<ArrangeMove>, Vec<u16>) {
        self.best.clone().unwrap_or_default()
    }

    /// Does something with other goals in place of these. What is known of placements stays.
    pub fn with_goals<T>(&mut self, goals: &Goals, work: impl FnOnce(&mut Self) -> T) -> T {
        let before = std::mem::replace(&mut self.goals, goals.clone());
        let done = work(self);
        self.goals = before;
        done
    }

    /// The moves after which all goals hold; none where there are none, or where it was [`ended`](Self::ended).
    ///
    /// # Errors
    /// What the models answer, and `cancelled`.
    pub fn arranged(&mut self, scene: &Arc<PreparedScene>, unsettled: BTreeSet<u16>) -> Result<Option<Vec<ArrangeMove>>, CallError> {
        self.best = Some((Vec::new(), unsettled.iter().copied().collect()));
        let state = State { scene: scene.clone(), unsettled };
        let fewest = state.unsettled.len();
        // An object set down aside costs a move, and one that stood where it should and made room another.
        for more in 0..=2 * self.request.max_parkings as usize {
            self.path.clear();
            self.most_moves = fewest + more;
            if self.solved(&state, self.request.max_parkings.min(more as u32))? {
                return Ok(Some(std::mem::take(&mut self.path)));
            }
            if self.ended.is_some() {
                break;
            }
        }
        Ok(None)
    }

    /// Whether all that is unsettled can be settled from here; the moves are then on the path.
    fn solved(&mut self, state: &State, parkings: u32) -> Result<bool, CallError> {
        let open = state.unsettled.len();
        if self.best.as_ref().is_none_or(|(_, unsettled)| open < unsettled.len()) {
            self.best = Some((self.path.clone(), state.unsettled.iter().copied().collect()));
        }
        if open == 0 {
            return Ok(true);
        }
        if self.path.len() + open > self.most_moves {
            return Ok(false);
        }
        let mut without_room: Vec<(u16, Vec<GoalTerm>)> = Vec::new();
        for object in self.order(state) {
            if !state.scene.carried(object).is_empty() {
                continue;
            }
            let mut others = state.unsettled.clone();
            others.remove(&object);
            let terms = self.goals.of(object, &others);
            if self.stays(state, object, &terms) {
                if self.solved(&State { scene: state.scene.clone(), unsettled: others }, parkings)? {
                    return Ok(true);
                }
                continue;
            }
            let mut found = false;
            for goal in self.positive(state, object, &terms, &others) {
                let places = self.places(&state.scene, object, &goal, self.request.alternatives)?;
                for placement in places.iter() {
                    let step = ArrangeMove { object, purpose: Purpose::Goal, goal: goal.clone(), placement: placement.clone() };
                    let scene = after(state, &step)?;
                    // On something that must move again it would be in the way.
                    if others.iter().any(|other| scene.carried(*other).contains(&object)) {
                        continue;
                    }
                    found = true;
                    if self.solved_after(step, &State { scene, unsettled: others.clone() }, parkings)? {
                        return Ok(true);
                    }
                }
                if found {
                    break;
                }
            }
            if !found {
                without_room.push((object, terms));
            }
        }
        if parkings > 0 && self.ended.is_none() { self.solved_aside(state, &without_room, parkings) } else { Ok(false) }
    }

    /// Whether an object needs no move: nothing is asked of it as long as the others do not stand, and all of them wait for each other; or
    /// what is asked of it holds where it is.
    fn stays(&self, state: &State, object: u16, terms: &[GoalTerm]) -> bool {
        match terms.is_empty() {
            true => state.unsettled.iter().all(|other| {
                let mut others = state.unsettled.clone();
                others.remove(other);
                self.goals.of(*other, &others).is_empty()
            }),
            // One that was set down aside, or had to give way, may well stand where it should.
            false => all_hold(&state.scene, &self.viewer, object, terms) && self.goals.waiting(object, &state.unsettled) == 0,
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

    /// Who is tried first: whoever waits for the fewest others, in the order of the goals.
    fn order(&self, state: &State) -> Vec<u16> {
        let mut order: Vec<u16> = self.goals.objects().iter().copied().filter(|o| state.unsettled.contains(o)).collect();
        order.sort_by_key(|object| self.goals.waiting(*object, &state.unsettled));
        order
    }

    /// Sets one object down aside, and goes on.
    fn solved_aside(&mut self, state: &State, without_room: &[(u16, Vec<GoalTerm>)], parkings: u32) -> Result<bool, CallError> {
        for object in self.in_the_way(state, without_room)? {
            let mut unsettled = state.unsettled.clone();
            if self.goals.has(object) {
                unsettled.insert(object);
            }
            // Goals about it may not hold any more; those that do are seen to when their turn comes.
            unsettled.extend(self.goals.about(object).filter(|other| *other != object));
            let mut others = unsettled.clone();
            others.remove(&object);
            let anchors = without_room.iter().flat_map(|(_, terms)| terms.iter().filter(|t| t.holds).map(|t| t.anchor)).collect();
            let mut kept = 0;
            for goal in places_aside(&state.scene, object, &others, &anchors) {
                let places = self.places(&state.scene, object, &goal, 1)?;
                for placement in places.iter() {
                    let step = ArrangeMove { object, purpose: Purpose::Aside, goal: goal.clone(), placement: placement.clone() };
                    let scene = after(state, &step)?;
                    if self.solved_after(step, &State { scene, unsettled: unsettled.clone() }, parkings - 1)? {
                        return Ok(true);
                    }
                    kept += 1;
                }
                if kept >= ASIDE || self.ended.is_some() {
                    break;
                }
            }
        }
        Ok(false)
    }

    /// The objects that keep others from their places: those that stand on what must move, or else those without which there would be room.
    fn in_the_way(&mut self, state: &State, without_room: &[(u16, Vec<GoalTerm>)]) -> Result<Vec<u16>, CallError> {
        let free = |id: &u16| state.scene.carried(*id).is_empty();
        let carried: BTreeSet<u16> = state.unsettled.iter().flat_map(|object| state.scene.carried(*object).iter().copied()).collect();
        if !carried.is_empty() {
            return Ok(carried.into_iter().filter(free).collect());
        }
        let mut found: Vec<u16> = Vec::new();
        for (object, terms) in without_room.iter().filter(|(_, terms)| terms.iter().any(|t| t.holds)) {
            let others: Vec<u16> = state.scene.objects.keys().copied().filter(|id| id != object).collect();
            // Who moves anyway first.
            let (moving, standing): (Vec<u16>, Vec<u16>) = others.into_iter().filter(free).partition(|id| state.unsettled.contains(id));
            for other in moving.into_iter().chain(standing) {
                let anchors = terms.iter().any(|t| t.anchor == other);
                if found.contains(&other) || anchors {
                    continue;
                }
                let scene = prepared(without(&state.scene.scene, other));
                if !self.places(&scene, *object, terms, 1)?.is_empty() {
                    found.push(other);
                }
                if self.ended.is_some() {
                    return Ok(found);
                }
            }
        }
        Ok(found)
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

    /// Places for an object on a scene, best first; none where there is none, where too little is known of it, or where the search has ended.
    fn places(
        &mut self,
        scene: &Arc<PreparedScene>,
        object: u16,
        terms: &[GoalTerm],
        count: u32,
    ) -> Result<Arc<Vec<Placement>>, CallError> {
        let named: Vec<String> = terms.iter().map(ToString::to_string).collect();
        let key = (scene.scene_id.clone(), object, format!("{count} {}", named.join(",")));
        if let Some(known) = self.known.get(&key) {
            return Ok(known.clone());
        }
        let time_is_up = self.request.time_ms.is_some_and(|ms| self.started.elapsed() >= Duration::from_millis(ms));
        if time_is_up || self.searches >= self.request.max_searches {
            self.ended = Some(if time_is_up { Ended::Time } else { Ended::Budget });
            return Ok(Arc::default());
        }
        self.searches += 1;
        let request = PlaceRequest {
            view_yaw_rad: Some(self.viewer.yaw_rad()),
            count,
            rotation: self.request.rotation,
            seed: self.request.seed,
            variant: self.request.variant,
            ..PlaceRequest::new(scene.scene_id.clone(), object, terms.to_vec())
        };
        let places = match plan(scene, &request, self.models, self.control) {
            Ok(result) => {
                self.weights_hash = result.weights_hash;
                result.placements
            }
            // It carries something, or too little of it was seen: it stays where it is.
            Err(error) if error.code == ErrorCode::FailedPrecondition && error.field.as_deref() == Some("query") => Vec::new(),
            Err(error) if error.code == ErrorCode::DeadlineExceeded => {
                self.ended = Some(Ended::Time);
                Vec::new()
            }
            Err(error) => return Err(error),
        };
        let places = Arc::new(places);
        self.known.insert(key, places.clone());
        Ok(places)
    }
}

/// The scene after a move.
fn after(state: &State, step: &ArrangeMove) -> Result<Arc<PreparedScene>, CallError> {
    let carried = from_row_major(&step.placement.placed_from_observed.0)
        .map_err(|e| CallError::internal(format!("a placement is no rigid motion: {e}")))?;
    Ok(prepared(moved(&state.scene.scene, step.object, &carried)))
}

fn prepared(scene: Scene) -> Arc<PreparedScene> {
    Arc::new(PreparedScene::new(Arc::new(scene)))
}
