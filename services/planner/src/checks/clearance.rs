//! How far a candidate keeps from everything that does not carry it: what an answer says, and what a request may ask for.
//!
//! Measured from the query's completed shape to the observed points of everything else and to the completed shapes of other objects.
//! Furniture below the query's bottom carries it, and so does the object that it stands on with all that carries that; what reaches up
//! beside the query from those (a bowl's rim, a wall) is not exempt. Other objects count at any height. Objects that a goal term asks to
//! touch do not count.

use std::collections::BTreeSet;

use crate::checks::footing::Ground;
use crate::checks::prisms::{PlacedPrisms, box_gap_m2};
use crate::scene::candidate::CandidatePose;
use crate::scene::prepared::PreparedScene;
use crate::scene::query::QueryObject;
use crate::settings::Fixed;

/// Measures the clearance of one problem's candidates.
#[derive(Debug)]
pub struct Clearance<'a> {
    prepared: &'a PreparedScene,
    query: &'a QueryObject,
    fixed: &'a Fixed,
    touched: Vec<u16>,
}

impl<'a> Clearance<'a> {
    /// `touched` are the objects that may be touched.
    pub fn new(prepared: &'a PreparedScene, query: &'a QueryObject, fixed: &'a Fixed, touched: Vec<u16>) -> Self {
        Self { prepared, query, fixed, touched }
    }

    /// The least distance from the placed query to what does not carry it, metres; none when there is nothing else.
    pub fn of(&self, candidate: &CandidatePose) -> Option<f64> {
        self.within(candidate, f64::INFINITY)
    }

    /// [`Clearance::of`] as far as it is less than `most_m`; that, or more, where it is not.
    pub fn within(&self, candidate: &CandidatePose, most_m: f64) -> Option<f64> {
        let placed = PlacedPrisms::new(&self.query.shape, candidate);
        let bounds = placed.bounds()?;
        let carriers = self.carriers(candidate);
        let counts = |id: &u16| *id != self.query.id && !self.touched.contains(id) && !carriers.contains(id);
        let shapes = self.prepared.belief.objects.iter().filter(|(id, _)| counts(id)).filter_map(|(_, o)| o.shape.as_ref());
        // Rounded upwards, so that what is at the limit is not taken to be nearer.
        let most_m = f64::from((most_m as f32).next_up());
        let to_shapes_m = shapes.map(|shape| placed.to_shape_m(shape, 0.0)).fold(most_m, f64::min) as f32;

        let floor_m = self.query.bottom_of(candidate.centroid_m[2]) + self.fixed.support.same_support_m;
        let mut nearest = Nearest::new(self.fixed.clearance.stray_points, to_shapes_m);
        for (point, label) in self.prepared.point_grid().around(&bounds, to_shapes_m) {
            // Most points are too far to look at whose they are.
            if box_gap_m2(&bounds, point) >= nearest.limit_m() * nearest.limit_m() {
                continue;
            }
            let may_carry = *label == 0 || carriers.contains(label);
            let is_beside = if may_carry { point.z > floor_m && !self.touched.contains(label) } else { counts(label) };
            if is_beside {
                nearest.see(placed.to_point_m(point));
            }
        }
        let least_m = nearest.limit_m().min(to_shapes_m);
        least_m.is_finite().then_some(f64::from(least_m))
    }

    /// The objects that carry a candidate: those under its base, and those that carry them.
    fn carriers(&self, candidate: &CandidatePose) -> BTreeSet<u16> {
        let ground = Ground { prepared: self.prepared, query: self.query, settings: &self.fixed.support };
        let mut carriers: BTreeSet<u16> = ground.objects_under(candidate).into_iter().collect();
        loop {
            let carries_one = |id: &&u16| self.prepared.belief.carried(**id).iter().any(|above| carriers.contains(above));
            let below: BTreeSet<u16> = self.prepared.belief.objects.keys().filter(carries_one).copied().collect();
            if below.is_subset(&carriers) {
                return carriers;
            }
            carriers.extend(below);
        }
    }
}

/// The smallest distances seen, so that a few stray points do not decide.
struct Nearest {
    /// Ascending.
    distances_m: Vec<f32>,
}

