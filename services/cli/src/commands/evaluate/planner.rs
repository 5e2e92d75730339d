//! `repose evaluate planner`: the paper's Table 1, and beside it how often what was returned is right.
//!
//! Every scene that is done goes to `scenes.jsonl` in the folder of `--out`: the same command goes on where it was interrupted, and
//! parts of the table (`--first`, `--scenes`) can be run apart into one folder, one after the other, by one program with the same settings.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::PathBuf;

use clap::Args;
use repose_evaluation::report::planner::{document, pictures, text_of};
use repose_evaluation::report::planner_records::Records;
use repose_evaluation::report::planner_sheets::Sheets;
use repose_evaluation::report::written::write_report;
use repose_evaluation::scenes::perturbation::Perturbation;
use repose_evaluation::scenes::planner_scene::{PlannerSceneSettings, SceneSet, TriedScene};
use repose_evaluation::scenes::problem::ProblemSettings;
use repose_evaluation::scenes::true_shapes::KnownShapes;
use repose_evaluation::tables::planner::{PlannerTableSettings, evaluate_planner, planner_tables};
use repose_networks::digest::digest;
use repose_proto::Relation;
use repose_proto::place::{Rotation, Variant};
use repose_simulator::scene::SceneKind;
use serde_json::{Value, json};

use super::shared::{TableArgs, can_report, check_slots, folder_name, only_meshes};
use crate::failure::{CommandResult, Failure};
use crate::output::Output;
use crate::progress::Progress;
use crate::values::{distinct_or, parse_count, parse_kind, parse_known_shapes, parse_perturbation, parse_rotation, parse_variant};

/// What begins the names of the variables with which perception makes the scenes.
const SEGMENTATION: &str = "REPOSE_PERCEPTION__SEGMENTATION__";
/// The kinds that scenes of a user's meshes take turns in.
const KINDS: [SceneKind; 6] =
    [SceneKind::OpenTable, SceneKind::LargeBox, SceneKind::Clutter, SceneKind::Stacking, SceneKind::Drawer, SceneKind::Shelf];

/// Arguments of `evaluate planner`.
#[derive(Debug, Args)]
pub struct EvaluatePlannerArgs {
    /// Scenes per set; the paper has 100.
    #[arg(long, default_value_t = 100, value_parser = parse_count)]
    pub scenes: usize,
    /// The first scene of each set, to make a table in parts.
    #[arg(long, default_value_t = 0)]
    pub first: u64,
    /// A variant to try; repeat for more. Default: all seven.
    #[arg(long = "variant", value_parser = parse_variant)]
    pub variants: Vec<Variant>,
    /// Evaluate scenes of this kind (open_table, large_box, clutter, stacking, shelf, drawer, kitchen, desk, pile) instead of the default sets; repeat for
    /// more. Default: kitchens, and, with `--objects`, scenes of all kinds with those meshes.
    #[arg(long = "kind", value_parser = parse_kind)]
    pub kinds: Vec<SceneKind>,
    /// A folder of held-out meshes to make the scenes from; kitchens have the program's own objects unless `--kind` is given.
    #[arg(long, value_name = "DIR")]
    pub objects: Option<PathBuf>,
    /// A fault of the camera's data; scenes, goals and true answers stay the same: found_masks (objects segmented by perception), pose_1_10 and
    /// pose_2_20 (the camera's pose off by 1° and 10 mm, 2° and 20 mm), labels_3_px (masks shifted by 3 pixels), depth_scale_1 (1 % too far),
    /// holes (shiny objects), 320x240.
    #[arg(long, value_name = "FAULT", value_parser = parse_perturbation)]
    pub perturb: Option<Perturbation>,
    /// Draw goals of this relation (left_of, above, near, …); repeat for more. Default: left_of, right_of, in_front_of and behind.
    #[arg(long = "relation", value_name = "RELATION")]
    pub relations: Vec<Relation>,
    /// Plan with true shapes in place of believed ones: of all objects, of the one to move (query) or of all others. Tells what better beliefs would
    /// bring; what an object is like on another side (`--rotation stable`) is believed all the same.
    #[arg(long, value_name = "WHOSE", value_parser = parse_known_shapes)]
    pub known_shapes: Option<KnownShapes>,
    /// Plan with shapes that the network completes, in place of those of the rules, with which the forecasts were fitted.
    #[arg(long)]
    pub learned_shapes: bool,
    /// How objects may be turned: fixed, yaw, or stable (set on another side as well; the paper's columns, which are of one attitude, are empty then).
    #[arg(long, default_value = "fixed", value_parser = parse_rotation)]
    pub rotation: Rotation,
    /// Split, weights and threads.
    #[command(flatten)]
    pub common: TableArgs,
    /// A folder for a record of every scene, the table as JSON and SVG, and contact sheets.
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// The variant whose answers the contact sheets show.
    #[arg(long, default_value = "best", value_parser = parse_variant)]
    pub look_at: Variant,
}

