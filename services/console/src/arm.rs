//! Where the arm's links are: for a robot's state, and along a plan.

use nalgebra::Isometry3;
use repose_geometry::transform::{from_row_major, to_row_major};
use repose_panda::{Joints, LinkFrames, hermite};
use repose_proto::motion::{MotionPlan, NotChosen};
use repose_proto::robot::{RobotState, SetPoint};
use serde::Serialize;

/// Links that are drawn: the base, links 1 to 7, the hand.
pub const DRAWN: usize = 9;
/// Poses of the arm that a plan is shown with, at most, over all phases.
const POSES: usize = 160;

/// Every drawn link's `world_from_link`, row-major without the last row.
pub type LinkPoses = [[f32; 12]; DRAWN];

/// Where a robot's base stands, as its state says; at the world's origin where it does not.
pub fn world_from_base(state: &RobotState) -> Isometry3<f64> {
    state.world_from_base.and_then(|pose| from_row_major(&pose.0).ok()).unwrap_or_else(Isometry3::identity)
}

/// The links at `joints`.
pub fn link_poses(world_from_base: &Isometry3<f64>, joints: &Joints) -> LinkPoses {
    let frames = LinkFrames::at(joints);
    let mut poses = [[0.0; 12]; DRAWN];
    let links = std::iter::once(Isometry3::identity()).chain(frames.links.iter().map(|f| f.isometry()));
    for (pose, base_from_link) in poses.iter_mut().zip(links.chain([frames.hand.isometry()])) {
        let numbers = to_row_major(&(world_from_base * base_from_link));
        // Tenths of a millimetre are finer than anything that is drawn.
        *pose = std::array::from_fn(|i| (numbers[i] * 1e4).round() as f32 / 1e4);
    }
    poses
}

/// A pose of the arm within a plan.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlanPose {
    /// Since the plan's start, milliseconds of robot time.
    pub t_ms: f64,
    /// The phase, by its place in [`PlanShown::phases`].
    pub phase: usize,
    /// The links.
    pub links: LinkPoses,
    /// The point between the fingertips, world frame, metres.
    pub tcp_m: [f32; 3],
    /// Gripper opening that was commanded last, metres; none before the first command.
    pub gripper_m: Option<f64>,
}

/// A phase's name and when it begins.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PhaseShown {
    /// `approach`, `grasp`, …
    pub name: String,
    /// Since the plan's start, milliseconds of robot time.
    pub start_ms: f64,
}

/// A plan as viewers get it.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlanShown {
    /// What `execute` asks for.
    pub plan: String,
    /// The robot.
    pub robot: String,
    /// The object that moves.
    pub query: u16,
    /// The chosen placement's rank, from 0.
    pub placement: usize,
    /// Why not the better ones.
    pub not_chosen: Vec<NotChosen>,
    /// What it ignores of the hidden parts of things, in words.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ignored: Option<&'static str>,
    /// Length of the motion, milliseconds of robot time.
    pub duration_ms: f64,
    /// The phases.
    pub phases: Vec<PhaseShown>,
    /// The arm on its way.
    pub poses: Vec<PlanPose>,
}

impl PlanShown {
    /// Samples a plan.
    pub fn new(id: String, plan: &MotionPlan, world_from_base: &Isometry3<f64>) -> Self {
        let (mut phases, mut poses) = (Vec::new(), Vec::new());
        let step_ms = (plan.duration_ms / POSES as f64).max(20.0);
        let (mut start_ms, mut gripper_m) = (0.0, None);
        for (k, phase) in plan.phases.iter().enumerate() {
            phases.push(PhaseShown { name: phase.name.to_string(), start_ms });
            gripper_m = phase.gripper.map_or(gripper_m, |g| Some(g.width_m));
            let Some(last) = phase.set_points.last() else { continue };
            let count = (last.t_ms / step_ms).ceil().max(1.0) as usize;
            for i in 0..=count {
                let within_ms = last.t_ms * i as f64 / count as f64;
                let joints = joints_at(&phase.set_points, within_ms);
                let tcp = world_from_base * LinkFrames::at(&joints).tcp().isometry();
                poses.push(PlanPose {
                    t_ms: start_ms + within_ms,
                    phase: k,
                    links: link_poses(world_from_base, &joints),
                    tcp_m: tcp.translation.vector.cast::<f32>().into(),
                    gripper_m,
                });
            }
            start_ms += last.t_ms;
        }
        let not_chosen = plan.not_chosen.clone();
        Self {
            plan: id,
            robot: plan.robot.clone(),
            query: plan.query,
            placement: plan.placement,
            not_chosen,
            ignored: plan.ignored_in_words(),
            duration_ms: plan.duration_ms,
            phases,
            poses,
        }
    }
}

