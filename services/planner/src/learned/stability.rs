//! How likely an object stays where it is released: the outcome network's probability combined with what geometry measures of the place.
//!
//! The network sees points, and tells only roughly that an object hangs above a table or is half inside something. Geometry measures that,
//! but knows nothing of shapes beyond its guess. Boosted trees on both predict better than either and are calibrated. They are fitted on
//! releases in training scenes, at draws of the prior and at the planner's places (`repose train --network stability`), and are part of the
//! weights ([`crate::learned::forecast`]).

use crate::checks::footing::{Footing, Ground};
use crate::checks::obstruction::{Obstruction, obstruction};
use crate::checks::unseen::unseen_share;
use crate::checks::visibility::view_miss;
use crate::scene::candidate::CandidatePose;
use crate::scene::prepared::PreparedScene;
use crate::scene::query::QueryObject;
use crate::settings::Fixed;
use repose_belief::view::Visibility;

/// The number of measures.
pub const COUNT: usize = 30;

/// The measure that is the outcome network's answer; all others are geometry's.
pub const NETWORK: usize = 0;

/// A measure: its name, and how it is computed from a place.
type Measure = (&'static str, fn(&Place<'_>) -> f64);

/// The measures, in the order that the trees read: lengths in metres, shares from 0 to 1, flags 0 or 1.
const MEASURES: [Measure; COUNT] = [
    // The outcome network's probability.
    ("network", |p| p.network),
    // How far it drops onto tops that reach at most so far above its bottom; negative: how deep it is in them.
    ("drop_onto_low", |p| f64::from(p.low.drop_m)),
    ("drop", |p| f64::from(p.settled.drop_m)),
    ("drop_onto_high", |p| f64::from(p.high.drop_m)),
    // Lowered onto those: how far its axis is inside the edge of its support, and how much of its base is carried.
    ("margin_low", |p| p.low.margin()),
    ("carried_low", |p| p.low.footing.carried_share),
    ("margin", |p| p.settled.margin()),
    ("carried", |p| p.settled.footing.carried_share),
    ("seen", |p| p.settled.footing.seen_share),
    ("on_object", |p| p.settled.on_object()),
    ("margin_high", |p| p.high.margin()),
    ("carried_high", |p| p.high.footing.carried_share),
    ("on_high_object", |p| p.high.on_object()),
    // The band around its base that is carried too.
    ("rim", |p| p.rim_share),
    // How much of its space is filled: as it is, lowered, and a little above that; and where its unseen back may reach.
    ("colliding", |p| p.here.colliding_share),
    ("colliding_settled", |p| p.there.colliding_share),
    ("colliding_lifted", |p| p.lifted.colliding_share),
    ("doubtful", |p| p.there.doubtful_share),
    // How far everything else is.
    ("clearance", |p| p.here.clearance_m),
    // Its volume in space that was not seen; its points that would be seen, and that are in the picture.
    ("unseen", |p| p.unseen_share),
    ("unhidden", |p| p.view.unhidden),
    ("in_picture", |p| p.view.in_picture),
    // The object: its height, how far inside its base its axis is and how far the base reaches, the areas of its base and its widest part,
    // square metres, and the share of its lowest part in that.
    ("height", |p| f64::from(p.query.shape.top_m - p.query.shape.bottom_m)),
    ("base_margin", |p| p.query.base_margin_m),
    ("base_reach", |p| p.base_reach_m()),
    ("base_area", |p| p.area_m2(p.query.base.len())),
    ("foot_share", |p| p.query.prisms.first().map_or(1.0, |foot| foot.inside as f64 / p.widest_cells() as f64)),
    ("widest_area", |p| p.area_m2(p.widest_cells())),
    // How far its unseen back may reach; how many points of it were seen.
    ("back_unknown", |p| f64::from(p.query.shape.doubt.norm())),
    ("points", |p| p.points),
];

/// The names of the measures, in the order that the trees read.
pub fn names() -> Vec<&'static str> {
    MEASURES.iter().map(|(name, _)| *name).collect()
}

/// Drops and distances from the edge are cut here, metres: more is as bad.
const FAR_M: f32 = 0.1;
/// Tops that reach at most so far above its bottom may carry it, metres: hardly into it, a little, and a lot.
const INTO_M: [f32; 3] = [0.01, 0.03, 0.08];

