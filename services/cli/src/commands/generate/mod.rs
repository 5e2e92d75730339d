//! `repose generate`: simulated scenes to train on, contact sheets of them to look at, and what they are like in numbers.

mod completion;
mod feet;
mod frames;
mod proposals;
mod shards;

use std::path::{Path, PathBuf};

use clap::Args;
use rayon::prelude::*;
use repose_dataset::Split;
use repose_evaluation::report::histogram::{Panel, histograms};
use repose_evaluation::report::written::can_write;
use repose_evaluation::scenes::proposals::ProposalSettings;
use repose_geometry::{Image, ViewerFrame};
use repose_local::picture::rgb_image;
use repose_proto::Relation;
use repose_sensor::SensorModel;
use repose_simulator::generate::{GenerateSettings, generate, surveyed, view_rng};
use repose_simulator::objects::{MeshLibrary, MeshSettings};
use repose_simulator::render::{DepthCanvas, picture};
use repose_simulator::scene::{SceneKind, SceneSettings, scene_of_seed};
use repose_simulator::sheet::{SheetSettings, scene_tile, stacked, tile};
use repose_simulator::statistics::Statistics;
use repose_simulator::trials::ReleaseTrialSettings;
use repose_simulator::views::view_of_scene;

use self::completion::{plan_completion, write_completion};
use self::feet::{plan_feet, write_feet};
use self::frames::write_frames;
use self::proposals::write_proposals;
use crate::embedded::engine;
use crate::failure::{CommandResult, Failure};
use crate::output::Output;
use crate::progress::Progress;
use crate::values::{check_scenes, parse_kind, parse_split, threads};

/// Arguments of `generate`.
#[derive(Debug, Args)]
#[command(group(clap::ArgGroup::new("product").required(true).multiple(true)))]
pub struct GenerateArgs {
    /// How many scenes.
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u64).range(1..))]
    pub scenes: u64,
    /// The first scene, counted from the split's first seed.
    #[arg(long, default_value_t = 0)]
    pub first: u64,
    /// Views per scene, 1000 at most: a shard has those of 16 scenes, and whoever reads it takes it into memory.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub views: u32,
    /// A folder for the shards. Existing shards are kept, missing ones are generated; a longer run replaces a short last shard.
    #[arg(long, value_name = "DIR", group = "product")]
    pub out: Option<PathBuf>,
    /// A folder for contact sheets of the scenes (the first 120 at most): color, depth, labels and relations of each one's first view.
    #[arg(long, value_name = "DIR", group = "product")]
    pub show: Option<PathBuf>,
    /// A folder for labelled frame folders of the scenes, 640 x 480 with a depth camera's noise, for `evaluate segmentation`.
    #[arg(long, value_name = "DIR", group = "product")]
    pub frames: Option<PathBuf>,
    /// A folder for shards that the network which completes the shapes of half-seen objects is trained on, by scripts/train_completion.py: three views
    /// of each of `--scenes` scenes of all kinds. Existing shards are kept; if they were made with other trees and networks, the folder is refused.
    #[arg(long, value_name = "DIR", group = "product", conflicts_with_all = ["split", "kind", "objects", "views"])]
    pub completion: Option<PathBuf>,
    /// A folder for shards that the network which looks at feet is trained on, by scripts/train_feet.py: two views of each of `--scenes` scenes of all
    /// kinds, those of `train --network foot`. Take some that it has not learned, by `--first`. Existing shards are kept; if they were made with other
    /// trees and networks, the folder is refused.
    #[arg(long, value_name = "DIR", group = "product", conflicts_with_all = ["split", "kind", "objects", "views"])]
    pub feet: Option<PathBuf>,
    /// A JSON file for statistics of the scenes: prevalence of relations, histograms of gaps and centre offsets, objects, kinds of scenes,
    /// rejections. The histograms are drawn beside it, in a file of its name that ends in .svg. With `--out`, only scenes written by this run are
    /// counted.
    #[arg(long, value_name = "FILE", group = "product", value_parser = parse_numbers_file)]
    pub statistics: Option<PathBuf>,
    /// Which split's seeds: train, validation or test.
    #[arg(long, default_value = "train", value_parser = parse_split)]
    pub split: Split,
    /// Scenes of one kind only: open_table, large_box, clutter, stacking, shelf, drawer, kitchen, desk or pile. By default the mixture to train
    /// on, which has no kitchens, desks or piles.
    #[arg(long, value_name = "KIND", value_parser = parse_kind)]
    pub kind: Option<SceneKind>,
    /// A folder of meshes (OBJ, STL, PLY) to draw objects from, beside the procedural families or instead of them.
    #[arg(long, value_name = "DIR")]
    pub objects: Option<PathBuf>,
    /// Probability that an object is one of `--objects`, 0 to 1.
    #[arg(long, default_value_t = 1.0, requires = "objects")]
    pub objects_share: f64,
    /// Metres per unit of the files in `--objects`: 0.001 for millimetres.
    #[arg(long, default_value_t = 1.0, requires = "objects")]
    pub objects_scale: f32,
    /// Simulate this many releases per scene, and write the outcomes beside the shards for `train --network outcome`. Existing shards get the
    /// outcomes that they lack.
    #[arg(long, value_name = "PER_SCENE", default_value_t = 0, requires = "out")]
    pub releases: usize,
    /// Simulate this many releases of one object per scene, 256 at most, at placements proposed by the prior (half), the prior with a turn (a
    /// quarter) and the geometric planner (a quarter).
    #[arg(long, value_name = "PER_SCENE", default_value_t = 0, requires = "out", value_parser = parse_proposals)]
    pub proposals: u32,
    /// A weights file for `--proposals`. Default: the program's own weights.
    #[arg(long, value_name = "FILE", requires = "proposals")]
    pub weights: Option<PathBuf>,
    /// Store color in the shards; training does not need it.
    #[arg(long, requires = "out")]
    pub color: bool,
    /// Threads. Default: one per core. The output does not depend on it.
    #[arg(long)]
    pub threads: Option<usize>,
}

