//! Contact sheets of `evaluate planner`: what was seen, what was planned, what came of it, sorted by how it ended.
//!
//! A tile a scene is kept as a file of its own, so that sheets can be bound of a table that was run in parts.

use std::path::{Path, PathBuf};

use nalgebra::Isometry3;
use repose_geometry::Image;
use repose_geometry::transform::from_row_major;
use repose_proto::place::Variant;
use repose_simulator::release::{ReleaseSettings, released};
use repose_simulator::render::picture;
use repose_simulator::sheet::{Rgb, SheetSettings, stacked, tile};

use crate::report::written::FileError;
use crate::report::written::write_picture;
use crate::scenes::planner_scene::{SceneRecord, TriedScene};
use repose_local::picture::{Coloring, draw_ids, library_picture, rgb_image, scene_picture};

/// Tiles on one sheet.
const TILES: usize = 12;
/// Sheets of successes, at most: one looks at failures.
const SUCCESS_SHEETS: usize = 4;

/// Contact sheets in a folder.
pub struct Sheets {
    folder: PathBuf,
    variant: Variant,
}

impl Sheets {
    /// Sheets of a variant's answers below a folder.
    pub fn new(folder: &Path, variant: Variant) -> Self {
        Self { folder: folder.to_owned(), variant }
    }

    /// Keeps a scene's tile.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn keep(&self, tried: &TriedScene) -> Result<(), FileError> {
        let Some(k) = tried.record.trials.iter().position(|t| t.variant == self.variant) else { return Ok(()) };
        let (problem, trial, result) = (&tried.problem, &tried.record.trials[k], &tried.results[k]);
        let best = result.as_ref().and_then(|r| r.placements.first());
        let first: Option<Isometry3<f64>> = best.and_then(|p| from_row_major(&p.placed_from_observed.0).ok());
        let mut before = scene_picture(&problem.observed, Coloring::Seen, None);
        draw_ids(&mut before, &problem.observed);
        let mut pictures = vec![library_picture(&before)];
        // Without an answer of its own, a true one is shown.
        let shown = first.or_else(|| tried.truth.first().map(|t| t.placed_from_observed));
        if let Some(placed) = shown {
            pictures.push(library_picture(&scene_picture(&problem.observed, Coloring::Seen, Some((problem.query, &placed)))));
            pictures.extend(settled(tried, &placed));
        }
        let record = &tried.record;
        let title = format!("object {} to {}: {}", record.query, record.goal, end_of(record, self.variant));
        let mut lines = vec![format!("{} {} ({}, seed {})", record.set, record.slot, record.kind.name(), record.seed)];
        if first.is_none() {
            lines.push(if shown.is_some() { "shown: a true answer" } else { "no true answer was found" }.to_owned());
        }
        lines.extend(trial.refused.clone());
        if let Some(r) = &trial.release {
            lines.push(format!(
                "moved {:.0} mm, others {:.0} mm, tipped {:.0} degrees, {:.1} mm deep; goal {}",
                r.judged.moved_m * 1e3,
                r.others_moved_m * 1e3,
                r.tilt_rad.to_degrees(),
                r.penetration_m * 1e3,
                if r.judged.goal { "holds" } else { "fails" }
            ));
        }
        if let Some(p) = best {
            let margin_m = p.geometric.first().map_or(0.0, |g| g.margin_m);
            lines.push(format!(
                "cost {:.2}, realism {}, relation {:.2}, by rule {:+.0} mm, support margin {} mm, clearance {} mm",
                p.cost,
                p.realism.map_or("-".to_owned(), |f| format!("{f:.2}")),
                p.relations.first().copied().unwrap_or(0.0),
                margin_m * 1e3,
                p.support_m.map_or("-".to_owned(), |m| format!("{:.0}", m * 1e3)),
                p.clearance_m.map_or("-".to_owned(), |m| format!("{:.0}", m * 1e3))
            ));
        }
        lines.push(trial.rejections.iter().map(|(r, n)| format!("{r:?} {n}")).collect::<Vec<_>>().join(", "));
        lines.push(format!(
            "true answers on {} supports; its answers on {}, good on {}",
            record.true_supports, trial.supports, trial.good_supports
        ));
        for other in record.trials.iter().filter(|t| t.variant != self.variant) {
            lines.push(format!("{}: {}", other.variant, end_of(record, other.variant)));
        }
        let tile = tile(&pictures, &title, &lines, &SheetSettings::default());
        write_picture(&self.tile_path(record), &rgb_image(&tile).into())
    }

    /// Binds the tiles of the records to sheets, one series a way of ending.
    ///
    /// # Errors
    /// When a tile cannot be read or a sheet not written.
    pub fn bind(&self, records: &[SceneRecord]) -> Result<(), FileError> {
        for end in [GOOD, BAD, MISSED, WRONG, NONE] {
            let paths = records.iter().filter(|r| end_of(r, self.variant) == end).map(|r| self.tile_path(r));
            let paths: Vec<PathBuf> = paths.filter(|path| path.exists()).collect();
            let most = if end == GOOD { SUCCESS_SHEETS } else { usize::MAX };
            for (page, of_page) in paths.chunks(TILES).take(most).enumerate() {
                let tiles: Result<Vec<Image<Rgb>>, FileError> = of_page.iter().map(|path| read(path)).collect();
                let name = format!("{}_{}_{page}.png", self.variant, end.replace(' ', "_"));
                write_picture(&self.folder.join("sheets").join(name), &rgb_image(&stacked(&tiles?)).into())?;
            }
        }
        Ok(())
    }

    fn tile_path(&self, record: &SceneRecord) -> PathBuf {
        self.folder.join("tiles").join(format!("{}_{}_{}.png", record.set, record.slot, self.variant))
    }
}

const GOOD: &str = "success";
const BAD: &str = "failure";
const MISSED: &str = "missed answer";
const WRONG: &str = "answer where none is known";
const NONE: &str = "rightly none";

/// How a variant's search of a scene ended, in words.
fn end_of(record: &SceneRecord, variant: Variant) -> &'static str {
    let Some(trial) = record.trial(variant) else { return NONE };
    match (trial.joint(), trial.release.is_some(), record.answerable()) {
        (true, ..) => GOOD,
        (false, true, true) => BAD,
        (false, true, false) => WRONG,
        (false, false, true) => MISSED,
        (false, false, false) => NONE,
    }
}

/// The true scene after the object was let go there, as the camera sees it.
fn settled(tried: &TriedScene, placed_from_observed: &Isometry3<f64>) -> Option<Image<Rgb>> {
    let (problem, truth) = (&tried.problem, &tried.problem.truth);
    let query = problem.index_of(problem.query)?;
    let placed = placed_from_observed * truth.objects[query].world_from_object;
    let outcome = released(truth, query, &placed, &ReleaseSettings::default())?;
    let after = truth.with_poses(&outcome.world_from_objects);
    Some(picture(&problem.camera, &problem.world_from_camera, &after.drawables()).color)
}

fn read(path: &Path) -> Result<Image<Rgb>, FileError> {
    let picture = image::open(path).map_err(|e| FileError::new(path, e))?;
    Ok(library_picture(&picture.into_rgb8()))
}
