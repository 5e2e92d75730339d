//! `repose generate --proposals`: objects let go where the prior and the planner would have them put, beside the shards.

use std::path::Path;

use repose_dataset::{ReleaseRecord, proposals_path, releases_are_there, write_releases};
use repose_evaluation::scenes::problem::{Problem, ProblemSettings};
use repose_evaluation::scenes::proposals::{ProposalSettings, proposals};
use repose_inference::Engine;
use repose_networks::serving::spread;
use repose_simulator::generate::{GenerateSettings, lines_of};

use crate::failure::Failure;
use crate::progress::Progress;

/// Lets each scene's problem go `per_scene` times, and writes what is missing in files of `settings.scenes_per_shard` scenes. Returns how many
/// releases were written. Files that are there stay, so an interrupted run goes on.
pub fn write_proposals(folder: &Path, settings: &GenerateSettings, per_scene: u32, engine: &Engine) -> Result<usize, Failure> {
    let problem = ProblemSettings { scene: settings.scene.clone(), ..ProblemSettings::default() };
    let proposal = ProposalSettings::new(per_scene);
    let made_with = serde_json::json!({"proposals": lines_of(&proposal), "weights_hash": engine.weights_hash()});
    let end = settings.first_scene + settings.scenes;
    let runs: Vec<u64> = (settings.first_scene..end).step_by(settings.scenes_per_shard.max(1) as usize).collect();
    let bar = Progress::new(settings.scenes, "scenes proposed on");
    let written = spread(
        runs.len(),
        settings.threads,
        || (),
        |(), run| {
            let scenes = runs[run]..(runs[run] + settings.scenes_per_shard.max(1)).min(end);
            let path = proposals_path(folder, scenes.start, scenes.end - scenes.start);
            if releases_are_there(&path, &made_with).map_err(|e| Failure::bad_input("proposals", e))? {
                bar.add(scenes.end - scenes.start);
                return Ok(0);
            }
            let mut records = Vec::new();
            for index in scenes {
                records.extend(of_scene(settings, index, &problem, engine, &proposal)?);
                bar.add(1);
            }
            write_releases(&path, &made_with, &records).map_err(|e| Failure::bad_input(&folder.display().to_string(), e))?;
            Ok(records.len())
        },
    );
    bar.finish();
    written.into_iter().sum()
}

/// What is proposed on one scene; nothing where its seed gives no problem.
fn of_scene(
    settings: &GenerateSettings,
    index: u64,
    problem: &ProblemSettings,
    engine: &Engine,
    proposal: &ProposalSettings,
) -> Result<Vec<ReleaseRecord>, Failure> {
    let Some(problem) = Problem::of_split(settings.split, index, problem) else { return Ok(Vec::new()) };
    proposals(&problem, engine, proposal).map_err(Failure::other)
}

#[cfg(test)]
mod tests {
    use repose_dataset::Split;

    use super::*;
    use crate::embedded::engine;

    #[test]
    fn a_folder_of_other_proposals_is_refused_by_name() {
        let folder = tempfile::tempdir().expect("a folder");
        let settings = GenerateSettings { threads: 1, ..GenerateSettings::new(folder.path(), Split::Validation, 1) };
        let there = serde_json::json!({"proposals": lines_of(&ProposalSettings::new(4)), "weights_hash": "of others"});
        write_releases(&proposals_path(folder.path(), 0, 1), &there, &[]).expect("written");
        let refused =
            format!("{:?}", write_proposals(folder.path(), &settings, 4, &engine(None).expect("weights")).expect_err("other weights"));
        assert!(refused.contains("proposals_000000_1") && refused.contains("weights_hash"), "{refused}");
    }
}
