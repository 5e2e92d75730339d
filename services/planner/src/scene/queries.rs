//! What was prepared of a scene and its objects for earlier requests: requests on a scene come in bursts, most of them about the same few objects.

use std::convert::Infallible;
use std::sync::Arc;

use repose_belief::view::OutlineEnds;
use repose_proto::CallError;

use crate::scene::point_grid::PointGrid;
use crate::scene::prepared::PreparedScene;
use crate::scene::query::QueryObject;
use crate::scene::traits::StandingTraits;
use crate::settings::Fixed;

/// Queries kept: some hundred kilobytes each.
const KEPT: usize = 8;

/// What a query was made with.
#[derive(Debug, PartialEq)]
struct QueryKey {
    id: u16,
    min_clearance_m: f64,
    fixed: Fixed,
}

/// The object whose place was read.
#[derive(Debug, PartialEq)]
struct TraitsKey(u16);

/// The scene's points by place.
#[derive(Debug, PartialEq)]
struct PointsKey;

/// The object of whose outline is known what it ends at.
#[derive(Debug, PartialEq)]
struct EndsKey(u16);

impl PreparedScene {
    /// [`QueryObject::new`], made once while it is kept.
    ///
    /// # Errors
    /// As that.
    pub fn query(&self, id: u16, min_clearance_m: f64, fixed: &Fixed) -> Result<Arc<QueryObject>, CallError> {
        let key = QueryKey { id, min_clearance_m, fixed: fixed.clone() };
        self.kept.of(KEPT, key, || QueryObject::new(self, id, min_clearance_m, fixed))
    }

    /// The scene's points by place, sorted when they are first needed.
    pub fn point_grid(&self) -> Arc<PointGrid> {
        let Ok(grid) = self.kept.of(1, PointsKey, || Ok::<_, Infallible>(PointGrid::new(&self.scene)));
        grid
    }

    /// [`repose_belief::ObservedView::outline_ends`], told once.
    pub fn outline_ends(&self, id: u16) -> OutlineEnds {
        let Ok(ends) = self.kept.of(self.belief.objects.len(), EndsKey(id), || Ok::<_, Infallible>(self.belief.view.outline_ends(id)));
        *ends
    }

    /// [`StandingTraits::of`], read once.
    pub fn standing_traits(&self, id: u16) -> Option<StandingTraits> {
        let traits = self.kept.of(self.belief.objects.len(), TraitsKey(id), || StandingTraits::of(self, id).ok_or(()));
        traits.ok().map(|traits| *traits)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::synthetic::{Prepared, SceneBuilder};

    #[test]
    fn a_query_is_made_once_for_the_same_clearance_and_settings() {
        let scene = SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.1]).object(2, [-0.3, -0.2], [0.06, 0.06, 0.08]).prepared();
        let fixed = Fixed::default();
        let query = |id, clearance_m, fixed: &Fixed| scene.query(id, clearance_m, fixed).unwrap();
        let first = query(2, 0.0, &fixed);
        assert!(Arc::ptr_eq(&first, &query(2, 0.0, &fixed)));
        assert!(query(2, 0.05, &fixed).ring_m > first.ring_m, "another clearance");
        let mut other = fixed.clone();
        other.unseen.step_m *= 0.5;
        assert!(query(2, 0.0, &other).prisms[0].sparse.len() > first.prisms[0].sparse.len(), "other settings");
        (0..KEPT).for_each(|i| drop(query(1, 0.001 * i as f64, &fixed)));
        assert!(!Arc::ptr_eq(&first, &query(2, 0.0, &fixed)), "given up for newer ones");
        assert!(scene.query(9, 0.0, &fixed).is_err());
    }
}
