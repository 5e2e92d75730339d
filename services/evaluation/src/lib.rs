//! The paper's tables, regenerated: problems with a known truth, what came of each answer, and rates with intervals.
//!
//! This crate may start any service's domain code; nothing depends on it but the command line.

pub mod agreement;
pub mod calibration;
pub mod carry_watch;
pub mod confusion;
pub mod correlation;
pub mod discriminator_table;
pub mod mask_scores;
pub mod one_scene;
pub mod outcome;
pub mod paired;
pub mod paper;
pub mod planner_scene;
pub mod planner_table;
pub mod problem;
pub mod proposals;
pub mod rate;
pub mod relations_table;
pub mod resample;
pub mod robot_scene;
pub mod robot_table;
pub mod robot_trial;
pub mod scoring_speed;
pub mod script;
pub mod segmentation;
pub mod stability_fit;
pub mod stability_samples;
pub mod svg;
pub mod true_answers;
pub mod world;

pub use discriminator_table::{DiscriminatorSettings, DiscriminatorTable, evaluate_discriminator};
pub use planner_scene::{PlannerSceneSettings, SceneRecord, SceneSet, ScriptTrial, TriedScene};
pub use planner_table::{Part, PlannerRow, PlannerTableSettings, SetTable, evaluate_planner, planner_tables};
pub use problem::{Problem, ProblemSettings};
pub use proposals::{ProposalSettings, proposals};
pub use rate::Rate;
pub use relations_table::{RelationsSettings, RelationsTable, evaluate_relations};
pub use robot_table::{RobotTable, RobotTableSettings, evaluate_robot};
pub use segmentation::{Half, SegmentationRow, SegmentationTrial, judge_frame, row_of};
pub use world::{WorldReport, WorldReportSettings, world_report};