fn parse_proposals(text: &str) -> Result<u32, String> {
    let most = ProposalSettings::MOST;
    text.parse::<u32>().ok().filter(|count| *count <= most).ok_or_else(|| format!("expected 0 to {most}"))
}

/// A file for numbers, beside which there is room for their pictures.
fn parse_numbers_file(path: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(path);
    let is_picture = path == path.with_extension(PICTURE);
    if is_picture { Err(format!("the histograms are drawn there: expected a name that does not end in .{PICTURE}")) } else { Ok(path) }
}

/// How the file ends in which histograms are drawn beside their numbers.
const PICTURE: &str = "svg";
/// How often each relation held in the paper's evaluation set, percent, in wire order (its Table 2; `aligned` was left out).
const PAPER_PERCENT: [Option<f64>; 10] =
    [Some(13.9), Some(14.0), Some(4.6), Some(5.0), Some(4.3), Some(4.3), Some(29.0), Some(12.7), Some(5.6), None];
/// Scenes on contact sheets, at most: nobody looks at more.
const SHOWN: u64 = 120;
/// Scenes on one sheet: what a screen shows at once.
const SCENES_PER_SHEET: usize = 6;

/// Runs the command.
pub fn run(args: &GenerateArgs, output: Output) -> CommandResult {
    check_scenes(args.split, args.first, args.scenes)?;
    let mut settings = GenerateSettings::new(args.out.as_deref().unwrap_or(Path::new("")), args.split, args.scenes);
    settings.first_scene = args.first;
    settings.views = args.views;
    settings.color = args.color;
    if let Some(kind) = args.kind {
        settings.scene = SceneSettings::only(kind);
    }
    if let Some(folder) = &args.objects {
        if !(0.0..=1.0).contains(&args.objects_share) {
            return Err(Failure::bad_input("objects-share", format!("expected 0 to 1, got {}", args.objects_share)));
        }
        let meshes = MeshSettings { scale: args.objects_scale, ..MeshSettings::default() };
        let library = MeshLibrary::load(folder, &meshes).map_err(|e| Failure::bad_input("objects", e))?;
        let source = &mut settings.scene.arrange.source;
        *source = source.clone().with_meshes(library, args.objects_share);
    }
    settings.threads = threads(args.threads);
    settings.trials = (args.releases > 0).then(|| ReleaseTrialSettings { per_scene: args.releases, ..ReleaseTrialSettings::default() });
    // What cannot be read or written is said before the scenes are made.
    let completion = args.completion.as_deref().map(|folder| plan_completion(folder, args.first, args.scenes)).transpose()?;
    let feet = args.feet.as_deref().map(|folder| plan_feet(folder, args.first, args.scenes)).transpose()?;
    let proposing = (args.proposals > 0).then(|| engine(args.weights.clone())).transpose()?;
    args.statistics.as_deref().map_or(Ok(()), can_write)?;
    let mut report = Report::default();
    if let Some(folder) = &args.show {
        let sheets = on_threads(settings.threads, || show(folder, &settings))??;
        report.text.push(format!("{} contact sheets in {}", sheets.len(), folder.display()));
        report.add("sheets", sheets);
    }
    if let Some(folder) = &args.frames {
        let frames = on_threads(settings.threads, || write_frames(folder, &settings))??;
        report.text.push(format!("{frames} frames in {}", folder.display()));
        report.add("frames", frames);
    }
    if let Some(plan) = &completion {
        let objects = on_threads(settings.threads, || write_completion(plan))??;
        report.text.push(format!("{objects} objects, each from one view, added in {}", plan.folder.display()));
        report.add("objects", objects);
    }
    if let Some(plan) = &feet {
        let objects = on_threads(settings.threads, || write_feet(plan))??;
        report.text.push(format!("{objects} objects whose foot is in doubt, each from one view, added in {}", plan.folder.display()));
        report.add("doubtful_feet", objects);
    }
    let statistics = match &args.out {
        Some(folder) => Some(write_shards(folder, &settings, &mut report)?),
        None => args.statistics.as_ref().map(|_| on_threads(settings.threads, || survey(&settings))).transpose()?,
    };
    if let (Some(folder), Some(engine)) = (&args.out, &proposing) {
        let proposals = write_proposals(folder, &settings, args.proposals, engine)?;
        report.add("proposals", proposals);
        report.text.push(format!("{proposals} proposals let go"));
    }
    // Nothing is counted of scenes that were there already.
    if let Some(statistics) = statistics.as_ref().filter(|s| s.pairs > 0 || args.statistics.is_some()) {
        report.add_statistics(statistics);
        if let Some(path) = &args.statistics {
            write_statistics(path, statistics)?;
        }
    }
    output.print(&report.document, || report.text.join("\n"))
}

