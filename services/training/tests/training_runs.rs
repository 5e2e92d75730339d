//! Training on a small synthetic set: boxes on a table, rendered here, so that the loop is tested without the simulator.

use std::path::Path;

use nalgebra::{Isometry3, Point3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use repose_dataset::{
    Elsewhere, Layer, ObjectRecord, ReleaseRecord, ShardWriter, Split, ViewRecord, proposals_path, releases_path, write_releases,
};
use repose_geometry::{OrientedBox, Pinhole, ViewerFrame, transform::look_at};
use repose_networks::{Models, NetworksConfig, Weights};
use repose_training::{
    Compute, RelationsVariant, TrainError, TrainSettings, TrainedPart,
    curve::Curve,
    merge::READS_RELATIONS,
    train,
    views::{TRIALS_AT_ONCE, Views},
};

#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

const CAMERA: Pinhole = Pinhole { width: 160, height: 120, fx: 140.0, fy: 140.0, cx: 79.5, cy: 59.5 };

/// Depth of a box (or of the table z = 0 without one) in every pixel.
fn rendered(world_from_camera: &Isometry3<f64>, solid: Option<(&Isometry3<f64>, &Vector3<f64>)>) -> Layer {
    let mut depth_m = vec![0.0f32; CAMERA.width * CAMERA.height];
    for (i, z) in depth_m.iter_mut().enumerate() {
        let ray_in_camera = CAMERA.unproject((i % CAMERA.width) as f64, (i / CAMERA.width) as f64, 1.0).coords;
        let (origin, ray) = (world_from_camera.translation.vector, world_from_camera * ray_in_camera);
        let hit = match solid {
            None => (ray.z < 0.0).then(|| -origin.z / ray.z),
            Some((world_from_box, half)) => {
                let (o, r) = (world_from_box.inverse() * Point3::from(origin), world_from_box.inverse() * ray);
                let slab = |k: usize| {
                    let (a, b) = ((-half[k] - o[k]) / r[k], (half[k] - o[k]) / r[k]);
                    (a.min(b), a.max(b))
                };
                let (near, far) = (0..3).map(slab).fold((0.0f64, f64::INFINITY), |(n, f), (a, b)| (n.max(a), f.min(b)));
                (near < far).then_some(near)
            }
        };
        *z = hit.filter(|t| *t < 3.0).unwrap_or(0.0) as f32;
    }
    Layer::from_depth_m(&depth_m, CAMERA.width)
}

fn view(seed: u64) -> ViewRecord {
    let mut rng = Pcg64::seed_from_u64(seed);
    let azimuth: f64 = rng.random_range(0.0..std::f64::consts::TAU);
    let eye = Point3::new(0.7 * azimuth.cos(), 0.7 * azimuth.sin(), 0.5);
    let world_from_camera = look_at(&eye, &Point3::origin(), &Vector3::z());
    let objects: Vec<ObjectRecord> = (0..3u16)
        .map(|k| {
            let half = Vector3::from_fn(|_, _| rng.random_range(0.025..0.05));
            let place = Vector3::new(0.18 * f64::from(k) - 0.18, rng.random_range(-0.15..0.15), half.z);
            let world_from_box = Isometry3::new(place, Vector3::z() * rng.random_range(0.0..1.5));
            let placed_from_elsewhere = Isometry3::new(Vector3::new(0.02, 0.03, 0.0), Vector3::z() * rng.random_range(-1.0..1.0));
            let before = placed_from_elsewhere.inverse() * world_from_box;
            let alone = rendered(&world_from_camera, Some((&world_from_box, &half)));
            ObjectRecord {
                id: k + 1,
                name: "box".into(),
                mass_kg: 0.2,
                world_from_object: world_from_box,
                bounds: OrientedBox { world_from_box, half_extents: half },
                visible_px: alone.count() as u32,
                alone_px: alone.count() as u32,
                alone,
                elsewhere: Some(Elsewhere { layer: rendered(&world_from_camera, Some((&before, &half))), placed_from_elsewhere }),
            }
        })
        .collect();
    let viewer = ViewerFrame::from_camera(&world_from_camera);
    let relations = (0..9)
        .map(|pair| {
            let between = objects[pair / 3].bounds.center() - objects[pair % 3].bounds.center();
            let d = viewer.viewer_from_world() * between;
            std::array::from_fn(|r| match r {
                0 => d.x < -0.05,
                1 => d.x > 0.05,
                2 => d.y < -0.05,
                3 => d.y > 0.05,
                _ => false,
            })
        })
        .collect();
    ViewRecord {
        scene_seed: seed,
        scene_kind: "table".into(),
        view: 0,
        camera: CAMERA,
        viewpoint: "tripod".into(),
        world_from_camera,
        view_yaw_rad: viewer.yaw_rad(),
        background: rendered(&world_from_camera, None),
        fixtures: Vec::new(),
        objects,
        relations,
        gap_m: vec![0.1; 9],
    }
}

fn data(folder: &Path) {
    let mut writer = ShardWriter::new(folder, 8, 0).unwrap();
    for k in 0..8 {
        writer.push(&view(Split::Train.seeds().start + k)).unwrap();
    }
    for k in 0..4 {
        writer.push(&view(Split::Validation.seeds().start + k)).unwrap();
    }
    writer.finish().unwrap();
}

fn settings(folder: &Path, part: TrainedPart, threads: usize, steps: u64) -> TrainSettings {
    TrainSettings {
        data: folder.join("data"),
        out: folder.join(format!("weights_{threads}.safetensors")),
        part,
        threads,
        steps,
        samples_per_slot: 2,
        episodes_kept: 4,
        validation_episodes: 4,
        checkpoint_steps: 2,
        warmup_steps: 2,
        ..TrainSettings::default()
    }
}

#[test]
fn a_run_gives_the_same_weights_on_one_thread_and_on_two() {
    for part in [TrainedPart::Joint, TrainedPart::Discriminator] {
        let folder = tempfile::tempdir().unwrap();
        data(&folder.path().join("data"));
        let one = settings(folder.path(), part, 1, 3);
        let two = settings(folder.path(), part, 2, 3);
        train(&one).unwrap();
        train(&two).unwrap();
        let read = |s: &TrainSettings| Weights::from_bytes(&std::fs::read(&s.out).unwrap()).unwrap();
        assert_eq!(read(&one).values, read(&two).values);
        assert!(read(&one).info.metrics[part.name()]["loss"].as_f64().unwrap().is_finite());
        // What is written serves, and differs from what training started with.
        Models::load(&std::fs::read(&one.out).unwrap()).unwrap();
        let initial = Weights::from_bytes(&Weights::initial(&NetworksConfig::default(), 1).unwrap()).unwrap();
        assert_ne!(read(&one).values, initial.values);
        // A finished run that is asked for more steps goes on from its checkpoint.
        let report = train(&TrainSettings { steps: 4, ..one }).unwrap();
        assert_eq!(report.steps, 4);
    }
}

#[test]
fn the_loss_falls() {
    let folder = tempfile::tempdir().unwrap();
    data(&folder.path().join("data"));
    let first = train(&settings(folder.path(), TrainedPart::Joint, 1, 1)).unwrap();
    let later = train(&TrainSettings { checkpoint_steps: 100, ..settings(folder.path(), TrainedPart::Joint, 2, 30) }).unwrap();
    let loss = |r: &repose_training::TrainReport| r.metrics["loss"].as_f64().unwrap();
    assert!(loss(&later) < loss(&first), "{} then {}", loss(&first), loss(&later));
}

#[test]
fn the_relation_predictor_is_fitted_alone_on_encoders_that_stay_as_they_are() {
    let folder = tempfile::tempdir().unwrap();
    data(&folder.path().join("data"));
    let start = folder.path().join("start.safetensors");
    std::fs::write(&start, Weights::initial(&NetworksConfig::default(), 3).unwrap()).unwrap();
    let of =
        |threads, steps| TrainSettings { start: Some(start.clone()), ..settings(folder.path(), TrainedPart::Relations, threads, steps) };
    let first = train(&of(3, 2)).unwrap();
    let (one, two) = (of(1, 40), of(2, 40));
    let later = train(&one).unwrap();
    train(&two).unwrap();
    let loss = |r: &repose_training::TrainReport| r.metrics["loss"].as_f64().unwrap();
    assert!(loss(&later) < loss(&first), "{} then {}", loss(&first), loss(&later));
    let pairs = ["pairs", "apart_pairs", "moved_pairs"].map(|of| later.metrics[of].as_u64().unwrap());
    assert!(pairs[0] > pairs[1] && pairs[1] > 0 && pairs[0] > pairs[2] && pairs[2] > 0, "{}", later.metrics);
    let read = |path: &Path| Weights::from_bytes(&std::fs::read(path).unwrap()).unwrap().values;
    let (before, after) = (read(&start), read(&one.out));
    for (name, value) in &after {
        assert_eq!(before[name] == *value, !name.starts_with("relations/"), "{name}");
    }
    assert_eq!(after, read(&two.out));
    let error = train(&TrainSettings { start: None, ..of(1, 1) }).unwrap_err();
    assert!(matches!(error, TrainError::NoStart(_)), "{error}");
}

#[test]
fn the_forecast_that_reads_the_relation_predictor_is_left_out_where_that_is_fitted() {
    let folder = tempfile::tempdir().unwrap();
    data(&folder.path().join("data"));
    let start = folder.path().join("start.safetensors");
    let mut weights = Weights::from_bytes(&Weights::initial(&NetworksConfig::default(), 3).unwrap()).unwrap();
    for name in ["stands", READS_RELATIONS] {
        weights.info.forecasts.insert(name.to_owned(), serde_json::json!({}));
    }
    std::fs::write(&start, Weights::to_bytes(&weights.values, &weights.info).unwrap()).unwrap();
    let [without, with]: [&[&str]; 2] = [&["stands"], &["stands", READS_RELATIONS]];
    for (part, kept) in [(TrainedPart::Joint, without), (TrainedPart::Relations, without), (TrainedPart::Discriminator, with)] {
        let out = folder.path().join(format!("{}.safetensors", part.name()));
        train(&TrainSettings { start: Some(start.clone()), out: out.clone(), ..settings(folder.path(), part, 1, 1) }).unwrap();
        let written = Weights::from_bytes(&std::fs::read(&out).unwrap()).unwrap();
        assert_eq!(written.info.forecasts.into_keys().collect::<Vec<_>>(), kept, "{}", part.name());
    }
}

#[test]
fn a_relation_predictor_that_is_not_fitted_stays_as_it_is_of_either_variant() {
    let folder = tempfile::tempdir().unwrap();
    data(&folder.path().join("data"));
    let start = folder.path().join("start.safetensors");
    for config in [NetworksConfig::paper(), NetworksConfig::default()] {
        std::fs::write(&start, Weights::initial(&config, 3).unwrap()).unwrap();
        let out = folder.path().join(format!("of_{}.safetensors", config.outcome));
        let kept = TrainSettings { start: Some(start.clone()), out, ..settings(folder.path(), TrainedPart::Discriminator, 1, 1) };
        train(&kept).unwrap();
        let predictor = |path: &Path| {
            let mut values = Weights::from_bytes(&std::fs::read(path).unwrap()).unwrap().values;
            values.retain(|name, _| name.starts_with("relations/"));
            values
        };
        assert_eq!(predictor(&kept.out), predictor(&start));
    }
}

#[test]
fn a_run_in_parts_gives_the_weights_of_one_in_one_go() {
    let folder = tempfile::tempdir().unwrap();
    data(&folder.path().join("data"));
    let whole = TrainSettings { checkpoint_steps: 100, ..settings(folder.path(), TrainedPart::Discriminator, 1, 5) };
    let parts = TrainSettings { threads: 2, out: folder.path().join("parts.safetensors"), ..whole.clone() };
    train(&whole).unwrap();
    for pause_at in [Some(3), None] {
        let report = train(&TrainSettings { pause_at, ..parts.clone() }).unwrap();
        assert_eq!(report.steps, pause_at.unwrap_or(5));
    }
    let read = |s: &TrainSettings| Weights::from_bytes(&std::fs::read(&s.out).unwrap()).unwrap();
    assert_eq!(read(&whole).values, read(&parts).values);
    assert_eq!(read(&whole).info, read(&parts).info);
    // The running loss goes on as well. JSON may round its last digit.
    let last = |s: &TrainSettings| {
        let curve: Curve = serde_json::from_slice(&std::fs::read(s.out.with_extension("discriminator.curve.json")).unwrap()).unwrap();
        curve.points.last().map(|point| (point.step, point.loss)).unwrap()
    };
    let ((steps, loss), (steps_in_parts, loss_in_parts)) = (last(&whole), last(&parts));
    assert_eq!((steps, steps_in_parts), (5, 5));
    assert!((loss - loss_in_parts).abs() < 1e-12, "{loss} and {loss_in_parts}");
}

#[test]
fn a_run_that_comes_to_no_numbers_leaves_what_was_written_before() {
    let folder = tempfile::tempdir().unwrap();
    data(&folder.path().join("data"));
    let sound = settings(folder.path(), TrainedPart::Discriminator, 1, 1);
    train(&sound).unwrap();
    let written = || [sound.out.clone(), sound.out.with_extension("discriminator.checkpoint")].map(|path| std::fs::read(path).unwrap());
    let before = written();
    // The loss of the next step is a number still, and its weights are too large to compute with.
    let error = train(&TrainSettings { steps: 4, learning_rate: 1e30, checkpoint_steps: 1, ..sound.clone() }).unwrap_err();
    assert!(matches!(error, TrainError::NotFinite { step: 2, .. }), "{error}");
    assert!(written() == before);
    assert_eq!(train(&TrainSettings { steps: 2, ..sound.clone() }).unwrap().steps, 2);
}

#[test]
fn weights_to_start_from_that_are_not_there_are_an_error_that_names_the_setting() {
    let folder = tempfile::tempdir().unwrap();
    let there = folder.path().join("there.safetensors");
    std::fs::write(&there, Weights::initial(&NetworksConfig::default(), 3).unwrap()).unwrap();
    let (missing, broken) = (folder.path().join("missing.safetensors"), folder.path().join("broken.safetensors"));
    std::fs::write(&broken, b"no weights").unwrap();
    let cases = [
        (Some(&missing), None, "start", "missing.safetensors"),
        (Some(&broken), None, "start", "broken.safetensors"),
        (Some(&there), Some(&missing), "mean_with", "missing.safetensors"),
        (Some(&there), Some(&broken), "mean_with", "broken.safetensors"),
        (None, Some(&there), "start", "weights to start from"),
    ];
    for (start, mean_with, field, message) in cases {
        let (start, mean_with) = (start.cloned(), mean_with.cloned().into_iter().collect());
        let error = train(&TrainSettings { start, mean_with, ..settings(folder.path(), TrainedPart::Discriminator, 1, 1) }).unwrap_err();
        assert_eq!(error.field(), Some(field), "{error}");
        assert!(error.to_string().contains(message), "{error}");
    }
}

#[test]
fn a_checkpoint_of_a_run_that_began_otherwise_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    data(&folder.path().join("data"));
    let [one, two] = [1, 2].map(|seed| {
        let path = folder.path().join(format!("start_{seed}.safetensors"));
        std::fs::write(&path, Weights::initial(&NetworksConfig::default(), seed).unwrap()).unwrap();
        path
    });
    let first = TrainSettings {
        start: Some(one.clone()),
        mean_with: vec![two.clone()],
        validation_episodes: 1,
        checkpoint_steps: 100,
        ..settings(folder.path(), TrainedPart::Relations, 1, 1)
    };
    train(&first).unwrap();
    let others = [
        ("start", TrainSettings { start: Some(two.clone()), ..first.clone() }),
        ("mean_with", TrainSettings { mean_with: Vec::new(), ..first.clone() }),
        ("relations", TrainSettings { relations: RelationsVariant::Paper, ..first.clone() }),
    ];
    for (field, other) in others {
        let error = train(&other).unwrap_err();
        assert!(matches!(error, TrainError::OtherRun { .. }), "{error}");
        assert_eq!(error.field(), Some(field), "{error}");
    }
    assert_eq!(train(&TrainSettings { steps: 2, ..first.clone() }).unwrap().steps, 2);
    // One that does not say how it began is resumed.
    let checkpoint = first.out.with_extension("relations.checkpoint");
    let mut stored = Weights::from_bytes(&std::fs::read(&checkpoint).unwrap()).unwrap();
    stored.info.recipe.as_object_mut().unwrap().remove("origin").unwrap();
    std::fs::write(&checkpoint, Weights::to_bytes(&stored.values, &stored.info).unwrap()).unwrap();
    assert_eq!(train(&TrainSettings { start: Some(two), steps: 3, ..first.clone() }).unwrap().steps, 3);
    // A run that writes over what it started from goes on too.
    let own = TrainSettings { out: one, seed: 2, ..first };
    train(&own).unwrap();
    assert_eq!(train(&TrainSettings { steps: 2, ..own }).unwrap().steps, 2);
}

