//! Places for objects on tables as they would be: each searched for once, within the budget of the request.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Instant;

use repose_geometry::ViewerFrame;
use repose_proto::arrange::ArrangeRequest;
use repose_proto::place::{Budget, Outcome, Placement, Rejection};
use repose_proto::{CallError, ErrorCode, GoalTerm, PlaceRequest, limits};

use crate::arrange::goals::all_hold;
use crate::arrange::surroundings::surroundings;
use crate::learned::models::PlacementModels;
use crate::plan::{SearchStep, plan};
use crate::scene::prepared::PreparedScene;
use crate::search::stop::StopReason;

/// Which limit ended a search before it was complete.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlacesEnd {
    /// As many placements as may be searched were.
    Budget,
    /// Its time.
    Time,
}

/// Tables that may be prepared for each search that may be made: a tenth as dear, and most are for searches.
const TABLES_A_SEARCH: u32 = 20;

/// Searched placements by scene or surroundings, object and terms.
type Known = BTreeMap<(String, u16, String), Arc<Vec<Placement>>>;

/// Searches for places, and what it has found out.
pub struct Places<'a> {
    request: &'a ArrangeRequest,
    viewer: ViewerFrame,
    models: &'a dyn PlacementModels,
    control: &'a mut dyn FnMut(SearchStep) -> ControlFlow<StopReason>,
    started: Instant,
    known: Known,
    /// Objects that stand nowhere by themselves.
    tipping: BTreeSet<u16>,
    searches: u32,
    /// How many may be searched for until [`Places::allow`] says otherwise.
    most_searches: u32,
    ended: Option<PlacesEnd>,
    weights_hash: String,
}

impl<'a> Places<'a> {
    /// Nothing searched yet.
    pub fn new(
        request: &'a ArrangeRequest,
        viewer: ViewerFrame,
        models: &'a dyn PlacementModels,
        control: &'a mut dyn FnMut(SearchStep) -> ControlFlow<StopReason>,
    ) -> Self {
        Self {
            request,
            viewer,
            models,
            control,
            started: Instant::now(),
            known: Known::new(),
            tipping: BTreeSet::new(),
            searches: 0,
            most_searches: request.max_searches,
            ended: None,
            weights_hash: String::new(),
        }
    }

