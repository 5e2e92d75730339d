//! The paper's tables, regenerated: problems with a known truth, what came of each answer, and rates with intervals.
//!
//! This crate may start any service's domain code; nothing depends on it but the command line.

pub mod agreement;
pub mod feasible;
pub mod mask_scores;
pub mod outcome;
pub mod planner_table;
pub mod problem;
pub mod rate;
pub mod robot_scene;
pub mod robot_table;
pub mod robot_trial;
pub mod segmentation;
pub mod world;

pub use planner_table::{PlannerRow, PlannerTable, evaluate_planner};
pub use problem::{Problem, ProblemSettings};
pub use rate::Rate;
pub use robot_table::{RobotTable, RobotTableSettings, evaluate_robot};
pub use segmentation::{Half, SegmentationRow, SegmentationTrial, judge_frame, row_of};
pub use world::{WorldReport, WorldReportSettings, world_report};
