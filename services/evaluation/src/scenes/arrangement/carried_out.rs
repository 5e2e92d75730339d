//! What moves come to in the true world: each is let go where it was planned, from where its object truly stands.

use nalgebra::Isometry3;
use repose_simulator::release::{ReleaseOutcome, ReleaseSettings, released};
use repose_simulator::scene::SimulatedScene;
use serde::{Deserialize, Serialize};

use crate::scenes::arrangement::task::ArrangementTask;
use crate::scenes::outcome::{OTHERS_MOVED_M, PENETRATION_M, STABLE_M, TILT_RAD};

/// What went wrong with a plan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PlanFault {
    /// There was none.
    NoPlan,
    /// Its search was cut short.
    CutShort,
    /// An object was put more than 5 mm into something.
    Pressed,
    /// An object tipped.
    Tipped,
    /// Something else moved more than 2 cm.
    MovedOthers,
    /// An object moved 5 cm where it was let go.
    Slid,
    /// All stayed, but a goal does not hold.
    Goal,
    /// As many moves as may be made were, and not all goals were seen to hold.
    GaveUp,
    /// Something that a goal is about was not seen any more.
    Lost,
}

impl PlanFault {
    /// Its name, as in records.
    pub fn name(self) -> &'static str {
        match self {
            Self::NoPlan => "no_plan",
            Self::CutShort => "cut_short",
            Self::Pressed => "pressed",
            Self::Tipped => "tipped",
            Self::MovedOthers => "moved_others",
            Self::Slid => "slid",
            Self::Goal => "goal",
            Self::GaveUp => "gave_up",
            Self::Lost => "lost",
        }
    }
}

/// An object and the motion of the world that carries it.
pub(super) type Move = (u16, Isometry3<f64>);

/// What moves came to in the true world.
pub(super) struct CarriedOut {
    /// The first fault.
    pub fault: Option<PlanFault>,
    /// The move that it came with, and what came of that.
    pub came: Option<(usize, ReleaseOutcome)>,
    /// The table before that move, or after all of them.
    pub table: SimulatedScene,
}

impl CarriedOut {
    pub(super) fn failed(fault: PlanFault, task: &ArrangementTask) -> Self {
        Self { fault: Some(fault), came: None, table: task.truth.clone() }
    }
}

/// Carries moves out in the true world, up to the first fault.
pub(super) fn carried_out(task: &ArrangementTask, moves: &[Move]) -> CarriedOut {
    let mut table = task.truth.clone();
    for (k, step) in moves.iter().enumerate() {
        let Some(came) = released_at(task, &table, step) else { return CarriedOut::failed(PlanFault::NoPlan, task) };
        if let Some(fault) = fault_of(&came) {
            return CarriedOut { fault: Some(fault), came: Some((k, came)), table };
        }
        table = table.with_poses(&came.world_from_objects);
    }
    CarriedOut { fault: (!task.hold(&table)).then_some(PlanFault::Goal), came: None, table }
}

/// What a move comes to on a true table; none where it does not have the object.
pub(super) fn released_at(task: &ArrangementTask, table: &SimulatedScene, (object, placed_from_observed): &Move) -> Option<ReleaseOutcome> {
    let settings = ReleaseSettings { ends_at_rest: true, ..ReleaseSettings::default() };
    let index = task.index_of(*object)?;
    released(table, index, &(placed_from_observed * table.objects[index].world_from_object), &settings)
}

/// What is wrong with a release.
pub(super) fn fault_of(came: &ReleaseOutcome) -> Option<PlanFault> {
    let faults = [
        (PlanFault::Pressed, came.penetration_m > PENETRATION_M),
        (PlanFault::Tipped, came.tilt_rad > TILT_RAD),
        (PlanFault::MovedOthers, came.others_moved_m > OTHERS_MOVED_M),
        (PlanFault::Slid, came.moved_m > STABLE_M),
    ];
    faults.into_iter().find(|(_, is)| *is).map(|(fault, _)| fault)
}

#[cfg(test)]
mod tests {
    use repose_dataset::Split;

    use super::*;
    use crate::scenes::arrangement::task::TaskKind;

    #[test]
    fn moves_are_tried_in_the_true_world_and_the_first_fault_is_named() {
        let task = ArrangementTask::of_slot(Split::Train, (TaskKind::Free, 2), 1).expect("a task");
        let fault = |moves: &[Move]| {
            let end = carried_out(&task, moves);
            (end.fault, end.came.map(|(k, _)| k))
        };
        assert_eq!(fault(&[]), (Some(PlanFault::Goal), None), "nothing was done");
        let object = task.goals[0].object;
        let dropped = (object, Isometry3::translation(0.0, 0.0, 0.3));
        let end = fault(&[dropped]);
        assert!(matches!(end, (Some(PlanFault::Slid | PlanFault::Tipped), Some(0))), "{end:?}");
        let sunk = (object, Isometry3::translation(0.0, 0.0, -0.02));
        assert_eq!(fault(&[sunk]), (Some(PlanFault::Pressed), Some(0)));
    }
}
