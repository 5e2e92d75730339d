//! Several cameras at once: the newest frame wins, nobody waits for a slow consumer, and every frame is accounted for.

mod common;

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use common::{config, encoded, frame, frame_of};
use repose_perception::PerceptionConfig;
use repose_perception::cameras::{CameraFollower, FrameCounts};
use repose_perception::newest_scenes::KeptScene;
use repose_perception::worker::{FrameOrigin, Worker};
use repose_proto::robot::RobotState;
use repose_proto::{ErrorCode, Payload, RigidTransform, SceneSummary};
use repose_runtime::{CancellationToken, JobContext, Session, Subscription, Traffic};

/// Cameras that are followed, and who listens to their scenes.
struct Following {
    session: Session,
    worker: Arc<Worker>,
    cameras: Arc<CameraFollower>,
    scenes: Subscription,
    stop: CancellationToken,
}

impl Following {
    /// Follows `names`, all cameras when empty, and has seen a scene of each of `used`.
    async fn start(names: &[&str], used: &[&str]) -> Self {
        Self::start_as(config(), names, used).await
    }

    async fn start_as(config: PerceptionConfig, names: &[&str], used: &[&str]) -> Self {
        let session = Session::embedded().await.unwrap();
        let worker = Arc::new(Worker::start(&config).unwrap());
        let cameras = CameraFollower::new(session.clone(), worker.clone(), &config);
        let stop = CancellationToken::new();
        let names: Vec<String> = names.iter().map(|name| (*name).to_owned()).collect();
        let scenes = session.subscribe_queue(&session.cell().scene("*"), 256).await.unwrap();
        cameras.clone().follow(&names, stop.clone()).await.unwrap();
        let mut following = Self { session, worker, cameras, scenes, stop };
        for camera in used {
            // Put until one arrives: the subscription may still be on its way.
            loop {
                following.put(camera, encoded(&frame(camera, 1))).await;
                if let Ok(Some(_)) = tokio::time::timeout(Duration::from_millis(300), following.scenes.recv()).await {
                    break;
                }
            }
        }
        following.settled().await;
        following
    }

    async fn put(&self, camera: &str, payload: Payload) {
        self.session.put(&self.session.cell().camera_frame(camera), payload, Traffic::Frame).await.unwrap();
    }

    fn counts(&self) -> &FrameCounts {
        self.cameras.counts()
    }

    /// Until every frame received has become something.
    async fn settled(&self) {
        self.until(|counts| {
            let ended = [&counts.dropped, &counts.unasked, &counts.late, &counts.failed, &counts.published];
            counts.received.load(Ordering::SeqCst) == ended.iter().map(|c| c.load(Ordering::SeqCst)).sum::<u64>()
        })
        .await;
    }

    async fn until(&self, holds: impl Fn(&FrameCounts) -> bool) {
        let waiting = async {
            while !holds(self.counts()) {
                tokio::task::yield_now().await;
            }
        };
        tokio::time::timeout(Duration::from_secs(20), waiting).await.unwrap_or_else(|_| panic!("still {:?}", self.counts()));
    }

    /// The stamp of a camera's newest scene.
    fn newest(&self, camera: &str) -> Option<u64> {
        self.worker.newest().of(camera).map(|summary| summary.stamp_ns)
    }

