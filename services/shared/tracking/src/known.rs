//! Which object is which when a camera numbers them anew: told by where they are.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Isometry3, Point3};
use repose_proto::{CallError, GoalTerm, ObjectSummary};

use crate::size::SAME_SIZE_M;

/// An object found anew is the known one that was to be nearest, up to this far away, metres.
const SAME_M: f64 = 0.08;
/// The same for one that was lost on its way, metres.
const LOST_M: f64 = 0.25;
/// By how much more one object's size must differ from what is seen than another's, so that it is sooner the other, metres.
const SOONER_M: f64 = 0.01;

/// The objects of the first view, and where each is in the newest.
pub struct Known {
    /// By the id of the first view: the id in the newest one (none when it was not found again), and its centroid.
    pub(crate) now: BTreeMap<u16, (Option<u16>, Point3<f64>)>,
}

impl Known {
    /// The objects of a first view.
    pub fn of(objects: &[ObjectSummary]) -> Self {
        Self { now: objects.iter().map(|o| (o.id, (Some(o.id), Point3::from(o.centroid_m)))).collect() }
    }

    /// A goal in the ids of the newest view. `field` names it in errors, as `{field}.query` and `{field}.goal[i].anchor`.
    ///
    /// # Errors
    /// `not_found` on an object that the first view lacks or that was not found again.
    pub fn translated(&self, field: &str, query: u16, terms: &[GoalTerm]) -> Result<(u16, Vec<GoalTerm>), CallError> {
        let find = |id: u16, field: String| match self.now.get(&id) {
            Some((Some(now), _)) => Ok(*now),
            Some((None, _)) => Err(CallError::not_found(field, format!("object {id} is not found again in the newest view"))),
            None => Err(CallError::not_found(field, format!("the first view has no object {id}"))),
        };
        let now = find(query, format!("{field}.query"))?;
        let term = |(i, t): (usize, &GoalTerm)| Ok(GoalTerm { anchor: find(t.anchor, format!("{field}.goal[{i}].anchor"))?, ..*t });
        Ok((now, terms.iter().enumerate().map(term).collect::<Result<_, CallError>>()?))
    }

    /// The id in the newest view of an object of the first; none where it was not found again.
    pub fn now(&self, id: u16) -> Option<u16> {
        self.now.get(&id).and_then(|(now, _)| *now)
    }

    /// The id in the first view of an object of the newest; none where that did not have it.
    pub fn named(&self, now: u16) -> Option<u16> {
        self.now.iter().find(|(_, (id, _))| *id == Some(now)).map(|(first, _)| *first)
    }

    /// An object of the first view was recognized in the newest one elsewhere.
    pub(crate) fn is_now(&mut self, id: u16, object: &ObjectSummary) {
        self.now.insert(id, (Some(object.id), Point3::from(object.centroid_m)));
    }

    /// An object (first view's id) was carried: it is to be where a motion put it.
    pub fn carried(&mut self, id: u16, placed_from_observed: &Isometry3<f64>) {
        if let Some((_, centroid)) = self.now.get_mut(&id) {
            *centroid = placed_from_observed * *centroid;
        }
    }

    /// Who is who in a new view, each at most so far from where it was to be. Nearest pairs first.
    pub fn look_again(&mut self, objects: &[ObjectSummary]) {
        let pairs = self.now.iter().flat_map(|(id, (_, expected))| objects.iter().map(move |o| (distance_m(o, expected), *id, o)));
        let found = nearest_first(pairs.filter(|(apart_m, ..)| *apart_m <= SAME_M).collect());
        self.now.values_mut().for_each(|(now, _)| *now = None);
        for (id, object) in found {
            self.is_now(id, object);
        }
    }

    /// Who is who in a new view, after an object (first view's id) was lost or fell: it may be some way off, among the objects that nobody is and that
    /// may be it. One of its size goes before a nearer one of another size, which may have been hidden before; but an object that lies may look smaller
    /// or larger than it did upright. `differs_m` says by how much the size of what is seen differs from that of an object (first view's id), metres.
    pub(crate) fn look_for_lost(
        &mut self,
        lost: u16,
        objects: &[ObjectSummary],
        may_be: impl Fn(&ObjectSummary) -> bool,
        differs_m: impl Fn(u16, &ObjectSummary) -> f64,
    ) {
        self.look_again(objects);
        let Some((None, expected)) = self.now.get(&lost) else { return };
        let taken: BTreeSet<u16> = self.now.values().filter_map(|(now, _)| *now).collect();
        let nobody = objects.iter().filter(|o| !taken.contains(&o.id) && may_be(o) && !self.is_sooner_another(lost, o, &differs_m));
        let near = nobody.map(|o| (distance_m(o, expected), o)).filter(|(away_m, _)| *away_m <= LOST_M);
        let is_other_size = |seen: &ObjectSummary| differs_m(lost, seen) > SAME_SIZE_M;
        let of_size_first = |a: &ObjectSummary, b: &ObjectSummary| is_other_size(a).cmp(&is_other_size(b));
        if let Some((_, found)) = near.min_by(|a, b| of_size_first(a.1, b.1).then(a.0.total_cmp(&b.0)).then(a.1.id.cmp(&b.1.id))) {
            self.is_now(lost, found);
        }
    }

    /// Whether what is seen is sooner another object that is not found again than the lost one, by its size: what goes lost may push others aside.
    fn is_sooner_another(&self, lost: u16, seen: &ObjectSummary, differs_m: impl Fn(u16, &ObjectSummary) -> f64) -> bool {
        let mut pushed = self.now.iter().filter(|(id, (now, was))| **id != lost && now.is_none() && distance_m(seen, was) <= LOST_M);
        pushed.any(|(id, _)| differs_m(*id, seen) + SOONER_M < differs_m(lost, seen))
    }
}

