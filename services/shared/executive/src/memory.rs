//! What was seen of goals before something hid what they are about.

use std::collections::{BTreeMap, BTreeSet};

use repose_proto::arrange::ObjectGoal;
use repose_tracking::{Fate, Followed};

/// Goals of which some were seen to hold. Ids are those of the first view.
#[derive(Debug, Clone)]
pub struct GoalMemory {
    goals: Vec<ObjectGoal>,
    /// Objects whose goals held when they were last seen, and nothing that they are about was carried since.
    held: BTreeSet<u16>,
}

impl GoalMemory {
    /// Nothing seen yet.
    pub fn of(goals: &[ObjectGoal]) -> Self {
        Self { goals: goals.to_vec(), held: BTreeSet::new() }
    }

    /// Which objects' goals hold on a new view; none where that cannot be seen. There what was seen before says nothing any more where something
    /// that the goal is about is `disturbed`, other than hidden: pushed aside, say, while the rest was out of sight.
    pub fn look(&mut self, holds: &BTreeMap<u16, Option<bool>>, disturbed: &BTreeMap<u16, Fate>) {
        let is_moved = |object: u16| disturbed.get(&object).is_some_and(|fate| *fate != Fate::Hidden);
        for (object, holds) in holds {
            match holds {
                Some(true) => drop(self.held.insert(*object)),
                Some(false) => drop(self.held.remove(object)),
                None => {}
            }
        }
        for goal in self.goals.iter().filter(|goal| holds.get(&goal.object) == Some(&None) && about(goal).any(is_moved)) {
            self.held.remove(&goal.object);
        }
    }

    /// An object was carried: what was seen of goals about it says nothing any more.
    pub fn carried(&mut self, object: u16) {
        for goal in self.goals.iter().filter(|goal| about(goal).any(|other| other == object)) {
            self.held.remove(&goal.object);
        }
    }

    /// Whether something that a goal is about is not found in the newest view.
    pub fn misses(&self, followed: &Followed) -> bool {
        !self.goals.iter().all(|goal| is_in_view(goal, followed))
    }

    /// The objects whose goals held when they were last seen, and cannot be seen for no other reason than that something hides what they are about.
    pub fn remembered(&self, followed: &Followed) -> BTreeSet<u16> {
        let disturbed = followed.disturbed();
        let is_untouched = |object: u16| followed.known().now(object).is_some() || disturbed.get(&object) == Some(&Fate::Hidden);
        let unseen = self.goals.iter().filter(|goal| self.held.contains(&goal.object) && !is_in_view(goal, followed));
        unseen.filter(|goal| about(goal).all(is_untouched)).map(|goal| goal.object).collect()
    }
}

/// The objects that a goal is about.
pub(crate) fn about(goal: &ObjectGoal) -> impl Iterator<Item = u16> + '_ {
    std::iter::once(goal.object).chain(goal.terms.iter().map(|term| term.anchor))
}

fn is_in_view(goal: &ObjectGoal, followed: &Followed) -> bool {
    about(goal).all(|object| followed.known().now(object).is_some())
}

#[cfg(test)]
mod tests {
    use repose_made_scenes::SceneBuilder;
    use repose_proto::{GoalTerm, Relation, Scene};

    use super::*;

    fn goal(object: u16, anchor: u16) -> ObjectGoal {
        ObjectGoal { object, terms: vec![GoalTerm { relation: Relation::Behind, anchor, holds: true }] }
    }

    /// Object 1 with 2 behind it, or without it where it was taken out of the picture, and 3 far off.
    fn scene(shows_second: bool) -> Scene {
        let table = SceneBuilder::table().object(1, [0.0, 0.0], [0.06; 3]).object(3, [0.3, 0.0], [0.06; 3]);
        let mut scene = if shows_second { table.object(2, [0.0, 0.2], [0.06; 3]).scene() } else { table.scene() };
        // From a camera whose pose nobody knows nothing is known to be gone.
        scene.meta.camera.world_from_camera = None;
        scene
    }

    #[test]
    fn a_goal_that_was_seen_to_hold_is_remembered_while_it_is_hidden_and_untouched() {
        let goals = [goal(2, 1), goal(3, 1)];
        let mut followed = Followed::of(&scene(true));
        let mut memory = GoalMemory::of(&goals);
        let undisturbed = BTreeMap::new();
        memory.look(&BTreeMap::from([(2, Some(true)), (3, Some(false))]), &undisturbed);
        assert!(!memory.misses(&followed) && memory.remembered(&followed).is_empty(), "all of it is seen");
        followed.look_again(&scene(false));
        memory.look(&BTreeMap::from([(2, None), (3, Some(false))]), &BTreeMap::from([(2, Fate::Hidden)]));
        assert!(memory.misses(&followed));
        assert_eq!(memory.remembered(&followed), [2].into());
        let mut of_moved_anchor = memory.clone();
        of_moved_anchor.carried(1);
        assert!(of_moved_anchor.remembered(&followed).is_empty(), "its anchor was carried");
        let mut of_pushed_anchor = memory.clone();
        of_pushed_anchor.look(&BTreeMap::from([(2, None)]), &BTreeMap::from([(1, Fate::Moved { by_m: 0.1 }), (2, Fate::Hidden)]));
        assert!(of_pushed_anchor.remembered(&followed).is_empty(), "its anchor was pushed aside");
        memory.carried(3);
        assert_eq!(memory.remembered(&followed), [2].into(), "it is not about that one");
        memory.look(&BTreeMap::from([(2, Some(false))]), &undisturbed);
        assert!(memory.remembered(&followed).is_empty(), "it was seen not to hold");
    }

    #[test]
    fn a_goal_about_something_low_is_not_remembered_once_that_was_taken_away() {
        // As high as a telephone, from a camera whose pose is known.
        let seen = |shows_second: bool| {
            let table = SceneBuilder::table().object(1, [0.0, 0.0], [0.06; 3]);
            if shows_second { table.object(2, [0.2, 0.1], [0.14, 0.07, 0.009]).scene() } else { table.scene() }
        };
        let mut followed = Followed::of(&seen(true));
        let mut memory = GoalMemory::of(&[goal(2, 1)]);
        memory.look(&BTreeMap::from([(2, Some(true))]), &BTreeMap::new());
        followed.look_again(&seen(false));
        assert_eq!(followed.disturbed(), BTreeMap::from([(2, Fate::Gone)]));
        assert!(memory.misses(&followed) && memory.remembered(&followed).is_empty());
    }
}