    async fn stop(self) {
        self.stop.cancel();
        drop(self.scenes);
        self.session.close().await.unwrap();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_newest_frame_of_each_camera_wins_whoever_is_slow_to_listen() {
    let following = Following::start(&[], &["fast", "slow"]).await;
    let cell = following.session.cell().clone();
    // Holds one message and never takes it.
    let _never_reads = following.session.subscribe_queue(&cell.scene("fast"), 1).await.unwrap();
    let before = following.counts().received.load(Ordering::SeqCst);
    for stamp_ns in 2..=40 {
        following.put("fast", encoded(&frame("fast", stamp_ns))).await;
        if stamp_ns % 20 == 0 {
            following.put("slow", encoded(&frame("slow", stamp_ns))).await;
        }
    }
    following.until(|counts| counts.received.load(Ordering::SeqCst) == before + 41).await;
    following.settled().await;
    assert_eq!((following.newest("fast"), following.newest("slow")), (Some(40), Some(40)));
    let counts = following.counts();
    assert_eq!(counts.failed.load(Ordering::SeqCst) + counts.late.load(Ordering::SeqCst), 0, "{counts:?}");
    following.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_after_a_newer_one_is_late_and_changes_nothing() {
    let following = Following::start(&["front"], &["front"]).await;
    let published = following.counts().published.load(Ordering::SeqCst);
    following.put("front", encoded(&frame("front", 100))).await;
    following.until(|counts| counts.published.load(Ordering::SeqCst) == published + 1).await;
    following.put("front", encoded(&frame("front", 50))).await;
    following.until(|counts| counts.late.load(Ordering::SeqCst) == 1).await;
    assert_eq!(following.newest("front"), Some(100));
    following.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_camera_that_is_named_twice_is_followed_once() {
    let following = Following::start(&["front", "front"], &["front"]).await;
    let count = |counter: &std::sync::atomic::AtomicU64| counter.load(Ordering::SeqCst);
    let (received, published) = (count(&following.counts().received), count(&following.counts().published));
    for n in 1..=3 {
        following.put("front", encoded(&frame("front", 1 + n))).await;
        following.until(|counts| count(&counts.published) >= published + n).await;
    }
    following.settled().await;
    assert_eq!(count(&following.counts().received), received + 3);
    following.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_camera_whose_clock_was_ahead_is_heard_again() {
    let following = Following::start(&["front"], &["front"]).await;
    let published = following.counts().published.load(Ordering::SeqCst);
    for (n, stamp_ns) in [(1, 3_600_000_000_000), (2, 50), (3, 60)] {
        following.put("front", encoded(&frame("front", stamp_ns))).await;
        following.until(|counts| counts.published.load(Ordering::SeqCst) == published + n).await;
        assert_eq!(following.newest("front"), Some(stamp_ns));
    }
    assert_eq!(following.counts().late.load(Ordering::SeqCst), 0);
    following.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn while_nobody_asks_few_frames_become_scenes_and_who_asks_gets_that_of_the_newest() {
    let idle = PerceptionConfig { idle_period_ms: 3_600_000, asked_for_ms: 200, ..config() };
    let mut following = Following::start_as(idle, &["front"], &[]).await;
    assert_eq!(following.worker.latest("nobody").await.unwrap_err().code, ErrorCode::NotFound);
    // The subscription may still be on its way.
    let mut last_put = Instant::now();
    while following.counts().received.load(Ordering::SeqCst) == 0 {
        last_put = Instant::now();
        following.put("front", encoded(&frame("front", 1))).await;
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    following.until(|counts| counts.published.load(Ordering::SeqCst) == 1).await;
    // A machine that is held up for a second makes a pause of it, after which a frame becomes a scene: then once more.
    let mut newest_ns = 1;
    let is_unasked = loop {
        let began = last_put;
        let (received, published) =
            (following.counts().received.load(Ordering::SeqCst), following.counts().published.load(Ordering::SeqCst));
        for n in 1..=5 {
            newest_ns += 1;
            following.put("front", encoded(&frame("front", newest_ns))).await;
            following.until(|counts| counts.received.load(Ordering::SeqCst) == received + n).await;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
        let is_unasked = following.counts().published.load(Ordering::SeqCst) == published;
        if began.elapsed() < Duration::from_millis(900) {
            break is_unasked;
        }
        following.settled().await;
        let published = following.counts().published.load(Ordering::SeqCst);
        newest_ns += 1;
        last_put = Instant::now();
        following.put("front", encoded(&frame("front", newest_ns))).await;
        following.until(|counts| counts.published.load(Ordering::SeqCst) == published + 1).await;
    };
    assert!(is_unasked, "nobody asks");
    assert_eq!(following.worker.latest("front").await.unwrap().stamp_ns, newest_ns);
    assert!(following.counts().unasked.load(Ordering::SeqCst) >= 4, "{:?}", following.counts());
    following.put("front", encoded(&frame("front", newest_ns + 1))).await;
    loop {
        let sample = tokio::time::timeout(Duration::from_secs(20), following.scenes.recv()).await.unwrap().unwrap();
        if sample.payload.decode_json::<SceneSummary>().unwrap().stamp_ns == newest_ns + 1 {
            break;
        }
    }
    following.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_last_frame_of_a_stream_and_one_after_a_pause_become_scenes_though_nobody_asks() {
    let idle = PerceptionConfig { idle_period_ms: 3_600_000, asked_for_ms: 1, ..config() };
    let following = Following::start_as(idle, &["front"], &["front"]).await;
    for stamp_ns in 2..=4 {
        following.put("front", encoded(&frame("front", stamp_ns))).await;
    }
    // The last of a stream.
    following.until(|_| following.newest("front") == Some(4)).await;
    tokio::time::sleep(Duration::from_millis(1100)).await;
    // After a pause, with another that follows it soon.
    let unasked = following.counts().unasked.load(Ordering::SeqCst);
    following.put("front", encoded(&frame("front", 5))).await;
    following.until(|_| following.newest("front") == Some(5)).await;
    assert_eq!(following.counts().unasked.load(Ordering::SeqCst), unasked);
    let told = following.worker.cameras();
    assert!(told.len() == 1 && told[0].camera == "front" && told[0].newest.is_some(), "{told:?}");
    following.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn robots_are_listened_to_only_while_their_states_are_needed() {
    let idle = PerceptionConfig { idle_period_ms: 3_600_000, asked_for_ms: 300, robots_wait_ms: 1, ..config() };
    let following = Following::start_as(idle, &["front"], &["front"]).await;
    let until = async |follows: bool| {
        let mut stamp_ns = 100;
        while following.worker.follows_robots() != follows {
            stamp_ns += 1;
            following.put("front", encoded(&frame("front", stamp_ns))).await;
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
    };
    let within = Duration::from_secs(20);
    tokio::time::timeout(within, until(false)).await.expect("nobody asks");
    following.worker.latest("front").await.expect("a scene");
    tokio::time::timeout(within, until(true)).await.expect("somebody asks");
    tokio::time::timeout(within, until(false)).await.expect("nobody asks any more");
    following.stop().await;
}

#[tokio::test]
async fn a_cameras_newest_scene_can_be_asked_for_whatever_another_camera_shows_since() {
    let worker = Worker::start(&PerceptionConfig { scenes_kept: 4, unasked_kept_ms: 0, ..config() }).unwrap();
    let keep = |camera: &str, stamp_ns: u64| {
        let summary = SceneSummary {
            scene_id: format!("{camera} {stamp_ns}"),
            camera: camera.to_owned(),
            stamp_ns,
            objects: Vec::new(),
            surfaces: Vec::new(),
            left_out: Vec::new(),
            warnings: Vec::new(),
        };
        let payload = Payload { encoding: String::new(), bytes: vec![0; 8].into() };
        let scene = Arc::new(KeptScene { summary, payload });
        let mut newest = worker.newest();
        newest.take(&scene);
        worker.keep_streamed(scene, &newest);
    };
    keep("picture", 1);
    for stamp_ns in 1..=20 {
        keep("stream", stamp_ns);
        // Those that are asked for fill what room there is.
        worker.scene(&format!("stream {stamp_ns}")).expect("the newest");
    }
    assert_eq!(worker.latest("picture").await.unwrap().scene_id, "picture 1");
    assert!(worker.scene("picture 1").is_ok() && worker.scene("stream 1").is_err());
}

#[tokio::test(flavor = "multi_thread")]
async fn with_several_threads_a_cameras_scenes_are_published_in_the_order_of_its_frames() {
    let threads = PerceptionConfig { threads: 3, ..config() };
    let mut following = Following::start_as(threads, &["front"], &["front"]).await;
    // Large frames take longer than small ones: with nothing to hold them back, a small one would overtake.
    let received = following.counts().received.load(Ordering::SeqCst);
    for stamp_ns in 2..=60 {
        following.put("front", encoded(&frame_of("front", stamp_ns, if stamp_ns % 2 == 0 { 4 } else { 1 }))).await;
        following.until(|counts| counts.received.load(Ordering::SeqCst) == received + stamp_ns - 1).await;
    }
    let mut stamps = Vec::new();
    while stamps.last() != Some(&60) {
        let sample = tokio::time::timeout(Duration::from_secs(20), following.scenes.recv()).await.unwrap().unwrap();
        stamps.push(sample.payload.decode_json::<SceneSummary>().unwrap().stamp_ns);
    }
    following.settled().await;
    assert!(stamps.is_sorted(), "{stamps:?}");
    assert_eq!((following.newest("front"), following.counts().late.load(Ordering::SeqCst)), (Some(60), 0));
    following.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_frame_that_cannot_be_used_is_counted_and_the_next_one_is_not_held_up() {
    let mut following = Following::start(&["front", "side"], &["front", "side"]).await;
    following.put("side", Payload { encoding: "nonsense".to_owned(), bytes: vec![1, 2, 3].into() }).await;
    following.until(|counts| counts.failed.load(Ordering::SeqCst) == 1).await;
    // A frame on another camera's key.
    following.put("side", encoded(&frame("front", 7))).await;
    following.until(|counts| counts.failed.load(Ordering::SeqCst) == 2).await;
    following.put("front", encoded(&frame("front", 9))).await;
    let summary: SceneSummary = loop {
        let sample = tokio::time::timeout(Duration::from_secs(20), following.scenes.recv()).await.unwrap().unwrap();
        let summary: SceneSummary = sample.payload.decode_json().unwrap();
        if summary.stamp_ns == 9 {
            break summary;
        }
    };
    assert_eq!(summary.camera, "front");
    assert_eq!(following.newest("side"), Some(1));
    following.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn robots_that_are_waited_for_longer_than_a_frame_may_take_cost_no_frame() {
    let patient = PerceptionConfig { robots_wait_ms: 3_600_000, frame_timeout_ms: 4000, ..config() };
    let following = Following::start_as(patient, &["front"], &[]).await;
    // The subscription may still be on its way.
    while following.counts().received.load(Ordering::SeqCst) == 0 {
        following.put("front", encoded(&frame("front", 1))).await;
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    following.until(|_| following.newest("front").is_some()).await;
    following.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_first_frame_waits_for_the_robots_and_a_silent_robot_stays_where_it_stood() {
    let patient = PerceptionConfig { robots_wait_ms: 10_000, ..config() };
    let mut following = Following::start_as(patient, &["front"], &[]).await;
    let state: RobotState = serde_json::from_value(serde_json::json!({
        "v": 1, "seq": 1, "stamp_ns": 2_000_000_000_u64, "robot_ms": 0.0, "q_rad": [0.0, 0.0, 0.0, -2.0, 0.0, 2.0, 0.0], "dq_rad_s": [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        "gripper_width_m": 0.04, "gripper_settled": true, "gripper_holding": false, "mode": "idle", "stop": null, "owner": null,
        "last_command": null, "stream_ms": null, "world_from_base": RigidTransform::IDENTITY,
    }))
    .unwrap();
    // The subscription may still be on its way.
    while following.counts().received.load(Ordering::SeqCst) == 0 {
        following.put("front", encoded(&frame("front", 2_050_000_000))).await;
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    assert_eq!(following.counts().published.load(Ordering::SeqCst), 0, "nothing is known of robots yet");
    let key = following.session.cell().robot_state("left");
    following.session.put(&key, Payload::json(&state).unwrap(), Traffic::RobotState).await.unwrap();
    let mut next = async || -> SceneSummary {
        let sample = tokio::time::timeout(Duration::from_secs(9), following.scenes.recv()).await.unwrap().unwrap();
        sample.payload.decode_json().unwrap()
    };
    let of_robots = |summary: &SceneSummary| summary.warnings.iter().filter(|warning| warning.field == "robots").count();
    assert_eq!(of_robots(&next().await), 0);
    following
        .session
        .put(&following.session.cell().camera_frame("front"), encoded(&frame("front", 9_000_000_000)), Traffic::Frame)
        .await
        .unwrap();
    let later = loop {
        let summary = next().await;
        if summary.stamp_ns == 9_000_000_000 {
            break summary;
        }
    };
    assert_eq!(of_robots(&later), 1, "{:?}", later.warnings);

    // A page that holds this picture has it looked at again long after.
    let again = async |stamp_ns: u64| {
        let context = JobContext::new(Instant::now() + Duration::from_secs(9), CancellationToken::new());
        following.worker.segment(context, encoded(&frame("front", stamp_ns)), FrameOrigin::Caller).await.unwrap().0
    };
    let held = again(9_000_000_000).await;
    assert_eq!((&held.summary.scene_id, &held.summary.warnings), (&later.scene_id, &later.warnings), "with the robot where it was");
    assert_eq!(of_robots(&again(99_000_000_000).await.summary), 1, "nobody knows where it was then");
    following.stop().await;
}
