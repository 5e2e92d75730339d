//! Segmentation on frames that nobody here made: skipped with a message where they are absent.

#[path = "../../../tests/common/real_data.rs"]
mod real_data;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use repose_geometry::Pinhole;
use repose_perception::readings::depth::DepthMap;
use repose_perception::readings::flying;
use repose_perception::{Settings, frame_folder, segment, segment_with_labels};
use repose_proto::scene::WorldFrame;
use repose_proto::{CameraModel, Frame, Scene};

/// The frame folders of a set, in name order; empty, with a message, when the data is not there.
fn folders(set: &str) -> Vec<PathBuf> {
    let Some(root) = real_data::real_data(&format!("frames/{set}")) else { return Vec::new() };
    let mut folders: Vec<PathBuf> = std::fs::read_dir(root).unwrap().filter_map(|e| Some(e.ok()?.path())).collect();
    folders.sort();
    folders
}

/// What every scene must hold, whatever it shows.
fn check(scene: &Scene, folder: &Path) {
    let name = folder.display();
    assert_eq!(scene.points.len(), scene.labels.len(), "{name}");
    assert!(scene.points.as_flattened().iter().all(|c| c.is_finite()), "{name}");
    assert_eq!(scene.meta.world_frame, WorldFrame::SupportPlane, "{name}");
    assert!(scene.meta.view_yaw_rad.abs() < 1e-9, "{name}: the camera looks along world +y");
    let table = scene.meta.surfaces.iter().find(|s| s.object.is_none()).unwrap_or_else(|| panic!("{name} has no table"));
    assert!(table.height_m.abs() < 0.01 && table.area_m2 > 0.2, "{name}: table at {} m, {} m2", table.height_m, table.area_m2);
    assert!(!scene.meta.objects.is_empty(), "{name} has no objects");
    for object in &scene.meta.objects {
        assert_eq!(scene.points_of(object.id).count(), object.points, "{name}");
        assert!((0.0..=1.0).contains(&object.completeness), "{name}");
        assert!(object.extent_m.iter().all(|e| (0.005..0.8).contains(e)), "{name}: object {} measures {:?}", object.id, object.extent_m);
        assert!(object.centroid_m[2] > 0.0 && object.centroid_m[2] < 0.4, "{name}: object {} at {:?}", object.id, object.centroid_m);
    }
}

#[test]
fn every_real_frame_gives_a_scene_with_its_labels_and_keeps_their_ids() {
    for folder in folders("mosd").into_iter().chain(folders("sixdof")) {
        let frame = frame_folder::read(&folder).unwrap();
        let scene = segment(&frame, &Settings::default()).unwrap();
        check(&scene, &folder);
        let mut given: Vec<u16> = frame.labels.unwrap().into_iter().filter(|id| *id != 0).collect();
        given.sort_unstable();
        given.dedup();
        let kept: Vec<u16> = scene.meta.objects.iter().map(|o| o.id).collect();
        assert_eq!(kept, given, "{}", folder.display());
    }
}

#[test]
fn every_real_frame_gives_a_scene_without_labels() {
    for folder in folders("mosd").into_iter().chain(folders("sixdof")) {
        let mut frame = frame_folder::read(&folder).unwrap();
        frame.labels = None;
        check(&segment(&frame, &Settings::default()).unwrap(), &folder);
    }
}

#[test]
fn objects_found_without_labels_are_the_labelled_ones() {
    let (mut matched, mut labelled) = (0, 0);
    for folder in folders("mosd") {
        let mut frame = frame_folder::read(&folder).unwrap();
        let given = frame.labels.take().unwrap();
        let found = segment_with_labels(&frame, &Settings::default()).unwrap().labels;
        // Pixels per (given, found) pair, and per id.
        let mut pairs = BTreeMap::new();
        let (mut given_size, mut found_size) = (BTreeMap::new(), BTreeMap::new());
        for (g, f) in given.iter().zip(found.pixels()) {
            *pairs.entry((*g, *f)).or_insert(0.0) += 1.0;
            *given_size.entry(*g).or_insert(0.0) += 1.0;
            *found_size.entry(*f).or_insert(0.0) += 1.0;
        }
        labelled += given_size.keys().filter(|id| **id != 0).count();
        // An F measure of at least 0.75 with one id: at most one id can have it.
        let good = |(&(g, f), n): (&(u16, u16), &f64)| g != 0 && f != 0 && 2.0 * n / (given_size[&g] + found_size[&f]) >= 0.75;
        matched += pairs.iter().filter(|pair| good(*pair)).count();
    }
    println!("{matched} of {labelled} labelled objects found");
    assert!(matched as f64 >= 0.95 * labelled as f64, "{matched} of {labelled}");
}

