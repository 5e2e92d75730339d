//! What became of objects between two views: they stand, were moved, fell, are hidden, or are gone.
//!
//! Not to be found where it was means one of two things, and the depth picture tells which: where the camera now looks through the place to
//! what is behind it, the object is gone from there; where something nearer covers the place, or nothing is read, it may well stand there
//! still. What is gone is looked for among the objects that nobody knows, by its size.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Isometry3, Point3};
use repose_proto::{CallError, GoalTerm, ObjectSummary, Scene};
use serde::Serialize;

use crate::known::Known;
use crate::picture::{DepthPicture, Reading};

/// Points of an object that are looked at.
const POINTS: usize = 300;
/// A share of the readings that decides what became of an object.
const MOST: f64 = 0.5;
/// Readings that are needed to say that something is gone.
const ENOUGH: usize = 12;
/// From here on an object was moved, metres: a centroid shifts by as much where another part of the object is seen.
const MOVED_M: f64 = 0.03;
/// From here on it fell, metres.
const FELL_M: f64 = 0.03;
/// Edge lengths of one object in two views differ by at most this much, metres.
const SAME_SIZE_M: f64 = 0.03;

/// What became of an object.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "fate")]
pub enum Fate {
    /// It stands where it was to be.
    Stands,
    /// It stands elsewhere.
    Moved {
        /// How far from where it was to be, metres.
        by_m: f64,
    },
    /// It lies lower than it was to be.
    Fell {
        /// How much lower, metres.
        by_m: f64,
    },
    /// Something covers the place where it was to be: it may be there.
    Hidden,
    /// The place where it was to be is empty, and nothing of its size is seen elsewhere.
    Gone,
}

/// The objects of a first view, followed from view to view.
pub struct Followed {
    known: Known,
    /// By the id of the first view: where its points are to be, and its edge lengths in ascending order.
    expected: BTreeMap<u16, (Vec<Point3<f64>>, [f64; 3])>,
}

impl Followed {
    /// The objects of a first view.
    pub fn of(scene: &Scene) -> Self {
        let expected = scene.meta.objects.iter().map(|o| (o.id, (points_of(scene, o.id), edges_of(o)))).collect();
        Self { known: Known::of(&scene.meta.objects), expected }
    }

    /// Who is who; see [`Known`].
    pub fn known(&self) -> &Known {
        &self.known
    }

    /// A goal in the ids of the newest view; see [`Known::translated`].
    ///
    /// # Errors
    /// As [`Known::translated`].
    pub fn translated(&self, field: &str, query: u16, terms: &[GoalTerm]) -> Result<(u16, Vec<GoalTerm>), CallError> {
        self.known.translated(field, query, terms)
    }

    /// Looks at a new view, after `moved` (first view's id and its motion), if any: what became of each object, by the id of the first view.
    pub fn look_again(&mut self, moved: Option<(u16, Isometry3<f64>)>, scene: &Scene) -> BTreeMap<u16, Fate> {
        if let Some((id, placed_from_observed)) = moved
            && let Some((points, _)) = self.expected.get_mut(&id)
        {
            points.iter_mut().for_each(|p| *p = placed_from_observed * *p);
        }
        self.known.look_again(moved, &scene.meta.objects);
        let picture = DepthPicture::of(scene);
        let mut fates: BTreeMap<u16, Fate> = BTreeMap::new();
        for (id, (points, _)) in &self.expected {
            let fate = match self.known.now(*id) {
                Some(now) => displaced(points, &points_of(scene, now)),
                None if picture.as_ref().is_some_and(|picture| is_empty(points, picture)) => Fate::Gone,
                None => Fate::Hidden,
            };
            fates.insert(*id, fate);
        }
        for (id, fate) in self.found_elsewhere(&fates, scene) {
            fates.insert(id, fate);
        }
        for (id, (points, edges)) in &mut self.expected {
            let seen = self.known.now(*id).and_then(|now| scene.object(now).map(|o| (points_of(scene, now), edges_of(o))));
            // One that is seen worse than before keeps what was known of it.
            if let Some((now, now_edges)) = seen.filter(|(now, _)| fates.get(id) != Some(&Fate::Stands) || now.len() >= points.len()) {
                (*points, *edges) = (now, now_edges);
            }
        }
        fates
    }

    /// Looks for those that are gone among the objects that nobody is, nearest pairs first; they are those from now on.
    fn found_elsewhere(&mut self, fates: &BTreeMap<u16, Fate>, scene: &Scene) -> BTreeMap<u16, Fate> {
        let taken: BTreeSet<u16> = self.expected.keys().filter_map(|id| self.known.now(*id)).collect();
        let strangers: Vec<&ObjectSummary> = scene.meta.objects.iter().filter(|o| !taken.contains(&o.id)).collect();
        let mut pairs: Vec<(f64, u16, Point3<f64>, &ObjectSummary)> = Vec::new();
        for (id, (points, edges)) in self.expected.iter().filter(|(id, _)| fates.get(id) == Some(&Fate::Gone)) {
            let fits = |o: &&&ObjectSummary| edges_of(o).iter().zip(edges).all(|(a, b)| (a - b).abs() <= SAME_SIZE_M);
            let Some(was) = middle(points) else { continue };
            pairs.extend(strangers.iter().filter(fits).map(|o| ((Point3::from(o.centroid_m) - was).norm(), *id, was, *o)));
        }
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0).then((a.1, a.3.id).cmp(&(b.1, b.3.id))));
        let mut found: BTreeMap<u16, Fate> = BTreeMap::new();
        let mut recognized: BTreeSet<u16> = BTreeSet::new();
        for (_, id, was, stranger) in pairs {
            if !found.contains_key(&id) && recognized.insert(stranger.id) {
                found.insert(id, apart(&was, &Point3::from(stranger.centroid_m)));
                self.known.is_now(id, stranger);
            }
        }
        found
    }
}

