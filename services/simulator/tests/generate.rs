//! Generated data does not depend on how many threads made it, and an interrupted run goes on where it stopped.

use std::path::Path;

use repose_dataset::{Composite, ShardWriter, Split, read_shard, shard_paths};
use repose_simulator::generate::{GenerateError, GenerateSettings, generate, scene_views};
use repose_simulator::render::picture;
use repose_simulator::scene::{SceneSettings, scene_of_seed};
use repose_simulator::trials::ReleaseTrialSettings;
use repose_simulator::viewpoint::ViewpointSettings;

fn settings(out: &Path, threads: usize) -> GenerateSettings {
    GenerateSettings { views: 2, scenes_per_shard: 2, threads, ..GenerateSettings::new(out, Split::Validation, 4) }
}

fn bytes(folder: &Path) -> Vec<Vec<u8>> {
    shard_paths(folder).expect("a folder").iter().map(|p| std::fs::read(p).expect("a shard")).collect()
}

#[test]
fn the_same_seeds_give_the_same_bytes_on_any_number_of_threads() {
    let (one, two) = (tempfile::tempdir().expect("a folder"), tempfile::tempdir().expect("a folder"));
    let made = generate(&settings(one.path(), 1), |_| true).expect("made");
    assert_eq!((made.scenes, made.views, made.failed), (4, 8, 0));
    generate(&settings(two.path(), 2), |_| true).expect("made");
    assert!(bytes(one.path()) == bytes(two.path()) && bytes(one.path()).len() == 2);
}

#[test]
fn a_run_that_was_stopped_goes_on_with_what_is_missing() {
    let folder = tempfile::tempdir().expect("a folder");
    let stopped = generate(&settings(folder.path(), 1), |_| false);
    assert!(matches!(stopped, Err(GenerateError::Stopped)));
    assert_eq!(bytes(folder.path()).len(), 1);
    let made = generate(&settings(folder.path(), 1), |_| true).expect("made");
    assert_eq!((made.scenes, made.skipped), (2, 2));
}

#[test]
fn views_show_their_objects_and_say_what_holds() {
    let folder = tempfile::tempdir().expect("a folder");
    generate(&settings(folder.path(), 2), |_| true).expect("made");
    for path in shard_paths(folder.path()).expect("a folder") {
        for view in read_shard(&path).expect("a shard") {
            let n = view.objects.len();
            assert!((3..=7).contains(&n) && view.relations.len() == n * n);
            let picture = Composite::of(&view, |_| true);
            let visible_px: Vec<u32> = view.objects.iter().map(|o| o.visible_px).collect();
            assert_eq!(picture.visible_px(n), visible_px);
            assert!((0..n).filter(|k| view.is_seen(*k)).count() >= 2, "{visible_px:?}");
            assert!(!view.fixtures.is_empty() && ["tripod", "head", "wrist"].contains(&view.viewpoint.as_str()));
            for (k, object) in view.objects.iter().enumerate() {
                assert_eq!(view.relations[k * n + k], [false; 10]);
                assert_eq!(object.alone_px as usize, object.alone.count());
                if let Some(elsewhere) = &object.elsewhere {
                    let (turned, up) = (elsewhere.placed_from_elsewhere.rotation, nalgebra::Vector3::z());
                    assert!((turned * up - up).norm() < 1e-6, "turned about z only");
                }
            }
        }
    }
}

#[test]
fn layers_with_color_compose_the_picture_that_is_drawn_at_once() {
    let folder = tempfile::tempdir().expect("a folder");
    let settings = GenerateSettings { color: true, ..settings(folder.path(), 1) };
    let seed = Split::Validation.seeds().start;
    let scene = scene_of_seed(seed, &settings.scene).expect("a scene").0;
    for view in scene_views(seed, &settings).expect("a scene").0 {
        let composed = Composite::of(&view, |_| true);
        let drawn = picture(&view.camera, &view.world_from_camera, &scene.drawables());
        let depth_off = composed.depth_m.iter().zip(drawn.depth_m.pixels()).filter(|(a, b)| (*a - *b).abs() > 3e-4 * *b * *b).count();
        let labels_off = composed.labels.iter().zip(drawn.labels.pixels()).filter(|(a, b)| a != b).count();
        let color_off = composed.color.iter().zip(drawn.color.pixels()).filter(|(a, b)| a != b).count();
        // Where two surfaces touch, rounding decides which is nearer.
        assert!(depth_off == 0 && labels_off < 40 && color_off < 80, "{depth_off} {labels_off} {color_off}");
    }
}

#[test]
fn a_longer_run_replaces_the_short_shard_of_the_one_before() {
    let folder = tempfile::tempdir().expect("a folder");
    let three = GenerateSettings { scenes: 3, ..settings(folder.path(), 1) };
    generate(&three, |_| true).expect("made");
    let made = generate(&settings(folder.path(), 1), |_| true).expect("made");
    assert_eq!((made.scenes, made.skipped), (2, 2));
    let whole = tempfile::tempdir().expect("a folder");
    generate(&settings(whole.path(), 1), |_| true).expect("made");
    assert!(bytes(folder.path()) == bytes(whole.path()));
    assert_eq!(generate(&three, |_| true).expect("nothing to do").scenes, 0);
}