/// The joints at an instant of a phase, by the cubics that the robot follows.
fn joints_at(points: &[SetPoint], t_ms: f64) -> Joints {
    let after = points.partition_point(|p| p.t_ms <= t_ms);
    let (Some(a), Some(b)) = (after.checked_sub(1).and_then(|i| points.get(i)), points.get(after)) else {
        return points.get(after.saturating_sub(1)).map_or([0.0; 7], |p| p.q_rad);
    };
    let span_ms = b.t_ms - a.t_ms;
    hermite((&a.q_rad, &a.dq_rad_s), (&b.q_rad, &b.dq_rad_s), span_ms / 1e3, (t_ms - a.t_ms) / span_ms).0
}

#[cfg(test)]
mod tests {
    use repose_panda::READY;
    use repose_proto::RigidTransform;
    use repose_proto::motion::{Grasp, MotionPhase, Phase};
    use repose_proto::robot::GripperCommand;

    use super::*;

    fn set_point(t_ms: f64, first_joint_rad: f64) -> SetPoint {
        let mut q_rad = READY;
        q_rad[0] = first_joint_rad;
        SetPoint { t_ms, q_rad, dq_rad_s: [0.0; 7] }
    }

    #[test]
    fn the_base_stands_where_it_is_said_to_and_the_hand_where_kinematics_puts_it() {
        let world_from_base = Isometry3::translation(1.0, 2.0, 0.5);
        let poses = link_poses(&world_from_base, &READY);
        assert_eq!([poses[0][3], poses[0][7], poses[0][11]], [1.0, 2.0, 0.5]);
        let hand = &poses[DRAWN - 1];
        // Franka's ready pose: the flange 0.3069 m ahead and 0.5903 m up, the hand straight down.
        assert!((hand[3] - 1.3069).abs() < 1e-3 && (hand[11] - 1.0903).abs() < 1e-3, "{hand:?}");
        assert!((hand[10] + 1.0).abs() < 1e-3, "{hand:?}");
    }

    #[test]
    fn a_plan_is_shown_from_its_first_to_its_last_set_point_with_phases_in_order() {
        let phase = |name: Phase, gripper_m: Option<f64>, points: Vec<SetPoint>| MotionPhase {
            name,
            gripper: gripper_m.map(|width_m| GripperCommand { width_m, force_n: 20.0 }),
            set_points: points,
        };
        let plan = MotionPlan {
            scene_id: "0".repeat(64),
            robot: "panda".to_owned(),
            query: 2,
            placement: 1,
            not_chosen: Vec::new(),
            grasp: Grasp { world_from_tcp: RigidTransform::IDENTITY, width_m: 0.05, score: 1.0 },
            start_joints_rad: READY,
            start_tolerance_rad: 0.02,
            scene_stamp_ns: 0,
            max_scene_age_ms: 1000,
            phases: vec![
                phase(Phase::Approach, Some(0.08), vec![set_point(0.0, 0.0), set_point(1000.0, 1.0)]),
                phase(Phase::Grasp, Some(0.03), Vec::new()),
                phase(Phase::Transfer, None, vec![set_point(0.0, 1.0), set_point(1000.0, 0.0)]),
            ],
            duration_ms: 2000.0,
            heeded: None,
        };
        let shown = PlanShown::new("p".to_owned(), &plan, &Isometry3::identity());
        assert_eq!(
            shown.phases.iter().map(|p| (p.name.as_str(), p.start_ms)).collect::<Vec<_>>(),
            [("approach", 0.0), ("grasp", 1000.0), ("transfer", 1000.0)]
        );
        assert!(shown.poses.windows(2).all(|w| w[0].t_ms <= w[1].t_ms) && shown.poses.len() <= POSES + plan.phases.len() * 2);
        let (first, last) = (&shown.poses[0], &shown.poses[shown.poses.len() - 1]);
        assert_eq!((first.t_ms, last.t_ms, last.phase, last.gripper_m), (0.0, 2000.0, 2, Some(0.03)));
        assert!((first.tcp_m[0] - last.tcp_m[0]).abs() < 1e-5, "it ends where it began");
        let middle = &shown.poses[shown.poses.partition_point(|p| p.t_ms < 1000.0)];
        assert!(middle.tcp_m[1] > 0.2, "the first joint has turned to the left: {:?}", middle.tcp_m);
    }
}
