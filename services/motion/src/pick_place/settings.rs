//! How a pick and place is planned: the settings of its parts, and its own.

use nalgebra::Isometry3;
use repose_panda::{InverseSettings, Model};

use crate::grasp::GraspSettings;
use crate::obstacles::{ObstacleSettings, ObstacleShape};
use crate::path::rrt_connect::RrtSettings;
use crate::path::simplify::SimplifySettings;
use crate::path::timing::TimingSettings;
use crate::pick_place::reach::EndSearchSettings;

/// How a pick and place is planned.
#[derive(Debug, Clone, PartialEq)]
pub struct PickPlaceSettings {
    /// Where the robot stands.
    pub world_from_base: Isometry3<f64>,
    /// What no part of the arm, nor what it holds, may enter. Default: nothing.
    pub keep_out: Vec<ObstacleShape>,
    /// What stands beside the robot and is in no scene: other robots.
    pub beside: Vec<ObstacleShape>,
    /// The obstacles' resolution.
    pub obstacles: ObstacleSettings,
    /// How grasps are found.
    pub grasp: GraspSettings,
    /// How the ends are reached, and within which limits of the joints everything is planned. Default: those that every driver of a Panda carries out.
    pub reach: EndSearchSettings,
    /// The search for paths between them.
    pub rrt: RrtSettings,
    /// The shortening of those paths.
    pub simplify: SimplifySettings,
    /// How fast the arm moves in free space. Default: under the same limits.
    pub timing: TimingSettings,
    /// Share of that speed and acceleration near things: approach, lift, lower, retreat. Default 0.5.
    pub contact_scale: f64,
    /// Share of the free speed and acceleration at which the object is carried, lifting and lowering included: what is held by friction turns and
    /// slips when it is hurried. Default 0.5.
    pub holding_scale: f64,
    /// What is added to the robot's spheres, metres: they leave out edges of the arm. Default 0.005.
    pub padding_m: f64,
    /// Spacing of the held object's points, metres. Default 0.012.
    pub held_spacing_m: f32,
    /// Ball that each of them stands for, metres. Default 0.004.
    pub held_radius_m: f64,
    /// Room that is kept around what is held on the way where there is some, metres. Default 0.02.
    pub held_room_m: f64,
    /// Room that is kept around the arm on its ways through free space where there is some, metres. Default 0.015.
    pub arm_room_m: f64,
    /// Grip force on what is held about its middle, newtons. Default 30.
    pub grip_force_n: f64,
    /// The most grip force, newtons, on what is held far beside its middle and would turn between the pads by its weight. Default 60.
    pub grip_force_max_n: f64,
    /// Grasps found here that are tried per placement, both turns of the hand counted. Default 64.
    pub grasps_per_placement: usize,
    /// A carry of at most this length (joint space) is short enough not to look for a shorter one, radians. Default 2.2.
    pub carry_rad: f64,
    /// What each further radian takes off a grasp's score (0 to 1). Default 0.08.
    pub carry_cost_per_rad: f64,
    /// Grasps found here, with longer carries, that are compared. Default 8.
    pub compared: usize,
    /// Path searches per placement that may fail. Default 4.
    pub path_failures: usize,
}

impl Default for PickPlaceSettings {
    fn default() -> Self {
        let limits = Model::default().driven_limits();
        let reach = EndSearchSettings::default();
        Self {
            world_from_base: Isometry3::identity(),
            keep_out: Vec::new(),
            beside: Vec::new(),
            obstacles: ObstacleSettings::default(),
            grasp: GraspSettings::default(),
            reach: EndSearchSettings { inverse: InverseSettings { limits, ..reach.inverse }, ..reach },
            // A pick and place asks many searches, some of them in vain.
            rrt: RrtSettings { iterations: 1500, ..RrtSettings::default() },
            simplify: SimplifySettings::default(),
            timing: TimingSettings { limits, ..TimingSettings::default() },
            contact_scale: 0.5,
            holding_scale: 0.5,
            padding_m: 0.005,
            held_spacing_m: 0.012,
            held_radius_m: 0.004,
            held_room_m: 0.02,
            arm_room_m: 0.015,
            grip_force_n: 30.0,
            grip_force_max_n: 60.0,
            grasps_per_placement: 64,
            carry_rad: 2.2,
            carry_cost_per_rad: 0.08,
            compared: 8,
            path_failures: 4,
        }
    }
}
