//! One file or folder a subcommand, which owns its arguments.

pub mod arrange;
pub mod bench;
pub mod cells;
pub mod demo;
pub mod deploy;
pub mod driver;
pub mod evaluate;
pub mod generate;
pub mod load;
pub mod mcp;
pub mod place;
pub mod plan;
pub mod play;
pub mod record;
pub mod relations;
pub mod replay;
pub mod robot;
pub mod scene;
pub mod score;
pub mod segment;
pub mod serve;
pub mod status;
pub mod train;
pub mod up;
pub mod weights;
