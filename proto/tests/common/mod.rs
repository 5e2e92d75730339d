//! Small messages of every kind, the same in every test.
#![allow(dead_code, reason = "each test file uses some of them")]

use std::collections::BTreeMap;

use repose_proto::arrange::*;
use repose_proto::load::WorkerLoad;
use repose_proto::motion::{
    ExecuteReply, ExecutionOutcome, Grasp, MotionFailure, MotionPhase, MotionPlan, MotionPlanRequest, NotChosen, Phase, RecoverReply,
    RecoverRequest, RecoveryMove,
};
use repose_proto::place::*;
use repose_proto::robot::*;
use repose_proto::scene::*;
use repose_proto::scoring::*;
use repose_proto::simulator::{TrueObject, TruePair, Truth};
use repose_proto::*;

pub const SCENE_ID: &str = "0123456789abcdef0123456789abcdef0123456789abcdef0123456789abcdef";

pub fn camera() -> CameraModel {
    CameraModel {
        width: 3,
        height: 2,
        fx: 525.0,
        fy: 525.5,
        cx: 1.0,
        cy: 0.5,
        depth_unit_m: 0.001,
        world_from_camera: Some(RigidTransform::IDENTITY),
    }
}

pub fn frame() -> Frame {
    Frame {
        color: Some(vec![[1, 2, 3]; 6]),
        labels: Some(vec![0, 0, 1, 1, 2, 2]),
        ..Frame::new("table".into(), 1_700_000_000_000_000_001, camera(), vec![0, 800, 801, 802, 803, 65535])
    }
}

/// The frame with all that came after the first release.
pub fn frame_with_robot_and_hints() -> Frame {
    let robot = RobotInView {
        name: "left".into(),
        model: "panda".into(),
        joints_rad: [0.0, -0.5, 0.0, -2.0, 0.0, 1.5, 0.75],
        gripper_width_m: 0.04,
        holding: Some(true),
        world_from_base: RigidTransform::IDENTITY,
    };
    let hints = SegmentHints { clicks_px: vec![[2, 1]], boxes_px: vec![[0, 0, 2, 1]], merge: vec![vec![1, 2]], split: vec![2] };
    Frame { robots: vec![robot], hints, ..frame() }
}

/// The scene with all that came after the first release.
pub fn scene_with_left_out() -> Scene {
    let mut scene = scene();
    scene.meta.objects[0].score = Some(0.75);
    let too_small = LeftOut { reason: LeftOutReason::TooSmall, points: 1, centroid_m: [0.0, 0.0, 0.5], label: Some(4) };
    scene.meta.left_out = vec![too_small];
    scene.meta.warnings = vec![SceneWarning { field: "world_from_camera".into(), message: "no level surface".into() }];
    scene
}

