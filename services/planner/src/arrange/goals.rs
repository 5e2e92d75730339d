//! The goals of an arrangement, and what they ask of one object when some of the others do not stand where they will.

use std::collections::{BTreeMap, BTreeSet};

use repose_geometry::ViewerFrame;
use repose_proto::GoalTerm;
use repose_proto::arrange::ObjectGoal;
use repose_proto::place::Variant;

use crate::checks::rules::Rules;
use crate::scene::prepared::PreparedScene;
use crate::settings::{Recipe, RuleSettings};

/// What shall hold at the end, by object.
#[derive(Debug, Clone)]
pub struct Goals {
    terms: BTreeMap<u16, Vec<GoalTerm>>,
    order: Vec<u16>,
}

impl Goals {
    /// Of a request, in its order.
    pub fn new(goals: &[ObjectGoal]) -> Self {
        Self {
            terms: goals.iter().map(|goal| (goal.object, goal.terms.clone())).collect(),
            order: goals.iter().map(|goal| goal.object).collect(),
        }
    }

    /// Whether an object has a goal of its own.
    pub fn has(&self, object: u16) -> bool {
        self.terms.contains_key(&object)
    }

    /// The objects with goals, in the order in which they were asked for.
    pub fn objects(&self) -> &[u16] {
        &self.order
    }

    /// The objects that an object waits for, directly or through others: those of its terms that do not stand yet, those of theirs, and so on.
    pub fn waits_for(&self, object: u16, unsettled: &BTreeSet<u16>) -> BTreeSet<u16> {
        let mut found = BTreeSet::new();
        let mut open = vec![object];
        while let Some(waiting) = open.pop() {
            let terms = self.terms.get(&waiting).into_iter().flatten();
            open.extend(terms.map(|t| t.anchor).filter(|anchor| unsettled.contains(anchor) && found.insert(*anchor)));
        }
        found
    }

    /// Whether nothing is asked yet of an object or of anyone whom it waits for, and all of these wait for it in turn: one of such a circle
    /// must stay where it is, for the others to be placed by it.
    pub fn waits_in_circle(&self, object: u16, unsettled: &BTreeSet<u16>) -> bool {
        let asked = |other: u16| {
            let others = unsettled.iter().copied().filter(|o| *o != other).collect();
            !self.of(other, &others).is_empty()
        };
        !asked(object) && self.waits_for(object, unsettled).into_iter().all(|o| !asked(o) && self.waits_for(o, unsettled).contains(&object))
    }

    /// What a place of an object must satisfy: its own terms, and turned about those of others about it, each as far as the other stands. They may
    /// be more than a request for a placement may have.
    pub fn of(&self, object: u16, unsettled: &BTreeSet<u16>) -> Vec<GoalTerm> {
        let own = self.terms.get(&object).into_iter().flatten().filter(|t| !unsettled.contains(&t.anchor)).copied();
        let others = self.terms.iter().filter(|(other, _)| **other != object && !unsettled.contains(other));
        let about = others.flat_map(|(other, terms)| {
            let about = terms.iter().filter(|t| t.anchor == object);
            about.map(|t| GoalTerm { relation: t.relation.converse(), anchor: *other, holds: t.holds })
        });
        let mut all: Vec<GoalTerm> = Vec::new();
        for term in own.chain(about) {
            if !all.contains(&term) {
                all.push(term);
            }
        }
        all
    }

    /// Whether the terms about an object hold of all others that stand where they will, as `holds` tells of one of them and its terms. A place of the
    /// object may satisfy their converse and break them: what is to be above the object must also be over it, where `below` asks nothing like that.
    pub fn hold_about(&self, object: u16, unsettled: &BTreeSet<u16>, holds: impl Fn(u16, &[GoalTerm]) -> bool) -> bool {
        let mut others = self.terms.iter().filter(|(other, _)| **other != object && !unsettled.contains(other));
        others.all(|(other, terms)| {
            let about: Vec<GoalTerm> = terms.iter().filter(|t| t.anchor == object).copied().collect();
            about.is_empty() || holds(*other, &about)
        })
    }

