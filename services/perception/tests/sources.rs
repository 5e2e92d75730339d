//! Frames from recordings that others wrote (`data/ros2` beside the repository, skipped with a message where it is absent) and from
//! sequences of pictures.

#[path = "../../../tests/common/real_data.rs"]
mod real_data;

use std::path::{Path, PathBuf};

use repose_perception::sources::{self, SourceError, Topics};
use repose_perception::{Settings, frame_folder, segment};
use repose_proto::{CameraModel, Frame};
use repose_ros_messages::PointCloud2;
use serde::Deserialize;

/// What `expected.json` says of one scene.
#[derive(Debug, Deserialize)]
struct Expected {
    stamp_s: u64,
    height: usize,
    width: usize,
    point_step: u32,
    finite_points: usize,
    mean_xyz: [f64; 3],
    min_xyz: [f64; 3],
    max_xyz: [f64; 3],
    point_row120_col200: [f64; 3],
    rgb_row120_col200: [u8; 3],
    #[serde(rename = "K")]
    k: [[f64; 3]; 3],
}

#[derive(Debug, Deserialize)]
struct File {
    expected: Vec<Expected>,
}

/// The data's folder and what is in it; none, with a message, when it is not there.
fn data() -> Option<(PathBuf, Vec<Expected>)> {
    let root = real_data::real_data("ros2")?;
    let text = std::fs::read_to_string(root.join("expected.json")).unwrap();
    let file: File = serde_json::from_str(&text).unwrap();
    Some((root, file.expected))
}

fn frames(path: &Path, topics: &Topics) -> Vec<Frame> {
    sources::open(path, topics).unwrap().collect::<Result<_, _>>().unwrap()
}

/// Checks a frame's points against what is expected, to within a count of depth.
fn check(frame: &Frame, expected: &Expected, name: &str) {
    let camera = &frame.camera;
    let stamp_s = frame.stamp_ns / 1_000_000_000;
    assert_eq!((camera.width, camera.height, stamp_s), (expected.width, expected.height, expected.stamp_s), "{name}");
    assert_eq!(
        [camera.fx, camera.fy, camera.cx, camera.cy],
        [expected.k[0][0], expected.k[1][1], expected.k[0][2], expected.k[1][2]],
        "{name}"
    );
    let point = |i: usize| {
        let z = f64::from(frame.depth[i]) * camera.depth_unit_m;
        [((i % camera.width) as f64 - camera.cx) / camera.fx * z, ((i / camera.width) as f64 - camera.cy) / camera.fy * z, z]
    };
    let points: Vec<[f64; 3]> = (0..frame.depth.len()).filter(|i| frame.depth[*i] > 0).map(point).collect();
    assert_eq!(points.len(), expected.finite_points, "{name}");
    let near = |a: [f64; 3], b: [f64; 3], what: &str| {
        assert!(a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-3), "{name}: {what} {a:?}, expected {b:?}");
    };
    let fold = |f: fn(f64, f64) -> f64, start: f64| points.iter().fold([start; 3], |m, p| std::array::from_fn(|k| f(m[k], p[k])));
    near(fold(|a, b| a + b, 0.0).map(|sum| sum / points.len() as f64), expected.mean_xyz, "mean");
    near(fold(f64::min, f64::INFINITY), expected.min_xyz, "least");
    near(fold(f64::max, f64::NEG_INFINITY), expected.max_xyz, "greatest");
    near(point(120 * camera.width + 200), expected.point_row120_col200, "sample");
    assert_eq!(frame.color.as_ref().unwrap()[120 * camera.width + 200], expected.rgb_row120_col200, "{name}");
}

#[test]
fn every_kind_of_recording_gives_the_frames_that_were_written() {
    let Some((root, expected)) = data() else { return };
    let clouds = Topics { clouds: true, ..Topics::default() };
    for name in ["mcap_lz4.mcap", "mcap_none", "mcap_zstd", "mcap_zstd/mcap_zstd.mcap"] {
        for (kind, topics) in [("images", &Topics::default()), ("clouds", &clouds)] {
            let frames = frames(&root.join(name), topics);
            assert_eq!(frames.len(), expected.len(), "{name}, {kind}");
            for (frame, expected) in frames.iter().zip(&expected) {
                check(frame, expected, &format!("{name}, {kind}"));
                let scene = segment(frame, &Settings::default()).unwrap();
                assert!(!scene.meta.objects.is_empty(), "{name}: a mug or a bottle stands on the table");
            }
        }
    }
}

