//! A robot's joints, where its links are, its body as the spheres of collision checks, and its stops as lines of a log.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use repose_geometry::transform::from_row_major;
use repose_panda::{LinkFrames, PlacedSphere, spheres_in_base};
use repose_proto::robot::RobotState;
use serde::Serialize;

use super::message::Look;
use super::schema::Kind;
use super::types::{Color, Entity, FrameTransform, FrameTransforms, SceneUpdate, Solid, Time, WORLD};

/// Between two drawings of a robot, nanoseconds: its states come faster than anybody looks.
const PERIOD_NS: u64 = 50_000_000;
/// Between two drawings of its body.
const BODY_PERIOD_NS: u64 = 200_000_000;
/// Foxglove's number for a line of information, and for a warning.
const INFO: u8 = 2;
const WARNING: u8 = 3;

/// What was drawn of a robot.
#[derive(Debug, Clone, Default)]
pub struct Drawn {
    at_ns: u64,
    body_at_ns: u64,
    stop: Option<String>,
}

#[derive(Serialize)]
struct JointStates {
    timestamp: Time,
    joints: Vec<JointState>,
}

#[derive(Serialize)]
struct JointState {
    name: String,
    position: f64,
    velocity: f64,
}

#[derive(Serialize)]
struct Log<'a> {
    timestamp: Time,
    level: u8,
    message: String,
    name: &'a str,
    file: &'static str,
    line: u32,
}

/// What is to be drawn of a state, given what was drawn before.
pub fn looks(name: &str, state: &RobotState, drawn: &mut Drawn) -> Vec<Look> {
    let (at_ns, at) = (state.stamp_ns, Time::of_ns(state.stamp_ns));
    let mut looks = Vec::new();
    let stop = state.stop.as_ref().map(|stop| format!("{} ({})", stop.reason, stop.kind));
    if stop != drawn.stop {
        let (level, message) = stop.clone().map_or((INFO, "the stop is cleared".to_owned()), |stop| (WARNING, format!("stopped: {stop}")));
        let line = Log { timestamp: at, level, message, name, file: "", line: 0 };
        looks.push(Look::new("/log".to_owned(), Kind::Log, at_ns, &line));
        drawn.stop = stop;
    }
    if at_ns.abs_diff(drawn.at_ns) < PERIOD_NS {
        return looks;
    }
    drawn.at_ns = at_ns;
    let joints = state.q_rad.iter().zip(&state.dq_rad_s).enumerate();
    let joints = joints.map(|(k, (q, dq))| JointState { name: format!("{name}_joint{}", k + 1), position: *q, velocity: *dq });
    let finger = |side: &str| JointState { name: format!("{name}_{side}_finger"), position: state.gripper_width_m / 2.0, velocity: 0.0 };
    let joints = joints.chain([finger("left"), finger("right")]).collect();
    looks.push(Look::new(format!("/robot/{name}/joints"), Kind::JointStates, at_ns, &JointStates { timestamp: at, joints }));
    let world_from_base = state.world_from_base.and_then(|pose| from_row_major(&pose.0).ok()).unwrap_or_else(Isometry3::identity);
    let frames = LinkFrames::at(&state.q_rad);
    looks.push(Look::new("/tf".to_owned(), Kind::FrameTransforms, at_ns, &transforms(name, at, &world_from_base, &frames)));
    if at_ns.abs_diff(drawn.body_at_ns) >= BODY_PERIOD_NS {
        drawn.body_at_ns = at_ns;
        let spheres = spheres_in_base(&frames, state.gripper_width_m);
        let entities = vec![body(name, at, &spheres, &world_from_base, state.stop.is_some())];
        let update = SceneUpdate { deletions: Vec::new(), entities };
        looks.push(Look::new(format!("/robot/{name}/body"), Kind::SceneUpdate, at_ns, &update));
    }
    looks
}

/// The links' frames in the world: `{name}_link0` to `{name}_link7`, and `{name}_hand`.
fn transforms(name: &str, at: Time, world_from_base: &Isometry3<f64>, frames: &LinkFrames) -> FrameTransforms {
    let links = frames.links.iter().enumerate().map(|(k, frame)| (format!("{name}_link{}", k + 1), frame.isometry()));
    let links = links.chain([(format!("{name}_link0"), Isometry3::identity()), (format!("{name}_hand"), frames.hand.isometry())]);
    FrameTransforms { transforms: links.map(|(link, pose)| FrameTransform::new(at, WORLD, link, &(world_from_base * pose))).collect() }
}

fn body(name: &str, at: Time, spheres: &[PlacedSphere], world_from_base: &Isometry3<f64>, is_stopped: bool) -> Entity {
    let color = if is_stopped { Color { r: 0.85, g: 0.25, b: 0.2, a: 1.0 } } else { Color { r: 0.88, g: 0.9, b: 0.93, a: 1.0 } };
    let solid = |sphere: &PlacedSphere| {
        let pose = Isometry3::from_parts((world_from_base * sphere.center).into(), UnitQuaternion::identity());
        Solid { pose: (&pose).into(), size: Vector3::repeat(2.0 * sphere.radius_m).into(), color }
    };
    let mut entity = Entity::new(at, name.to_owned());
    entity.spheres = spheres.iter().map(solid).collect();
    entity
}