pub fn scene() -> Scene {
    Scene {
        camera_name: "table".into(),
        stamp_ns: 7,
        points: vec![[0.0, 0.0, 0.5], [0.25, 0.0, 0.5], [-0.25, 1.0, 0.75]],
        labels: vec![0, 1, 2],
        colors: Some(vec![[9, 8, 7]; 3]),
        meta: SceneMeta {
            objects: vec![
                ObjectSummary { id: 1, points: 1, centroid_m: [0.25, 0.0, 0.5], extent_m: [0.0; 3], completeness: 0.5, score: None },
                ObjectSummary { id: 2, points: 1, centroid_m: [-0.25, 1.0, 0.75], extent_m: [0.0; 3], completeness: 0.5, score: None },
            ],
            surfaces: vec![Surface { height_m: 0.0, outline_m: vec![[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], area_m2: 0.5, object: None }],
            camera: camera(),
            world_frame: WorldFrame::Extrinsics,
            view_yaw_rad: 0.25,
            unseen: Unseen {
                pixels_without_reading: 1,
                pixels_on_borders: 2,
                pixels_flying: 3,
                share: 0.5,
                space: Some(UnseenSpace { origin_m: [-0.5, 0.0, 0.0], cell_m: 0.02, columns: 2, rows: 1, hidden: vec![0, 0x8000_0003] }),
            },
            left_out: Vec::new(),
            warnings: Vec::new(),
        },
        as_sent: None,
    }
}

pub fn place_request() -> PlaceRequest {
    let goal = vec!["left_of:2".parse().unwrap(), "not:near:3".parse().unwrap()];
    PlaceRequest {
        region: vec![RegionBox { min_m: [0.0; 3], max_m: [1.0; 3], inside: true }],
        budget: Budget { iterations: Some(2), ..Budget::default() },
        ..PlaceRequest::new(SCENE_ID.into(), 1, goal)
    }
}

pub fn arrange_request() -> ArrangeRequest {
    let goal = ObjectGoal { object: 1, terms: vec!["left_of:2".parse().unwrap(), "not:near:3".parse().unwrap()] };
    ArrangeRequest { view_yaw_rad: Some(0.5), time_ms: Some(2000), ..ArrangeRequest::new(SCENE_ID.into(), vec![goal]) }
}

pub fn arrange_result() -> ArrangeResult {
    let goals = arrange_request().goals;
    ArrangeResult {
        outcome: Outcome::Partial,
        moves: vec![ArrangeMove {
            object: 1,
            purpose: Purpose::Aside,
            goal: vec!["right_of:2".parse().unwrap()],
            placement: place_result().placements.remove(0),
        }],
        satisfied: vec![4],
        open: vec![1],
        needs_view: Vec::new(),
        probability: Some(0.75),
        conflict: Some(Conflict { goals: goals.clone(), proof: Proof::NotFound, smallest: true }),
        searches: 3,
        weights_hash: String::new(),
        scene_id: SCENE_ID.into(),
        view_yaw_rad: 0.5,
        goals,
        seed: 7,
    }
}

pub fn place_result() -> PlaceResult {
    PlaceResult {
        outcome: Outcome::Found,
        placements: vec![Placement {
            placed_from_observed: RigidTransform::IDENTITY,
            cost: 0.5,
            realism: Some(0.75),
            success: None,
            relations: vec![0.875, 1.0],
            geometric: vec![GeometricCheck { holds: true, margin_m: 0.0625 }],
            support_m: Some(0.03125),
            clearance_m: Some(1.0),
        }],
        rejections: BTreeMap::from([(Rejection::Goal, 3), (Rejection::OutOfView, 1)]),
        rejected_at_m: BTreeMap::new(),
        relaxation: Some(Relaxation { term: "not:near:3".parse().unwrap(), admits: 4 }),
        shortfall: None,
        iterations: 2,
        evaluated: 20,
        weights_hash: String::new(),
        models_hash: String::new(),
        kernel: String::new(),
        seed: u64::MAX,
        scene_id: SCENE_ID.into(),
        world_from_camera: None,
        query: 1,
        goal: place_request().goal,
        variant: Variant::Geometric,
        rotation: Rotation::Yaw,
        view_yaw_rad: 0.25,
        count: 1,
        min_separation_m: 0.03125,
        min_clearance_m: 0.0,
        min_success: None,
        robot: None,
        budget: Budget { iterations: Some(2), batch: Some(100), elites: Some(20), draws_per_batch: Some(3), time_ms: None },
        cost_weights: CostWeights { realism: Some(100.0), relations: Some(1.0) },
        thresholds: Thresholds { realism: Some(0.5), relations: Some(0.5) },
    }
}

/// A result with what came after version 1's first release.
pub fn place_result_2() -> PlaceResult {
    let first = place_result();
    let unevaluated = Placement { realism: None, support_m: None, clearance_m: None, ..first.placements[0].clone() };
    PlaceResult {
        placements: vec![unevaluated],
        relaxation: None,
        shortfall: Some(Shortfall { reason: ShortfallReason::Separation, passed: 17, too_close: 16 }),
        world_from_camera: Some(RigidTransform::IDENTITY),
        count: 3,
        ..first
    }
}

/// A request that names a robot and demands sureness.
pub fn place_request_3() -> PlaceRequest {
    let robot = ReachingRobot { name: "panda".into(), world_from_base: Some(RigidTransform::IDENTITY) };
    PlaceRequest { min_success: Some(0.875), robot: Some(robot), ..place_request() }
}

/// What answers it.
pub fn place_result_3() -> PlaceResult {
    let first = place_result();
    let sure = Placement { success: Some(0.9375), ..first.placements[0].clone() };
    PlaceResult {
        placements: vec![sure],
        rejections: BTreeMap::from([(Rejection::OutOfReach, 2), (Rejection::Unsure, 1)]),
        min_success: place_request_3().min_success,
        robot: place_request_3().robot,
        ..first
    }
}

/// A request that lets the object be set on another side.
pub fn place_request_4() -> PlaceRequest {
    PlaceRequest { rotation: Rotation::Stable, ..place_request() }
}

/// What answers it where the object leans.
pub fn place_result_4() -> PlaceResult {
    PlaceResult {
        rotation: Rotation::Stable,
        rejections: BTreeMap::from([(Rejection::Tips, 4), (Rejection::Collision, 1)]),
        ..place_result()
    }
}

pub fn set_point(t_ms: f64) -> SetPoint {
    SetPoint { t_ms, q_rad: [0.125; 7], dq_rad_s: [0.0; 7] }
}

pub fn motion_plan_request() -> MotionPlanRequest {
    MotionPlanRequest {
        scene: SceneRef { scene_id: SCENE_ID.into() },
        robot: "panda".into(),
        query: 1,
        placements: vec![RigidTransform::IDENTITY],
        start_joints_rad: [0.0; 7],
        grasps: None,
        seed: 1,
    }
}

pub fn motion_plan() -> MotionPlan {
    MotionPlan {
        scene_id: SCENE_ID.into(),
        robot: "panda".into(),
        query: 1,
        placement: 1,
        not_chosen: vec![NotChosen { placement: 0, reason: MotionFailure::PlaceUnreachable, detail: "0.9 m away".into() }],
        grasp: Grasp { world_from_tcp: RigidTransform::IDENTITY, width_m: 0.0625, score: 0.5 },
        start_joints_rad: [0.0; 7],
        start_tolerance_rad: 0.0625,
        scene_stamp_ns: 7,
        max_scene_age_ms: 60_000,
        phases: vec![MotionPhase {
            name: Phase::Standoff,
            gripper: Some(GripperCommand { width_m: 0.0625, force_n: 20.0 }),
            set_points: vec![set_point(0.0), set_point(10.0)],
        }],
        duration_ms: 10.0,
        heeded: None,
    }
}

pub fn robot_command() -> RobotCommand {
    RobotCommand {
        v: 1,
        seq: 3,
        owner: Owner { id: "motion-1".into(), epoch: 2 },
        ttl_ms: 300,
        starts_stream: true,
        ends_stream: false,
        set_points: vec![set_point(0.0), set_point(250.0)],
        gripper: None,
        clear_stop: false,
        clears: None,
        task: None,
    }
}

pub fn execute_reply() -> ExecuteReply {
    ExecuteReply { outcome: ExecutionOutcome::Stopped, phase: Phase::Lift, reason: Some("estop".into()), joints_rad: [0.5; 7] }
}

pub fn score_request() -> ScoreRequest {
    ScoreRequest {
        scene: SceneRef { scene_id: SCENE_ID.into() },
        query: 1,
        anchors: vec![2],
        view_yaw_rad: 0.25,
        realism: true,
        realism_by: RealismBy::Discriminator,
        relations: true,
        candidates: vec![[0.0, 0.5, 1.0, 0.0], [0.25, 0.5, 1.0, -0.5]],
    }
}

pub fn score_reply() -> ScoreReply {
    ScoreReply {
        weights_hash: "w".into(),
        kernel: "k".into(),
        realism: vec![0.5, 0.25],
        relations: vec![[0.125; RELATION_COUNT]; 2],
        anchors: 1,
    }
}

pub fn prior_reply() -> PriorReply {
    PriorReply {
        mixture: vec![MixtureComponent {
            weight: 1.0,
            mean_m: [0.5, 0.0, 0.25],
            sigma_m: [0.0625; 3],
            yaw_mean_rad: 0.0,
            yaw_concentration: 2.0,
        }],
        weights_hash: "w".into(),
        kernel: "k".into(),
        candidates: vec![[0.5, 0.25, 0.125, 0.0]],
        components: vec![0],
    }
}

pub fn prior_request() -> PriorRequest {
    PriorRequest {
        scene: SceneRef { scene_id: SCENE_ID.into() },
        query: 1,
        anchor: 2,
        goal: [1, 0, 0, -1, 0, 0, 0, 0, 0, 0],
        view_yaw_rad: 0.25,
        rotation: Rotation::Yaw,
        count: 100,
        seed: 9,
    }
}

pub fn models_reply() -> ModelsReply {
    let model = ModelInfo {
        name: "relations".into(),
        hash: "h".into(),
        recipe: serde_json::json!({"seed": 1}),
        metrics: serde_json::json!({"f1": 0.5}),
    };
    ModelsReply { weights_hash: "w".into(), kernel: "avx2".into(), models: vec![model] }
}

pub fn robot_state() -> RobotState {
    RobotState {
        v: 1,
        seq: 5,
        stamp_ns: 1_700_000_000_000_000_001,
        robot_ms: 12.5,
        q_rad: [0.25; 7],
        dq_rad_s: [0.0; 7],
        gripper_width_m: 0.0625,
        gripper_settled: true,
        gripper_holding: false,
        mode: RobotMode::Stopped,
        stop: Some(StopState { kind: "estop".into(), reason: "button".into(), estop_id: Some("e1".into()) }),
        owner: Some(Owner { id: "motion-1".into(), epoch: 2 }),
        last_command: Some(3),
        stream_ms: None,
        task: None,
        held: None,
        model: None,
        world_from_base: None,
        since_handling_ms: None,
        horizon_ms: None,
    }
}

pub fn held() -> HeldObject {
    HeldObject { scene_id: SCENE_ID.into(), object: 3, low_m: [-0.03, -0.02, -0.05], high_m: [0.03, 0.02, 0.01] }
}

pub fn task() -> Task {
    Task { id: "t1".into(), open: true, grasps: Some(held()) }
}

pub fn recover_request() -> RecoverRequest {
    RecoverRequest { robot: "panda".into(), motion: RecoveryMove::Home, scene: Some(SceneRef { scene_id: SCENE_ID.into() }) }
}

pub fn recover_reply() -> RecoverReply {
    let checked_against = Some(SCENE_ID.into());
    RecoverReply { outcome: ExecutionOutcome::Done, reason: None, retreated_m: Some(0.09), checked_against, joints_rad: [0.5; 7] }
}

pub fn emergency_stop() -> EmergencyStop {
    EmergencyStop { v: 1, id: "e1".into(), source: "panel".into(), reason: "button".into(), stamp_ns: 1_700_000_000_000_000_001 }
}

pub fn truth() -> Truth {
    Truth {
        seed: 7,
        sim_ms: 250.0,
        at_rest: true,
        view_yaw_rad: 0.0,
        objects: vec![TrueObject {
            id: 1,
            name: "mug".into(),
            world_from_object: RigidTransform::IDENTITY,
            world_from_box: RigidTransform::IDENTITY,
            extent_m: [0.0625, 0.0625, 0.125],
        }],
        relations: vec![TruePair { query: 1, anchor: 2, holds: [true, false, false, false, false, false, true, false, false, false] }],
    }
}

pub fn worker_load() -> WorkerLoad {
    WorkerLoad {
        v: 1,
        seq: 9,
        queue_depth: 2,
        queue_capacity: 32,
        in_flight: 1,
        service_ms: 12.5,
        weights_hash: "w".into(),
        kernel: "avx2".into(),
        draining: false,
        operates: false,
        journals: false,
        version: None,
        stamp_ns: None,
        ended: None,
        failed: None,
        keep_out: Vec::new(),
        cameras: Vec::new(),
    }
}