/// Where a candidate would come to rest.
#[derive(Debug, Clone, Copy)]
struct Rest {
    /// How far below the candidate, metres; negative above it.
    drop_m: f32,
    footing: Footing,
}

impl Rest {
    /// Lowered onto what reaches at most so far above the candidate's bottom, in the order of [`INTO_M`].
    fn all(ground: &Ground<'_>, candidate: &CandidatePose) -> [Self; 3] {
        let bottom_m = ground.query.bottom_of(candidate.centroid_m[2]);
        let drop_m = |into_m: f32| {
            let rest_m = ground.rest_m(candidate, bottom_m + into_m);
            rest_m.map_or(FAR_M, |rest_m| (bottom_m - (rest_m - ground.settings.release_m)).min(FAR_M))
        };
        let at = |drop_m: f32| Self { drop_m, footing: ground.footing(&lowered(candidate, drop_m)) };
        // Most often all of them are one place, and a footing is the costliest measure.
        let [low_m, settled_m, high_m] = INTO_M.map(drop_m);
        let low = at(low_m);
        let settled = if settled_m == low_m { low } else { at(settled_m) };
        let high = if high_m == settled_m { settled } else { at(high_m) };
        [low, settled, high]
    }

    fn margin(&self) -> f64 {
        self.footing.margin_or_far_m().max(-f64::from(FAR_M))
    }

    fn on_object(&self) -> f64 {
        f64::from(u8::from(self.footing.carrier.is_some_and(|carrier| carrier != 0)))
    }
}

fn lowered(candidate: &CandidatePose, by_m: f32) -> CandidatePose {
    let mut at = *candidate;
    at.centroid_m[2] -= by_m;
    at
}

/// A candidate with everything that the measures read.
struct Place<'a> {
    prepared: &'a PreparedScene,
    query: &'a QueryObject,
    network: f64,
    low: Rest,
    settled: Rest,
    high: Rest,
    rim_share: f64,
    here: Obstruction,
    there: Obstruction,
    lifted: Obstruction,
    unseen_share: f64,
    view: Visibility,
    points: f64,
}

impl<'a> Place<'a> {
    fn new(prepared: &'a PreparedScene, query: &'a QueryObject, candidate: &CandidatePose, outcome: f32, fixed: &Fixed) -> Self {
        let ground = Ground { prepared, query, settings: &fixed.support };
        let [low, settled, high] = Rest::all(&ground, candidate);
        let at = lowered(candidate, settled.drop_m);
        let in_way = |c: &CandidatePose| obstruction(prepared, query, c, &[], &fixed.clearance, &fixed.support);
        Self {
            prepared,
            query,
            network: f64::from(outcome),
            low,
            settled,
            high,
            rim_share: ground.rim_share(&at),
            here: in_way(candidate),
            there: in_way(&at),
            lifted: in_way(&lowered(candidate, settled.drop_m - fixed.support.release_m)),
            unseen_share: unseen_share(prepared.scene.meta.unseen.space.as_ref(), query, candidate, &fixed.unseen),
            view: view_miss(&prepared.belief.view, query, candidate, &fixed.view).0,
            points: prepared.belief.objects.get(&query.id).map_or(0.0, |o| o.points.len() as f64),
        }
    }

    fn base_reach_m(&self) -> f64 {
        let axis = self.query.shape.axis_offset();
        self.query.base.iter().map(|cell| f64::from((cell - axis).norm())).fold(0.0, f64::max)
    }

    fn widest_cells(&self) -> usize {
        self.query.prisms.iter().map(|p| p.inside).max().unwrap_or(0).max(1)
    }

    fn area_m2(&self, cells: usize) -> f64 {
        cells as f64 * f64::from(self.prepared.belief.columns.cell_m()).powi(2)
    }
}