    /// What was asked.
    pub fn request(&self) -> &'a ArrangeRequest {
        self.request
    }

    /// The viewer of all relations.
    pub fn viewer(&self) -> &ViewerFrame {
        &self.viewer
    }

    /// Whether all terms about an object hold where it stands, as they are asked of places for it.
    pub fn hold(&self, scene: &PreparedScene, object: u16, terms: &[GoalTerm]) -> bool {
        all_hold(scene, &self.viewer, self.request.variant, object, terms)
    }

    /// Placements searched for so far.
    pub fn searches(&self) -> u32 {
        self.searches
    }

    /// Lets that share of the searches that are left be made; what was ended by having made too many goes on.
    pub fn allow(&mut self, share: f64) {
        let left = self.request.max_searches.saturating_sub(self.searches);
        self.most_searches = self.searches + (f64::from(left) * share).ceil() as u32;
        self.ended = self.ended.filter(|ended| *ended != PlacesEnd::Budget);
    }

    /// Whether another table may be prepared after so many: as many as all searches that may be made are worth. Notices time that has ended, too, which
    /// leaves one more table, for a place that was found last.
    ///
    /// # Errors
    /// `cancelled`.
    pub fn allows_tables(&mut self, prepared: u32) -> Result<bool, CallError> {
        let had_ended = self.ended == Some(PlacesEnd::Time);
        match (self.control)(SearchStep::Batch) {
            ControlFlow::Break(StopReason::Cancelled) => return Err(CallError::new(ErrorCode::Cancelled, "cancelled while searching")),
            ControlFlow::Break(StopReason::Deadline) => self.ended = Some(PlacesEnd::Time),
            ControlFlow::Continue(()) if self.left_ms() == Some(0) => self.ended = Some(PlacesEnd::Time),
            ControlFlow::Continue(()) => {}
        }
        let allowed = prepared < self.most_searches.saturating_mul(TABLES_A_SEARCH);
        if !allowed && self.ended.is_none() {
            self.ended = Some(PlacesEnd::Budget);
        }
        Ok(allowed && !had_ended)
    }

    /// What ended it early, if anything.
    pub fn ended(&self) -> Option<PlacesEnd> {
        self.ended
    }

    /// The weights that answered; empty where no network was asked.
    pub fn weights_hash(&self) -> &str {
        &self.weights_hash
    }

    /// Places for an object on a table, best first; none where there is none, where too little is known of it, where it has more terms than a placement
    /// may be asked for, or where the search has ended.
    ///
    /// # Errors
    /// What the models answer, and `cancelled`.
    pub fn of(
        &mut self,
        scene: &Arc<PreparedScene>,
        object: u16,
        terms: &[GoalTerm],
        count: u32,
    ) -> Result<Arc<Vec<Placement>>, CallError> {
        let named: Vec<String> = terms.iter().map(ToString::to_string).collect();
        let table = surroundings(scene, object, terms).unwrap_or_else(|| scene.scene_id.clone());
        let key = (table, object, format!("{count} {}", named.join(",")));
        if let Some(known) = self.known.get(&key) {
            return Ok(known.clone());
        }
        // More terms than one search may have cannot be tried together, and a place that was tried for some of them is none.
        if self.tipping.contains(&object) || terms.len() > limits::MAX_GOAL_TERMS {
            return Ok(Arc::default());
        }
        let left_ms = self.left_ms();
        if left_ms == Some(0) || self.searches >= self.most_searches {
            self.ended = Some(if left_ms == Some(0) { PlacesEnd::Time } else { PlacesEnd::Budget });
            return Ok(Arc::default());
        }
        self.searches += 1;
        let request = PlaceRequest {
            view_yaw_rad: Some(self.viewer.yaw_rad()),
            count,
            rotation: self.request.rotation,
            robot: self.request.robot.clone(),
            seed: self.request.seed,
            variant: self.request.variant,
            // How sure a move must be is for the whole arrangement to weigh.
            min_success: Some(0.0),
            budget: Budget { time_ms: left_ms, ..Budget::default() },
            ..PlaceRequest::new(scene.scene_id.clone(), object, terms.to_vec())
        };
        let places = match plan(scene, &request, self.models, self.control) {
            Ok(result) => {
                let success = result.placements.first().and_then(|place| place.success);
                tracing::debug!(object, terms = %named.join(","), places = result.placements.len(), success, rejections = ?result.rejections, "searched");
                if result.rejections.keys().eq([&Rejection::Tips]) {
                    self.tipping.insert(object);
                }
                if result.outcome == Outcome::Partial && result.placements.is_empty() {
                    // It was not searched to the end: nobody knows whether there is none.
                    self.ended = Some(PlacesEnd::Time);
                }
                self.weights_hash = result.weights_hash;
                result.placements
            }
            // It carries something, or too little of it was seen: it stays where it is.
            Err(error) if error.code == ErrorCode::FailedPrecondition && error.field.as_deref() == Some("query") => Vec::new(),
            Err(error) if error.code == ErrorCode::DeadlineExceeded => {
                self.ended = Some(PlacesEnd::Time);
                Vec::new()
            }
            Err(error) => return Err(error),
        };
        let places = Arc::new(places);
        self.known.insert(key, places.clone());
        Ok(places)
    }

    /// What is left of the request's time, milliseconds; none where it has no limit.
    fn left_ms(&self) -> Option<u64> {
        self.request.time_ms.map(|ms| ms.saturating_sub(self.started.elapsed().as_millis() as u64))
    }
}

#[cfg(test)]
mod tests {
    use repose_proto::place::Variant;

    use super::*;
    use crate::learned::models::NoModels;
    use crate::tests::synthetic::{Prepared, SceneBuilder};

    #[test]
    fn a_stop_is_heard_between_tables_though_nothing_is_searched() {
        let request = ArrangeRequest::new("a scene".to_owned(), Vec::new());
        let stopping = |stop: StopReason| move |_: SearchStep| -> ControlFlow<StopReason> { ControlFlow::Break(stop) };
        let mut control = stopping(StopReason::Deadline);
        let mut places = Places::new(&request, ViewerFrame::from_yaw(0.0), &NoModels, &mut control);
        assert_eq!([0, 1].map(|prepared| places.allows_tables(prepared).unwrap()), [true, false]);
        assert_eq!(places.ended(), Some(PlacesEnd::Time));
        let mut control = stopping(StopReason::Cancelled);
        let mut places = Places::new(&request, ViewerFrame::from_yaw(0.0), &NoModels, &mut control);
        assert_eq!(places.allows_tables(0).unwrap_err().code, ErrorCode::Cancelled);
    }

    #[test]
    fn a_search_that_time_ended_without_a_place_does_not_say_that_there_is_none() {
        let scene = SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.1]).object(2, [-0.3, -0.2], [0.06, 0.06, 0.08]);
        let scene = Arc::new(scene.prepared());
        let request = ArrangeRequest { variant: Variant::Geometric, ..ArrangeRequest::new(scene.scene_id.clone(), Vec::new()) };
        let terms: Vec<GoalTerm> = ["left_of:1", "not:left_of:1"].map(|term| term.parse().unwrap()).to_vec();
        for (stops, ended) in [(false, None), (true, Some(PlacesEnd::Time))] {
            let mut control = |step: SearchStep| match step {
                SearchStep::Iteration(_) if stops => ControlFlow::Break(StopReason::Deadline),
                _ => ControlFlow::Continue(()),
            };
            let mut places = Places::new(&request, ViewerFrame::from_yaw(0.0), &NoModels, &mut control);
            assert!(places.of(&scene, 2, &terms, 1).unwrap().is_empty());
            assert_eq!(places.ended(), ended);
        }
    }
}
