//! What the tables of `repose evaluate` share: scenes of a user's meshes, an engine for many threads, reports on disk.

use std::path::Path;

use repose_inference::{Engine, InferenceConfig, engine_of};
use repose_simulator::objects::{MeshLibrary, MeshSettings, ObjectSource};
use repose_simulator::scene::SceneSettings;

use crate::failure::{Failure, Outcome};

/// The threads to use: as many as asked for, or one a core.
pub fn threads(asked: Option<usize>) -> usize {
    asked.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from)).max(1)
}

/// A weights file's networks, or those that come with the program, one thread a request: the tables spread scenes over the cores.
pub fn one_thread_engine(weights: Option<&Path>) -> Result<Engine, Failure> {
    let config = InferenceConfig { weights: weights.map(Path::to_path_buf), threads: 1, ..InferenceConfig::default() };
    engine_of(&config).map_err(|e| Failure::bad_input("weights", e))
}

/// Makes scenes of a folder's meshes only.
pub fn only_meshes(scene: &mut SceneSettings, folder: &Path) -> Outcome {
    let library = MeshLibrary::load(folder, &MeshSettings::default()).map_err(|e| Failure::bad_input("objects", e))?;
    scene.arrange.source = ObjectSource::meshes(library);
    Ok(())
}

/// Writes `NAME.json` and pictures (name, SVG) into a folder.
pub fn write_report(folder: &Path, name: &str, document: &serde_json::Value, pictures: &[(&str, String)]) -> Outcome {
    let failed = |e: std::io::Error| Failure::bad_input("out", format!("{}: {e}", folder.display()));
    std::fs::create_dir_all(folder).map_err(failed)?;
    let json = serde_json::to_string_pretty(document).map_err(Failure::other)?;
    std::fs::write(folder.join(format!("{name}.json")), json).map_err(failed)?;
    pictures.iter().try_for_each(|(name, svg)| std::fs::write(folder.join(format!("{name}.svg")), svg).map_err(failed))
}
