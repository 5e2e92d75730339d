//! What came of a placement: the object is put there in the true world and let go (paper, section 3: 500 physics steps).

use nalgebra::Isometry3;
use repose_simulator::release::{ReleaseSettings, released};

use crate::scenes::problem::Problem;

/// How far the object's centre may move and still count as stable (the paper's 5 cm).
pub const STABLE_M: f64 = 0.05;
/// How far anything else may move in a joint success.
pub const OTHERS_MOVED_M: f64 = 0.02;
/// How far the object may tip in a joint success.
pub const TILT_RAD: f64 = 15.0 * std::f64::consts::PI / 180.0;
/// How deep the object may be put into something in a joint success.
pub const PENETRATION_M: f32 = 0.005;

/// The outcome of a placement.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Judged {
    /// How far the object's centre moved after its release, metres.
    pub moved_m: f64,
    /// Whether that is stable by the paper's measure.
    pub stable: bool,
    /// Whether the goal held by ground truth after settling.
    pub goal: bool,
    /// Whether nothing else moved, the object did not tip and was not put into anything.
    pub clean: bool,
}

impl Judged {
    /// Stable, with the goal, and clean.
    pub fn joint(&self) -> bool {
        self.stable && self.goal && self.clean
    }
}

/// A release in detail.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Release {
    /// Its outcome.
    pub judged: Judged,
    /// The farthest that anything else moved, metres.
    pub others_moved_m: f64,
    /// How far the object tipped, radians.
    pub tilt_rad: f64,
    /// How deep it was put into something, metres.
    pub penetration_m: f32,
    /// How far its centre came down, metres; negative: up.
    #[serde(default)]
    pub dropped_m: f64,
}

impl Release {
    /// What went wrong first, in the order of [`PlacementFault::ALL`]; none where nothing did.
    pub fn fault(&self) -> Option<PlacementFault> {
        let is = |fault: &PlacementFault| match fault {
            PlacementFault::Fell => self.dropped_m > STABLE_M,
            PlacementFault::Pressed => self.penetration_m > PENETRATION_M,
            PlacementFault::Tipped => self.tilt_rad > TILT_RAD,
            PlacementFault::MovedOthers => self.others_moved_m > OTHERS_MOVED_M,
            PlacementFault::Slid => !self.judged.stable,
            PlacementFault::Goal => !self.judged.goal,
        };
        PlacementFault::ALL.into_iter().find(is)
    }
}

/// The fault of a returned placement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PlacementFault {
    /// Its centre came down by 5 cm: over an edge, or off what carried it.
    Fell,
    /// It was put more than 5 mm into something.
    Pressed,
    /// It tipped by more than 15 degrees.
    Tipped,
    /// Something else moved more than 2 cm.
    MovedOthers,
    /// It moved 5 cm without any of that.
    Slid,
    /// It stayed, but the goal does not hold.
    Goal,
}

impl PlacementFault {
    /// The worst first: an answer with several faults counts for the first.
    pub const ALL: [Self; 6] = [Self::Fell, Self::Pressed, Self::Tipped, Self::MovedOthers, Self::Slid, Self::Goal];

    /// Its name, as in records.
    pub fn name(self) -> &'static str {
        match self {
            Self::Fell => "fell",
            Self::Pressed => "pressed",
            Self::Tipped => "tipped",
            Self::MovedOthers => "moved_others",
            Self::Slid => "slid",
            Self::Goal => "goal",
        }
    }
}

/// Puts the problem's query where `placed_from_observed` carries it, and lets go. `None` when the scene lacks the query or its anchor.
pub fn judge(problem: &Problem, placed_from_observed: &Isometry3<f64>, settings: &ReleaseSettings) -> Option<Judged> {
    release(problem, placed_from_observed, settings).map(|release| release.judged)
}

/// As [`judge`], in detail.
pub fn release(problem: &Problem, placed_from_observed: &Isometry3<f64>, settings: &ReleaseSettings) -> Option<Release> {
    let (query, anchor) = (problem.index_of(problem.query)?, problem.index_of(problem.goal.anchor)?);
    let placed = placed_from_observed * problem.truth.objects[query].world_from_object;
    let outcome = released(&problem.truth, query, &placed, settings)?;
    let settled = problem.truth.with_poses(&outcome.world_from_objects);
    let holds = settled.relations(&problem.viewer)[query * settled.objects.len() + anchor][problem.goal.relation.index()];
    let judged = Judged {
        moved_m: outcome.moved_m,
        stable: outcome.moved_m < STABLE_M,
        goal: holds == problem.goal.holds,
        clean: outcome.others_moved_m <= OTHERS_MOVED_M && outcome.tilt_rad <= TILT_RAD && outcome.penetration_m <= PENETRATION_M,
    };
    Some(Release {
        judged,
        others_moved_m: outcome.others_moved_m,
        tilt_rad: outcome.tilt_rad,
        penetration_m: outcome.penetration_m,
        dropped_m: placed.translation.z - outcome.world_from_objects[query].translation.z,
    })
}
