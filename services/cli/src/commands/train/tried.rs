//! Scenes that are tried for a fit. Each goes to a file in the data folder as soon as it was tried, so that a run that was stopped goes on, and
//! parts made on several machines can be put together. Each says what it was measured with; what was measured with something else is refused.

use std::collections::BTreeMap;
use std::fmt::Display;
use std::fs::File;
use std::io::Write;
use std::path::Path;

use repose_dataset::Split;
use repose_evaluation::statistics::forecast_fit::{FitSample, FitSettings, fit_forecast};
use repose_networks::serving::spread;
use repose_planner::learned::forecast::{Forecast, ForecastFitData};
use repose_proto::CallError;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::failure::Failure;
use crate::progress::Progress;
use crate::values::SceneNumbers;

/// The measures and results of one scene, from which a forecast is fitted.
pub trait MeasuredScene: Serialize + DeserializeOwned + Send {
    /// The scene.
    fn seed(&self) -> u64;
    /// How many measures each of its samples has that is not of this program's length; none where all are.
    fn other_length(&self) -> Option<String>;
}

/// A line of the file.
#[derive(Debug, Serialize, Deserialize)]
struct Row<S> {
    /// [`TriedScenes::made_with`] when it was tried.
    made_with: String,
    scene: S,
}

/// What is read of a line first: the rest of one that another program wrote may be of any form.
#[derive(Debug, Deserialize)]
struct Origin {
    made_with: Option<String>,
}

/// What a forecast is fitted on, and where it goes.
#[derive(Debug, Clone, Copy)]
pub struct FitArgs<'a> {
    /// The folder of what is learned from.
    pub data: &'a Path,
    /// Weights in place of those that come with the program.
    pub start: Option<&'a Path>,
    /// The weights file that is written: those of `start` with the forecasts in it.
    pub out: &'a Path,
    /// The first scene that is tried, counted from the first of those that are learned from.
    pub first: u64,
    /// Scenes tried, if they are not in the folder yet; whatever else is there is learned from too.
    pub scenes: u64,
    /// Threads.
    pub threads: usize,
    /// Seed of what each tree sees.
    pub seed: u64,
}

impl<'a> FitArgs<'a> {
    /// The scenes to try, kept in a file of the data folder; `first_seed` is that of the first of those that are learned from, and `made_with` a hash of
    /// what they are measured with.
    pub fn scenes_in(&self, file: &'a str, first_seed: u64, made_with: &'a str) -> TriedScenes<'a> {
        TriedScenes { data: self.data, file, first_seed, first: self.first, count: self.scenes, threads: self.threads, made_with }
    }

    /// Refuses weights to start from, for what is no part of them.
    pub fn refuse_start(&self) -> Result<(), Failure> {
        match self.start {
            Some(_) => Err(Failure::bad_input("start", "only networks start from other weights")),
            None => Ok(()),
        }
    }

    /// Writes what was fitted to `out`, in JSON.
    pub fn write(&self, fitted: &impl Serialize) -> Result<(), Failure> {
        let text = serde_json::to_string(fitted).map_err(Failure::other)?;
        repose_dataset::write_whole(self.out, text.as_bytes())
            .map_err(|e| Failure::bad_input("out", format!("{}: {e}", self.out.display())))
    }
}

/// The scenes that are tried for a fit.
#[derive(Debug, Clone, Copy)]
pub struct TriedScenes<'a> {
    /// The data folder.
    pub data: &'a Path,
    /// The file in it, of JSON lines.
    pub file: &'a str,
    /// The seed of the first of the scenes that are learned from.
    pub first_seed: u64,
    /// The first scene that is tried, counted from that one.
    pub first: u64,
    /// Scenes tried, if they are not in the file yet; whatever else is there is learned from too.
    pub count: u64,
    /// Threads.
    pub threads: usize,
    /// A hash of everything learned that they are measured with.
    pub made_with: &'a str,
}

