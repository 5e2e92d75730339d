//! The objects of a first view, followed from view to view: who is who, and what became of each. What is gone is looked for among the objects that nobody
//! knows, by its size.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Isometry3, Point3};
use repose_proto::{CallError, GoalTerm, ObjectSummary, Scene};

use crate::fate::{Fate, Reach, apart, are_near, displaced, is_covered, is_empty, meet, middle, points_of, reach};
use crate::known::{Known, distance_m, nearest_first};
use crate::picture::DepthPicture;
use crate::size::{SAME_SIZE_M, Size};

/// The objects of a first view, followed from view to view.
///
/// What became of them counts from when something was last [carried out](Self::carried), over all looks since: one that was moved stays told
/// when it stands, or is hidden, in the next look. Of one that was never told it counts from the first view.
pub struct Followed {
    known: Known,
    /// By the id of the first view.
    objects: BTreeMap<u16, Object>,
}

/// An object that is followed.
struct Object {
    /// Where its points were to be when something was last carried out.
    expected: Vec<Point3<f64>>,
    /// Where they were seen last, some of so many.
    seen: Vec<Point3<f64>>,
    seen_of: usize,
    /// What became of it since something was last carried out.
    fate: Fate,
}

impl Followed {
    /// The objects of a first view.
    pub fn of(scene: &Scene) -> Self {
        let object = |o: &ObjectSummary| {
            let points = points_of(scene, o.id);
            Object { expected: points.clone(), seen: points, seen_of: o.points, fate: Fate::Stands }
        };
        Self { known: Known::of(&scene.meta.objects), objects: scene.meta.objects.iter().map(|o| (o.id, object(o))).collect() }
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

    /// The objects that do not stand where they were to be, by the id of the first view, as all looks since something was last carried out say.
    pub fn disturbed(&self) -> BTreeMap<u16, Fate> {
        self.objects.iter().map(|(id, object)| (*id, object.fate)).filter(|(_, fate)| *fate != Fate::Stands).collect()
    }

    /// Something was carried out: an object (first view's id; none where that did not have it) is to be where a motion put it. Every other that was told
    /// as disturbed is to be where it was seen last, and the rest where it was to be before: shifts that are each too small to be told add up. What is
    /// gone stays so until it is found.
    pub fn carried(&mut self, id: Option<u16>, placed_from_observed: &Isometry3<f64>) {
        for object in self.objects.values_mut().filter(|object| object.fate != Fate::Stands) {
            object.expected.clone_from(&object.seen);
            // What is gone does not come back because something else was carried.
            if object.fate != Fate::Gone {
                object.fate = Fate::Stands;
            }
        }
        let Some(id) = id else { return };
        self.known.carried(id, placed_from_observed);
        if let Some(object) = self.objects.get_mut(&id) {
            object.fate = Fate::Stands;
            object.expected.iter_mut().chain(&mut object.seen).for_each(|p| *p = placed_from_observed * *p);
        }
    }

    /// Looks at a new view after an execution that was to move one object (first view's id): where it put it, or none where it was not placed.
    pub fn look_after_moving(&mut self, id: u16, placed_from_observed: Option<&Isometry3<f64>>, scene: &Scene) {
        match placed_from_observed {
            Some(motion) => {
                self.carried(Some(id), motion);
                self.look_again(scene);
            }
            None => {
                self.carried(None, &Isometry3::identity());
                self.look_for_lost(id, scene);
            }
        }
    }

    /// Looks at a new view.
    pub fn look_again(&mut self, scene: &Scene) {
        self.known.look_again(&scene.meta.objects);
        self.judge(scene);
    }

    /// Looks at a new view after an object (first view's id) was lost or fell: it may be some way off. Where something covers the place where it was to
    /// be, it may well stand there, and nothing but an object of its size is taken for it.
    pub fn look_for_lost(&mut self, lost: u16, scene: &Scene) {
        let picture = DepthPicture::of(scene);
        let place = self.objects.get(&lost).zip(picture.as_ref());
        let may_be_covered = place.is_some_and(|(object, picture)| is_covered(&object.seen, picture));
        let known_sizes: BTreeMap<u16, Size> = self.objects.iter().map(|(id, object)| (*id, Size::of(&object.seen))).collect();
        let sizes: BTreeMap<u16, Size> = scene.meta.objects.iter().map(|o| (o.id, Size::of(&points_of(scene, o.id)))).collect();
        let differs_m = |id: u16, seen: &ObjectSummary| match (known_sizes.get(&id), sizes.get(&seen.id)) {
            (Some(was), Some(is)) => was.differs_m(is),
            _ => f64::INFINITY,
        };
        let may_be = |stranger: &ObjectSummary| !may_be_covered || differs_m(lost, stranger) <= SAME_SIZE_M;
        self.known.look_for_lost(lost, &scene.meta.objects, may_be, differs_m);
        self.judge(scene);
    }

    /// Says what became of each object, once it is known who is who.
    fn judge(&mut self, scene: &Scene) {
        let picture = DepthPicture::of(scene);
        self.look_in_place(scene, picture.as_ref());
        for (id, object) in &mut self.objects {
            object.fate = match (self.known.now(*id), object.fate) {
                (Some(now), _) => displaced(&object.expected, &points_of(scene, now), picture.as_ref()),
                (None, _) if picture.as_ref().is_some_and(|picture| is_empty(&object.seen, picture)) => Fate::Gone,
                // It may still be where it was last seen; and what was gone from its place does not come back because something covers that.
                (None, fate @ (Fate::Moved { .. } | Fate::Fell { .. } | Fate::Gone)) => fate,
                (None, _) => Fate::Hidden,
            };
        }
        self.look_elsewhere(scene);
        for (id, object) in &mut self.objects {
            let Some((now, summary)) = self.known.now(*id).and_then(|now| Some((points_of(scene, now), scene.object(now)?))) else {
                continue;
            };
            // One that is seen worse than before keeps what was known of it.
            if object.fate != Fate::Stands || summary.points >= object.seen_of {
                (object.seen, object.seen_of) = (now, summary.points);
            }
        }
    }

    /// Looks for those that are not found by their middles where they were seen last, among the objects that nobody is, nearest pairs first: the middle of
    /// what is seen of something wide is elsewhere once more or less of it is covered, but one of the two is then where a part of the other is.
    fn look_in_place(&mut self, scene: &Scene, picture: Option<&DepthPicture>) {
        if self.objects.keys().all(|id| self.known.now(*id).is_some()) {
            return;
        }
        let strangers = self.strangers(scene);
        let clouds: Vec<Vec<Point3<f64>>> = strangers.iter().map(|o| points_of(scene, o.id)).collect();
        let reaches: Vec<Reach> = clouds.iter().map(|points| reach(points)).collect();
        let mut pairs = Vec::new();
        for (id, object) in self.objects.iter().filter(|(id, _)| self.known.now(**id).is_none()) {
            let Some(was) = middle(&object.seen).filter(|_| !picture.is_some_and(|picture| is_empty(&object.seen, picture))) else {
                continue;
            };
            let own = reach(&object.seen);
            let is_there =
                |k: &usize| meet(&own, &reaches[*k]) && (are_near(&clouds[*k], &object.seen) || are_near(&object.seen, &clouds[*k]));
            let there = (0..strangers.len()).filter(is_there).map(|k| strangers[k]);
            pairs.extend(there.map(|o| (distance_m(o, &was), *id, o)));
        }
        for (id, stranger) in nearest_first(pairs) {
            self.known.is_now(id, stranger);
        }
    }

    /// The objects of a view that nobody is.
    fn strangers<'s>(&self, scene: &'s Scene) -> Vec<&'s ObjectSummary> {
        let taken: BTreeSet<u16> = self.objects.keys().filter_map(|id| self.known.now(*id)).collect();
        scene.meta.objects.iter().filter(|o| !taken.contains(&o.id)).collect()
    }

    /// Looks for those that are gone among the objects that nobody is, nearest pairs first; they are those from now on.
    fn look_elsewhere(&mut self, scene: &Scene) {
        if self.objects.values().all(|object| object.fate != Fate::Gone) {
            return;
        }
        let strangers = self.strangers(scene).into_iter().map(|o| (o, Size::of(&points_of(scene, o.id))));
        let strangers: Vec<(&ObjectSummary, Size)> = strangers.collect();
        let mut pairs = Vec::new();
        for (id, object) in self.objects.iter().filter(|(_, object)| object.fate == Fate::Gone && !object.expected.is_empty()) {
            let Some(was) = middle(&object.seen) else { continue };
            let size = Size::of(&object.seen);
            let alike = strangers.iter().filter(|(_, other)| size.differs_m(other) <= SAME_SIZE_M);
            pairs.extend(alike.map(|(o, _)| (distance_m(o, &was), *id, *o)));
        }
        for (id, stranger) in nearest_first(pairs) {
            if let Some(object) = self.objects.get_mut(&id)
                && let Some(was) = middle(&object.expected)
            {
                object.fate = apart(&was, &Point3::from(stranger.centroid_m));
                self.known.is_now(id, stranger);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;
    use repose_geometry::{Aabb, cloud};

    use super::*;
    use crate::tests::{Block, block, scene_of};

    /// A view from above and before the table.
    fn view(blocks: &[(u16, [f64; 3])]) -> Scene {
        scene_of(&blocks.iter().map(|(id, at)| block(*id, *at)).collect::<Vec<_>>())
    }

    fn fates<const N: usize>(followed: &Followed, ids: [u16; N]) -> [Fate; N] {
        let disturbed = followed.disturbed();
        ids.map(|id| disturbed.get(&id).copied().unwrap_or(Fate::Stands))
    }

    #[test]
    fn what_stands_is_told_from_what_was_moved_fell_or_is_gone() {
        let first = view(&[(1, [-0.2, 0.0, 0.0]), (2, [0.0, 0.0, 0.0]), (3, [0.2, 0.0, 0.1]), (4, [0.2, 0.2, 0.0])]);
        let mut followed = Followed::of(&first);
        // 2 was pushed, 3 came down, 4 was taken away; the camera numbers them anew.
        followed.look_again(&view(&[(7, [-0.2, 0.0, 0.0]), (8, [0.0, 0.12, 0.0]), (9, [0.22, 0.02, 0.0])]));
        let [stands, pushed, fell, gone] = fates(&followed, [1, 2, 3, 4]);
        assert_eq!((stands, gone), (Fate::Stands, Fate::Gone));
        assert!(matches!(pushed, Fate::Moved { by_m } if (by_m - 0.12).abs() < 0.03), "{pushed:?}");
        assert!(matches!(fell, Fate::Fell { by_m } if (by_m - 0.1).abs() < 0.03), "{fell:?}");
        let term = [GoalTerm { relation: repose_proto::Relation::Near, anchor: 1, holds: true }];
        assert_eq!(followed.translated("goals[0]", 3, &term).expect("it is known where it lies").0, 9);
    }

    #[test]
    fn what_something_covers_is_hidden_and_found_again_where_it_was() {
        // The camera looks along +y: a wall before object 2.
        let mut followed = Followed::of(&view(&[(1, [-0.3, 0.0, 0.0]), (2, [0.0, 0.1, 0.0])]));
        let wall = Block { label: 0, min: [-0.1, -0.15, 0.0], max: [0.1, -0.1, 0.3] };
        followed.look_again(&scene_of(&[block(1, [-0.3, 0.0, 0.0]), wall]));
        assert_eq!(fates(&followed, [1, 2]), [Fate::Stands, Fate::Hidden]);
        followed.look_again(&view(&[(5, [-0.3, 0.0, 0.0]), (6, [0.0, 0.1, 0.0])]));
        assert_eq!(followed.disturbed(), BTreeMap::new());
    }

    #[test]
    fn what_is_gone_is_not_hidden_by_what_comes_before_its_place_and_is_found_elsewhere() {
        let [stays, wall] = [block(1, [-0.3, 0.0, 0.0]), Block { label: 0, min: [-0.1, -0.15, 0.0], max: [0.1, -0.1, 0.3] }];
        let mut followed = Followed::of(&view(&[(1, [-0.3, 0.0, 0.0]), (2, [0.0, 0.1, 0.0])]));
        followed.look_again(&scene_of(&[stays]));
        assert_eq!(fates(&followed, [1, 2]), [Fate::Stands, Fate::Gone]);
        // The robot set something down since.
        followed.carried(Some(1), &Isometry3::identity());
        followed.look_again(&scene_of(&[stays, wall]));
        assert_eq!(fates(&followed, [1, 2]), [Fate::Stands, Fate::Gone], "its place was seen to be empty");
        followed.look_again(&scene_of(&[stays, wall, block(7, [0.3, 0.1, 0.0])]));
        assert!(matches!(fates(&followed, [2]), [Fate::Moved { .. }]), "{:?}", followed.disturbed());
        assert_eq!(followed.known().now(2), Some(7));
    }

    #[test]
    fn what_was_partly_covered_for_a_while_is_known_by_its_whole_size_afterwards() {
        let at = |x_m: f64| scene_of(&[Block { label: 1, min: [x_m - 0.025, -0.025, 0.0], max: [x_m + 0.025, 0.025, 0.1] }]);
        let whole = at(0.0);
        // Its lower half is hidden: of two thirds of its points more are looked at than of all.
        let shown = whole.points.iter().zip(&whole.labels).filter(|(p, label)| **label != 1 || p[2] > 0.05);
        let (points, labels): (Vec<[f32; 3]>, Vec<u16>) = shown.map(|(p, label)| (*p, *label)).unzip();
        let mut covered = Scene { points, labels, ..whole.clone() };
        let left = covered.points_of(1).count();
        (covered.meta.objects[0].points, covered.meta.objects[0].extent_m) = (left, [0.05, 0.05, 0.05]);
        assert!(left < whole.meta.objects[0].points && points_of(&covered, 1).len() > points_of(&whole, 1).len());
        let mut followed = Followed::of(&whole);
        followed.look_again(&covered);
        assert_eq!(followed.disturbed(), BTreeMap::new());
        followed.look_again(&at(0.25));
        assert!(matches!(fates(&followed, [1]), [Fate::Moved { .. }]), "{:?}", followed.disturbed());
    }

    #[test]
    fn what_is_low_is_gone_once_it_was_taken_away_and_found_elsewhere() {
        let low = |label: u16, x_m: f64| Block { label, min: [x_m - 0.07, -0.035, 0.0], max: [x_m + 0.07, 0.035, 0.009] };
        let mut followed = Followed::of(&scene_of(&[low(1, 0.0)]));
        followed.look_again(&scene_of(&[low(0, 0.0)]));
        assert_eq!(fates(&followed, [1]), [Fate::Hidden], "it lies there, and was not told from the table");
        followed.look_again(&scene_of(&[]));
        assert_eq!(fates(&followed, [1]), [Fate::Gone]);
        followed.look_again(&scene_of(&[low(5, 0.3)]));
        let told = fates(&followed, [1]);
        assert!(matches!(told, [Fate::Moved { by_m }] if (by_m - 0.3).abs() < 0.01), "{told:?}");
        assert_eq!(followed.known().now(1), Some(5));
    }

    #[test]
    fn what_was_pushed_and_turned_is_found_by_its_size() {
        let first = scene_of(&[Block { label: 1, min: [-0.08, -0.025, 0.0], max: [0.08, 0.025, 0.05] }]);
        let motion = Isometry3::new(Vector3::new(0.2, 0.0, 0.0), Vector3::z() * 40f64.to_radians());
        let turned: Vec<Point3<f32>> = first.points_of(1).map(|p| (motion * Point3::from(p).cast::<f64>()).cast::<f32>()).collect();
        let beside = |others: &[Block]| {
            let mut scene = scene_of(others);
            scene.points.extend(turned.iter().map(|p| <[f32; 3]>::from(*p)));
            scene.labels.resize(scene.points.len(), 9);
            let centroid_m = cloud::centroid(&turned).expect("it is seen").into();
            let extent_m = Aabb::of(&turned).expect("it is seen").extent().cast::<f64>().into();
            scene.meta.objects.push(ObjectSummary { id: 9, points: turned.len(), centroid_m, extent_m, completeness: 1.0, score: None });
            scene
        };
        let is_found = |followed: &Followed| matches!(fates(followed, [1]), [Fate::Moved { .. }]) && followed.known().now(1) == Some(9);
        let mut followed = Followed::of(&first);
        followed.look_again(&beside(&[]));
        assert!(is_found(&followed), "{:?}", followed.disturbed());
        // What came to light nearer by is as large as the box along the world's axes that goes around it now.
        let wide = Block { label: 5, min: [-0.22, -0.07, 0.0], max: [-0.09, 0.07, 0.05] };
        let mut followed = Followed::of(&first);
        followed.look_for_lost(1, &beside(&[wide]));
        assert!(is_found(&followed), "{:?}", followed.disturbed());
    }

    #[test]
    fn what_was_carried_is_looked_for_where_it_was_put() {
        let mut followed = Followed::of(&view(&[(1, [-0.2, 0.0, 0.0]), (2, [0.1, 0.0, 0.0])]));
        followed.carried(Some(1), &Isometry3::translation(0.1, 0.2, 0.0));
        followed.look_again(&view(&[(1, [-0.1, 0.2, 0.0]), (2, [0.1, 0.0, 0.0])]));
        assert_eq!(followed.disturbed(), BTreeMap::new());
    }

    #[test]
    fn what_was_moved_stays_told_until_something_else_is_carried_out() {
        let mut followed = Followed::of(&view(&[(1, [-0.3, 0.0, 0.0]), (2, [0.0, 0.1, 0.0])]));
        let pushed = view(&[(1, [-0.3, 0.0, 0.0]), (2, [0.06, 0.1, 0.0])]);
        let is_told =
            |followed: &Followed| matches!(fates(followed, [1, 2]), [Fate::Stands, Fate::Moved { by_m }] if (by_m - 0.06).abs() < 0.02);
        followed.look_again(&pushed);
        assert!(is_told(&followed), "{:?}", followed.disturbed());
        let wall = Block { label: 0, min: [-0.05, -0.15, 0.0], max: [0.15, -0.1, 0.3] };
        followed.look_again(&scene_of(&[block(1, [-0.3, 0.0, 0.0]), wall]));
        assert!(is_told(&followed), "it may be where it was pushed to: {:?}", followed.disturbed());
        followed.look_again(&pushed);
        assert!(is_told(&followed), "{:?}", followed.disturbed());
        followed.carried(Some(1), &Isometry3::identity());
        followed.look_again(&pushed);
        assert_eq!(followed.disturbed(), BTreeMap::new(), "where it stands now is where it is to be");
    }

    #[test]
    fn what_is_seen_whole_once_something_is_out_of_its_way_has_not_moved() {
        // 1 hides two thirds of 2 and is set down elsewhere: the middle of what is seen of 2 shifts by 7 cm.
        let wide = Block { label: 2, min: [-0.09, 0.08, 0.0], max: [0.09, 0.14, 0.08] };
        let before = |x_m: f64| Block { label: 1, min: [x_m, -0.08, 0.0], max: [x_m + 0.165, -0.02, 0.3] };
        let mut followed = Followed::of(&scene_of(&[wide, before(-0.13)]));
        followed.carried(Some(1), &Isometry3::translation(-0.3, 0.0, 0.0));
        followed.look_again(&scene_of(&[wide, before(-0.43)]));
        assert_eq!(followed.disturbed(), BTreeMap::new());
    }

    #[test]
    fn what_is_wide_stands_where_it_is_however_much_of_it_is_covered() {
        // Three quarters of 2 are hidden or not: the middle of what is seen of it shifts by 15 cm.
        let wide = Block { label: 2, min: [-0.2, 0.08, 0.0], max: [0.2, 0.14, 0.08] };
        let wall = Block { label: 0, min: [-0.22, -0.08, 0.0], max: [0.08, -0.02, 0.3] };
        let (whole, covered) = (scene_of(&[wide]), scene_of(&[wide, wall]));
        let shift_m = covered.meta.objects[0].centroid_m[0] - whole.meta.objects[0].centroid_m[0];
        assert!(shift_m > 0.1, "{shift_m}");
        for (before, after) in [(&whole, &covered), (&covered, &whole)] {
            let mut followed = Followed::of(before);
            followed.look_again(after);
            assert_eq!((followed.disturbed(), followed.known().now(2)), (BTreeMap::new(), Some(2)));
        }
        // Of what stands at its end now that it is away nothing is taken for it.
        let mut followed = Followed::of(&whole);
        followed.look_again(&scene_of(&[Block { label: 9, min: [0.12, 0.08, 0.0], max: [0.18, 0.14, 0.08] }]));
        assert_eq!((fates(&followed, [2]), followed.known().now(2)), ([Fate::Gone], None));
    }

    #[test]
    fn what_is_large_has_moved_when_it_was_pushed_by_less_than_half_its_length() {
        let large = |x_m: f64| Block { label: 1, min: [x_m - 0.15, -0.05, 0.0], max: [x_m + 0.15, 0.05, 0.08] };
        let mut followed = Followed::of(&scene_of(&[large(0.0)]));
        followed.look_again(&scene_of(&[large(0.06)]));
        let told = fates(&followed, [1]);
        assert!(matches!(told, [Fate::Moved { by_m }] if (by_m - 0.06).abs() < 0.01), "{told:?}");
        // What hides one end of 2 is set down before the other end.
        let wide = Block { label: 2, min: [-0.12, 0.08, 0.0], max: [0.12, 0.14, 0.08] };
        let before = |x_m: f64| Block { label: 1, min: [x_m, -0.08, 0.0], max: [x_m + 0.1, -0.02, 0.3] };
        let mut followed = Followed::of(&scene_of(&[wide, before(-0.16)]));
        followed.carried(Some(1), &Isometry3::translation(0.22, 0.0, 0.0));
        followed.look_again(&scene_of(&[wide, before(0.06)]));
        assert_eq!(followed.disturbed(), BTreeMap::new());
    }

    #[test]
    fn what_was_turned_round_stands_where_it_was_put_though_it_shows_its_back() {
        let tall = |[x, y]: [f64; 2]| Block { label: 1, min: [x - 0.04, y - 0.04, 0.0], max: [x + 0.04, y + 0.04, 0.2] };
        let about_z = Vector3::z() * std::f64::consts::PI;
        let after = |x_m: f64| {
            let mut followed = Followed::of(&scene_of(&[tall([-0.2, 0.0])]));
            // To x = 0.15, y = 0.05.
            followed.carried(Some(1), &Isometry3::new(Vector3::new(-0.05, 0.05, 0.0), about_z));
            followed.look_again(&scene_of(&[tall([x_m, 0.05])]));
            fates(&followed, [1])[0]
        };
        assert_eq!(after(0.15), Fate::Stands);
        assert!(matches!(after(0.19), Fate::Moved { .. }), "{:?}", after(0.19));
    }

    #[test]
    fn what_is_tall_has_fallen_when_it_sank_by_less_than_half_its_height() {
        let upright = |bottom_m: f64| Block { label: 1, min: [-0.03, -0.18, bottom_m], max: [0.03, -0.12, bottom_m + 0.2] };
        let below = Block { label: 0, min: [-0.03, -0.18, 0.0], max: [0.03, -0.12, 0.06] };
        let mut followed = Followed::of(&scene_of(&[upright(0.06), below]));
        followed.look_again(&scene_of(&[upright(0.0)]));
        let told = fates(&followed, [1]);
        assert!(matches!(told, [Fate::Fell { by_m }] if (by_m - 0.06).abs() < 0.01), "{told:?}");
    }

    #[test]
    fn what_was_put_behind_something_is_not_taken_for_another_thing_that_came_to_light() {
        let wall = Block { label: 0, min: [-0.1, -0.05, 0.0], max: [0.1, 0.0, 0.3] };
        let after = |stranger: Block| {
            let mut followed = Followed::of(&scene_of(&[block(1, [0.25, -0.1, 0.0]), wall]));
            followed.carried(Some(1), &Isometry3::translation(-0.25, 0.25, 0.0));
            followed.look_for_lost(1, &scene_of(&[wall, stranger]));
            (followed.known().now(1), fates(&followed, [1])[0])
        };
        assert_eq!(after(Block { label: 5, min: [-0.27, 0.09, 0.0], max: [-0.15, 0.21, 0.05] }), (None, Fate::Hidden));
        let (now, fate) = after(block(5, [-0.18, 0.15, 0.0]));
        assert!(now == Some(5) && matches!(fate, Fate::Moved { .. }), "it rolled there: {fate:?}");
    }
}
