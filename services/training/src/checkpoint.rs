//! A run's state beside its weights: what it takes to go on as if it had not been interrupted.

use std::path::{Path, PathBuf};

use repose_networks::{Weights, WeightsInfo, parameters::WeightMap};

use crate::{adam::AdamW, error::TrainError, settings::TrainSettings};

/// What is taken up again.
pub struct State {
    /// Steps done.
    pub step: u64,
    /// Trained values and running statistics.
    pub values: WeightMap,
    /// Averaged values.
    pub average: WeightMap,
    /// The optimiser.
    pub adam: AdamW,
}

fn path(settings: &TrainSettings) -> PathBuf {
    settings.out.with_extension(format!("{}.checkpoint", settings.part.name()))
}

/// Replaces a file at once, so that a reader or an interruption never meets half of one.
pub fn write(path: &Path, bytes: &[u8]) -> Result<(), TrainError> {
    repose_dataset::write_whole(path, bytes).map_err(|source| TrainError::Io { path: path.to_path_buf(), source })
}

/// Writes the state after `step` steps.
pub fn save(settings: &TrainSettings, step: u64, values: &WeightMap, average: &WeightMap, adam: &AdamW) -> Result<(), TrainError> {
    let (adam_step, moments) = adam.state();
    let mut all = WeightMap::new();
    let mut add = |kind: &str, name: &str, shape: Vec<usize>, numbers: Vec<f32>| all.insert(format!("{kind}:{name}"), (shape, numbers));
    for (name, (shape, numbers)) in values {
        add("value", name, shape.clone(), numbers.clone());
    }
    for (name, (shape, numbers)) in average {
        add("average", name, shape.clone(), numbers.clone());
    }
    for (name, (first, second)) in moments {
        add("first", name, vec![first.len()], first.clone());
        add("second", name, vec![second.len()], second.clone());
    }
    let recipe = serde_json::json!({ "step": step, "adam_step": adam_step, "seed": settings.seed, "part": settings.part });
    write(&path(settings), &Weights::to_bytes(&all, &WeightsInfo { recipe, metrics: serde_json::Value::Null })?)
}

/// The state of an interrupted run of the same part and seed, if there is one that is not finished.
pub fn load(settings: &TrainSettings) -> Result<Option<State>, TrainError> {
    let path = path(settings);
    let bytes = match std::fs::read(&path) {
        Ok(bytes) => bytes,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(source) => return Err(TrainError::Io { path, source }),
    };
    let stored = Weights::from_bytes(&bytes)?;
    let number = |key: &str| stored.info.recipe[key].as_u64();
    if number("seed") != Some(settings.seed) || stored.info.recipe["part"] != serde_json::json!(settings.part) {
        return Ok(None);
    }
    let of = |kind: &str| -> WeightMap {
        let prefix = format!("{kind}:");
        stored.values.iter().filter_map(|(name, v)| Some((name.strip_prefix(&prefix)?.to_string(), v.clone()))).collect()
    };
    let second = of("second");
    let moments =
        of("first").into_iter().filter_map(|(name, (_, first))| Some((name.clone(), (first, second.get(&name)?.1.clone())))).collect();
    let adam = AdamW::restore(number("adam_step").unwrap_or(0) as i32, moments);
    Ok(Some(State { step: number("step").unwrap_or(0), values: of("value"), average: of("average"), adam }))
}
