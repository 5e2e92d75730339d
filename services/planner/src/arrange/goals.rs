//! The goals of an arrangement, and what they ask of one object when some of the others do not stand where they will.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Point3;
use repose_geometry::ViewerFrame;
use repose_proto::arrange::ObjectGoal;
use repose_proto::{GoalTerm, limits};
use repose_relations::{ObservedObject, observed};

use crate::scene::prepared::PreparedScene;

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

    /// How many of an object's own terms are about objects that do not stand yet.
    pub fn waiting(&self, object: u16, unsettled: &BTreeSet<u16>) -> usize {
        self.terms.get(&object).map_or(0, |terms| terms.iter().filter(|t| unsettled.contains(&t.anchor)).count())
    }

    /// What a place of an object must satisfy: its own terms, and turned about those of others about it, each as far as the other stands.
    pub fn of(&self, object: u16, unsettled: &BTreeSet<u16>) -> Vec<GoalTerm> {
        let own = self.terms.get(&object).into_iter().flatten().filter(|t| !unsettled.contains(&t.anchor)).copied();
        let others = self.terms.iter().filter(|(other, _)| **other != object && !unsettled.contains(other));
        let about = others.flat_map(|(other, terms)| {
            let about = terms.iter().filter(|t| t.anchor == object);
            about.map(|t| GoalTerm { relation: t.relation.converse(), anchor: *other, holds: t.holds })
        });
        let mut all: Vec<GoalTerm> = Vec::new();
        for term in own.chain(about) {
            if !all.contains(&term) && all.len() < limits::MAX_GOAL_TERMS {
                all.push(term);
            }
        }
        all
    }

    /// The objects of which some term does not hold as things stand, by rule on what was seen.
    pub fn unmet(&self, scene: &PreparedScene, viewer: &ViewerFrame) -> BTreeSet<u16> {
        self.order.iter().copied().filter(|object| !all_hold(scene, viewer, *object, &self.terms[object])).collect()
    }

    /// The objects whose goals have a term about an object.
    pub fn about(&self, object: u16) -> impl Iterator<Item = u16> + '_ {
        self.terms.iter().filter(move |(_, terms)| terms.iter().any(|t| t.anchor == object)).map(|(other, _)| *other)
    }
}

/// Whether all terms about an object hold as things stand, by rule on what was seen.
pub fn all_hold(scene: &PreparedScene, viewer: &ViewerFrame, object: u16, terms: &[GoalTerm]) -> bool {
    let cloud = |id: u16| {
        let points: Vec<Point3<f32>> = scene.objects.get(&id).map(|o| o.points.clone()).unwrap_or_default();
        ObservedObject::new(&points, viewer)
    };
    let Some(moved) = cloud(object) else { return false };
    terms.iter().all(|t| cloud(t.anchor).is_some_and(|anchor| observed(&moved, &anchor)[t.relation.index()] == t.holds))
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
