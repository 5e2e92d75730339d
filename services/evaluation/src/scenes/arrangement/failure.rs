//! Why a plan failed, as far as the true world tells: what its move met there, and where the planner believed things otherwise than they are.

use repose_geometry::transform::from_row_major;
use repose_planner::PreparedScene;
use repose_proto::arrange::{ArrangeMove, ArrangeResult, Purpose};
use repose_simulator::release::{ReleaseOutcome, Surroundings, Thing};
use repose_simulator::scene::{SceneObject, SimulatedScene};
use serde::{Deserialize, Serialize};

use crate::scenes::arrangement::carried_out::CarriedOut;
use crate::scenes::arrangement::task::ArrangementTask;

/// What a place is lowered by to find what would carry an object there, metres.
const REACH_M: f64 = 0.03;

/// The details of a fault: the move, the unmet terms, the conflict.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct FaultDetails {
    /// The move that it came with.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub step: Option<FailedMove>,
    /// Terms that do not hold in the end, each with its object.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub unmet: Vec<String>,
    /// The goals for which no arrangement was found.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub conflict: Vec<String>,
}

/// A move that failed in the true world.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FailedMove {
    /// The object.
    pub object: u16,
    /// What the move was for.
    pub purpose: Purpose,
    /// The terms that its place was chosen by.
    pub goal: Vec<String>,
    /// The success that it was given.
    pub success: Option<f64>,
    /// What it was put into: an object, or 0 for furniture.
    pub into: Option<u16>,
    /// How deep, metres.
    pub penetration_m: f32,
    /// How far it tipped, radians.
    pub tilt_rad: f64,
    /// How far it moved, metres.
    pub moved_m: f64,
    /// How far something else moved, metres.
    pub others_moved_m: f64,
    /// How much higher its foot was believed to be than it is, in the view that was planned on, metres.
    pub foot_error_m: Option<f64>,
    /// What carries it where it was put: an object, or 0 for furniture.
    pub carrier: Option<u16>,
    /// How much higher the top of that was believed to be than it is, in the view that was planned on, metres.
    pub carrier_error_m: Option<f64>,
}

impl FaultDetails {
    /// Of a plan that failed, with the view that it was made on: what was prepared of it, and the true table then.
    pub(super) fn of(task: &ArrangementTask, seen: (&PreparedScene, &SimulatedScene), result: &ArrangeResult, end: &CarriedOut) -> Self {
        match end.came.as_ref().and_then(|(k, came)| Some((result.moves.get(*k)?, came))) {
            Some((step, came)) => Self::of_move(task, seen, step, (&end.table, came)),
            None => Self::without_move(task, result, &end.table),
        }
    }

    /// Of a move, with the true table before it and what came of it there.
    pub(super) fn of_move(
        task: &ArrangementTask,
        seen: (&PreparedScene, &SimulatedScene),
        step: &ArrangeMove,
        came: (&SimulatedScene, &ReleaseOutcome),
    ) -> Self {
        Self { step: FailedMove::of(task, seen, step, came), ..Self::default() }
    }

    /// Of an answer that had no move, or none that failed: what does not hold on the true table.
    pub(super) fn without_move(task: &ArrangementTask, result: &ArrangeResult, table: &SimulatedScene) -> Self {
        let unmet = if result.conflict.is_none() { unmet(task, table) } else { Vec::new() };
        let conflict = result.conflict.iter().flat_map(|c| c.goals.iter().map(ToString::to_string)).collect();
        Self { step: None, unmet, conflict }
    }

    /// Of a table on which all goals should hold: those terms that do not.
    pub(super) fn of_table(task: &ArrangementTask, table: &SimulatedScene) -> Self {
        Self { unmet: unmet(task, table), ..Self::default() }
    }
}

impl FailedMove {
    fn of(
        task: &ArrangementTask,
        (prepared, seen): (&PreparedScene, &SimulatedScene),
        step: &ArrangeMove,
        (table, came): (&SimulatedScene, &ReleaseOutcome),
    ) -> Option<Self> {
        let index = task.index_of(step.object)?;
        let motion = from_row_major(&step.placement.placed_from_observed.0).ok()?;
        let placed = motion * table.objects[index].world_from_object;
        let around = Surroundings::of(table, index)?;
        let id = |thing: Thing| match thing {
            Thing::Object(id) => id,
            Thing::Fixture(_) => 0,
        };
        let carrier = around.carrier(&placed, REACH_M).map(id);
        let believed = |id: u16| prepared.belief.objects.get(&id).and_then(|o| o.shape.as_ref());
        let truly = |id: u16| task.index_of(id).map(|i| span_m(&seen.objects[i]));
        Some(Self {
            object: step.object,
            purpose: step.purpose,
            goal: step.goal.iter().map(ToString::to_string).collect(),
            success: step.placement.success,
            into: around.deepest(&placed).map(|(thing, _)| id(thing)),
            penetration_m: came.penetration_m,
            tilt_rad: came.tilt_rad,
            moved_m: came.moved_m,
            others_moved_m: came.others_moved_m,
            foot_error_m: believed(step.object).zip(truly(step.object)).map(|(b, [low_m, _])| f64::from(b.bottom_m) - low_m),
            carrier,
            carrier_error_m: carrier.and_then(|id| believed(id).zip(truly(id))).map(|(b, [_, high_m])| f64::from(b.top_m) - high_m),
        })
    }
}

/// An object's lowest and highest point, metres.
fn span_m(object: &SceneObject) -> [f64; 2] {
    let mesh = object.shape.mesh.transformed(&object.world_from_object.cast());
    let heights = mesh.vertices.iter().map(|v| f64::from(v.z));
    heights.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], z| [low.min(z), high.max(z)])
}

fn unmet(task: &ArrangementTask, table: &SimulatedScene) -> Vec<String> {
    let (n, relations) = (table.objects.len(), table.relations(&task.viewer));
    let of_goal = |goal: &repose_proto::arrange::ObjectGoal| {
        let i = task.index_of(goal.object)?;
        let fails =
            |t: &&repose_proto::GoalTerm| task.index_of(t.anchor).is_none_or(|j| relations[i * n + j][t.relation.index()] != t.holds);
        Some(goal.terms.iter().filter(fails).map(|t| format!("{}={t}", goal.object)).collect::<Vec<_>>())
    };
    task.goals.iter().filter_map(of_goal).flatten().collect()
}
