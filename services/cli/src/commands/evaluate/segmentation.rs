//! `repose evaluate segmentation`: perception's masks of labelled frames against the labels.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use clap::Args;
use repose_evaluation::report::segmentation::SegmentationReport;
use repose_evaluation::statistics::mask_scores::tolerance_px;
use repose_evaluation::tables::segmentation::judge_frame;
use repose_perception::Settings;

use crate::failure::{CommandResult, Failure};
use crate::frames;
use crate::output::Output;

/// Arguments of `evaluate segmentation`.
#[derive(Debug, Args)]
pub struct EvaluateSegmentationArgs {
    /// A folder with labelled frame folders anywhere below it; a frame's parent folder is its set.
    pub dir: PathBuf,
    /// Segmentation settings to try, a TOML file with what `[perception.segmentation]` of a configuration may hold. Default: the
    /// environment's, REPOSE_PERCEPTION__SEGMENTATION__FIELD.
    #[arg(long, value_name = "FILE")]
    pub settings: Option<PathBuf>,
}

/// Runs the command.
pub fn run(args: &EvaluateSegmentationArgs, output: Output) -> CommandResult {
    let mut folders = Vec::new();
    find_frames(&args.dir, &mut BTreeSet::new(), &mut folders)?;
    if folders.is_empty() {
        return Err(Failure::bad_input(&args.dir.display().to_string(), "no frame folder with depth.png and labels.png here or below"));
    }
    let settings = match &args.settings {
        Some(path) => read_settings(path)?,
        None => repose_local::segmentation()?,
    };
    let mut trials = Vec::new();
    let mut tolerances = Vec::new();
    for folder in &folders {
        let (set, name) = (name_of(folder.parent()), name_of(Some(folder)));
        let frame = frames::read(folder)?;
        tolerances.push(tolerance_px(frame.camera.width, frame.camera.height));
        let trial = judge_frame(&set, &name, &frame, &settings)
            .map_err(|e| Failure::bad_input(&format!("{}: {}", folder.display(), e.field.as_deref().unwrap_or("frame")), &e.message))?;
        tracing::info!(frame = name, overlap_f = trial.masks.overlap.f, boundary_f = trial.masks.boundary.f, "judged");
        trials.push(trial);
    }
    tolerances.sort_unstable();
    tolerances.dedup();
    let report = SegmentationReport::new(&trials, &tolerances);
    output.print(&report.document(), || report.text())
}

fn read_settings(path: &Path) -> Result<Settings, Failure> {
    let failed = |e: &dyn std::fmt::Display| Failure::bad_input(&path.display().to_string(), e);
    let text = std::fs::read_to_string(path).map_err(|e| failed(&e))?;
    let settings: Settings = toml::from_str(&text).map_err(|e| failed(&e))?;
    settings.validate("perception.segmentation").map_err(|e| failed(&format!("{}: {}", e.field.unwrap_or_default(), e.message)))?;
    Ok(settings)
}

/// Folders that hold a labelled frame, in name order; nothing below a frame is searched. A folder that several links lead to is searched once.
fn find_frames(dir: &Path, searched: &mut BTreeSet<PathBuf>, found: &mut Vec<PathBuf>) -> CommandResult {
    let failed = |e: std::io::Error| Failure::bad_input(&dir.display().to_string(), e);
    if !searched.insert(dir.canonicalize().map_err(failed)?) {
        return Ok(());
    }
    if dir.join("depth.png").is_file() {
        if dir.join("labels.png").is_file() {
            found.push(dir.to_owned());
        }
        return Ok(());
    }
    let mut below = Vec::new();
    for entry in std::fs::read_dir(dir).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if path.is_dir() {
            below.push(path);
        }
    }
    below.sort();
    below.iter().try_for_each(|folder| find_frames(folder, searched, found))
}

fn name_of(folder: Option<&Path>) -> String {
    folder.and_then(Path::file_name).map_or_else(|| ".".to_owned(), |name| name.to_string_lossy().into_owned())
}

#[cfg(test)]
mod tests {
    #[cfg(unix)]
    #[test]
    fn a_frame_is_judged_once_however_many_links_lead_to_it() {
        use std::collections::BTreeSet;
        use std::os::unix::fs::symlink;

        use super::find_frames;

        let folder = tempfile::tempdir().expect("a folder");
        let root = folder.path();
        for name in ["a/second", "a/first", "c/third"] {
            std::fs::create_dir_all(root.join(name)).expect("a folder");
            for file in ["depth.png", "labels.png"] {
                std::fs::write(root.join(name).join(file), "").expect("written");
            }
        }
        symlink(root, root.join("a/around")).expect("a link");
        symlink(root.join("a"), root.join("b")).expect("a link");
        symlink(root.join("a/first"), root.join("c/again")).expect("a link");
        let mut found = Vec::new();
        find_frames(root, &mut BTreeSet::new(), &mut found).unwrap_or_else(|e| panic!("{e:?}"));
        assert_eq!(found, ["a/first", "a/second", "c/third"].map(|name| root.join(name)));
    }
}
