//! Tables as moves would leave them, prepared once: orders and rounds of the search come back to the same ones.

use std::collections::VecDeque;
use std::sync::Arc;

use repose_proto::place::Variant;
use repose_proto::{CallError, RigidTransform};

use crate::plan::rigid;
use crate::scene::moved::{table_after, table_without};
use crate::scene::prepared::PreparedScene;

/// Tables kept: a prepared scene takes some ten megabytes.
const KEPT: usize = 32;

/// What was done to a table: an object carried elsewhere (where to, to the bit), or taken away.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Change {
    scene_id: String,
    object: u16,
    motion: Option<[u64; 16]>,
}

/// Prepared tables, the last used ones kept.
#[derive(Debug)]
pub struct Tables {
    kept: VecDeque<(Change, Arc<PreparedScene>)>,
    variant: Variant,
    prepared: u32,
}

impl Tables {
    /// None yet; objects are let go where the placements of `variant` say.
    pub fn new(variant: Variant) -> Self {
        Self { kept: VecDeque::new(), variant, prepared: 0 }
    }

    /// How many were prepared so far.
    pub fn prepared(&self) -> u32 {
        self.prepared
    }

    /// The table after an object was carried elsewhere.
    ///
    /// # Errors
    /// `internal` where the motion is not rigid.
    pub fn after(
        &mut self,
        scene: &Arc<PreparedScene>,
        object: u16,
        placed_from_observed: &RigidTransform,
    ) -> Result<Arc<PreparedScene>, CallError> {
        let carried = rigid(placed_from_observed)?;
        let motion = Some(placed_from_observed.0.map(f64::to_bits));
        let change = Change { scene_id: scene.scene_id.clone(), object, motion };
        let variant = self.variant;
        Ok(self.kept(change, || table_after(scene, object, &carried, variant)))
    }

    /// The table without an object.
    pub fn without(&mut self, scene: &Arc<PreparedScene>, object: u16) -> Arc<PreparedScene> {
        let change = Change { scene_id: scene.scene_id.clone(), object, motion: None };
        self.kept(change, || table_without(scene, object))
    }

    fn kept(&mut self, change: Change, prepare: impl FnOnce() -> PreparedScene) -> Arc<PreparedScene> {
        let known = self.kept.iter().position(|(other, _)| *other == change).and_then(|at| self.kept.remove(at));
        let (change, scene) = known.unwrap_or_else(|| {
            self.prepared += 1;
            (change, Arc::new(prepare()))
        });
        self.kept.push_back((change, scene.clone()));
        if self.kept.len() > KEPT {
            self.kept.pop_front();
        }
        scene
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::synthetic::{Prepared, SceneBuilder};

    #[test]
    fn the_same_move_gives_the_same_table_and_only_the_last_ones_are_kept() {
        let scene = Arc::new(SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.1]).object(2, [0.3, 0.0], [0.06; 3]).prepared());
        let by = |x: f64| RigidTransform([1.0, 0.0, 0.0, x, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
        let mut tables = Tables::new(Variant::Full);
        let first = tables.after(&scene, 1, &by(-0.2)).unwrap();
        assert!(Arc::ptr_eq(&first, &tables.after(&scene, 1, &by(-0.2)).unwrap()));
        assert!(!Arc::ptr_eq(&first, &tables.without(&scene, 1)));
        for k in 0..KEPT {
            tables.after(&scene, 2, &by(-0.001 * k as f64)).unwrap();
        }
        assert_eq!(tables.kept.len(), KEPT);
        assert!(!Arc::ptr_eq(&first, &tables.after(&scene, 1, &by(-0.2)).unwrap()), "it was used longest ago");
    }
}