/// Replaces the nearer or farther reading at outlines, in every other row, by their mean, as a camera that mixes them would; how many.
fn mix_readings_at_outlines(frame: &mut Frame) -> usize {
    let (width, step) = (frame.camera.width, (0.15 / frame.camera.depth_unit_m) as u16);
    let clean = frame.depth.clone();
    let mut mixed = 0;
    for row in (2..frame.camera.height - 2).step_by(2) {
        for i in row * width + 1..(row + 1) * width - 2 {
            let (near, far) = (clean[i].min(clean[i + 1]), clean[i].max(clean[i + 1]));
            if near > 0 && far - near > step {
                frame.depth[i] = near + (far - near) / 2;
                mixed += 1;
            }
        }
    }
    mixed
}

#[test]
fn readings_that_hang_between_surfaces_go_and_hardly_any_other_does() {
    let (mut all_mixed, mut all_removed) = (0, 0);
    for folder in folders("sixdof").into_iter().chain(folders("mosd").into_iter().take(5)) {
        let mut frame = Frame { labels: None, ..frame_folder::read(&folder).unwrap() };
        let flying = |frame: &Frame| segment(frame, &Settings::default()).unwrap().meta.unseen.pixels_flying;
        // These cameras leave out what they cannot tell, so that there is next to nothing to find.
        let own = flying(&frame);
        assert!(own * 1000 < frame.depth.len(), "{}: {own}", folder.display());
        let mixed = mix_readings_at_outlines(&mut frame);
        let removed = flying(&frame) - own;
        println!("{}: {own} of its own, {mixed} mixed in, {removed} more removed", folder.display());
        all_mixed += mixed;
        all_removed += removed;
    }
    assert!(all_removed * 10 >= all_mixed * 9, "{all_removed} of {all_mixed}");
}

/// How many pixels wide a frame repeats each reading, and how many pixels hang between surfaces.
fn repeated_and_flying(frame: &Frame) -> (usize, usize) {
    let CameraModel { width, height, fx, fy, cx, cy, depth_unit_m, .. } = frame.camera;
    let settings = Settings::default();
    let camera = Pinhole { width, height, fx, fy, cx, cy };
    let mut depth = DepthMap::new(&frame.depth, depth_unit_m, &camera, settings.max_depth_m);
    let repeat_px = depth.repeat_px();
    (repeat_px, flying::remove(depth.depth_m_mut(), repeat_px, fx as f32, &settings.flying).removed)
}

/// A frame's depth with every pixel twice in both directions.
fn doubled(frame: &Frame) -> Frame {
    let from = &frame.camera;
    let (width, height) = (2 * from.width, 2 * from.height);
    let depth = (0..width * height).map(|i| frame.depth[i / width / 2 * from.width + i % width / 2]).collect();
    let [cx, cy] = [from.cx, from.cy].map(|c| 2.0 * c + 0.5);
    let camera = CameraModel { width, height, fx: 2.0 * from.fx, fy: 2.0 * from.fy, cx, cy, ..from.clone() };
    Frame { camera, depth, color: None, labels: None, ..frame.clone() }
}

#[test]
fn real_cameras_repeat_nothing_and_where_every_pixel_is_there_twice_four_times_as_many_hang_in_the_air() {
    for folder in folders("sixdof").into_iter().chain(folders("mosd")).chain(folders("desk")) {
        let mut frame = frame_folder::read(&folder).unwrap();
        assert_eq!(repeated_and_flying(&frame).0, 1, "{}", folder.display());
        // Fewer say nothing.
        if mix_readings_at_outlines(&mut frame) < 6 {
            continue;
        }
        let (repeat_px, own) = repeated_and_flying(&frame);
        let (twice_px, of_doubled) = repeated_and_flying(&doubled(&frame));
        println!("{}: {own} of its own size, {of_doubled} of twice that", folder.display());
        assert_eq!((repeat_px, twice_px, of_doubled), (1, 2, 4 * own), "{}", folder.display());
    }
}

#[test]
fn the_same_frame_gives_the_same_scene_whatever_its_stamp() {
    for folder in folders("mosd").into_iter().take(2) {
        let mut frame = frame_folder::read(&folder).unwrap();
        frame.labels = None;
        let first = segment(&frame, &Settings::default()).unwrap();
        frame.stamp_ns = 77;
        let second = segment(&frame, &Settings::default()).unwrap();
        assert_eq!(first.id(), second.id());
        assert_eq!(Scene::from_bulk(&first.to_bulk()).unwrap().id(), first.id(), "an id survives the wire");
        assert_eq!(second.stamp_ns, 77);
    }
}