/// Does work that is spread over threads on so many of them.
fn on_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> Result<T, Failure> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().map_err(Failure::other)?;
    Ok(pool.install(work))
}

/// What the command prints: for programs and for people.
#[derive(Default)]
struct Report {
    document: serde_json::Map<String, serde_json::Value>,
    text: Vec<String>,
}

impl Report {
    fn add(&mut self, key: &str, value: impl Into<serde_json::Value>) {
        self.document.insert(key.to_owned(), value.into());
    }

    /// Prevalence next to the paper's, and how far apart things are around the limits that relations have.
    fn add_statistics(&mut self, statistics: &Statistics) {
        let percent = statistics.prevalence_percent();
        let prevalence: serde_json::Map<_, _> = Relation::ALL.iter().map(|r| (r.as_str().to_owned(), percent[r.index()].into())).collect();
        self.add("prevalence", prevalence);
        self.add("pairs", statistics.pairs);
        self.text.push(format!("of {} ordered pairs of objects that a view shows:", statistics.pairs));
        for relation in Relation::ALL {
            let paper = PAPER_PERCENT[relation.index()].map_or("-".to_owned(), |p| format!("{p:.1}"));
            self.text.push(format!("  {:<12} {:>5.1} %   paper {paper:>5}", relation.as_str(), percent[relation.index()]));
        }
        for (what, lengths) in [("surfaces", &statistics.gaps), ("centres", &statistics.center_offsets)] {
            let share = |low_mm: f64, high_mm: f64| 100.0 * lengths.between(low_mm, high_mm) as f64 / lengths.total().max(1) as f64;
            let (close, unclear) = (share(0.0, 1.0), share(1.0, 3.0));
            self.text.push(format!("{what} apart: under 1 mm {close:.1} % of {} pairs, 1 to 3 mm {unclear:.1} %", lengths.total()));
        }
        for (what, table) in [("scenes", &statistics.scene_kinds), ("draws rejected", &statistics.rejections)] {
            let entries: Vec<String> = table.iter().map(|(name, n)| format!("{name} {n}")).collect();
            if !entries.is_empty() {
                self.text.push(format!("{what}: {}", entries.join(", ")));
            }
        }
    }
}