/// The measures of a candidate, in the order of their names; all finite. `outcome` is the outcome network's probability.
pub fn measures(prepared: &PreparedScene, query: &QueryObject, candidate: &CandidatePose, outcome: f32, fixed: &Fixed) -> [f32; COUNT] {
    let place = Place::new(prepared, query, candidate, outcome, fixed);
    MEASURES.map(|(_, of)| of(&place) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::forecasts;
    use crate::tests::synthetic::{Prepared, SceneBuilder, standing_at};

    #[test]
    fn what_is_measured_is_what_it_is_called() {
        let prepared =
            SceneBuilder::table().object(1, [0.0, 0.1], [0.15, 0.15, 0.1]).object(2, [-0.3, -0.2], [0.06, 0.06, 0.08]).prepared();
        let fixed = Fixed::default();
        let query = QueryObject::new(&prepared, 2, 0.0, &fixed).unwrap();
        let of = |name: &str, x: f32, y: f32, bottom_m: f32| {
            let measured = measures(&prepared, &query, &standing_at(&query, x, y, bottom_m), 0.25, &fixed);
            measured[MEASURES.iter().position(|(m, _)| *m == name).unwrap()]
        };
        let is = |value: f32, expected: f32, within: f32| assert!((value - expected).abs() < within, "{value}, not {expected}");
        assert_eq!(of("network", 0.25, 0.0, 0.004), 0.25);
        is(of("drop", 0.25, 0.0, 0.05), 0.05, 0.005);
        is(of("drop", 0.25, 0.0, -0.02), -0.02, 0.005);
        is(of("drop", 0.9, 0.0, 0.05), 0.1, 1e-6);
        // Five centimetres into the box: it stands on the table beneath, or on the box.
        is(of("drop", 0.0, 0.1, 0.05), 0.05, 0.005);
        is(of("drop_onto_high", 0.0, 0.1, 0.05), -0.05, 0.005);
        assert_eq!((of("colliding", 0.25, 0.0, 0.004), of("on_high_object", 0.0, 0.1, 0.05)), (0.0, 1.0));
        assert!(of("colliding", 0.0, 0.1, 0.05) > 0.5 && of("colliding_settled", 0.0, 0.1, 0.05) > 0.5);
        assert!(of("margin", 0.55, 0.0, 0.004) < 0.0 && of("margin", 0.25, 0.0, 0.004) > 0.02);
        assert!(of("rim", 0.25, 0.0, 0.004) > 0.95 && of("rim", 0.49, 0.0, 0.004) < 0.9);
        assert_eq!((of("on_object", 0.0, 0.1, 0.104), of("on_object", 0.25, 0.0, 0.004)), (1.0, 0.0));
        assert!(of("clearance", 0.14, 0.1, 0.004) < 0.05 && of("clearance", 0.14, 0.1, 0.004) > 0.01);
        is(of("height", 0.25, 0.0, 0.004), 0.08, 0.006);
        is(of("base_area", 0.25, 0.0, 0.004), 0.0036, 0.0012);
        is(of("base_reach", 0.25, 0.0, 0.004), 0.042, 0.01);
        is(of("foot_share", 0.25, 0.0, 0.004), 1.0, 0.2);
        assert!(of("seen", 0.25, 0.0, 0.004) > 0.9 && of("in_picture", 0.25, 0.0, 0.004) > 0.9 && of("points", 0.25, 0.0, 0.004) > 50.0);
    }

    #[test]
    fn what_stands_is_likelier_to_stay_than_what_hangs_sinks_or_overhangs() {
        let prepared =
            SceneBuilder::table().object(1, [0.0, 0.1], [0.15, 0.15, 0.1]).object(2, [-0.3, -0.2], [0.06, 0.06, 0.08]).prepared();
        let fixed = Fixed::default();
        let query = QueryObject::new(&prepared, 2, 0.0, &fixed).unwrap();
        let stays = |x: f32, y: f32, bottom_m: f32| {
            forecasts().stability.of(&measures(&prepared, &query, &standing_at(&query, x, y, bottom_m), 0.7, &fixed))
        };
        let stands = stays(0.25, 0.0, 0.004);
        assert!(stands > 0.8, "{stands}");
        for (other, what) in
            [(stays(0.25, 0.0, 0.12), "hangs"), (stays(0.0, 0.1, 0.05), "is in the box"), (stays(0.5, 0.0, 0.004), "overhangs")]
        {
            assert!(other < stands - 0.1, "{what}: {other}, standing {stands}");
        }
    }
}
