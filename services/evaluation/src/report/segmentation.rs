//! The report of `evaluate segmentation`: JSON with the contract's keys, and a table for people.

use serde_json::{Value, json};

use crate::report::text;
use crate::statistics::mask_scores::{MaskScores, PrecisionRecall};
use crate::tables::segmentation::{Half, SegmentationRow, SegmentationTrial, row_of};

/// What the figures mean; part of the JSON.
const DEFINITION: &str = "Xie et al., CoRL 2019 (after Dave et al. 2019): Hungarian assignment on pairwise overlap F, background excluded, \
                          contours matched within 0.3 % of the picture's diagonal; means over frames, share over objects with F > 0.75";

/// Heading of the faults.
const FAULTS: &str = "faults";

/// What is printed of judged frames.
pub struct SegmentationReport<'a> {
    trials: &'a [SegmentationTrial],
    tolerances_px: &'a [usize],
    /// Name, whole masks, cleaned masks; all frames first.
    rows: Vec<(String, SegmentationRow, SegmentationRow)>,
}

impl<'a> SegmentationReport<'a> {
    /// Of frames judged with contours matched within these tolerances.
    pub fn new(trials: &'a [SegmentationTrial], tolerances_px: &'a [usize]) -> Self {
        let mut sets: Vec<&str> = trials.iter().map(|t| t.set.as_str()).collect();
        sets.sort_unstable();
        sets.dedup();
        let row = |name: String, pick: &dyn Fn(&SegmentationTrial) -> bool| {
            let of = |scores: fn(&SegmentationTrial) -> &MaskScores| row_of(trials.iter().filter(|t| pick(t)), scores);
            (name, of(|t| &t.masks), of(|t| &t.cleaned))
        };
        let mut rows = vec![row("all".to_owned(), &|_| true)];
        for set in &sets {
            rows.push(row(format!("{set}, tuning half"), &|t| t.set == *set && t.half == Half::Tuning));
            rows.push(row(format!("{set}, reporting half"), &|t| t.set == *set && t.half == Half::Reporting));
            rows.push(row((*set).to_owned(), &|t| t.set == *set));
        }
        for [least, most] in OBJECTS {
            let many = format!("{least} to {most} objects");
            rows.push(row(many, &|t| (least..=most).contains(&t.masks.labelled)));
        }
        rows.retain(|(_, masks, _)| masks.frames > 0);
        Self { trials, tolerances_px, rows }
    }

    /// The JSON.
    pub fn document(&self) -> Value {
        let row =
            |(name, masks, cleaned): &(String, SegmentationRow, SegmentationRow)| json!({"name": name, "masks": masks, "cleaned": cleaned});
        let all = self.rows.first();
        let masks = all.map(|(_, masks, _)| masks);
        json!({
            "frames": self.trials.len(), "objects": masks.map(|m| m.objects), "found": masks.map(|m| m.found),
            "overlap": masks.map(|m| m.overlap), "boundary": masks.map(|m| m.boundary), "share_75": masks.map(|m| m.share_75),
            "cleaned": all.map(|(_, _, cleaned)| cleaned),
            "rows": self.rows.iter().map(row).collect::<Vec<_>>(),
            "trials": self.trials,
            "definition": DEFINITION,
            "tolerance_px": self.tolerances_px,
            "split": "tuning: the frame's name ends in an even digit; reporting: all others",
        })
    }

    /// The table for people.
    pub fn text(&self) -> String {
        let mut table =
            text::table(["frames", "n", "objects", "found", "masks", "overlap P / R / F", "boundary P / R / F", "share > .75", FAULTS]);
        for (name, masks, cleaned) in &self.rows {
            table.add_row(cells(name, "whole", masks));
            table.add_row(cells("", "cleaned", cleaned));
        }
        let mut worst: Vec<&SegmentationTrial> = self.trials.iter().filter(|t| t.half == Half::Tuning).collect();
        worst.sort_by(|a, b| a.masks.overlap.f.total_cmp(&b.masks.overlap.f));
        let worst: Vec<String> = worst.iter().take(5).map(|t| format!("{} ({:.3})", t.frame, t.masks.overlap.f)).collect();
        let tolerances_px = self.tolerances_px;
        format!(
            "{table}\n{}\n{}\n{}",
            text::legend(&LEGEND),
            text::paragraph(&format!("{DEFINITION}; tolerance {tolerances_px:?} px")),
            text::paragraph(&format!("lowest overlap F of the tuning half: {}", worst.join(", ")))
        )
    }
}

/// Frames by how many objects are labelled in them.
const OBJECTS: [[usize; 2]; 4] = [[1, 3], [4, 7], [8, 12], [13, 64]];

/// The columns, in their order.
const LEGEND: [(&str, &str); 5] = [
    ("objects, found", "labelled objects, and objects that perception found"),
    ("masks", "whole, or cleaned of their borders as scenes have them"),
    ("P / R / F", "precision, recall and their harmonic mean, on whole masks and on contours"),
    ("share > .75", "of the labelled objects, those found with an overlap F above .75"),
    (
        FAULTS,
        "the others: merged, split, missed, inexact objects; then masks invented on the background; large objects left out without a reason",
    ),
];

fn cells(name: &str, kind: &str, row: &SegmentationRow) -> Vec<String> {
    let three = |s: PrecisionRecall| format!("{:.3} / {:.3} / {:.3}", s.precision, s.recall, s.f);
    vec![
        name.to_owned(),
        row.frames.to_string(),
        row.objects.to_string(),
        row.found.to_string(),
        kind.to_owned(),
        three(row.overlap),
        three(row.boundary),
        format!("{:.3}", row.share_75),
        [row.faults.merged, row.faults.split, row.faults.missed, row.faults.inexact, row.faults.invented, row.untold]
            .map(|n| n.to_string())
            .join(" "),
    ]
}
