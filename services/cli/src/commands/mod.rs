//! One file a subcommand.

pub mod bench;
pub mod bench_motion;
pub mod bench_perception;
pub mod bench_scoring;
pub mod demo;
pub mod evaluate;
pub mod evaluate_discriminator;
pub mod evaluate_relations;
pub mod evaluate_robot;
pub mod evaluate_scenes;
pub mod evaluate_segmentation;
pub mod evaluate_world;
pub mod generate;
pub mod load;
pub mod place;
pub mod plan;
pub mod play;
pub mod relations;
pub mod score;
pub mod segment;
pub mod serve;
pub mod train;
pub mod up;
pub mod weights;