    /// The objects of which some term does not hold as things stand.
    pub fn unmet(&self, scene: &PreparedScene, viewer: &ViewerFrame, variant: Variant) -> BTreeSet<u16> {
        self.order.iter().copied().filter(|object| !all_hold(scene, viewer, variant, *object, &self.terms[object])).collect()
    }

    /// The objects whose goals have a term about an object.
    pub fn about(&self, object: u16) -> impl Iterator<Item = u16> + '_ {
        self.terms.iter().filter(move |(_, terms)| terms.iter().any(|t| t.anchor == object)).map(|(other, _)| *other)
    }
}

/// Whether all terms about an object hold as things stand: by the rules on completed shapes that a variant's placements are judged by. Nothing
/// holds of what is not there, or of which too little was seen.
pub fn all_hold(scene: &PreparedScene, viewer: &ViewerFrame, variant: Variant, object: u16, terms: &[GoalTerm]) -> bool {
    let goal_by = Recipe::of(variant).goal_by;
    Rules::new(scene, object, terms, viewer, &RuleSettings::default()).is_ok_and(|rules| rules.hold_as_observed(goal_by))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::synthetic::{Prepared, SceneBuilder};

    fn goals(texts: &[(u16, &[&str])]) -> Goals {
        let goal =
            |(object, terms): &(u16, &[&str])| ObjectGoal { object: *object, terms: terms.iter().map(|t| t.parse().unwrap()).collect() };
        Goals::new(&texts.iter().map(goal).collect::<Vec<_>>())
    }

    #[test]
    fn terms_about_what_does_not_stand_yet_wait_and_are_asked_of_the_other_later() {
        let goals = goals(&[(2, &["left_of:3", "near:4"]), (3, &["behind:4"])]);
        let named = |object, unsettled: &[u16]| {
            let terms = goals.of(object, &unsettled.iter().copied().collect());
            terms.iter().map(ToString::to_string).collect::<Vec<_>>()
        };
        assert_eq!(named(2, &[3]), ["near:4"]);
        assert_eq!(named(3, &[]), ["behind:4", "right_of:2"]);
        assert_eq!(named(3, &[2]), ["behind:4"]);
        assert_eq!(named(4, &[2]), ["in_front_of:3"]);
    }

    #[test]
    fn no_term_is_passed_over_however_many_there_are() {
        const BESIDE: &[&str] = &["near:1", "not:aligned:1"];
        let mut asked: Vec<(u16, &[&str])> = (2..12).map(|object| (object, BESIDE)).collect();
        asked.push((1, &["left_of:20"]));
        assert_eq!(goals(&asked).of(1, &BTreeSet::new()).len(), 21);
    }

    #[test]
    fn what_stands_high_beside_an_anchor_is_above_it_only_where_places_beside_it_are() {
        let scene = SceneBuilder::table()
            .object(1, [0.0, 0.0], [0.1, 0.1, 0.1])
            .object(3, [0.15, 0.0], [0.12, 0.12, 0.32])
            .object_at(2, [0.15, 0.0], 0.32, [0.06, 0.06, 0.06])
            .object_at(4, [0.0, 0.0], 0.1, [0.06, 0.06, 0.06])
            .prepared();
        let terms = ["above:1".parse().unwrap()];
        let holds = |variant, object| all_hold(&scene, &ViewerFrame::from_yaw(0.0), variant, object, &terms);
        assert!(holds(Variant::Geometric, 2) && !holds(Variant::Best, 2), "best places over the anchor only");
        assert!(holds(Variant::Geometric, 4) && holds(Variant::Best, 4));
    }

    #[test]
    fn a_circle_is_told_from_those_who_wait_for_it() {
        let goals = goals(&[(1, &["left_of:2"]), (2, &["near:1"]), (3, &["behind:2"]), (4, &["near:9"])]);
        let unsettled: BTreeSet<u16> = [1, 2, 3, 4].into();
        assert_eq!(goals.waits_for(3, &unsettled), [1, 2].into());
        let in_circle: Vec<u16> = unsettled.iter().copied().filter(|o| goals.waits_in_circle(*o, &unsettled)).collect();
        assert_eq!(in_circle, [1, 2]);
        // Once one of them stands, the other has something to go by.
        assert!(!goals.waits_in_circle(1, &[1, 3].into()));
    }
}