impl TriedScenes<'_> {
    /// All scenes by seed: those in the file, and those that are tried now, by their index.
    pub fn tried<S: MeasuredScene>(&self, of: impl Fn(u64) -> Result<S, CallError> + Sync) -> Result<BTreeMap<u64, S>, Failure> {
        // Beyond the last training scene are those of validation, by which what was learned is judged.
        SceneNumbers { split: Split::Train, before: self.first_seed, count_option: "steps" }.check(self.first, self.count)?;
        let path = self.data.join(self.file);
        let bad = |e: &dyn Display| Failure::bad_input("data", format!("{}: {e}", path.display()));
        std::fs::create_dir_all(self.data).map_err(|e| bad(&e))?;
        let text = if path.exists() { std::fs::read_to_string(&path).map_err(|e| bad(&e))? } else { String::new() };
        let mut all: BTreeMap<u64, S> = BTreeMap::new();
        // A last line that was being written when the program was stopped is tried again.
        let whole = text.rfind('\n').map_or(0, |end| end + 1);
        for line in text[..whole].lines() {
            let Origin { made_with } = serde_json::from_str(line).map_err(|e| bad(&e))?;
            if made_with.as_deref() != Some(self.made_with) {
                return Err(bad(&self.other_origin(made_with.as_deref())));
            }
            let Row { scene, .. } = serde_json::from_str::<Row<S>>(line).map_err(|e| bad(&e))?;
            if let Some(other) = scene.other_length() {
                return Err(bad(&format!("{other}: made by another program")));
            }
            all.insert(scene.seed(), scene);
        }
        let mut file = File::options().create(true).append(true).open(&path).map_err(|e| bad(&e))?;
        file.set_len(whole as u64).map_err(|e| bad(&e))?;
        let open: Vec<u64> = (self.first..self.first + self.count).filter(|i| !all.contains_key(&(self.first_seed + i))).collect();
        let bar = Progress::new(open.len() as u64, "scenes");
        for batch in open.chunks(self.threads.max(1) * 2) {
            for scene in spread(batch.len(), self.threads, || (), |(), k| of(batch[k])) {
                let scene = scene?;
                let row = Row { made_with: self.made_with.to_owned(), scene: &scene };
                writeln!(file, "{}", serde_json::to_string(&row).map_err(Failure::other)?).map_err(|e| bad(&e))?;
                all.insert(scene.seed(), scene);
                bar.add(1);
            }
        }
        bar.finish();
        Ok(all)
    }

    /// Why scenes that were measured with something else are not learned from, and what to do.
    fn other_origin(&self, theirs: Option<&str>) -> String {
        let theirs = match theirs {
            Some(theirs) => format!("its scenes were measured with {theirs}"),
            None => "it does not say what its scenes were measured with".to_owned(),
        };
        format!(
            "{theirs}, expected {}, a hash of the weights that are started from and of the trees and networks that come with the program: delete the \
             file, or give another folder as --data",
            self.made_with
        )
    }
}

/// In so many parts the scenes are held out in turn, to tell how good a fit is.
const FOLDS: usize = 8;

/// What fits say of scenes that they have not seen, in the order of the scenes: each part of them is judged by a fit on all the others.
pub fn held_out<S, F, T>(
    scenes: &[S],
    fit: impl Fn(&[&S]) -> Result<F, Failure>,
    said: impl Fn(&F, &S) -> Vec<T>,
) -> Result<Vec<Vec<T>>, Failure> {
    let mut all: Vec<(usize, Vec<T>)> = Vec::with_capacity(scenes.len());
    for fold in 0..FOLDS {
        let learned: Vec<&S> = scenes.iter().enumerate().filter(|(i, _)| i % FOLDS != fold).map(|(_, scene)| scene).collect();
        let fitted = fit(&learned)?;
        all.extend(scenes.iter().enumerate().skip(fold).step_by(FOLDS).map(|(i, scene)| (i, said(&fitted, scene))));
    }
    all.sort_by_key(|(i, _)| *i);
    Ok(all.into_iter().map(|(_, said)| said).collect())
}

