//! Generated data does not depend on how many threads made it, and an interrupted run goes on where it stopped.

use std::path::Path;

use repose_dataset::{Composite, Split, read_shard, shard_paths};
use repose_simulator::generate::{GenerateError, GenerateSettings, generate};

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
            let seen = view.objects.iter().filter(|o| picture.labels.contains(&o.id)).count();
            assert!(seen * 2 >= n, "{seen} of {n} objects are seen");
            for (k, object) in view.objects.iter().enumerate() {
                assert_eq!(view.relations[k * n + k], [false; 10]);
                if let Some(elsewhere) = &object.elsewhere {
                    let (turned, up) = (elsewhere.placed_from_elsewhere.rotation, nalgebra::Vector3::z());
                    assert!((turned * up - up).norm() < 1e-6, "turned about z only");
                }
            }
        }
    }
}

#[test]
fn more_scenes_than_the_split_has_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let too_many = GenerateSettings { first_scene: 999_999_999, ..settings(folder.path(), 1) };
    assert!(matches!(generate(&too_many, |_| true), Err(GenerateError::Seeds { .. })));
}
