//! What is written is read back, and what is broken is an error that says what.

use std::path::{Path, PathBuf};

use nalgebra::{Isometry3, Vector3};
use proptest::prelude::*;
use repose_dataset::{
    Elsewhere, FixtureRecord, Layer, ObjectRecord, RELATIONS, ReadError, Shard, ShardWriter, ViewRecord, read_shard, shard_paths,
};
use repose_geometry::{OrientedBox, Pinhole};

fn view(seed: u64, color: bool) -> ViewRecord {
    let layer = |w: u16| Layer {
        x0: 1,
        y0: 2,
        width: 2,
        height: 3,
        inverse_depth: vec![w, 0, w, w + 1, w, 0],
        color: if color { vec![[w as u8, 2, 3]; 6] } else { Vec::new() },
    };
    let bounds = OrientedBox { world_from_box: Isometry3::translation(0.1, 0.0, 0.0), half_extents: Vector3::new(0.1, 0.2, 0.3) };
    let object = |id: u16| ObjectRecord {
        id,
        name: format!("box {id}"),
        mass_kg: 0.25,
        world_from_object: Isometry3::translation(0.1, 0.2, f64::from(id)),
        bounds,
        visible_px: 3,
        alone_px: 4,
        alone: layer(id * 1000),
        elsewhere: (id == 2)
            .then(|| Elsewhere { layer: layer(7), placed_from_elsewhere: Isometry3::new(Vector3::x(), Vector3::z() * 0.3) }),
    };
    let mut relations = vec![[false; RELATIONS]; 4];
    relations[1][9] = true;
    ViewRecord {
        scene_seed: seed,
        scene_kind: "table".into(),
        view: 1,
        camera: Pinhole { width: 6, height: 8, fx: 5.0, fy: 5.0, cx: 2.5, cy: 3.5 },
        viewpoint: "head".into(),
        world_from_camera: Isometry3::new(Vector3::new(0.0, -1.0, 0.5), Vector3::x()),
        view_yaw_rad: 0.25,
        background: layer(12_345),
        fixtures: vec![FixtureRecord { name: "table".into(), bounds }],
        objects: vec![object(1), object(2)],
        relations,
        gap_m: vec![0.0, 0.01, 0.01, 0.0],
    }
}

fn written(folder: &Path, views: &[ViewRecord]) -> Vec<PathBuf> {
    let mut writer = ShardWriter::new(folder, 2, 0).unwrap();
    for view in views {
        writer.push(view).unwrap();
    }
    let bytes = writer.finish().unwrap();
    let paths = shard_paths(folder).unwrap();
    assert_eq!(bytes, paths.iter().map(|p| std::fs::metadata(p).unwrap().len()).sum::<u64>());
    paths
}

/// Equal up to the rounding of transforms.
fn same(a: &ViewRecord, b: &ViewRecord) -> bool {
    let close = |a: &Isometry3<f64>, b: &Isometry3<f64>| (a.to_homogeneous() - b.to_homogeneous()).amax() < 1e-8;
    let mut aligned = a.clone();
    aligned.world_from_camera = b.world_from_camera;
    for (to, from) in aligned.objects.iter_mut().zip(&b.objects) {
        if let (Some(to), Some(from)) = (&mut to.elsewhere, &from.elsewhere) {
            if !close(&to.placed_from_elsewhere, &from.placed_from_elsewhere) {
                return false;
            }
            to.placed_from_elsewhere = from.placed_from_elsewhere;
        }
    }
    close(&a.world_from_camera, &b.world_from_camera) && aligned == *b
}

#[test]
fn what_was_written_is_read_back_with_and_without_color() {
    for color in [false, true] {
        let folder = tempfile::tempdir().unwrap();
        let views: Vec<_> = (0..3).map(|seed| view(seed, color)).collect();
        let paths = written(folder.path(), &views);
        assert_eq!(paths.len(), 2, "two views, then one");
        let read: Vec<_> = paths.iter().flat_map(|p| read_shard(p).unwrap()).collect();
        assert!(views.len() == read.len() && views.iter().zip(&read).all(|(a, b)| same(a, b)), "{read:#?}");
        assert!(read.iter().all(|v| v.has_color() == color));
    }
}

