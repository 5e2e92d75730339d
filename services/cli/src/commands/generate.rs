//! `repose generate`: simulated scenes to train on, and contact sheets of them to look at.

use std::path::{Path, PathBuf};

use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use rayon::prelude::*;
use repose_dataset::Split;
use repose_geometry::{Image, ViewerFrame};
use repose_proto::Relation;
use repose_sensor::SensorModel;
use repose_simulator::generate::{GenerateSettings, generate, view_rng};
use repose_simulator::render::{DepthCanvas, picture};
use repose_simulator::scene::scene_of_seed;
use repose_simulator::sheet::{SheetSettings, scene_tile, stacked, tile};
use repose_simulator::views::view_of_scene;

use crate::failure::{Failure, Outcome};
use crate::output::Output;
use crate::picture::rgb_image;

/// Arguments of `generate`.
#[derive(Debug, Args)]
#[command(group(clap::ArgGroup::new("product").required(true).multiple(true)))]
pub struct GenerateArgs {
    /// How many scenes.
    #[arg(long, default_value_t = 1000)]
    pub scenes: u64,
    /// The first scene, counted from the split's first seed.
    #[arg(long, default_value_t = 0)]
    pub first: u64,
    /// Views per scene.
    #[arg(long, default_value_t = 5)]
    pub views: u32,
    /// The folder for the shards; what is there already is kept and gone on from.
    #[arg(long, value_name = "DIR", group = "product")]
    pub out: Option<PathBuf>,
    /// A folder for contact sheets of the scenes (the first 120 at most): color, depth, labels and relations of each one's first view.
    #[arg(long, value_name = "DIR", group = "product")]
    pub show: Option<PathBuf>,
    /// Which split's seeds: train, validation or test.
    #[arg(long, default_value = "train")]
    pub split: String,
    /// Keep color in the shards too; training does not need it.
    #[arg(long)]
    pub color: bool,
    /// Threads; all cores by default. The bytes do not depend on it.
    #[arg(long)]
    pub threads: Option<usize>,
}

/// How often each relation held in the paper's evaluation set, percent, in wire order (its Table 2; `aligned` was left out).
const PAPER_PERCENT: [Option<f64>; 10] =
    [Some(13.9), Some(14.0), Some(4.6), Some(5.0), Some(4.3), Some(4.3), Some(29.0), Some(12.7), Some(5.6), None];
/// Scenes on contact sheets, at most: nobody looks at more.
const SHOWN: u64 = 120;
/// Scenes on one sheet: what a screen shows at once.
const SCENES_PER_SHEET: usize = 6;

/// The split of that name.
pub fn split_of(name: &str) -> Result<Split, Failure> {
    let known = || Split::ALL.map(Split::name).join(", ");
    Split::ALL
        .into_iter()
        .find(|s| s.name() == name)
        .ok_or_else(|| Failure::bad_input("split", format!("expected one of {}, got {name:?}", known())))
}

/// Runs the command.
pub fn run(args: &GenerateArgs, output: Output) -> Outcome {
    let mut settings = GenerateSettings::new(args.out.as_deref().unwrap_or(Path::new("")), split_of(&args.split)?, args.scenes);
    settings.first_scene = args.first;
    settings.views = args.views;
    settings.color = args.color;
    settings.threads = args.threads.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from));
    let mut document = serde_json::Map::new();
    let mut text = Vec::new();
    if let Some(folder) = &args.show {
        let sheets = show(folder, &settings)?;
        text.push(format!("{} contact sheets in {}", sheets.len(), folder.display()));
        document.insert("sheets".to_owned(), sheets.into());
    }
    if let Some(folder) = &args.out {
        write_shards(folder, &settings, &mut document, &mut text)?;
    }
    output.print(&document, || text.join("\n"))
}

