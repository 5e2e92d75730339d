//! A frame in memory to its scene, by size and by whether labels came with it: `cargo bench -p repose-perception`.
//!
//! The frames are the real `mosd/learn0`, at its own size and resampled, so that the noise is a camera's; without
//! the data a drawn table with boxes stands in. Records are in `record/`.

#[path = "../../../tests/common/real_data.rs"]
mod real_data;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use repose_perception::{Settings, frame_folder, segment};
use repose_proto::{CameraModel, Frame, Scene};

/// Name, columns and rows.
const SIZES: [(&str, usize, usize); 2] = [("640x480", 640, 480), ("1280x720", 1280, 720)];

fn real() -> Frame {
    match real_data::real_data("frames/mosd/learn0") {
        Some(folder) => frame_folder::read(&folder).expect("a frame"),
        None => drawn(),
    }
}

/// A table 1 m below a camera that looks straight down, with boxes of 8 cm on it.
fn drawn() -> Frame {
    let (width, height) = (640, 480);
    let camera = CameraModel { width, height, fx: 525.0, fy: 525.0, cx: 319.5, cy: 239.5, depth_unit_m: 0.001, world_from_camera: None };
    let on_box = |i: usize| (i % width) % 100 < 45 && (i / width) % 100 < 45;
    let count = width * height;
    let labels = (0..count).map(|i| if on_box(i) { (1 + (i % width) / 100 + 7 * ((i / width) / 100)) as u16 } else { 0 }).collect();
    let depth = (0..count).map(|i| if on_box(i) { 920 } else { 1000 }).collect();
    Frame { color: Some(vec![[128; 3]; count]), labels: Some(labels), ..Frame::new("drawn".to_owned(), 0, camera, depth) }
}

/// Nearest pixels, intrinsics scaled alike.
fn resampled(frame: &Frame, width: usize, height: usize) -> Frame {
    let from = &frame.camera;
    let source = |i: usize| (i / width * from.height / height) * from.width + i % width * from.width / width;
    let (across, down) = (width as f64 / from.width as f64, height as f64 / from.height as f64);
    let camera =
        CameraModel { width, height, fx: from.fx * across, fy: from.fy * down, cx: from.cx * across, cy: from.cy * down, ..from.clone() };
    let pick = |values: &Vec<u16>| (0..width * height).map(|i| values[source(i)]).collect::<Vec<u16>>();
    Frame {
        camera,
        depth: pick(&frame.depth),
        color: frame.color.as_ref().map(|c| (0..width * height).map(|i| c[source(i)]).collect()),
        labels: frame.labels.as_ref().map(pick),
        ..frame.clone()
    }
}

fn frame_to_scene(criterion: &mut Criterion) {
    let settings = Settings::default();
    let original = real();
    let mut group = criterion.benchmark_group("frame_to_scene");
    for (name, width, height) in SIZES {
        let labelled = resampled(&original, width, height);
        let unlabelled = Frame { labels: None, ..labelled.clone() };
        for (labels, frame) in [("found", &unlabelled), ("given", &labelled)] {
            group.bench_with_input(BenchmarkId::new(labels, name), frame, |b, frame| {
                b.iter(|| segment(frame, &settings));
            });
        }
    }
    group.finish();
}

/// What publishing adds: bytes and id.
fn scene_to_bytes(criterion: &mut Criterion) {
    let scene: Option<Scene> = segment(&Frame { labels: None, ..real() }, &Settings::default()).ok();
    let Some(scene) = scene else { return };
    criterion.bench_function("scene_to_bytes_and_id", |b| b.iter(|| (scene.to_bulk().encode(), scene.id())));
}

criterion_group!(benches, frame_to_scene, scene_to_bytes);
criterion_main!(benches);
