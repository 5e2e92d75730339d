//! A run's state beside its weights: everything it needs to continue as if it had not been interrupted, and to recognise the same run.

use std::path::{Path, PathBuf};

use repose_networks::{Weights, WeightsError, WeightsInfo, parameters::WeightMap};
use serde::{Deserialize, Serialize};

use crate::{
    adam::AdamW,
    error::TrainError,
    settings::{RelationsVariant, TrainSettings},
};

/// What a run began with. A run that began with something else is another run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Origin {
    /// The weights it started from, by [`name_of`]; none for new ones.
    pub start: Option<String>,
    /// The others whose mean with those it started from.
    pub mean_with: Vec<String>,
    /// Which relation predictor the networks have.
    pub relations: RelationsVariant,
}

/// How an [`Origin`] identifies weights: by their hash. A run that overwrites its start has nothing to compare later.
pub fn name_of(weights: &Weights, path: &Path, out: &Path) -> String {
    let is_out = path == out || matches!((path.canonicalize(), out.canonicalize()), (Ok(path), Ok(out)) if path == out);
    if is_out { "the file that it writes".to_owned() } else { weights.hash.clone() }
}

impl Origin {
    /// The first field that differs: its name, what it is in `self`, and what in `other`.
    fn difference(&self, other: &Self) -> Option<(&'static str, [String; 2])> {
        let start = |origin: &Self| origin.start.clone().unwrap_or_else(|| "new weights".to_owned());
        let mean_with = |origin: &Self| format!("a mean with [{}]", origin.mean_with.join(", "));
        let relations = |origin: &Self| format!("the {} relation predictor", origin.relations.name());
        if self.start != other.start {
            Some(("start", [self, other].map(|o| format!("start {}", start(o)))))
        } else if self.mean_with != other.mean_with {
            Some(("mean_with", [self, other].map(mean_with)))
        } else if self.relations != other.relations {
            Some(("relations", [self, other].map(relations)))
        } else {
            None
        }
    }
}

/// The state that a training run resumes from.
pub struct TrainingState {
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
    beside(settings, "checkpoint")
}

/// The path of what a run keeps beside its weights: `weights.safetensors` → `weights.joint.checkpoint`. Any other ending is part of the weights'
/// name: `run.1` and `run.2` are two runs.
pub fn beside(settings: &TrainSettings, ending: &str) -> PathBuf {
    let out = &settings.out;
    let weights = if out.extension().is_some_and(|e| e == "safetensors") { out.with_extension("") } else { out.clone() };
    let mut path = weights.into_os_string();
    path.push(format!(".{}.{ending}", settings.part.name()));
    path.into()
}

/// Replaces a file atomically: readers and interruptions never see half of it.
pub fn write(path: &Path, bytes: &[u8]) -> Result<(), TrainError> {
    repose_dataset::write_whole(path, bytes).map_err(|source| TrainError::Io { path: path.to_path_buf(), source })
}

/// Writes the state after `step` steps.
pub fn save(
    settings: &TrainSettings,
    origin: &Origin,
    step: u64,
    values: &WeightMap,
    average: &WeightMap,
    adam: &AdamW,
) -> Result<(), TrainError> {
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
    let recipe =
        serde_json::json!({ "step": step, "adam_step": adam_step, "seed": settings.seed, "part": settings.part, "origin": origin });
    write(&path(settings), &Weights::to_bytes(&all, &WeightsInfo { recipe, ..WeightsInfo::default() })?)
}

/// The state of an earlier session of the same part and seed, if there is one.
///
/// # Errors
/// [`TrainError::OtherRun`] when that run began differently. Checkpoints that do not say how they began are resumed.
pub fn load(settings: &TrainSettings, origin: &Origin) -> Result<Option<TrainingState>, TrainError> {
    let path = path(settings);
    let bytes = match std::fs::read(&path) {
        Ok(bytes) => bytes,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(source) => return Err(TrainError::Io { path, source }),
    };
    let broken = |source| TrainError::Checkpoint { path: path.clone(), source };
    let stored = Weights::from_bytes(&bytes).map_err(broken)?;
    let number = |key: &str| stored.info.recipe[key].as_u64();
    if number("seed") != Some(settings.seed) || stored.info.recipe["part"] != serde_json::json!(settings.part) {
        return Ok(None);
    }
    let theirs = serde_json::from_value::<Option<Origin>>(stored.info.recipe["origin"].clone());
    let theirs = theirs.map_err(|e| broken(WeightsError::Malformed { field: "origin".to_owned(), reason: e.to_string() }))?;
    if let Some((field, [theirs, ours])) = theirs.and_then(|theirs| theirs.difference(origin)) {
        return Err(TrainError::OtherRun { field, checkpoint: path, theirs, ours });
    }
    let of = |kind: &str| -> WeightMap {
        let prefix = format!("{kind}:");
        stored.values.iter().filter_map(|(name, v)| Some((name.strip_prefix(&prefix)?.to_string(), v.clone()))).collect()
    };
    let second = of("second");
    let moments =
        of("first").into_iter().filter_map(|(name, (_, first))| Some((name.clone(), (first, second.get(&name)?.1.clone())))).collect();
    let adam = AdamW::restore(number("adam_step").unwrap_or(0) as i32, moments);
    Ok(Some(TrainingState { step: number("step").unwrap_or(0), values: of("value"), average: of("average"), adam }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_that_write_other_weights_keep_other_files() {
        let kept = |out: &str| beside(&TrainSettings { out: out.into(), ..TrainSettings::default() }, "checkpoint");
        assert_eq!(kept("out/weights.safetensors"), Path::new("out/weights.joint.checkpoint"));
        assert_eq!(kept("out/round.2.safetensors"), Path::new("out/round.2.joint.checkpoint"));
        assert_eq!(["out/run.1", "out/run.2"].map(kept), ["out/run.1.joint.checkpoint", "out/run.2.joint.checkpoint"].map(PathBuf::from));
    }
}
