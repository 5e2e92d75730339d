//! What carries a candidate, as far as it was seen: which objects, by how much of its base, and how level their tops are there.
//!
//! A footing says whether something stands; on bowls' rims and on two things at once it stands on paper only.

use std::collections::BTreeMap;

use repose_belief::columns::ColumnRun;

use crate::checks::contact::Contact;
use crate::checks::footing::Ground;
use crate::scene::candidate::CandidatePose;

/// Tops within this of the bottom are level with it, metres: less than what counts as carried.
const LEVEL_M: f32 = 0.003;
/// A thing carries from this share of the base on.
const CARRIES_SHARE: f64 = 0.03;

/// The tops under a candidate's base.
#[derive(Debug, Clone, PartialEq)]
pub struct Carriers {
    /// Share of the base over tops of each object, 0 for furniture.
    shares: BTreeMap<u16, f64>,
    /// How far inside the outline of the tops that are level with it the axis stands, metres; none without an outline.
    pub level_margin_m: Option<f64>,
    /// How much the heights of the tops vary, metres: their mean distance from their mean.
    pub spread_m: f64,
}

impl Carriers {
    /// How many things carry it.
    pub fn count(&self) -> usize {
        self.shares.values().filter(|share| **share >= CARRIES_SHARE).count()
    }

    /// Share of the base over tops of some objects.
    pub fn share_of(&self, is: impl Fn(u16) -> bool) -> f64 {
        self.shares.iter().filter(|(object, _)| is(**object)).map(|(_, share)| share).sum()
    }
}

impl Ground<'_> {
    /// What carries a candidate where it is.
    pub fn carriers(&self, candidate: &CandidatePose) -> Carriers {
        let level_m = self.query.bottom_of(candidate.centroid_m[2]) - self.settings.release_m;
        let (columns, base) = (&self.prepared.belief.columns, &self.query.base);
        let is_top =
            |run: &&ColumnRun| run.seen && run.object != self.query.id && (run.high_m - level_m).abs() <= self.settings.tolerance_m;
        let (mut cells, mut level, mut tops_m) = (BTreeMap::<u16, usize>::new(), Contact::default(), Vec::with_capacity(base.len()));
        columns.visit(base, &candidate.carrying(), |i, place, cell| {
            let Some(top) = columns.runs(cell).iter().rfind(is_top) else { return };
            *cells.entry(top.object).or_default() += 1;
            tops_m.push(f64::from(top.high_m));
            if (top.high_m - level_m).abs() <= LEVEL_M {
                level.add(base.y_m(i), place);
            }
        });
        let axis = candidate.carry(&self.query.shape.axis_offset());
        let mean = |values: &mut dyn Iterator<Item = f64>| values.sum::<f64>() / tops_m.len().max(1) as f64;
        let mean_m = mean(&mut tops_m.iter().copied());
        Carriers {
            shares: cells.into_iter().map(|(object, count)| (object, count as f64 / base.len().max(1) as f64)).collect(),
            level_margin_m: level.outline().map(|outline| f64::from(outline.margin(&axis))),
            spread_m: mean(&mut tops_m.iter().map(|top_m| (top_m - mean_m).abs())),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::query::QueryObject;
    use crate::settings::{Fixed, SupportSettings};
    use crate::tests::synthetic::{Prepared, SceneBuilder, standing_at};

    #[test]
    fn what_carries_it_is_told_by_name_and_by_how_level_it_is() {
        let scene = SceneBuilder::table()
            .object(1, [0.0, 0.1], [0.1, 0.15, 0.1])
            .object(2, [0.11, 0.1], [0.1, 0.15, 0.094])
            .object(3, [-0.3, -0.2], [0.06, 0.06, 0.08])
            .prepared();
        let query = QueryObject::new(&scene, 3, 0.0, &Fixed::default()).unwrap();
        let settings = SupportSettings::default();
        let ground = Ground { prepared: &scene, query: &query, settings: &settings };
        let at = |x: f32, bottom_m: f32| ground.carriers(&standing_at(&query, x, 0.1, bottom_m + settings.release_m));

        let table = ground.carriers(&standing_at(&query, 0.25, -0.2, settings.release_m));
        assert!(table.count() == 1 && table.share_of(|id| id == 0) > 0.5 && table.spread_m < 1e-3, "{table:?}");
        let on_one = at(0.0, 0.1);
        assert!(on_one.count() == 1 && on_one.share_of(|id| id == 1) > 0.5 && on_one.spread_m < 1e-3, "{on_one:?}");
        let on_both = at(0.055, 0.1);
        assert!(on_both.count() == 2 && on_both.share_of(|id| id == 2) > 0.05 && on_both.spread_m > 1e-3, "{on_both:?}");
        assert!(on_both.level_margin_m < on_one.level_margin_m, "only the higher one carries it: {on_both:?}, {on_one:?}");
    }
}
