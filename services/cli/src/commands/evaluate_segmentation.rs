//! `repose evaluate segmentation`: perception's masks of labelled frames against the labels.

use std::path::{Path, PathBuf};

use clap::Args;
use comfy_table::Table;
use repose_evaluation::mask_scores::{MaskScores, tolerance_px};
use repose_evaluation::{Half, SegmentationRow, SegmentationTrial, judge_frame, row_of};
use repose_perception::Settings;

use crate::failure::{Failure, Outcome};
use crate::frames;
use crate::output::Output;

/// What the figures mean; part of the JSON.
const DEFINITION: &str = "Xie et al., CoRL 2019 (after Dave et al. 2019): Hungarian assignment on pairwise overlap F, background excluded, \
                          contours matched within 0.3 % of the picture's diagonal; means over frames, share over objects with F > 0.75";

/// Arguments of `evaluate segmentation`.
#[derive(Debug, Args)]
pub struct EvaluateSegmentationArgs {
    /// A folder with labelled frame folders somewhere below it; the folder right above a frame is its set.
    pub dir: PathBuf,
}

/// Runs the command.
pub fn run(args: &EvaluateSegmentationArgs, output: Output) -> Outcome {
    let mut folders = Vec::new();
    find_frames(&args.dir, &mut folders)?;
    if folders.is_empty() {
        return Err(Failure::bad_input(&args.dir.display().to_string(), "no frame folder with depth.png and labels.png here or below"));
    }
    let mut trials = Vec::new();
    let mut tolerances = Vec::new();
    for folder in &folders {
        let (set, name) = (name_of(folder.parent()), name_of(Some(folder)));
        let frame = frames::read(folder)?;
        tolerances.push(tolerance_px(frame.camera.width, frame.camera.height));
        let trial = judge_frame(&set, &name, &frame, &Settings::default())
            .map_err(|e| Failure::bad_input(&format!("{}: {}", folder.display(), e.field.as_deref().unwrap_or("frame")), &e.message))?;
        tracing::info!(frame = name, overlap_f = trial.masks.overlap.f, boundary_f = trial.masks.boundary.f, "judged");
        trials.push(trial);
    }
    tolerances.sort_unstable();
    tolerances.dedup();
    print(&trials, &tolerances, output)
}

fn print(trials: &[SegmentationTrial], tolerances_px: &[usize], output: Output) -> Outcome {
    let mut sets: Vec<&str> = trials.iter().map(|t| t.set.as_str()).collect();
    sets.sort_unstable();
    sets.dedup();
    let rows = |pick: &dyn Fn(&SegmentationTrial) -> bool| {
        let of = |scores: fn(&SegmentationTrial) -> &MaskScores| row_of(trials.iter().filter(|t| pick(t)), scores);
        (of(|t| &t.masks), of(|t| &t.cleaned))
    };
    let mut named = vec![("all".to_owned(), rows(&|_| true))];
    for set in &sets {
        named.push((format!("{set}, tuning half"), rows(&|t| t.set == *set && t.half == Half::Tuning)));
        named.push((format!("{set}, reporting half"), rows(&|t| t.set == *set && t.half == Half::Reporting)));
        named.push(((*set).to_owned(), rows(&|t| t.set == *set)));
    }
    named.retain(|(_, (row, _))| row.frames > 0);
    let all = &named[0].1;
    let document = serde_json::json!({
        "frames": all.0.frames, "objects": all.0.objects, "found": all.0.found,
        "overlap": all.0.overlap, "boundary": all.0.boundary, "share_75": all.0.share_75,
        "cleaned": all.1,
        "rows": named.iter().map(|(name, (masks, cleaned))| serde_json::json!({"name": name, "masks": masks, "cleaned": cleaned})).collect::<Vec<_>>(),
        "trials": trials,
        "definition": DEFINITION,
        "tolerance_px": tolerances_px,
        "split": "tuning: the frame's name ends in an even digit; reporting: all others",
    });
    output.print(&document, || {
        let mut table = Table::new();
        table.set_header(["frames", "n", "objects", "found", "masks", "overlap P / R / F", "boundary P / R / F", "share ≥ .75"]);
        for (name, (masks, cleaned)) in &named {
            table.add_row(cells(name, "whole", masks));
            table.add_row(cells("", "cleaned", cleaned));
        }
        let mut worst: Vec<&SegmentationTrial> = trials.iter().filter(|t| t.half == Half::Tuning).collect();
        worst.sort_by(|a, b| a.masks.overlap.f.total_cmp(&b.masks.overlap.f));
        let worst: Vec<String> = worst.iter().take(5).map(|t| format!("{} ({:.3})", t.frame, t.masks.overlap.f)).collect();
        format!("{table}\n{DEFINITION}; tolerance {tolerances_px:?} px\nlowest overlap F of the tuning half: {}", worst.join(", "))
    })
}

fn cells(name: &str, kind: &str, row: &SegmentationRow) -> Vec<String> {
    let three = |s: repose_evaluation::mask_scores::Scores| format!("{:.3} / {:.3} / {:.3}", s.precision, s.recall, s.f);
    vec![
        name.to_owned(),
        row.frames.to_string(),
        row.objects.to_string(),
        row.found.to_string(),
        kind.to_owned(),
        three(row.overlap),
        three(row.boundary),
        format!("{:.3}", row.share_75),
    ]
}

/// Folders that hold a labelled frame, in name order; nothing below a frame is searched.
fn find_frames(dir: &Path, found: &mut Vec<PathBuf>) -> Outcome {
    if dir.join("depth.png").is_file() {
        if dir.join("labels.png").is_file() {
            found.push(dir.to_owned());
        }
        return Ok(());
    }
    let failed = |e: std::io::Error| Failure::bad_input(&dir.display().to_string(), e);
    let mut below = Vec::new();
    for entry in std::fs::read_dir(dir).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if path.is_dir() {
            below.push(path);
        }
    }
    below.sort();
    below.iter().try_for_each(|folder| find_frames(folder, found))
}

fn name_of(folder: Option<&Path>) -> String {
    folder.and_then(Path::file_name).map_or_else(|| ".".to_owned(), |name| name.to_string_lossy().into_owned())
}