/// Which of the objects that are seen is which, of pairs of one (first view's id) and what it may be with how far apart they are, metres: nearest pairs
/// first, each of both once.
pub(crate) fn nearest_first(mut pairs: Vec<(f64, u16, &ObjectSummary)>) -> Vec<(u16, &ObjectSummary)> {
    pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2.id).cmp(&(b.1, b.2.id))));
    let (mut found, mut taken) = (BTreeSet::new(), BTreeSet::new());
    pairs.retain(|(_, id, seen)| {
        let is_free = !found.contains(id) && !taken.contains(&seen.id);
        is_free && found.insert(*id) && taken.insert(seen.id)
    });
    pairs.into_iter().map(|(_, id, seen)| (id, seen)).collect()
}

pub(crate) fn distance_m(object: &ObjectSummary, place: &Point3<f64>) -> f64 {
    (Point3::from(object.centroid_m) - place).norm()
}

#[cfg(test)]
mod tests {
    use repose_proto::Relation;

    use super::*;

    fn seen(id: u16, centroid_m: [f64; 3]) -> ObjectSummary {
        ObjectSummary { id, points: 100, centroid_m, extent_m: [0.1; 3], completeness: 1.0, score: None }
    }

    /// By how much edges differ from those of a first view, metres.
    fn differing(first: &[ObjectSummary]) -> impl Fn(u16, &ObjectSummary) -> f64 {
        move |id: u16, seen: &ObjectSummary| {
            let was = first.iter().find(|o| o.id == id).expect("it is of the first view");
            (seen.extent_m[0] - was.extent_m[0]).abs()
        }
    }

    #[test]
    fn objects_are_told_by_where_they_were_put_when_a_view_numbers_them_anew() {
        let mut known = Known::of(&[seen(1, [0.0, 0.0, 0.0]), seen(2, [0.3, 0.0, 0.0]), seen(3, [0.0, 0.4, 0.0])]);
        // 1 went to x = 0.5; 3 is hidden; all others have new numbers.
        let view = [seen(1, [0.31, 0.0, 0.0]), seen(2, [0.49, 0.01, 0.0]), seen(3, [0.9, 0.9, 0.0])];
        known.carried(1, &Isometry3::translation(0.5, 0.0, 0.0));
        known.look_again(&view);
        let near = |anchor: u16| [GoalTerm { relation: Relation::Near, anchor, holds: true }];
        let (query, terms) = known.translated("goals[0]", 1, &near(2)).expect("both are there");
        assert_eq!((query, terms[0].anchor), (2, 1));
        let field = |query: u16, anchor: u16| known.translated("goals[1]", query, &near(anchor)).unwrap_err().field;
        assert_eq!(field(3, 1).as_deref(), Some("goals[1].query"), "it is hidden");
        assert_eq!(field(1, 9).as_deref(), Some("goals[1].goal[0].anchor"), "there never was one");
        // A lost one may be some way off, and takes nobody else's place.
        let view = [seen(7, [0.0, 0.2, 0.0]), seen(2, [0.49, 0.01, 0.0]), seen(1, [0.31, 0.0, 0.0])];
        known.look_for_lost(3, &view, |_| true, |_, _| 0.0);
        assert_eq!(known.translated("goals[1]", 3, &near(2)).expect("it is found").0, 7);
    }

    #[test]
    fn what_a_lost_object_has_pushed_aside_is_not_taken_for_it() {
        let sized = |id: u16, x_m: f64, edge_m: f64| ObjectSummary { extent_m: [edge_m; 3], ..seen(id, [x_m, 0.0, 0.0]) };
        // 1 rolled off the table, and pushed 2 by 10 cm.
        let first = [sized(1, 0.0, 0.06), sized(2, 0.1, 0.1)];
        let mut known = Known::of(&first);
        known.look_for_lost(1, &[sized(5, 0.2, 0.1)], |_| true, differing(&first));
        assert_eq!((known.now(1), known.now(2)), (None, None), "2 was pushed farther than it is looked for");
        // Here it was 1 that rolled as far, and 2 is hidden.
        let mut known = Known::of(&first);
        known.look_for_lost(1, &[sized(5, 0.2, 0.06)], |_| true, differing(&first));
        assert_eq!((known.now(1), known.now(2)), (Some(5), None));
        // Those that are as large may be either: the lost one is.
        let first = [sized(1, 0.0, 0.06), sized(2, 0.1, 0.06)];
        let mut known = Known::of(&first);
        known.look_for_lost(1, &[sized(5, 0.2, 0.061)], |_| true, differing(&first));
        assert_eq!((known.now(1), known.now(2)), (Some(5), None));
    }

    #[test]
    fn of_two_that_came_to_light_the_one_of_its_size_is_the_lost_one_though_the_other_is_nearer() {
        let sized = |id: u16, x_m: f64, edge_m: f64| ObjectSummary { extent_m: [edge_m; 3], ..seen(id, [x_m, 0.0, 0.0]) };
        let found = |strangers: &[ObjectSummary]| {
            let first = [sized(1, 0.0, 0.06)];
            let mut known = Known::of(&first);
            known.look_for_lost(1, strangers, |_| true, differing(&first));
            known.now(1)
        };
        // 4 stood behind it.
        assert_eq!(found(&[sized(4, 0.1, 0.15), sized(5, 0.2, 0.06)]), Some(5));
        assert_eq!(found(&[sized(4, 0.1, 0.15)]), Some(4), "where there is no other, it may look otherwise from here");
    }
}
