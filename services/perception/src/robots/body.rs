//! A robot's body as balls in the camera frame.

use nalgebra::{Isometry3, Point3};
use repose_geometry::transform::from_row_major;
use repose_panda::kinematics::LinkFrames;
use repose_panda::{base_from_hand, hand_from_tcp, visible_spheres_in_base};
use repose_proto::RobotInView;
use repose_proto::robot::PANDA_LIKE;

/// The Panda's foot reaches further back than its collision sphere: centre (base frame, metres) and radius of what is added. They are the
/// ends of link 0's capsule in Franka's robot description (`franka_description`, `franka_arm.xacro`: centre (-0.075, 0, 0.06), radius 0.06,
/// length 0.03) with the safety distance of 0.03 that it gives the Panda.
const PANDA_FOOT: [[f64; 4]; 2] = [[-0.09, 0.0, 0.06, 0.09], [-0.06, 0.0, 0.06, 0.09]];

/// Why a robot cannot be told from the rest of the picture.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NoBody {
    /// Its shape is not known.
    #[error("unknown robot model {0:?}, expected \"panda\" or \"fr3\"")]
    Model(String),
    /// Its pose is no rigid transform.
    #[error("world_from_base: {0}")]
    Pose(String),
}

/// A ball that a part of the robot lies within.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ball {
    /// Its centre, camera frame, metres.
    pub center: Point3<f32>,
    /// Its radius, metres.
    pub radius_m: f32,
}

/// The geometry of a robot when the picture was taken.
#[derive(Debug, Clone, PartialEq)]
pub struct RobotBody {
    /// What it fills, a little more than that.
    pub balls: Vec<Ball>,
    /// The point between the fingertips: z along the approach, y along the opening.
    pub camera_from_tcp: Isometry3<f64>,
    /// The fingers' opening, metres.
    pub gripper_width_m: f64,
}

impl RobotBody {
    /// The robot in the frame of a camera.
    ///
    /// # Errors
    /// [`NoBody`] when its model is unknown or its pose is not rigid.
    pub fn new(robot: &RobotInView, camera_from_world: &Isometry3<f64>) -> Result<Self, NoBody> {
        if !PANDA_LIKE.contains(&robot.model.as_str()) {
            return Err(NoBody::Model(robot.model.clone()));
        }
        let world_from_base = from_row_major(&robot.world_from_base.0).map_err(|e| NoBody::Pose(e.to_string()))?;
        let camera_from_base = camera_from_world * world_from_base;
        let spheres = visible_spheres_in_base(&LinkFrames::at(&robot.joints_rad), robot.gripper_width_m);
        let ball = |center: &Point3<f64>, radius_m: f64| Ball { center: (camera_from_base * center).cast(), radius_m: radius_m as f32 };
        let balls = spheres.iter().map(|s| ball(&s.center, s.radius_m));
        let foot = PANDA_FOOT.iter().map(|[x, y, z, radius_m]| ball(&Point3::new(*x, *y, *z), *radius_m));
        Ok(Self {
            balls: balls.chain(foot).collect(),
            camera_from_tcp: camera_from_base * base_from_hand(&robot.joints_rad) * hand_from_tcp(),
            gripper_width_m: robot.gripper_width_m,
        })
    }
}
