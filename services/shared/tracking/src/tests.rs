//! Views made for tests, and goal terms judged on one.

use repose_made_scenes::SceneBuilder;
use repose_proto::{GoalTerm, Relation, Scene};

use crate::holds;

/// An upright block.
#[derive(Debug, Clone, Copy)]
pub struct Block {
    pub label: u16,
    pub min: [f64; 3],
    pub max: [f64; 3],
}

/// A block of 6 cm by 6 cm by 8 cm with the middle of its bottom at a place.
pub fn block(label: u16, [x, y, z]: [f64; 3]) -> Block {
    Block { label, min: [x - 0.03, y - 0.03, z], max: [x + 0.03, y + 0.03, z + 0.08] }
}

/// What a camera at y = −0.8 m, 0.7 m high, that looks along +y sees of blocks (0: no object) on a table of 1 m by 0.8 m.
pub fn scene_of(blocks: &[Block]) -> Scene {
    let seen = blocks.iter().fold(SceneBuilder::table(), |seen, block| {
        let [x0, y0, z0] = block.min;
        let size = [0, 1, 2].map(|k| block.max[k] - block.min[k]);
        seen.object_at(block.label, [x0 + size[0] / 2.0, y0 + size[1] / 2.0], z0, size)
    });
    seen.scene()
}

#[test]
fn terms_are_judged_on_what_is_seen() {
    let scene = scene_of(&[block(1, [-0.3, 0.0, 0.0]), block(2, [0.1, 0.0, 0.0])]);
    let term = |relation: Relation, holds: bool| GoalTerm { relation, anchor: 2, holds };
    let terms = [term(Relation::LeftOf, true), term(Relation::RightOf, true), term(Relation::Near, false)];
    assert_eq!(holds(&scene, 0.0, 1, &terms), [true, false, true]);
    assert_eq!(holds(&scene, 0.0, 9, &terms[..1]), [false], "what is not seen is not said to hold");
}