#[test]
fn outcomes_that_are_added_while_a_run_goes_on_are_drawn_too() {
    let folder = tempfile::tempdir().unwrap();
    data(folder.path());
    let seed = Split::Train.seeds().start;
    let release = |scene_seed, object| ReleaseRecord {
        scene_seed,
        object,
        origin_m: [0.0, 0.0, 0.1],
        yaw_rad: 0.0,
        moved_m: 0.0,
        tilt_rad: 0.0,
        penetration_m: 0.0,
        others_moved_m: 0.0,
    };
    let mut views = Views::released(folder.path(), Split::Train).unwrap();
    assert!(views.is_empty());
    write_releases(&releases_path(folder.path(), 0, 8), &serde_json::Value::Null, &[release(seed, 1), release(seed + 1, 2)]).unwrap();
    assert_eq!((views.rescan().unwrap(), views.queries()), (2, 2));
    // As many again for one of them as make a second sample, and one more view.
    let proposals: Vec<_> = std::iter::repeat_n(release(seed, 1), TRIALS_AT_ONCE).chain([release(seed + 2, 3)]).collect();
    write_releases(&proposals_path(folder.path(), 0, 8), &serde_json::Value::Null, &proposals).unwrap();
    assert_eq!((views.rescan().unwrap(), views.queries()), (1, 4));
    let drawn: usize = (0..views.queries()).map(|i| views.query(i).unwrap().releases.len()).sum();
    assert_eq!(drawn, 2 * (1 + TRIALS_AT_ONCE) + 1 + 1);
    assert_eq!((views.rescan().unwrap(), views.queries()), (0, 4));
}

