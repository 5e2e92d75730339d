//! Which object is which when a camera numbers them anew: told by where they are.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Point3};
use repose_proto::{CallError, GoalTerm, ObjectSummary};

/// An object found anew is the known one that was to be nearest, up to this far away, metres.
const SAME_M: f64 = 0.08;
/// The same for one that was lost on its way, metres.
const LOST_M: f64 = 0.25;

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

    /// Who is who in a new view. Nearest pairs first.
    pub fn look_again(&mut self, objects: &[ObjectSummary]) {
        self.matched(objects, |_| SAME_M);
    }

    /// Who is who in a new view, after an object (first view's id) was lost or fell: it may be some way off.
    pub fn look_for_lost(&mut self, lost: u16, objects: &[ObjectSummary]) {
        self.matched(objects, |id| if id == lost { LOST_M } else { SAME_M });
    }

    /// Who is who in a new view, each at most so far from where it was to be.
    fn matched(&mut self, objects: &[ObjectSummary], within_m: impl Fn(u16) -> f64) {
        let mut pairs: Vec<(f64, u16, usize)> = Vec::new();
        for (id, (_, expected)) in &self.now {
            let distance = |o: &ObjectSummary| (Point3::from(o.centroid_m) - expected).norm();
            pairs.extend(objects.iter().enumerate().map(|(k, o)| (distance(o), *id, k)).filter(|p| p.0 <= within_m(*id)));
        }
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.2).cmp(&(b.1, b.2))));
        let mut taken = vec![false; objects.len()];
        let mut found: BTreeMap<u16, usize> = BTreeMap::new();
        for (_, id, k) in pairs {
            if !taken[k] && !found.contains_key(&id) {
                taken[k] = true;
                found.insert(id, k);
            }
        }
        for (id, (now, centroid)) in &mut self.now {
            *now = found.get(id).map(|k| objects[*k].id);
            if let Some(k) = found.get(id) {
                *centroid = Point3::from(objects[*k].centroid_m);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use repose_proto::Relation;

    use super::*;

    fn seen(id: u16, centroid_m: [f64; 3]) -> ObjectSummary {
        ObjectSummary { id, points: 100, centroid_m, extent_m: [0.1; 3], completeness: 1.0, score: None }
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
        known.look_for_lost(3, &[seen(7, [0.0, 0.2, 0.0]), seen(2, [0.49, 0.01, 0.0]), seen(1, [0.31, 0.0, 0.0])]);
        assert_eq!(known.translated("goals[1]", 3, &near(2)).expect("it is found").0, 7);
    }
}