/// Runs the command.
pub fn run(args: &EvaluatePlannerArgs, output: Output) -> CommandResult {
    can_report(args.out.as_deref(), "planner")?;
    check_slots(args.first, args.scenes, SceneSet::SLOTS)?;
    let mut settings = settings_of(args)?;
    let engine = args.common.engine()?;
    let made_with = made_with(args, &settings, engine.weights_hash());
    let scenes = args.common.first("planner", &made_with)?;
    (settings.split, settings.first) = (scenes.seeds_of, settings.first + scenes.first);
    let named = scenes.named(&made_with);
    let mut records = Records::open(args.out.as_deref(), &named)?;
    let sheets = args.out.as_ref().map(|folder| Sheets::new(folder, args.look_at));
    let bar = Progress::new((settings.sets.len() * settings.scenes) as u64, "scenes");
    let done = records.all.clone();
    bar.set(done.len() as u64);
    evaluate_planner(&settings, &engine, &done, |tried: TriedScene| {
        if let Some(sheets) = &sheets {
            sheets.keep(&tried)?;
        }
        log(&tried);
        bar.add(1);
        records.add(tried.record).map_err(Failure::from)
    })?;
    bar.finish();
    let tables = planner_tables(&records.in_order(&settings.sets), &settings.scene.variants);
    let document = document(&tables, &records.all, &named);
    if let Some(folder) = &args.out {
        write_report(folder, "planner", &document, &pictures(&tables).map_err(Failure::other)?)?;
    }
    if let Some(sheets) = &sheets {
        sheets.bind(&records.all)?;
    }
    output.print(&document, || text_of(&tables))
}

/// What the table is made with: records of anything else are not gone on with.
fn made_with(args: &EvaluatePlannerArgs, settings: &PlannerTableSettings, weights_hash: &str) -> Value {
    let mut made_with = json!({
        "weights_hash": weights_hash, "variants": settings.scene.variants, "answers": settings.scene.answers,
        "objects": folder_name(args.objects.as_deref()), "sets": settings.sets.iter().map(told_of).collect::<Vec<_>>(), "perturb": args.perturb,
    });
    if !args.relations.is_empty() {
        made_with["relations"] = json!(args.relations);
    }
    if args.known_shapes.is_some() {
        made_with["known_shapes"] = json!(args.known_shapes);
    }
    if args.learned_shapes {
        made_with["learned_shapes"] = json!(true);
    }
    if args.rotation != Rotation::Fixed {
        made_with["rotation"] = json!(args.rotation);
    }
    let segmentation = segmentation_of(std::env::vars_os());
    if !segmentation.is_empty() {
        made_with["segmentation"] = json!(segmentation);
    }
    made_with
}

/// What tells a set from others of its name: the kinds that take turns, and whose objects its scenes have.
fn told_of(set: &SceneSet) -> Value {
    let source = &set.problem.scene.arrange.source;
    let objects = match *source == ProblemSettings::default().scene.arrange.source {
        true => "own".to_owned(),
        // It says names and a hash of the files.
        false => digest([("objects", format!("{source:?}").as_bytes())]),
    };
    json!({"name": set.name, "kinds": set.kinds, "objects": objects})
}