/// A forecast, and how good it is.
pub struct Fitted {
    /// Fitted on all scenes.
    pub forecast: Forecast,
    /// By scene, what fits on others say of each of its samples, with whether that came true.
    pub held_out: Vec<Vec<(f64, bool)>>,
}

/// The forecast that samples, by scene, tell.
pub fn fitted(names: &[&str], scenes: &[Vec<FitSample>], outcome_hash: &str, settings: &FitSettings) -> Result<Fitted, Failure> {
    let fit = |learned: &[&Vec<FitSample>]| {
        let kept: Vec<FitSample> = learned.iter().copied().flatten().cloned().collect();
        let fitted_on = ForecastFitData { scenes: scenes.len() as u64, releases: kept.len(), outcome_hash: outcome_hash.to_owned() };
        fit_forecast(names, &kept, fitted_on, settings).map_err(|e| Failure::bad_input("data", e))
    };
    let said = |forecast: &Forecast, samples: &Vec<FitSample>| -> Vec<(f64, bool)> {
        samples.iter().map(|sample| (forecast.of(&sample.measures), sample.came_true)).collect()
    };
    Ok(Fitted { held_out: held_out(scenes, fit, said)?, forecast: fit(&scenes.iter().collect::<Vec<_>>())? })
}

/// Says of samples of another length than `expected`.
pub fn other_length<'a>(expected: usize, mut samples: impl Iterator<Item = &'a Vec<f32>>) -> Option<String> {
    let measures = samples.find(|measures| measures.len() != expected)?;
    Some(format!("expected {expected} measures, got {}", measures.len()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Serialize, Deserialize)]
    struct Answers {
        seed: u64,
    }

    impl MeasuredScene for Answers {
        fn seed(&self) -> u64 {
            self.seed
        }

        fn other_length(&self) -> Option<String> {
            None
        }
    }

    #[test]
    fn what_was_measured_with_something_else_or_with_nobody_knows_what_is_not_learned_from() {
        let folder = tempfile::tempdir().expect("a folder");
        let tried = |made_with: &str, count: u64| {
            let tried = TriedScenes { data: folder.path(), file: "answers.jsonl", first_seed: 7, first: 0, count, threads: 1, made_with };
            let all = tried.tried(|index| Ok(Answers { seed: 7 + index }));
            all.map(|all| all.into_keys().collect::<Vec<_>>()).map_err(|refused| (refused.exit_code(), refused.into_error().message))
        };
        assert_eq!(tried("old", 2), Ok(vec![7, 8]));
        assert_eq!(tried("old", 3), Ok(vec![7, 8, 9]), "it goes on");
        let (code, message) = tried("new", 3).expect_err("other trees");
        assert!(code == 2 && ["answers.jsonl", "old", "new", "delete", "--data"].iter().all(|told| message.contains(told)), "{message}");
        std::fs::write(folder.path().join("answers.jsonl"), "{\"seed\":7,\"measures\":[]}\n").expect("written by an earlier release");
        let (code, message) = tried("old", 3).expect_err("nobody knows which trees");
        assert!(code == 2 && message.contains("does not say") && message.contains("--data"), "{message}");
    }

    #[test]
    fn more_scenes_than_there_are_to_learn_from_are_too_many_steps() {
        let folder = tempfile::tempdir().expect("a folder");
        let (data, first_seed) = (folder.path(), Split::Train.scenes() - 3);
        let tried = TriedScenes { data, file: "answers.jsonl", first_seed, first: 0, count: 4, threads: 1, made_with: "own" };
        let refused = tried.tried(|index| Ok(Answers { seed: first_seed + index })).map(|_| ()).expect_err("there are three");
        assert_eq!((refused.exit_code(), refused.into_error().field.as_deref()), (2, Some("steps")));
    }
}