/// Makes the shards that are missing, and reports; returns what their scenes are like.
fn write_shards(folder: &Path, settings: &GenerateSettings, report: &mut Report) -> Result<Statistics, Failure> {
    let bar = Progress::new(settings.scenes, "scenes");
    let started = std::time::Instant::now();
    let made = generate(settings, |so_far| {
        bar.set((so_far.scenes + so_far.skipped + so_far.unwritten) as u64);
        true
    });
    let made = made.map_err(|e| Failure::bad_input(&folder.display().to_string(), e))?;
    bar.finish();
    let scenes_per_s = made.scenes as f64 / started.elapsed().as_secs_f64();
    report.add("scenes", made.scenes);
    report.add("skipped", made.skipped);
    report.add("views", made.views);
    report.add("scenes_per_s", scenes_per_s);
    report.add("rejected", made.rejected);
    report.add("failed", made.failed);
    report.add("unseen_views", made.unseen);
    report.add("releases", made.releases);
    report.add("bytes_per_view", made.bytes_per_view());
    report.text.push(format!(
        "{} scenes ({} were there), {} views of {:.1} kB, {scenes_per_s:.1} scenes/s; {} draws rejected, {} seeds and {} views given up",
        made.scenes,
        made.skipped,
        made.views,
        made.bytes_per_view() / 1e3,
        made.rejected,
        made.failed,
        made.unseen
    ));
    if settings.trials.is_some() {
        report.text.push(format!("{} releases", made.releases));
    }
    Ok(made.statistics)
}

/// What the scenes are like, without writing them. Sums: the number of threads does not matter.
fn survey(settings: &GenerateSettings) -> Statistics {
    const SCENES_AT_ONCE: u64 = 8;
    let seeds = settings.split.seeds();
    let first = seeds.start + settings.first_scene;
    let end = (first + settings.scenes).min(seeds.end);
    let bar = Progress::new(end.saturating_sub(first), "scenes counted");
    let runs: Vec<u64> = (first..end).step_by(SCENES_AT_ONCE as usize).collect();
    let counted = runs.par_iter().map(|start| surveyed(*start..(start + SCENES_AT_ONCE).min(end), settings, || bar.add(1)));
    let statistics = counted.reduce(Statistics::default, |mut sum, part| {
        sum.merge(&part);
        sum
    });
    bar.finish();
    statistics
}

/// Writes the numbers, and the two histograms beside them.
fn write_statistics(path: &Path, statistics: &Statistics) -> CommandResult {
    let failed = |path: &Path, e: &dyn std::fmt::Display| Failure::bad_input("statistics", format!("{}: {e}", path.display()));
    let json = serde_json::to_string_pretty(statistics).map_err(Failure::other)?;
    std::fs::write(path, json).map_err(|e| failed(path, &e))?;
    let panels = [
        Panel { title: "Distance between surfaces", histogram: &statistics.gaps, limits_mm: &[1.0, 2.5, 50.0] },
        Panel { title: "Horizontal distance between centres", histogram: &statistics.center_offsets, limits_mm: &[1.0] },
    ];
    let picture = path.with_extension(PICTURE);
    std::fs::write(&picture, histograms(&panels).map_err(Failure::other)?).map_err(|e| failed(&picture, &e))
}