#[test]
fn scenes_of_a_short_shard_that_is_replaced_while_a_run_goes_on_count_once() {
    let folder = tempfile::tempdir().unwrap();
    let mut short = ShardWriter::new(folder.path(), 8, 0).unwrap().with_suffix("_of_2_scenes");
    for k in 0..2 {
        short.push(&view(Split::Train.seeds().start + k)).unwrap();
    }
    short.finish().unwrap();
    let mut views = Views::open(folder.path(), Split::Train).unwrap();
    assert_eq!(views.len(), 2);
    std::fs::remove_file(ShardWriter::shard_path(folder.path(), 0, "_of_2_scenes")).unwrap();
    data(folder.path());
    views.rescan().unwrap();
    let anew = Views::open(folder.path(), Split::Train).unwrap();
    assert_eq!((views.len(), views.queries()), (anew.len(), anew.queries()));
}

#[cfg(unix)]
#[test]
fn a_shard_that_has_gone_since_it_was_listed_is_passed_over() {
    let folder = tempfile::tempdir().unwrap();
    data(folder.path());
    let before = Views::open(folder.path(), Split::Train).unwrap().len();
    std::os::unix::fs::symlink("gone", ShardWriter::shard_path(folder.path(), 7, "_of_2_scenes")).unwrap();
    assert_eq!(Views::open(folder.path(), Split::Train).unwrap().len(), before);
}

