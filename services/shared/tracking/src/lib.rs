//! Which object is which from view to view, and whether what was asked holds in a view.
//!
//! A camera that finds its objects anew numbers them anew. Goals that are carried out one after another name objects as in the first view;
//! [`Known`] tells them by where they are: the moved one where it was put, every other where it was. [`changes`] says what is different in a
//! second view, [`holds`] judges goal terms by rule.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Point3};
use repose_geometry::ViewerFrame;
use repose_proto::{CallError, GoalTerm, ObjectSummary, Scene};
use repose_relations::{ObservedObject, observed};

/// An object found anew is the known one that was to be nearest, up to this far away, metres.
const SAME_M: f64 = 0.08;
/// The same for one that was lost on its way, metres.
const LOST_M: f64 = 0.25;

/// The objects of the first view, and where each is in the newest.
pub struct Known {
    /// By the id of the first view: the id in the newest one (none when it was not found again), and its centroid.
    now: BTreeMap<u16, (Option<u16>, Point3<f64>)>,
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

    /// Who is who in a new view, after `moved` (first view's id and its motion), if any. Nearest pairs first.
    pub fn look_again(&mut self, moved: Option<(u16, Isometry3<f64>)>, objects: &[ObjectSummary]) {
        if let Some((id, placed_from_observed)) = moved
            && let Some((_, centroid)) = self.now.get_mut(&id)
        {
            *centroid = placed_from_observed * *centroid;
        }
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

/// What has become of an object between two views.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Change {
    /// It stands elsewhere.
    Moved {
        /// Its id in the first view.
        id: u16,
        /// How far its centroid has moved, metres.
        by_m: f64,
    },
    /// It is not found near where it was.
    Gone {
        /// Its id in the first view.
        id: u16,
    },
    /// Something is there that was not.
    New {
        /// Its id in the second view.
        id: u16,
    },
}

impl std::fmt::Display for Change {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Moved { id, by_m } => write!(f, "object {id} has moved by {:.0} mm", by_m * 1e3),
            Self::Gone { id } => write!(f, "object {id} is not where it was"),
            Self::New { id } => write!(f, "there is an object (now {id}) that was not there"),
        }
    }
}

/// What is different in a second view of a scene that nobody should have touched; centroids up to `still_m` apart are the same place.
pub fn changes(before: &[ObjectSummary], after: &[ObjectSummary], still_m: f64) -> Vec<Change> {
    let mut known = Known::of(before);
    known.look_again(None, after);
    let mut changes = Vec::new();
    for object in before {
        let found = known.now.get(&object.id).and_then(|(now, centroid)| now.map(|_| centroid));
        match found.map(|now| (now - Point3::from(object.centroid_m)).norm()) {
            Some(by_m) if by_m > still_m => changes.push(Change::Moved { id: object.id, by_m }),
            Some(_) => {}
            None => changes.push(Change::Gone { id: object.id }),
        }
    }
    let found: Vec<u16> = known.now.values().filter_map(|(now, _)| *now).collect();
    changes.extend(after.iter().filter(|o| !found.contains(&o.id)).map(|o| Change::New { id: o.id }));
    changes
}

/// Each term by rule on what is seen, for a viewer who looks along `view_yaw_rad`. A term about an object that is not seen does not hold.
pub fn holds(scene: &Scene, view_yaw_rad: f64, query: u16, terms: &[GoalTerm]) -> Vec<bool> {
    let viewer = ViewerFrame::from_yaw(view_yaw_rad);
    let object = |id: u16| ObservedObject::new(&scene.points_of(id).map(Point3::from).collect::<Vec<_>>(), &viewer);
    let moved = object(query);
    let term = |t: &GoalTerm| match (&moved, object(t.anchor)) {
        (Some(moved), Some(anchor)) => observed(moved, &anchor)[t.relation.index()] == t.holds,
        _ => false,
    };
    terms.iter().map(term).collect()
}

#[cfg(test)]
mod tests {
    use repose_proto::{CameraModel, Relation, SceneMeta, scene::WorldFrame};

    use super::*;

    fn seen(id: u16, centroid_m: [f64; 3]) -> ObjectSummary {
        ObjectSummary { id, points: 100, centroid_m, extent_m: [0.1; 3], completeness: 1.0, score: None }
    }

    #[test]
    fn objects_are_told_by_where_they_were_put_when_a_view_numbers_them_anew() {
        let mut known = Known::of(&[seen(1, [0.0, 0.0, 0.0]), seen(2, [0.3, 0.0, 0.0]), seen(3, [0.0, 0.4, 0.0])]);
        // 1 went to x = 0.5; 3 is hidden; all others have new numbers.
        let view = [seen(1, [0.31, 0.0, 0.0]), seen(2, [0.49, 0.01, 0.0]), seen(3, [0.9, 0.9, 0.0])];
        known.look_again(Some((1, Isometry3::translation(0.5, 0.0, 0.0))), &view);
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

    #[test]
    fn what_somebody_touched_between_two_views_is_told() {
        let before = [seen(1, [0.0, 0.0, 0.0]), seen(2, [0.3, 0.0, 0.0]), seen(3, [0.0, 0.4, 0.0])];
        let same = [seen(2, [0.002, 0.0, 0.0]), seen(1, [0.3, 0.001, 0.0]), seen(3, [0.0, 0.4, 0.003])];
        assert_eq!(changes(&before, &same, 0.01), [], "other numbers and a camera's noise are no change");
        let touched = [seen(1, [0.0, 0.0, 0.0]), seen(2, [0.3, 0.05, 0.0]), seen(4, [0.9, 0.4, 0.0])];
        let told = changes(&before, &touched, 0.01);
        assert!(
            matches!(told[..], [Change::Moved { id: 2, by_m }, Change::Gone { id: 3 }, Change::New { id: 4 }] if (by_m - 0.05).abs() < 1e-9),
            "{told:?}"
        );
    }

    #[test]
    fn terms_are_judged_on_what_is_seen() {
        let block =
            |x: f32, id: u16| (0..64).map(move |i| ([x + (i % 4) as f32 * 0.02, (i / 4 % 4) as f32 * 0.02, (i / 16) as f32 * 0.02], id));
        let (points, labels) = block(-0.5, 1).chain(block(0.0, 2)).unzip();
        let camera = CameraModel { width: 4, height: 4, fx: 4.0, fy: 4.0, cx: 2.0, cy: 2.0, depth_unit_m: 0.001, world_from_camera: None };
        let meta = SceneMeta {
            objects: Vec::new(),
            surfaces: Vec::new(),
            camera,
            world_frame: WorldFrame::Extrinsics,
            view_yaw_rad: 0.0,
            unseen: repose_proto::Unseen::default(),
            left_out: Vec::new(),
            warnings: Vec::new(),
        };
        let scene = Scene { camera_name: "front".to_owned(), stamp_ns: 0, points, labels, colors: None, meta };
        let term = |relation: Relation, holds: bool| GoalTerm { relation, anchor: 2, holds };
        let terms = [term(Relation::LeftOf, true), term(Relation::RightOf, true), term(Relation::Near, false)];
        assert_eq!(holds(&scene, 0.0, 1, &terms), [true, false, true]);
        assert_eq!(holds(&scene, 0.0, 9, &terms[..1]), [false], "what is not seen is not said to hold");
    }
}
