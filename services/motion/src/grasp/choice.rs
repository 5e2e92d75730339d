//! Which of the proposed grasps are handed on: those that hold the object, best first, each only if hand and fingers touch nothing else there and no
//! better one is nearly the same.
//!
//! Whether the rest of the scene is in the way takes longest to tell, so it is asked of the best that are left until there are enough.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use nalgebra::Isometry3;

use super::gripper::{Between, GripperFit, Misfit};
use super::score::score;
use super::{GraspCandidate, GraspCloud, GraspScene, GraspSettings, GraspTally, gripper_touches};

/// The choice among proposed poses of the grasp centre.
pub struct Choice<'a> {
    /// The poses.
    pub proposals: &'a [Isometry3<f64>],
    /// What is to be grasped.
    pub object: &'a GraspCloud,
    /// It and what is around it.
    pub scene: &'a GraspScene<'a>,
    /// How grasps are judged.
    pub settings: &'a GraspSettings,
}

/// How the hand comes to a grasp.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Coming {
    /// Open wide, then to the middle of the object.
    Wide,
    /// Open as far as is needed beside something, then to the middle.
    Narrow,
    /// As far open as the first of these that has room; the fingers close where they came down.
    Aside { narrow: bool },
}

/// A grasp that holds the object.
struct Holding {
    grasp: GraspCandidate,
    proposal: usize,
    coming: Coming,
}

impl PartialEq for Holding {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Holding {}

impl PartialOrd for Holding {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Holding {
    /// By score; of equal ones the one that was proposed earlier is greater.
    fn cmp(&self, other: &Self) -> Ordering {
        self.grasp.score.total_cmp(&other.grasp.score).then(other.proposal.cmp(&self.proposal))
    }
}

impl Choice<'_> {
    /// The best distinct grasps that touch nothing else, best first.
    pub fn best(&self, tally: &mut GraspTally) -> Vec<GraspCandidate> {
        let mut held: BinaryHeap<Holding> = (0..self.proposals.len()).filter_map(|i| self.holding(i, Coming::Wide, tally)).collect();
        let mut kept: Vec<GraspCandidate> = Vec::new();
        while kept.len() < self.settings.count
            && let Some(best) = held.pop()
        {
            if kept.iter().any(|k| self.is_nearly(k, &best.grasp)) {
                continue;
            }
            match self.next(&best) {
                None => kept.push(best.grasp),
                Some(Some(coming)) => held.extend(self.holding(best.proposal, coming, tally)),
                Some(None) => tally.scene_in_the_way += 1,
            }
        }
        kept
    }

    /// The grasp at a proposed pose, moved along the closing direction so that the fingers meet the object at the same time; or nothing.
    fn holding(&self, proposal: usize, coming: Coming, tally: &mut GraspTally) -> Option<Holding> {
        let mut refused = |misfit| match misfit {
            Misfit::Empty => tally.empty += 1,
            Misfit::TooWide => tally.too_wide += 1,
            Misfit::Slanted => tally.slanted += 1,
            Misfit::FingerBlocked | Misfit::PalmBlocked => tally.object_in_the_way += 1,
        };
        let (world_from_tcp, gripper) = (&self.proposals[proposal], &self.settings.gripper);
        let clearance_m = match coming {
            Coming::Wide | Coming::Aside { narrow: false } => gripper.clearance_m,
            Coming::Narrow | Coming::Aside { narrow: true } => gripper.clearance_beside_m,
        };
        let between = Between::fingers(world_from_tcp, self.object, self.scene.view, gripper).map_err(&mut refused).ok()?;
        let fit = between.fit(clearance_m).and_then(|fit| self.held(fit)).map_err(&mut refused).ok()?;
        let is_aside = matches!(coming, Coming::Aside { .. });
        let (y, aside_m) = if is_aside { (fit.offset_m + fit.aside_m, 0.0) } else { (fit.offset_m, fit.aside_m) };
        let world_from_tcp = world_from_tcp * Isometry3::translation(0.0, y, 0.0);
        let score = score(&world_from_tcp, &fit, self.object, self.settings);
        let grasp = GraspCandidate { world_from_tcp, aside_m, opening_m: fit.opening_m, width_m: Some(fit.width_m), score };
        Some(Holding { grasp, proposal, coming })
    }

    /// What the fingers close on, unless they meet it as a wedge that is blunter, or on a slope that is steeper, than friction bridges, or turn it further:
    /// a plate that is taken at its rim from above hangs from the fingers until it is out.
    fn held(&self, fit: GripperFit) -> Result<GripperFit, Misfit> {
        let bridged_rad = self.settings.friction.atan();
        let steepest_rad = fit.slope_rad.max(fit.turn_rad).max(0.5 * fit.meeting.wedge_rad);
        if steepest_rad > bridged_rad { Err(Misfit::Slanted) } else { Ok(fit) }
    }

    /// Nothing where the hand has room to come to a grasp, else how it may come instead, if at all.
    fn next(&self, holding: &Holding) -> Option<Option<Coming>> {
        let Holding { grasp: GraspCandidate { world_from_tcp, aside_m, opening_m, .. }, coming, .. } = holding;
        let touches = |y: f64| {
            let hand = world_from_tcp * Isometry3::translation(0.0, y, 0.0);
            gripper_touches(&hand, *opening_m, self.scene.others, self.settings.padding_m)
        };
        match coming {
            // Whether it has room where it comes down is known.
            Coming::Aside { .. } => None,
            Coming::Wide if touches(*aside_m) => Some(Some(Coming::Narrow)),
            Coming::Narrow if touches(*aside_m) => Some(None),
            Coming::Wide | Coming::Narrow if *aside_m != 0.0 && touches(0.0) => {
                Some(Some(Coming::Aside { narrow: *coming == Coming::Narrow }))
            }
            Coming::Wide | Coming::Narrow => None,
        }
    }

    /// Whether two grasps are nearly the same.
    fn is_nearly(&self, one: &GraspCandidate, other: &GraspCandidate) -> bool {
        let apart = (one.world_from_tcp.translation.vector - other.world_from_tcp.translation.vector).norm();
        let turn = one.world_from_tcp.rotation.angle_to(&other.world_from_tcp.rotation);
        apart + 0.05 * turn.min(std::f64::consts::PI - turn) < self.settings.separation_m
    }
}
