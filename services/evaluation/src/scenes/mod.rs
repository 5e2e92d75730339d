//! Single scenes: a problem with its truth, what is tried on it, and what physics makes of the answer.

pub mod agreement;
pub mod arrangement;
pub mod back_samples;
pub mod bearing_samples;
pub mod believed;
pub mod carry_watch;
pub mod cell_run;
pub mod cut_samples;
pub mod foot_samples;
pub mod loads;
pub mod one_scene;
pub mod outcome;
pub mod perturbation;
pub mod planner_scene;
pub mod problem;
pub mod proposals;
pub mod robot_scene;
pub mod robot_settings;
pub mod robot_trial;
pub mod script;
pub mod stability_samples;
pub mod standing_samples;
pub mod success_samples;
pub mod training_views;
pub mod true_answers;
pub mod true_reach;
