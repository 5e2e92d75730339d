//! A robot's joints, where its links are, its body as the spheres that cover what shows of it, and its stops as lines of a log.

use foxglove::messages::{FrameTransforms, JointState, JointStates, Log, SceneEntity, SceneUpdate, SpherePrimitive, Timestamp, log};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use repose_geometry::transform::from_row_major;
use repose_panda::{LinkFrames, PlacedSphere, visible_spheres_in_base};
use repose_proto::robot::RobotState;

use super::message::VisualMessage;
use super::types::{WORLD, color, entity, instant, pose, transform, vector};

/// Between two drawings of a robot, nanoseconds: its states come faster than anybody looks.
const PERIOD_NS: u64 = 50_000_000;
/// Between two drawings of its body.
const BODY_PERIOD_NS: u64 = 200_000_000;
/// The state of a robot that was last drawn.
#[derive(Debug, Clone, Default)]
pub struct DrawnRobot {
    at_ns: u64,
    body_at_ns: u64,
    stop: Option<String>,
}

/// What is to be drawn of a state, given what was drawn before.
pub fn looks(name: &str, state: &RobotState, drawn: &mut DrawnRobot) -> Vec<VisualMessage> {
    let (at_ns, at) = (state.stamp_ns, instant(state.stamp_ns));
    let mut looks = Vec::new();
    let stop = state.stop.as_ref().map(|stop| format!("{} ({})", stop.reason, stop.kind));
    if stop != drawn.stop {
        let cleared = (log::Level::Info, "the stop is cleared".to_owned());
        let (level, message) = stop.clone().map_or(cleared, |stop| (log::Level::Warning, format!("stopped: {stop}")));
        let line = Log { timestamp: at, level: level.into(), message, name: name.to_owned(), file: String::new(), line: 0 };
        looks.extend(VisualMessage::new("/log".to_owned(), at_ns, &line));
        drawn.stop = stop;
    }
    if at_ns.abs_diff(drawn.at_ns) < PERIOD_NS {
        return looks;
    }
    drawn.at_ns = at_ns;
    let joints = state.q_rad.iter().zip(&state.dq_rad_s).enumerate();
    let joint =
        |name: String, q: f64, dq: f64| JointState { name, position: Some(q), velocity: Some(dq), acceleration: None, effort: None };
    let joints = joints.map(|(k, (q, dq))| joint(format!("{name}_joint{}", k + 1), *q, *dq));
    let finger = |side: &str| joint(format!("{name}_{side}_finger"), state.gripper_width_m / 2.0, 0.0);
    let joints = joints.chain([finger("left"), finger("right")]).collect();
    looks.extend(VisualMessage::new(format!("/robot/{name}/joints"), at_ns, &JointStates { timestamp: at, joints }));
    let world_from_base = state.world_from_base.and_then(|pose| from_row_major(&pose.0).ok()).unwrap_or_else(Isometry3::identity);
    let frames = LinkFrames::at(&state.q_rad);
    looks.extend(VisualMessage::new("/tf".to_owned(), at_ns, &transforms(name, at, &world_from_base, &frames)));
    if at_ns.abs_diff(drawn.body_at_ns) >= BODY_PERIOD_NS {
        drawn.body_at_ns = at_ns;
        let spheres = visible_spheres_in_base(&frames, state.gripper_width_m);
        let entities = vec![body(name, at, &spheres, &world_from_base, state.stop.is_some())];
        let update = SceneUpdate { deletions: Vec::new(), entities };
        looks.extend(VisualMessage::new(format!("/robot/{name}/body"), at_ns, &update));
    }
    looks
}

/// The links' frames in the world: `{name}_link0` to `{name}_link7`, and `{name}_hand`.
fn transforms(name: &str, at: Option<Timestamp>, world_from_base: &Isometry3<f64>, frames: &LinkFrames) -> FrameTransforms {
    let links = frames.links.iter().enumerate().map(|(k, frame)| (format!("{name}_link{}", k + 1), frame.isometry()));
    let links = links.chain([(format!("{name}_link0"), Isometry3::identity()), (format!("{name}_hand"), frames.hand.isometry())]);
    FrameTransforms { transforms: links.map(|(link, pose)| transform(at, WORLD, link, &(world_from_base * pose))).collect() }
}

fn body(name: &str, at: Option<Timestamp>, spheres: &[PlacedSphere], world_from_base: &Isometry3<f64>, is_stopped: bool) -> SceneEntity {
    let of = if is_stopped { [0.85, 0.25, 0.2, 1.0] } else { [0.88, 0.9, 0.93, 1.0] };
    let solid = |sphere: &PlacedSphere| {
        let at = Isometry3::from_parts((world_from_base * sphere.center).into(), UnitQuaternion::identity());
        SpherePrimitive { pose: Some(pose(&at)), size: Some(vector(&Vector3::repeat(2.0 * sphere.radius_m))), color: Some(color(of)) }
    };
    SceneEntity { spheres: spheres.iter().map(solid).collect(), ..entity(at, name.to_owned()) }
}

#[cfg(test)]
mod tests {
    use foxglove::Decode;
    use repose_panda::{READY, SPHERE_COUNT};
    use repose_proto::robot::RobotMode;

    use super::*;

    #[test]
    fn the_whole_of_a_robot_that_shows_is_drawn() {
        let state = RobotState {
            v: 1,
            seq: 1,
            stamp_ns: 1_000_000_000,
            robot_ms: 0.0,
            q_rad: READY,
            dq_rad_s: [0.0; 7],
            gripper_width_m: 0.04,
            gripper_settled: true,
            gripper_holding: false,
            mode: RobotMode::Stopped,
            stop: None,
            owner: None,
            last_command: None,
            stream_ms: None,
            task: None,
            held: None,
            since_handling_ms: None,
            model: None,
            world_from_base: None,
            horizon_ms: None,
        };
        let looks = looks("panda", &state, &mut DrawnRobot::default());
        let body = looks.iter().find(|look| look.topic == "/robot/panda/body").expect("a body");
        let update = SceneUpdate::decode(&*body.message).expect("a scene update");
        let spheres = visible_spheres_in_base(&LinkFrames::at(&READY), 0.04);
        assert!(spheres.len() > SPHERE_COUNT, "those that the shoulder's own leave out are among them");
        assert_eq!(update.entities[0].spheres.len(), spheres.len());
    }
}