#[test]
fn a_raw_cloud_message_is_read_with_its_padding_and_holes() {
    let Some((root, expected)) = data() else { return };
    let cloud = PointCloud2::read(&std::fs::read(root.join("pointcloud2_red_mug.cdr")).unwrap()).unwrap();
    let expected = &expected[0];
    assert_eq!((cloud.width as usize, cloud.height as usize, cloud.point_step), (expected.width, expected.height, expected.point_step));
    let points: Vec<_> = cloud.points().unwrap().collect();
    assert_eq!(points.len(), expected.width * expected.height);
    let finite: Vec<[f32; 3]> = points.iter().map(|(p, _)| *p).filter(|p| p.iter().all(|c| c.is_finite())).collect();
    assert_eq!(finite.len(), expected.finite_points);
    for k in 0..3 {
        let mean = finite.iter().map(|p| f64::from(p[k])).sum::<f64>() / finite.len() as f64;
        assert!((mean - expected.mean_xyz[k]).abs() < 1e-6, "{mean}");
    }
    let (sample, color) = points[120 * expected.width + 200];
    assert_eq!((sample.map(f64::from), color), (expected.point_row120_col200, Some(expected.rgb_row120_col200)));
}

#[test]
fn a_recording_without_what_is_asked_for_says_what_it_has() {
    let Some((root, _)) = data() else { return };
    let topics = Topics { depth: Some("/nothing".to_owned()), ..Topics::default() };
    let errors: Vec<SourceError> = sources::open(&root.join("mcap_lz4.mcap"), &topics).unwrap().filter_map(Result::err).collect();
    assert_eq!(errors.len(), 1);
    assert!(errors[0].to_string().contains("/camera/color/camera_info"), "{}", errors[0]);
}

#[test]
fn a_damaged_recording_is_an_error_and_not_a_panic() {
    let Some((root, expected)) = data() else { return };
    let whole = std::fs::read(root.join("mcap_lz4.mcap")).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("damaged.mcap");
    let read = |bytes: &[u8]| {
        std::fs::write(&file, bytes).unwrap();
        sources::open(&file, &Topics::default()).unwrap().collect::<Vec<_>>()
    };
    let cut = read(&whole[..whole.len() / 2]);
    assert!(cut.last().unwrap().is_err() && cut.len() <= expected.len() + 1);
    assert!(read(b"no recording at all").iter().all(Result::is_err));
    for at in (0..whole.len()).step_by(whole.len() / 23) {
        let mut spoiled = whole.clone();
        spoiled[at] ^= 0x5a;
        assert!(read(&spoiled).len() <= expected.len() + 1);
    }
}

/// A frame of 4 x 3 pixels whose depths are all `count`.
fn frame(count: u16) -> Frame {
    let camera = CameraModel { width: 4, height: 3, fx: 5.0, fy: 5.0, cx: 1.5, cy: 1.0, depth_unit_m: 0.001, world_from_camera: None };
    Frame { color: Some(vec![[7; 3]; 12]), ..Frame::new("folder".to_owned(), 0, camera, vec![count; 12]) }
}

#[test]
fn pictures_come_in_the_order_of_their_numbers_in_both_forms() {
    let root = tempfile::tempdir().unwrap();
    let (folders, sequence) = (root.path().join("folders"), root.path().join("sequence"));
    for kind in ["depth", "color"] {
        std::fs::create_dir_all(sequence.join(kind)).unwrap();
    }
    for number in [2, 10, 1] {
        let folder = folders.join(format!("frame{number}"));
        frame_folder::write(&folder, &frame(number)).unwrap();
        std::fs::copy(folder.join("camera.json"), sequence.join("camera.json")).unwrap();
        std::fs::copy(folder.join("depth.png"), sequence.join(format!("depth/{number}.png"))).unwrap();
        if number != 10 {
            std::fs::copy(folder.join("color.png"), sequence.join(format!("color/{number}.png"))).unwrap();
        }
    }
    let of = |path: &Path| frames(path, &Topics::default()).iter().map(|f| (f.depth[0], f.color.is_some())).collect::<Vec<_>>();
    assert_eq!(of(&folders), [(1, true), (2, true), (10, true)]);
    assert_eq!(of(&sequence), [(1, true), (2, true), (10, false)]);
    assert_eq!(of(&folders.join("frame10")), [(10, true)]);
    assert!(matches!(sources::open(root.path(), &Topics::default()), Err(SourceError::Empty { .. })));
    assert!(matches!(sources::open(&root.path().join("absent"), &Topics::default()), Err(SourceError::File { .. })));
}
