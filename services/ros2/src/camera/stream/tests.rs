//! A camera's pictures become frames, or are counted by why not.

use std::time::Duration;

use repose_ros_messages::pictures::Depth;
use repose_ros_messages::{Time, synthetic};

use super::*;
use crate::config::Ros2Config;

const SIDE: usize = 40;
const STAMP_NS: u64 = 5_000_000_000;
const NOW: Now = Now { ms: 0, ns: STAMP_NS + 1_000_000 };

fn stream(settings: &str) -> CameraStream {
    let pose = "world_from_camera = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]";
    let config: Ros2Config = toml::from_str(&format!("[[cameras]]\nname = \"front\"\n{settings}\n{pose}")).expect("TOML");
    config.validate().expect("a configuration");
    CameraStream::new(config.cameras[0].clone(), "world".to_owned())
}

fn header(stamp_ns: u64) -> Header {
    Header { stamp: Time::from_ns(stamp_ns), frame_id: "optical".to_owned() }
}

fn taken<T>(picture: T, stamp_ns: u64, arrived: Instant) -> Taken<T> {
    Taken { arrived, read: Ok((header(stamp_ns), picture)) }
}

fn depth(side: usize) -> Sight {
    Depth { width: side, height: side, unit_m: 1e-3, counts: vec![1000; side * side] }.into()
}

fn color(side: usize, pixel: [u8; 3]) -> Color {
    Color { width: side, height: side, pixels: vec![pixel; side * side] }
}

/// A cloud's picture, with a focal length of 50 pixels and colors of its own.
fn cloud(focal_px: f32) -> Sight {
    let middle = (SIDE as f32 - 1.0) / 2.0;
    let point = |row: u32, column: u32| [(column as f32 - middle) / focal_px, (row as f32 - middle) / focal_px, 1.0];
    let cloud = repose_ros_messages::PointCloud2::read(&synthetic::cloud("optical", SIDE as u32, point)).expect("a cloud");
    let sight = repose_ros_messages::cloud::sight(&cloud).expect("a picture");
    Sight { color: Some(color(SIDE, [7; 3])), ..sight }
}

fn next(stream: &mut CameraStream) -> Option<Made> {
    stream.next(|_, of, _| Err(TransformError::Unknown { frame: of.to_owned(), known: String::new() }), NOW)
}

#[test]
fn a_frame_is_complete_when_its_last_picture_has_come() {
    let mut stream = stream("depth = \"/depth_rect\"\ninfo = \"/info\"\ncolor = \"/color\"");
    stream.info(CameraInfo::read(&synthetic::info("optical", SIDE as u32)).expect("intrinsics"));
    let (early, late) = (Instant::now(), Instant::now() + Duration::from_millis(5));
    stream.depth(taken(depth(SIDE), STAMP_NS, late), NOW);
    assert!(next(&mut stream).is_none());
    stream.color(taken(color(SIDE, [1, 2, 3]), STAMP_NS, early), NOW);
    let made = next(&mut stream).expect("a frame");
    assert_eq!((made.complete, made.frame.stamp_ns, made.frame.color.expect("color")[0]), (late, STAMP_NS, [1, 2, 3]));
    assert_eq!((stream.counts().0.frames, stream.counts().1.paired), (1, 1));
}

#[test]
fn a_cloud_is_a_frame_without_intrinsics_and_with_its_own_color() {
    let mut stream = stream("cloud = \"/points\"");
    stream.depth(taken(cloud(50.0), STAMP_NS, Instant::now()), NOW);
    let frame = next(&mut stream).expect("a frame").frame;
    assert!((frame.camera.fx - 50.0).abs() < 1e-3 && frame.depth == vec![10_000; SIDE * SIDE]);
    assert_eq!(frame.color.expect("color")[0], [7; 3]);
    // A camera that was zoomed, or another one under the same name.
    stream.depth(taken(cloud(120.0), STAMP_NS + 1, Instant::now()), NOW);
    let zoomed = next(&mut stream).expect("a frame").frame;
    assert!((zoomed.camera.fx - 120.0).abs() < 1e-3);
}

#[test]
fn a_cloud_with_intrinsics_has_to_be_of_that_camera() {
    let mut stream = stream("cloud = \"/points\"\ninfo = \"/info\"");
    stream.depth(taken(cloud(5.0), STAMP_NS, Instant::now()), NOW);
    assert!(next(&mut stream).is_none(), "no intrinsics have come");
    // Of a focal length of 5 pixels.
    stream.info(CameraInfo::read(&synthetic::info("optical", SIDE as u32)).expect("intrinsics"));
    stream.depth(taken(cloud(5.0), STAMP_NS + 1, Instant::now()), NOW);
    assert_eq!(next(&mut stream).expect("a frame").frame.camera.fx, 5.0);
    stream.depth(taken(cloud(50.0), STAMP_NS + 2, Instant::now()), NOW);
    assert!(next(&mut stream).is_none());
    let lost = &stream.counts().0.lost;
    assert_eq!((lost[&Lost::NoIntrinsics], lost[&Lost::Unfit]), (1, 1));
    assert!(stream.take_why().is_some_and(|(_, why)| why.contains("optical frame")));
}

