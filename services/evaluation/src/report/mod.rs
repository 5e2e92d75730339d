//! What the tables are printed and drawn as: JSON, text, plots, pictures of scenes, contact sheets.

pub mod arrange;
pub mod belief;
pub mod discriminator;
pub mod final_runs;
pub mod histogram;
pub mod own_commit;
pub mod planner;
pub mod planner_records;
pub mod planner_sheets;
pub mod plots;
pub mod relations;
pub mod robot;
pub mod segmentation;
pub mod text;
pub mod world;
pub mod written;