#[test]
fn scenes_without_outcomes_are_told_from_no_scenes() {
    let folder = tempfile::tempdir().unwrap();
    let shards = folder.path().join("data");
    std::fs::create_dir_all(&shards).unwrap();
    data(&shards);
    let error = train(&settings(folder.path(), TrainedPart::Outcome, 1, 1)).unwrap_err();
    assert!(matches!(error, TrainError::NoOutcomes { split: "train", .. }), "{error}");
}

#[test]
fn a_folder_without_training_scenes_is_an_error_that_says_so() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::create_dir_all(folder.path().join("data")).unwrap();
    let error = train(&settings(folder.path(), TrainedPart::Joint, 1, 1)).unwrap_err();
    assert!(matches!(error, TrainError::Empty { split: "train", .. }), "{error}");
}

#[test]
fn views_of_which_cleaning_leaves_nothing_are_an_error_with_steps_and_without() {
    let folder = tempfile::tempdir().unwrap();
    let mut writer = ShardWriter::new(&folder.path().join("data"), 8, 0).unwrap();
    for k in 0..2 {
        let mut view = view(Split::Train.seeds().start + k);
        for (y0, object) in (20..).step_by(30).zip(&mut view.objects) {
            object.alone = Layer { x0: 30, y0, width: 100, height: 1, inverse_depth: vec![20_000; 100], color: Vec::new() };
            (object.alone_px, object.visible_px, object.elsewhere) = (100, 100, None);
        }
        writer.push(&view).unwrap();
    }
    writer.finish().unwrap();
    let start = folder.path().join("start.safetensors");
    std::fs::write(&start, Weights::initial(&NetworksConfig::default(), 3).unwrap()).unwrap();
    for part in [TrainedPart::Joint, TrainedPart::Discriminator] {
        for steps in [0, 1] {
            let error = train(&TrainSettings { start: Some(start.clone()), ..settings(folder.path(), part, 1, steps) }).unwrap_err();
            assert!(error.to_string().contains("no view of the data could be prepared"), "{error}");
        }
    }
}

#[test]
fn a_device_that_is_not_there_is_an_error_before_anything_is_read() {
    if candle_core::utils::cuda_is_available() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let error = train(&TrainSettings { device: Compute::Cuda, ..settings(folder.path(), TrainedPart::Joint, 1, 1) }).unwrap_err();
    assert!(matches!(error, TrainError::Cuda(_)) && error.field() == Some("device"), "{error}");
}