/// Whether what was read where the points were to be is behind them: nothing is there.
fn is_empty(points: &[Point3<f64>], picture: &DepthPicture) -> bool {
    let (mut read, mut through) = (0usize, 0usize);
    for reading in points.iter().map(|p| picture.reading(p)) {
        read += usize::from(reading != Reading::None);
        through += usize::from(reading == Reading::Behind);
    }
    read >= ENOUGH.min(points.len()) && through as f64 > MOST * points.len() as f64
}

/// How far points are from where they were to be; a part of them may be covered, so that what is compared is where both were seen.
fn displaced(expected: &[Point3<f64>], seen: &[Point3<f64>]) -> Fate {
    const TOUCH_M: f64 = 0.02;
    let near = |p: &&Point3<f64>| expected.iter().any(|e| (*e - **p).norm() <= TOUCH_M);
    let standing = seen.iter().filter(near).count() as f64 > MOST * seen.len() as f64;
    match (middle(expected), middle(seen)) {
        (Some(was), Some(is)) if !standing => apart(&was, &is),
        _ => Fate::Stands,
    }
}

fn apart(was: &Point3<f64>, is: &Point3<f64>) -> Fate {
    let (by_m, lower_m) = ((is - was).norm(), was.z - is.z);
    match by_m {
        _ if lower_m >= FELL_M => Fate::Fell { by_m: lower_m },
        by_m if by_m >= MOVED_M => Fate::Moved { by_m },
        _ => Fate::Stands,
    }
}

fn middle(points: &[Point3<f64>]) -> Option<Point3<f64>> {
    let sum: nalgebra::Vector3<f64> = points.iter().map(|p| p.coords).sum();
    (!points.is_empty()).then(|| Point3::from(sum / points.len() as f64))
}

/// Some of an object's points, spread over its cloud.
fn points_of(scene: &Scene, id: u16) -> Vec<Point3<f64>> {
    let all: Vec<Point3<f64>> = scene.points_of(id).map(|p| Point3::from(p).cast()).collect();
    all.iter().step_by(all.len().div_ceil(POINTS).max(1)).copied().collect()
}

fn edges_of(object: &ObjectSummary) -> [f64; 3] {
    let mut edges = object.extent_m;
    edges.sort_by(f64::total_cmp);
    edges
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::{Block, block, scene_of};

    /// A view from above and before the table.
    fn view(blocks: &[(u16, [f64; 3])]) -> Scene {
        scene_of(&blocks.iter().map(|(id, at)| block(*id, *at)).collect::<Vec<_>>())
    }

    #[test]
    fn what_stands_is_told_from_what_was_moved_fell_or_is_gone() {
        let first = view(&[(1, [-0.2, 0.0, 0.0]), (2, [0.0, 0.0, 0.0]), (3, [0.2, 0.0, 0.1]), (4, [0.2, 0.2, 0.0])]);
        let mut followed = Followed::of(&first);
        // 2 was pushed, 3 came down, 4 was taken away; the camera numbers them anew.
        let fates = followed.look_again(None, &view(&[(7, [-0.2, 0.0, 0.0]), (8, [0.0, 0.12, 0.0]), (9, [0.22, 0.02, 0.0])]));
        assert_eq!(fates[&1], Fate::Stands);
        assert!(matches!(fates[&2], Fate::Moved { by_m } if (by_m - 0.12).abs() < 0.03), "{fates:?}");
        assert!(matches!(fates[&3], Fate::Fell { by_m } if (by_m - 0.1).abs() < 0.03), "{fates:?}");
        assert_eq!(fates[&4], Fate::Gone);
        let term = [GoalTerm { relation: repose_proto::Relation::Near, anchor: 1, holds: true }];
        assert_eq!(followed.translated("goals[0]", 3, &term).expect("it is known where it lies").0, 9);
    }

    #[test]
    fn what_something_covers_is_hidden_and_found_again_where_it_was() {
        // The camera looks along +y: a wall before object 2.
        let mut followed = Followed::of(&view(&[(1, [-0.3, 0.0, 0.0]), (2, [0.0, 0.1, 0.0])]));
        let wall = Block { label: 0, min: [-0.1, -0.15, 0.0], max: [0.1, -0.1, 0.3] };
        let covered = scene_of(&[block(1, [-0.3, 0.0, 0.0]), wall]);
        assert_eq!(followed.look_again(None, &covered)[&2], Fate::Hidden);
        let again = followed.look_again(None, &view(&[(5, [-0.3, 0.0, 0.0]), (6, [0.0, 0.1, 0.0])]));
        assert_eq!((again[&1], again[&2]), (Fate::Stands, Fate::Stands));
    }

    #[test]
    fn what_was_carried_is_looked_for_where_it_was_put() {
        let mut followed = Followed::of(&view(&[(1, [-0.2, 0.0, 0.0]), (2, [0.1, 0.0, 0.0])]));
        let put = Isometry3::translation(0.1, 0.2, 0.0);
        let fates = followed.look_again(Some((1, put)), &view(&[(1, [-0.1, 0.2, 0.0]), (2, [0.1, 0.0, 0.0])]));
        assert_eq!((fates[&1], fates[&2]), (Fate::Stands, Fate::Stands));
    }
}