fn settings_of(args: &EvaluatePlannerArgs) -> Result<PlannerTableSettings, Failure> {
    let mut own = ProblemSettings { perception: repose_local::segmentation()?, ..ProblemSettings::default() };
    if !args.relations.is_empty() {
        own.relations.clone_from(&args.relations);
    }
    let mut of_meshes = own.clone();
    if let Some(folder) = &args.objects {
        only_meshes(&mut of_meshes.scene, folder)?;
    }
    let set = |name: &str, kinds: &[SceneKind], problem: &ProblemSettings| SceneSet {
        name: name.to_owned(),
        kinds: kinds.to_vec(),
        problem: problem.clone(),
    };
    let sets = if args.kinds.is_empty() {
        let meshes = args.objects.iter().map(|_| set("objects", &KINDS, &of_meshes));
        meshes.chain([set(SceneKind::Kitchen.name(), &[SceneKind::Kitchen], &own)]).collect()
    } else {
        distinct_or(&args.kinds, &[]).into_iter().map(|kind| set(kind.name(), &[kind], &of_meshes)).collect()
    };
    let variants = distinct_or(&args.variants, &Variant::ALL);
    Ok(PlannerTableSettings {
        split: args.common.split,
        sets,
        first: args.first,
        scenes: args.scenes,
        scene: PlannerSceneSettings {
            variants,
            rotation: args.rotation,
            perturbation: args.perturb,
            known_shapes: args.known_shapes,
            learned_shapes: args.learned_shapes,
            ..PlannerSceneSettings::default()
        },
        threads: args.common.threads(),
    })
}

/// The variables that say how perception makes scenes otherwise than by default.
fn segmentation_of(variables: impl Iterator<Item = (OsString, OsString)>) -> BTreeMap<String, String> {
    let said = variables.map(|(name, value)| [name, value].map(|text| text.to_string_lossy().into_owned()));
    said.filter(|[name, _]| name.to_ascii_uppercase().starts_with(SEGMENTATION)).map(|[name, value]| (name, value)).collect()
}