impl Nearest {
    /// Passes over the `strays` nearest; nothing beyond `most_m` matters.
    fn new(strays: usize, most_m: f32) -> Self {
        Self { distances_m: vec![most_m; strays + 1] }
    }

    /// The least distance that more than the strays are within, metres.
    fn limit_m(&self) -> f32 {
        self.distances_m[self.distances_m.len() - 1]
    }

    fn see(&mut self, distance_m: f32) {
        let at = self.distances_m.partition_point(|d| *d <= distance_m);
        if at < self.distances_m.len() {
            self.distances_m.pop();
            self.distances_m.insert(at, distance_m);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::synthetic::{Prepared, SceneBuilder, standing_at};

    fn clearance_m(prepared: &PreparedScene, touched: &[u16], place: [f32; 3]) -> Option<f64> {
        let fixed = Fixed::default();
        let query = QueryObject::new(prepared, 2, 0.0, &fixed).unwrap();
        let [x, y, bottom_m] = place;
        Clearance::new(prepared, &query, &fixed, touched.to_vec()).of(&standing_at(&query, x, y, bottom_m))
    }

    fn is_about(clearance_m: Option<f64>, expected_m: f64) {
        assert!(clearance_m.is_some_and(|c| (c - expected_m).abs() < 0.008), "{clearance_m:?}, not {expected_m}");
    }

    #[test]
    fn it_is_the_gap_to_the_next_thing_and_0_in_contact() {
        let prepared = SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.12]).object(2, [-0.3, -0.2], [0.06, 0.06, 0.08]).prepared();
        is_about(clearance_m(&prepared, &[], [0.13, 0.0, 0.004]), 0.05);
        is_about(clearance_m(&prepared, &[], [0.4, 0.0, 0.004]), 0.32);
        assert_eq!(clearance_m(&prepared, &[], [0.07, 0.0, 0.004]), Some(0.0));
        assert_eq!(clearance_m(&prepared, &[1], [0.13, 0.0, 0.004]), None, "the table alone is left, and carries it");
    }

    #[test]
    fn low_things_beside_it_count_and_so_does_what_stands_lower_than_it() {
        let table = || SceneBuilder::table().object(2, [-0.3, -0.2], [0.06, 0.06, 0.08]);
        let low = table().object(1, [0.0, 0.0], [0.1, 0.1, 0.011]).prepared();
        is_about(clearance_m(&low, &[], [0.13, 0.0, 0.004]), 0.05);
        // On a box 0.3 m high, with a can on the table beside it.
        let raised = table().object(1, [0.0, 0.0], [0.1, 0.1, 0.3]).object(3, [0.16, 0.0], [0.06, 0.06, 0.2]).prepared();
        is_about(clearance_m(&raised, &[], [0.0, 0.0, 0.304]), 0.143);
        assert_eq!(clearance_m(&table().object(1, [0.0, 0.0], [0.1, 0.1, 0.3]).prepared(), &[], [0.0, 0.0, 0.304]), None);
    }

    #[test]
    fn what_reaches_up_beside_it_from_its_own_carrier_counts() {
        let walled = SceneBuilder::table()
            .object(0, [0.0, 0.1], [0.4, 0.04, 0.2])
            .object(1, [0.3, -0.3], [0.05, 0.05, 0.05])
            .object(2, [-0.3, -0.2], [0.06, 0.06, 0.08])
            .prepared();
        is_about(clearance_m(&walled, &[1], [0.0, -0.05, 0.004]), 0.1);
    }

    #[test]
    fn the_rim_of_what_carries_it_counts_unless_that_is_to_be_touched() {
        let tray = SceneBuilder::table()
            .object(1, [0.0, 0.0], [0.3, 0.3, 0.02])
            .object(1, [0.0, 0.13], [0.3, 0.04, 0.08])
            .object(2, [-0.3, -0.2], [0.06, 0.06, 0.08])
            .prepared();
        is_about(clearance_m(&tray, &[], [0.0, 0.0, 0.024]), 0.08);
        assert_eq!(clearance_m(&tray, &[1], [0.0, 0.0, 0.024]), None, "the rim is of what it is to touch");
    }
}