#[test]
fn a_short_shard_stays_until_the_longer_one_is_there() {
    let folder = tempfile::tempdir().expect("a folder");
    let made = |scenes| generate(&GenerateSettings { scenes, scenes_per_shard: 4, ..settings(folder.path(), 1) }, |_| true);
    made(1).expect("made");
    let before = bytes(folder.path());
    // In the way of what is written, as a full disk is.
    let mut in_the_way = ShardWriter::shard_path(folder.path(), 0, "_of_2_scenes").into_os_string();
    in_the_way.push(format!(".{}.tmp", std::process::id()));
    std::fs::create_dir(&in_the_way).expect("a folder");
    assert!(matches!(made(2), Err(GenerateError::Write { .. })));
    assert!(bytes(folder.path()) == before && before.len() == 1);
    std::fs::remove_dir(&in_the_way).expect("removed");
    made(2).expect("made");
    let longer = bytes(folder.path());
    assert_eq!(longer.len(), 1);
    // As a run leaves it that is interrupted before it removes it.
    std::fs::write(ShardWriter::shard_path(folder.path(), 0, "_of_1_scenes"), &before[0]).expect("written");
    made(2).expect("nothing to do");
    assert!(bytes(folder.path()) == longer);
}

#[test]
fn a_shorter_run_keeps_the_scenes_and_releases_that_are_there() {
    let folder = tempfile::tempdir().expect("a folder");
    let trials = Some(ReleaseTrialSettings { per_scene: 1, ..ReleaseTrialSettings::default() });
    let asked = |scenes| GenerateSettings { scenes, scenes_per_shard: 4, trials: trials.clone(), ..settings(folder.path(), 1) };
    let files = || [folder.path().to_path_buf(), folder.path().join("releases")].map(|folder| bytes(&folder));
    generate(&asked(2), |_| true).expect("made");
    let before = files();
    let made = generate(&asked(1), |_| true).expect("nothing to do");
    assert_eq!((made.scenes, made.skipped, made.releases), (0, 1, 0));
    assert!(files() == before, "nothing is added or removed");
    generate(&asked(3), |_| true).expect("made");
    assert_eq!(files().map(|files| files.len()), before.map(|files| files.len()), "a longer run replaces both files");
}

#[test]
fn another_setting_in_the_same_folder_is_refused_by_name() {
    let folder = tempfile::tempdir().expect("a folder");
    let settings = GenerateSettings { scenes: 0, ..settings(folder.path(), 1) };
    generate(&settings, |_| true).expect("an empty folder with a manifest");
    let others = [
        (GenerateSettings { views: 3, ..settings.clone() }, "settings.views: there 2, now 3"),
        (GenerateSettings { color: true, ..settings.clone() }, "settings.color"),
        (GenerateSettings { split: Split::Test, ..settings.clone() }, "settings.split"),
        (
            GenerateSettings { viewpoint: ViewpointSettings { width: 640, ..settings.viewpoint.clone() }, ..settings.clone() },
            "settings.viewpoint.width",
        ),
        (
            GenerateSettings { scene: SceneSettings { watch_limit_m: 0.002, ..settings.scene.clone() }, ..settings.clone() },
            "watch_limit_m: 0.002",
        ),
    ];
    for (other, named) in others {
        let error = generate(&other, |_| true).expect_err("refused");
        assert!(matches!(error, GenerateError::Manifest(_)) && error.to_string().contains(named), "{error}");
    }
    generate(&settings, |_| true).expect("the same settings are welcome");
}

#[test]
fn more_scenes_than_the_split_has_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    // The last of these ends beyond what can be counted.
    for first_scene in [999_999_998, u64::MAX - 1] {
        let too_many = GenerateSettings { first_scene, ..settings(folder.path(), 1) };
        assert!(matches!(generate(&too_many, |_| true), Err(GenerateError::Seeds { .. })));
    }
    let between = GenerateSettings { first_scene: 3, ..settings(folder.path(), 1) };
    assert!(matches!(generate(&between, |_| true), Err(GenerateError::FirstScene { got: 3, .. })));
}

#[test]
fn releases_asked_for_later_are_added_and_others_than_those_that_are_there_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let asked = |per_scene: Option<usize>| GenerateSettings {
        scenes: 1,
        trials: per_scene.map(|per_scene| ReleaseTrialSettings { per_scene, ..ReleaseTrialSettings::default() }),
        ..settings(folder.path(), 1)
    };
    let made = |per_scene| generate(&asked(per_scene), |_| true);
    assert_eq!(made(None).expect("made").releases, 0);
    assert_eq!(made(Some(2)).expect("made").releases, 2);
    assert_eq!(made(Some(2)).expect("made").releases, 0, "they are there");
    let refused = made(Some(3)).expect_err("other settings").to_string();
    assert!(refused.contains("releases_000000_1") && refused.contains("per_scene: 2") && refused.contains("per_scene: 3"), "{refused}");
}
