//! Tables over many scenes: the paper's, and those that say how well each part works.

pub mod arrange;
pub mod belief;
pub mod discriminator;
pub mod paper;
pub mod planner;
pub mod relations;
pub mod robot;
pub mod scoring_speed;
pub mod segmentation;
pub mod world;