#[test]
fn a_shard_says_what_is_in_it_without_unpacking() {
    let folder = tempfile::tempdir().unwrap();
    let paths = written(folder.path(), &[view(8, false), view(9, false)]);
    let shard = Shard::open(&paths[0]).unwrap();
    let seeds: Vec<u64> = shard.summaries().map(|s| s.scene_seed).collect();
    assert_eq!((shard.len(), seeds), (2, vec![8, 9]));
    let summary = shard.summaries().next().unwrap();
    assert_eq!((summary.visible_px().collect::<Vec<_>>(), summary.alone_px().next()), (vec![3, 3], Some(4)));
    assert!(matches!(shard.view(2), Err(ReadError::Malformed { .. })));
}

#[test]
fn a_view_that_contradicts_itself_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut writer = ShardWriter::new(folder.path(), 2, 0).unwrap();
    let refused = |writer: &mut ShardWriter, change: &dyn Fn(&mut ViewRecord)| {
        let mut bad = view(0, true);
        change(&mut bad);
        writer.push(&bad).unwrap_err().to_string()
    };
    let error = refused(&mut writer, &|v| v.gap_m.truncate(3));
    assert!(error.contains("gap_m") && error.contains("expected 4"), "{error}");
    let error = refused(&mut writer, &|v| v.objects[0].alone.color.clear());
    assert!(error.contains("alone.color"), "{error}");
}

#[test]
fn a_camera_by_which_no_points_can_be_told_is_an_error_and_leaves_the_other_views() {
    let camera = view(0, false).camera;
    let broken =
        [Pinhole { fx: 0.0, ..camera }, Pinhole { fy: -5.0, ..camera }, Pinhole { fx: 1e-300, ..camera }, Pinhole { cx: 1e300, ..camera }];
    for camera in broken {
        let folder = tempfile::tempdir().unwrap();
        let path = &written(folder.path(), &[ViewRecord { camera, ..view(0, false) }, view(1, false)])[0];
        let shard = Shard::open(path).unwrap();
        let error = shard.view(0).unwrap_err().to_string();
        assert!(error.contains("views[0].camera"), "{error}");
        assert!(shard.view(1).is_ok());
    }
}

#[test]
fn the_first_version_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("shard_00000.safetensors");
    let bytes = |key: &str, value: &str| {
        let metadata = std::collections::HashMap::from([(key.to_owned(), value.to_owned())]);
        safetensors::serialize(Vec::<(String, safetensors::tensor::TensorView)>::new(), Some(metadata)).unwrap()
    };
    for (key, value, named) in [("repose-views-1", "[]", "repose-views-1"), ("format", "repose-views-9", "repose-views-9")] {
        std::fs::write(&path, bytes(key, value)).unwrap();
        let error = read_shard(&path).unwrap_err();
        assert!(matches!(error, ReadError::Version { .. }) && error.to_string().contains(named), "{error}");
    }
}

#[test]
fn a_broken_layer_is_an_error_that_names_the_tensor() {
    let folder = tempfile::tempdir().unwrap();
    let path = &written(folder.path(), &[view(0, false)])[0];
    let bytes = std::fs::read(path).unwrap();
    let (header, metadata) = safetensors::SafeTensors::read_metadata(&bytes).unwrap();
    let (_, end) = metadata.info("0000/object_1/alone").unwrap().data_offsets;
    let mut broken = bytes.clone();
    // The last byte of the stream's checksum.
    broken[8 + header + end - 1] ^= 1;
    std::fs::write(path, broken).unwrap();
    let error = read_shard(path).unwrap_err().to_string();
    assert!(error.contains("0000/object_1/alone"), "{error}");
}

proptest! {
    #[test]
    fn a_truncated_or_changed_shard_never_panics(at: prop::sample::Index, flip in 1u8..=255, truncate: bool) {
        let folder = tempfile::tempdir().unwrap();
        let path = &written(folder.path(), &[view(0, true)])[0];
        let mut bytes = std::fs::read(path).unwrap();
        let at = at.index(bytes.len());
        if truncate {
            bytes.truncate(at);
        } else {
            bytes[at] ^= flip;
        }
        std::fs::write(path, bytes).unwrap();
        // A changed byte may hit a relation or a gap, which nothing guards; a shorter file is always noticed.
        let read = read_shard(path);
        prop_assert!(!truncate || matches!(read, Err(ReadError::Malformed { .. })), "{read:?}");
    }
}