/// Writes contact sheets of the first scenes; returns their paths.
fn show(folder: &Path, settings: &GenerateSettings) -> Result<Vec<String>, Failure> {
    let seeds = settings.split.seeds();
    let first = seeds.start + settings.first_scene;
    let shown: Vec<u64> = (first..(first + settings.scenes.min(SHOWN)).min(seeds.end)).collect();
    std::fs::create_dir_all(folder).map_err(|e| Failure::bad_input("show", format!("{}: {e}", folder.display())))?;
    let bar = Progress::new(shown.len() as u64, "scenes shown");
    let sheets: Result<Vec<String>, Failure> = shown
        .par_chunks(SCENES_PER_SHEET)
        .map(|seeds| {
            let rows: Vec<Image<[u8; 3]>> = seeds.iter().map(|seed| row_of_seed(*seed, settings)).inspect(|_| bar.add(1)).collect();
            let path = folder.join(format!("scenes_{:010}.png", seeds[0]));
            let written = rgb_image(&stacked(&rows)).save(&path);
            written.map_err(|e| Failure::bad_input("show", format!("{}: {e}", path.display())))?;
            Ok(path.display().to_string())
        })
        .collect();
    bar.finish();
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
    // A camera as training episodes draw them: the named ones would lose what a wrist holds them close to.
    SensorModel::jittered(&mut view_rng(seed, u32::MAX)).disturb(seen.depth_m.pixels_mut(), &view.camera, seed);
    let title = format!("seed {seed}, {}, {}, {} draws rejected", scene.kind.name(), view.viewpoint, rejected.len());
    scene_tile(&scene, &seen, &ViewerFrame::from_camera(&view.world_from_camera), &title, &sheet)
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    type Line = crate::testing::Line<GenerateArgs>;

    fn parsed(arguments: &[&str]) -> Result<GenerateArgs, clap::Error> {
        Line::try_parse_from(std::iter::once("generate").chain(arguments.iter().copied())).map(|line| line.args)
    }

    #[test]
    fn something_must_be_made() {
        assert!(parsed(&["--scenes", "3"]).is_err());
        assert!(parsed(&["--show", "a", "--scenes", "0"]).is_err() && parsed(&["--show", "a", "--views", "0"]).is_err());
        let views = |count| parsed(&["--out", "c", "--views", count]);
        assert!(views("1000").is_ok() && views("1001").is_err_and(|e| e.to_string().contains("1000")), "shards that nobody could read");
        assert!(
            parsed(&["--statistics", "b.svg"]).is_err_and(|e| e.to_string().contains("histograms")),
            "one would be written over the other"
        );
        let proposals = |count| parsed(&["--out", "c", "--proposals", count]);
        assert!(proposals("256").is_ok() && proposals("257").is_err_and(|e| e.to_string().contains("256")), "more than the planner gives");
        assert!(parsed(&["--show", "a", "--color"]).is_err(), "sheets have it in any case, and nothing else is stored");
        assert!(parsed(&["--show", "a"]).is_ok() && parsed(&["--statistics", "b.json", "--out", "c"]).is_ok());
    }

    #[test]
    fn scenes_beyond_the_split_are_refused_whatever_is_made_of_them() {
        let folder = tempfile::tempdir().expect("a folder");
        let sheets = folder.path().join("sheets").display().to_string();
        for first in ["999999999", "18446744073709551615"] {
            let arguments = ["--show", &sheets, "--scenes", "2", "--views", "1", "--split", "validation", "--first", first];
            let refused = run(&parsed(&arguments).expect("arguments"), Output { json: false }).expect_err("there are no such scenes");
            assert_eq!((refused.exit_code(), refused.error().and_then(|e| e.field.as_deref())), (2, Some("first")));
        }
    }

    #[test]
    fn scenes_that_one_of_two_networks_lacks_are_refused_before_any_is_made_for_the_other() {
        let folder = tempfile::tempdir().expect("a folder");
        let [completion, feet] = ["completion", "feet"].map(|name| folder.path().join(name).display().to_string());
        let refused = |scenes: &[&str]| {
            let arguments = [["--completion", &completion, "--feet", &feet].as_slice(), scenes].concat();
            let refused = run(&parsed(&arguments).expect("arguments"), Output { json: false }).expect_err("there are fewer for feet");
            assert_eq!(refused.exit_code(), 2);
            let made = [&completion, &feet].iter().filter_map(|folder| std::fs::read_dir(folder).ok()).flatten().count();
            assert_eq!(made, 0);
            refused.into_error().field
        };
        assert_eq!(refused(&["--first", "49999999", "--scenes", "2"]).as_deref(), Some("first"));
        assert_eq!(refused(&["--scenes", "50000001"]).as_deref(), Some("scenes"));
    }

    #[test]
    fn work_is_done_on_as_many_threads_as_are_asked_for() {
        assert_eq!([1, 3].map(|threads| on_threads(threads, rayon::current_num_threads).expect("a pool")), [1, 3]);
    }

    #[test]
    fn sheets_and_statistics_are_made_without_shards() {
        let folder = tempfile::tempdir().expect("a folder");
        let [sheets, numbers] = ["sheets", "numbers.json"].map(|name| folder.path().join(name));
        let [sheets_text, numbers_text] = [&sheets, &numbers].map(|path| path.to_str().expect("a path"));
        let arguments = ["--scenes", "2", "--views", "1", "--split", "validation", "--show", sheets_text, "--statistics", numbers_text];
        run(&parsed(&arguments).expect("arguments"), Output { json: false }).unwrap_or_else(|e| panic!("{e:?}"));
        let sheet = image::open(sheets.join("scenes_1000000000.png")).expect("a sheet");
        assert_eq!(sheet.width() as usize, SheetSettings::default().width);
        let statistics: Statistics = serde_json::from_slice(&std::fs::read(&numbers).expect("a file")).expect("its format");
        assert_eq!(statistics.objects_per_scene.values().sum::<u64>(), 2);
        assert!(std::fs::read_to_string(numbers.with_extension("svg")).expect("a picture").contains("</svg>"));
        assert_eq!(std::fs::read_dir(folder.path()).expect("a folder").count(), 3, "no shards");
    }
}