#[test]
fn every_picture_that_is_no_frame_is_counted_and_its_reason_told() {
    let mut stream = stream("depth = \"/depth\"\ninfo = \"/info\"\ncolor = \"/color\"");
    let lost = |stream: &mut CameraStream, why: Lost, words: &str| {
        assert!(next(stream).is_none());
        let (reason, told) = stream.take_why().expect("a reason");
        assert!(reason == why && stream.counts().0.lost.get(&why) == Some(&1) && told.contains(words), "{why:?}: {told}");
    };
    let broken = MessageError::Unsupported { field: "encoding", got: "yuv422".to_owned(), expected: "rgb8" };
    stream.color(Taken { arrived: Instant::now(), read: Err(broken.into()) }, NOW);
    lost(&mut stream, Lost::Unreadable, "color: encoding: yuv422");
    stream.depth(taken(depth(SIDE), 1, Instant::now()), NOW);
    lost(&mut stream, Lost::Late, "depth was 5000 ms old");
    let pair = |stream: &mut CameraStream, stamp_ns: u64, side: usize| {
        stream.depth(taken(depth(SIDE), stamp_ns, Instant::now()), NOW);
        stream.color(taken(color(side, [0; 3]), stamp_ns, Instant::now()), NOW);
    };
    pair(&mut stream, STAMP_NS, SIDE);
    lost(&mut stream, Lost::NoIntrinsics, "/info");
    pair(&mut stream, STAMP_NS + 1, SIDE / 2);
    lost(&mut stream, Lost::Unfit, "color of 20 x 20 and depth of 40 x 40");
}

#[test]
fn a_frame_waits_for_the_transform_at_its_stamp_for_as_long_as_it_has_patience() {
    let toml = "[[cameras]]\nname = \"front\"\ndepth = \"/depth_rect\"\ninfo = \"/info\"\npatience_ms = 100\nframe = \"optical\"";
    let config: Ros2Config = toml::from_str(toml).expect("TOML");
    let mut stream = CameraStream::new(config.cameras[0].clone(), "world".to_owned());
    stream.info(CameraInfo::read(&synthetic::info("other", SIDE as u32)).expect("intrinsics"));
    let missing = |_: &str, of: &str, _| Err(TransformError::Unknown { frame: of.to_owned(), known: String::new() });
    let there = |to: &str, of: &str, at_ns| {
        assert_eq!((to, of, at_ns), ("world", "optical", STAMP_NS));
        Ok(Isometry3::translation(1.0, 2.0, 3.0))
    };
    stream.depth(taken(depth(SIDE), STAMP_NS, Instant::now()), NOW);
    assert!(stream.next(missing, NOW).is_none() && stream.waits_for_pose());
    assert_eq!(stream.due_ms(), Some(100));
    let made = stream.next(there, Now { ms: 99, ..NOW }).expect("a frame");
    assert_eq!(made.frame.camera.world_from_camera.expect("a pose").0[3], 1.0);
    stream.depth(taken(depth(SIDE), STAMP_NS + 1, Instant::now()), NOW);
    assert!(stream.next(missing, Now { ms: 0, ..NOW }).is_none());
    assert!(stream.next(missing, Now { ms: 100, ..NOW }).is_none());
    assert_eq!(stream.counts().0.lost[&Lost::NoPose], 1);
}

#[test]
fn a_frame_that_is_stamped_on_arrival_has_the_stamp_of_its_depth_whatever_it_waited_for() {
    let settings = "depth = \"/depth_rect\"\ninfo = \"/info\"\ncolor = \"/color\"\nstamp_on_arrival = true";
    let config: Ros2Config = toml::from_str(&format!("[[cameras]]\nname = \"front\"\n{settings}")).expect("TOML");
    let mut stream = CameraStream::new(config.cameras[0].clone(), "world".to_owned());
    stream.info(CameraInfo::read(&synthetic::info("optical", SIDE as u32)).expect("intrinsics"));
    // So that it is taken as it comes, however slow the machine is.
    let just_now = Instant::now() + Duration::from_secs(3600);
    let later = |ms: u64| Now { ms, ns: NOW.ns + ms * 1_000_000 };
    stream.depth(taken(depth(SIDE), STAMP_NS, just_now), NOW);
    stream.color(taken(color(SIDE, [0; 3]), STAMP_NS, just_now), later(50));
    assert!(next(&mut stream).is_none() && stream.waits_for_pose(), "the transform has not come");
    let there = |_: &str, _: &str, at_ns: u64| {
        assert_eq!(at_ns, STAMP_NS, "transforms are of ROS's clock");
        Ok(Isometry3::identity())
    };
    assert_eq!(stream.next(there, later(150)).expect("a frame").frame.stamp_ns, NOW.ns);
}
