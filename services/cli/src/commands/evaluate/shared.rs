//! What the tables of `repose evaluate` share: their arguments, an engine for many threads, scenes of a user's meshes.

use std::path::{Path, PathBuf};

use clap::Args;
use repose_dataset::Split;
use repose_inference::Engine;
use repose_planner::learned::stability::Stability;
use repose_planner::{PlannerConfig, stability_of};
use repose_simulator::objects::{MeshLibrary, MeshSettings, ObjectSource};
use repose_simulator::scene::SceneSettings;

use crate::embedded::engine;
use crate::failure::{Failure, Outcome};
use crate::values::{parse_split, threads};

/// What every table of the networks and the planner is told.
#[derive(Debug, Args)]
pub struct TableArgs {
    /// Which split's seeds: validation or test.
    #[arg(long, default_value = "test", value_parser = parse_split)]
    pub split: Split,
    /// A weights file in place of the weights that come with the program.
    #[arg(long, value_name = "FILE")]
    pub weights: Option<PathBuf>,
    /// Threads; all cores by default. The table does not depend on it.
    #[arg(long)]
    pub threads: Option<usize>,
}

impl TableArgs {
    /// The networks, one thread a request: the tables spread scenes over the cores.
    pub fn engine(&self) -> Result<Engine, Failure> {
        engine(self.weights.clone())
    }

    /// The threads to use.
    pub fn threads(&self) -> usize {
        threads(self.threads)
    }
}

/// What the tables of `best` are told beside the weights.
#[derive(Debug, Args)]
pub struct StabilityArgs {
    /// A file of `train --network stability` in place of the one that comes with the program: to go with `--weights`.
    #[arg(long, value_name = "FILE")]
    pub stability: Option<PathBuf>,
}

impl StabilityArgs {
    /// What `best` makes of the outcome network of an engine; says so when it was fitted on another one's words.
    pub fn read(&self, engine: &Engine) -> Result<Stability, Failure> {
        let config = PlannerConfig { stability: self.stability.clone(), ..PlannerConfig::default() };
        let stability = stability_of(&config).map_err(|e| Failure::bad_input("stability", e))?;
        let fitted_with = &stability.fitted_on().weights_hash;
        if fitted_with != engine.weights_hash() {
            tracing::warn!(
                weights_hash = engine.weights_hash(),
                fitted_with,
                "the stability was fitted with other weights: the figures of `best` are not what these weights can reach; `repose train --network stability` fits it anew"
            );
        }
        Ok(stability)
    }
}

/// What a report says of a stability.
pub fn named(stability: &Stability) -> serde_json::Value {
    serde_json::json!({"hash": stability.hash(), "fitted_on": stability.fitted_on()})
}

/// Makes scenes of a folder's meshes only.
pub fn only_meshes(scene: &mut SceneSettings, folder: &Path) -> Outcome {
    let library = MeshLibrary::load(folder, &MeshSettings::default()).map_err(|e| Failure::bad_input("objects", e))?;
    scene.arrange.source = ObjectSource::meshes(library);
    Ok(())
}