fn log(tried: &TriedScene) {
    let record = &tried.record;
    for trial in &record.trials {
        let came = match (&trial.release, &trial.refused) {
            (Some(r), _) => format!("moved {:.0} mm, goal {}, clean {}", r.judged.moved_m * 1e3, r.judged.goal, r.judged.clean),
            (None, Some(why)) => why.clone(),
            (None, None) => "none".to_owned(),
        };
        tracing::info!(
            set = record.set, slot = record.slot, kind = record.kind.name(), seed = record.seed, variant = %trial.variant,
            answerable = record.answerable(), ms = trial.plan_ms.round(), "{came}"
        );
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use clap::Parser;

    use super::*;

    type Line = crate::testing::Line<EvaluatePlannerArgs>;

    #[test]
    fn a_table_is_gone_on_with_and_has_the_contracts_keys() {
        let folder = tempfile::tempdir().expect("a folder");
        let out = folder.path().to_str().expect("a plain path");
        let line = |scenes: &'static str, split: &'static str| {
            Line::parse_from([
                "x",
                "--scenes",
                scenes,
                "--variant",
                "geometric",
                "--kind",
                "large_box",
                "--split",
                split,
                "--out",
                out,
                "--look-at",
                "geometric",
            ])
            .args
        };
        let read = |name: &str| std::fs::read_to_string(folder.path().join(name)).expect(name);
        run(&line("1", "validation"), Output { json: false }).unwrap_or_else(|e| panic!("{e:?}"));
        let first = read("scenes.jsonl");
        run(&line("2", "validation"), Output { json: false }).unwrap_or_else(|e| panic!("{e:?}"));
        let both = read("scenes.jsonl");
        assert!(both.starts_with(&first) && both.lines().count() == first.lines().count() + 1, "one more scene");
        let document: Value = serde_json::from_str(&read("planner.json")).expect("JSON");
        assert_eq!(document["scenes"], 2);
        assert!(document["feasible"].as_u64().is_some_and(|n| n <= 2));
        let row = &document["rows"][0];
        assert_eq!(row["variant"], "geometric");
        for key in ["predicates", "realistic", "successful", "stable", "joint", "none_precision", "none_recall"] {
            // Nothing tried has no rate.
            let counted = row["counts"].get(key).unwrap_or(&row["counts"]["of_all"][key]);
            match counted["n"].as_u64() {
                Some(0) => assert_eq!(row.get(key), Some(&Value::Null), "{key}: {row}"),
                _ => assert!(row[key].as_f64().is_some_and(|p| (0.0..=100.0).contains(&p)), "{key}: {row}"),
            }
        }
        assert!(read("planner_large_box.svg").contains("</svg>"));
        let refused = run(&line("2", "test"), Output { json: false }).expect_err("other settings");
        assert_eq!(refused.exit_code(), 2);
        // A table has one commit, and so all of its scenes have.
        std::fs::write(folder.path().join("scenes.jsonl"), both.replacen("\"commit\":\"", "\"commit\":\"of others, ", 1)).expect("written");
        let refused = run(&line("2", "validation"), Output { json: false }).expect_err("other code");
        assert!(refused.error().is_some_and(|e| e.message.contains("commit")), "{refused:?}");
    }

    /// A folder with a box of so many metres as its only mesh.
    fn meshes(folder: &Path, edge_m: f64) -> String {
        let folder = folder.join("meshes");
        std::fs::create_dir_all(&folder).expect("a folder");
        let corners =
            (0..8u8).map(|i| [i & 1, (i >> 1) & 1, i >> 2].map(|k| f64::from(k) * edge_m)).map(|[x, y, z]| format!("v {x} {y} {z}\n"));
        let faces = ["1 3 4 2", "5 6 8 7", "1 2 6 5", "3 7 8 4", "1 5 7 3", "2 4 8 6"].map(|corners| format!("f {corners}\n"));
        std::fs::write(folder.join("box.obj"), corners.chain(faces).collect::<String>()).expect("written");
        folder.display().to_string()
    }

    #[test]
    fn scenes_of_one_name_with_other_objects_are_not_gone_on_with() {
        let folder = tempfile::tempdir().expect("a folder");
        let head = |options: &[&str]| {
            let args = Line::parse_from(["x"].iter().chain(options)).args;
            made_with(&args, &settings_of(&args).unwrap_or_else(|e| panic!("{e:?}")), "weights")
        };
        let small = meshes(folder.path(), 0.05);
        // The kitchens of the first have the program's own objects, those of the second the folder's.
        let (beside, of_meshes) = (head(&["--objects", &small]), head(&["--objects", &small, "--kind", "kitchen"]));
        assert_eq!((&beside["sets"][1]["name"], &of_meshes["sets"][0]["name"]), (&json!("kitchen"), &json!("kitchen")));
        assert_eq!(beside["sets"][1]["objects"], "own");
        let large = meshes(folder.path(), 0.08);
        let of_others = head(&["--objects", &large, "--kind", "kitchen"]);
        let records = folder.path().join("out");
        let open = |head: &Value| Records::open(Some(&records), head).map(drop).map_err(|refused| refused.to_string());
        assert_eq!(open(&of_meshes), Ok(()));
        assert_eq!(open(&of_meshes), Ok(()), "it goes on");
        for other in [beside, of_others, head(&["--kind", "kitchen"]), head(&["--objects", &large])] {
            assert!(open(&other).is_err_and(|refused| refused.contains("sets: ")), "{other}");
        }
    }

    #[test]
    fn what_the_environment_says_of_perception_is_part_of_what_a_table_is_made_with() {
        let variables = [("REPOSE_PERCEPTION__SEGMENTATION__MAX_DEPTH_M", "2"), ("REPOSE_CELL", "lab"), ("HOME", "/root")];
        let said = segmentation_of(variables.into_iter().map(|(name, value)| (name.into(), value.into())));
        assert_eq!(said, BTreeMap::from([("REPOSE_PERCEPTION__SEGMENTATION__MAX_DEPTH_M".to_owned(), "2".to_owned())]));
    }

    #[test]
    fn scenes_of_the_next_block_are_refused_before_a_block_is_claimed() {
        for first in ["50000000", "999999", "18446744073709551615"] {
            let line = ["x", "--scenes", "2", "--split", "final", "--first", first];
            let refused = run(&Line::parse_from(line).args, Output { json: false }).expect_err("beyond the table");
            assert_eq!((refused.exit_code(), refused.error().and_then(|e| e.field.as_deref())), (2, Some("first")));
        }
    }
}
