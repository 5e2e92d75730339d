//! The true shapes of objects, in the form in which shapes are believed: what planning would come to if no more were hidden of objects.

use repose_planner::PreparedScene;
use repose_simulator::scene::SimulatedScene;
use serde::Serialize;

use crate::scenes::true_objects::true_shape;

/// Whose shapes are known in place of believed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum KnownShapes {
    /// Those of all objects.
    All,
    /// That of the object to move.
    Query,
    /// Those of all others.
    Others,
}

impl KnownShapes {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::All, Self::Query, Self::Others];

    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::All => "all",
            Self::Query => "query",
            Self::Others => "others",
        }
    }

    /// A scene with the shapes that are known. Which of its objects were seen, and what of the furniture, stays as it is.
    pub fn in_scene(self, seen: &PreparedScene, truth: &SimulatedScene, query: u16) -> PreparedScene {
        let is_known = |id: u16| match self {
            Self::All => true,
            Self::Query => id == query,
            Self::Others => id != query,
        };
        let mut shapes = seen.belief.shapes();
        for object in truth.objects.iter().filter(|object| is_known(object.id)) {
            if let Some(shape) = shapes.get_mut(&object.id) {
                *shape = true_shape(object, shape.centroid).unwrap_or_else(|| shape.clone());
            }
        }
        PreparedScene::with_shapes(seen.scene.clone(), shapes)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use rand_pcg::Pcg64;
    use repose_geometry::Aabb;
    use repose_simulator::scene::scene_of_seed;

    use super::*;
    use crate::scenes::problem::{CameraView, ProblemSettings};
    use crate::scenes::true_objects::{CELL_M, true_corners};

    #[test]
    fn what_is_known_ends_where_the_object_does_and_what_is_not_stays_as_it_was_believed() {
        let settings = ProblemSettings::default();
        let shown = |seed: u64| {
            let (truth, _) = scene_of_seed(seed, &settings.scene).ok()?;
            let view = CameraView::at_random(&truth, &settings, &mut Pcg64::new(u128::from(seed), 1), seed)?;
            let seen = PreparedScene::new(Arc::new(view.observed));
            (seen.belief.shapes().len() > 2).then_some((truth, seen))
        };
        let (truth, seen) = (0..20).find_map(shown).expect("a view of several objects");
        let objects = seen.belief.shapes();
        let query = *objects.keys().next().unwrap();
        for known in KnownShapes::ALL {
            let shapes = known.in_scene(&seen, &truth, query).belief.shapes();
            for object in truth.objects.iter().filter(|object| objects.contains_key(&object.id)) {
                let (is, bounds) = (&shapes[&object.id], Aabb::of(&true_corners(object)).unwrap());
                if known != KnownShapes::All && (known == KnownShapes::Query) != (object.id == query) {
                    assert_eq!(is, &objects[&object.id]);
                    continue;
                }
                let reached = Aabb::of(&is.corners().collect::<Vec<_>>()).unwrap();
                assert!(
                    (reached.min - bounds.min).amax() <= CELL_M && (reached.max - bounds.max).amax() <= CELL_M,
                    "{reached:?} {bounds:?}"
                );
                assert!(is.slabs.windows(2).all(|pair| pair[0].high_m == pair[1].low_m));
            }
        }
    }
}