/// Makes the shards that are missing, and reports.
fn write_shards(
    folder: &Path,
    settings: &GenerateSettings,
    document: &mut serde_json::Map<String, serde_json::Value>,
    text: &mut Vec<String>,
) -> Outcome {
    let bar = progress_bar(settings.scenes, "scenes");
    let started = std::time::Instant::now();
    let made = generate(settings, |so_far| {
        bar.set_position((so_far.scenes + so_far.skipped) as u64);
        true
    });
    let made = made.map_err(|e| Failure::bad_input(&folder.display().to_string(), e))?;
    bar.finish_and_clear();
    let scenes_per_s = made.scenes as f64 / started.elapsed().as_secs_f64();
    let percent = made.prevalence_percent();
    let prevalence: serde_json::Map<_, _> = Relation::ALL.iter().map(|r| (r.as_str().to_owned(), percent[r.index()].into())).collect();
    let mut add = |key: &str, value: serde_json::Value| document.insert(key.to_owned(), value);
    add("scenes", made.scenes.into());
    add("skipped", made.skipped.into());
    add("views", made.views.into());
    add("scenes_per_s", scenes_per_s.into());
    add("rejected", made.rejected.into());
    add("failed", made.failed.into());
    add("unseen_views", made.unseen.into());
    add("bytes_per_view", made.bytes_per_view().into());
    add("pairs", made.pairs.into());
    add("prevalence", prevalence.into());
    text.push(format!(
        "{} scenes ({} were there), {} views of {:.1} kB, {scenes_per_s:.1} scenes/s; {} draws rejected, {} seeds and {} views given up",
        made.scenes,
        made.skipped,
        made.views,
        made.bytes_per_view() / 1e3,
        made.rejected,
        made.failed,
        made.unseen
    ));
    text.push(format!("of {} ordered pairs of objects that a view shows:", made.pairs));
    for relation in Relation::ALL {
        let paper = PAPER_PERCENT[relation.index()].map_or("-".to_owned(), |p| format!("{p:.1}"));
        text.push(format!("  {:<12} {:>5.1} %   paper {paper:>5}", relation.as_str(), percent[relation.index()]));
    }
    Ok(())
}

/// Writes contact sheets of the first scenes; returns their paths.
fn show(folder: &Path, settings: &GenerateSettings) -> Result<Vec<String>, Failure> {
    let seeds = settings.split.seeds();
    let first = seeds.start + settings.first_scene;
    let shown: Vec<u64> = (first..(first + settings.scenes.min(SHOWN)).min(seeds.end)).collect();
    std::fs::create_dir_all(folder).map_err(|e| Failure::bad_input("show", format!("{}: {e}", folder.display())))?;
    let bar = progress_bar(shown.len() as u64, "scenes shown");
    let sheets: Result<Vec<String>, Failure> = shown
        .par_chunks(SCENES_PER_SHEET)
        .map(|seeds| {
            let rows: Vec<Image<[u8; 3]>> = seeds.iter().map(|seed| row_of_seed(*seed, settings)).inspect(|_| bar.inc(1)).collect();
            let path = folder.join(format!("scenes_{:010}.png", seeds[0]));
            let written = rgb_image(&stacked(&rows)).save(&path);
            written.map_err(|e| Failure::bad_input("show", format!("{}: {e}", path.display())))?;
            Ok(path.display().to_string())
        })
        .collect();
    bar.finish_and_clear();
    sheets
}

/// The tile of a seed's scene as its first viewpoint sees it; says why where the seed gives none.
fn row_of_seed(seed: u64, settings: &GenerateSettings) -> Image<[u8; 3]> {
    let sheet = SheetSettings::default();
    let (scene, rejected) = match scene_of_seed(seed, &settings.scene) {
        Ok(found) => found,
        Err(none) => return tile(&[], &format!("seed {seed}"), &[none.to_string()], &sheet),
    };
    let mut canvas = DepthCanvas::new(settings.viewpoint.width, settings.viewpoint.height);
    let Some(view) = view_of_scene(&scene, 0, &settings.viewpoint, false, &mut canvas, &mut view_rng(seed, 0)) else {
        return tile(&[], &format!("seed {seed}"), &["no viewpoint shows enough of it".to_owned()], &sheet);
    };
    let mut seen = picture(&view.camera, &view.world_from_camera, &scene.drawables());
    SensorModel::default().disturb(seen.depth_m.pixels_mut(), &view.camera, seed);
    let title = format!("seed {seed}, {}: {} objects, {} draws rejected", view.viewpoint, scene.objects.len(), rejected.len());
    scene_tile(&scene, &seen, &ViewerFrame::from_camera(&view.world_from_camera), &title, &sheet)
}

fn progress_bar(scenes: u64, what: &str) -> ProgressBar {
    let bar = ProgressBar::new(scenes);
    if let Ok(style) = ProgressStyle::with_template(&format!("{{bar:40}} {{pos}}/{{len}} {what}, {{per_sec}}, {{eta}} left")) {
        bar.set_style(style);
    }
    bar
}
