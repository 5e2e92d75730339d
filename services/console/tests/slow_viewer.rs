//! A viewer over a slow link: a scene comes whole, and a robot's state soon, whatever else is on its way.

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use futures::FutureExt;
use repose_console::viewers::{Outbox, Outgoing, Topic, ViewerMessage};
use repose_proto::{Bulk, Tensor};
use tokio::time::{Instant, advance};

/// How often it is looked at what has come, and every how many looks the robot tells its state.
const LOOK: Duration = Duration::from_millis(10);
const LOOKS_A_STATE: u32 = 5;

/// A viewer of a paced outbox, and the link to it, in the test's own time.
struct Viewer {
    outbox: Outbox,
    bytes_per_s: f64,
    /// What is on its way, and when it comes.
    link: VecDeque<(Instant, Outgoing)>,
    is_free_at: Instant,
    begun: BTreeMap<String, Vec<u8>>,
    texts: Vec<String>,
    bulks: Vec<Vec<u8>>,
}

impl Viewer {
    fn new(bytes_per_s: f64) -> Self {
        let outbox = Outbox::paced();
        let (link, begun) = (VecDeque::new(), BTreeMap::new());
        Self { outbox, bytes_per_s, link, is_free_at: Instant::now(), begun, texts: Vec::new(), bulks: Vec::new() }
    }

    /// Hands to the link what the outbox gives, and takes what has come.
    fn look(&mut self) {
        let now = Instant::now();
        while let Some(Some(outgoing)) = self.outbox.next().now_or_never() {
            let bytes = match &outgoing {
                Outgoing::Whole(ViewerMessage::Text(text)) => text.len(),
                Outgoing::Whole(ViewerMessage::Binary(bytes)) | Outgoing::Part { bytes, .. } => bytes.len(),
                Outgoing::Whole(ViewerMessage::View(_)) => panic!("no scene of a camera was put"),
            };
            self.is_free_at = self.is_free_at.max(now) + Duration::from_secs_f64(bytes as f64 / self.bytes_per_s);
            self.link.push_back((self.is_free_at, outgoing));
        }
        while self.link.front().is_some_and(|(comes, _)| *comes <= now) {
            let Some((_, outgoing)) = self.link.pop_front() else { break };
            self.outbox.received();
            match outgoing {
                Outgoing::Whole(ViewerMessage::Text(text)) => self.texts.push(text.to_string()),
                Outgoing::Whole(ViewerMessage::Binary(bytes)) => self.bulks.push(bytes.to_vec()),
                Outgoing::Whole(ViewerMessage::View(_)) => {}
                Outgoing::Part { bytes, .. } => self.join(&Bulk::decode(&bytes).expect("bulk")),
            }
        }
    }

    fn join(&mut self, part: &Bulk) {
        let said = |name: &str| part.text(name).expect("said").to_owned();
        let (of, offset, total_bytes) = (said("of"), said("offset"), said("total_bytes"));
        let begun = self.begun.entry(of.clone()).or_default();
        if offset == "0" {
            begun.clear();
        }
        assert_eq!(begun.len().to_string(), offset, "parts come in their order");
        begun.extend_from_slice(&part.tensors["bytes"].bytes);
        if begun.len().to_string() == total_bytes {
            self.bulks.extend(self.begun.remove(&of));
        }
    }
}

fn scene(seed: u8) -> Vec<u8> {
    let mut bulk = Bulk::default();
    bulk.metadata.insert("kind".to_owned(), "scene".to_owned());
    bulk.tensors.insert("points".to_owned(), Tensor::u8(&[1_000_000], &vec![seed; 1_000_000]));
    bulk.encode()
}

#[tokio::test(start_paused = true)]
async fn a_robots_states_come_soon_while_scenes_come_over_a_slow_link() {
    // 0.3, 1 and 10 Mbit/s.
    for bytes_per_s in [37_500.0, 125_000.0, 1_250_000.0] {
        let (mut viewer, began) = (Viewer::new(bytes_per_s), Instant::now());
        let (mut told, mut oldest, mut looks) = (0, Duration::ZERO, 0);
        viewer.outbox.put(Topic::Scene, ViewerMessage::Binary(scene(1).into()));
        while viewer.bulks.is_empty() {
            if looks % LOOKS_A_STATE == 0 {
                // As long as one is.
                let state = format!("{:>2000}", began.elapsed().as_millis());
                viewer.outbox.put(Topic::Robot("panda".into()), ViewerMessage::Text(state.into()));
            }
            viewer.look();
            for state in viewer.texts.drain(..) {
                let at: u64 = state.trim().parse().expect("an instant");
                oldest = oldest.max(began.elapsed() - Duration::from_millis(at));
                told += 1;
            }
            advance(LOOK).await;
            looks += 1;
            assert!(looks < 10_000, "the scene does not come");
        }
        assert!(viewer.bulks[0] == scene(1), "the scene is whole");
        // The page calls a robot silent after three seconds.
        assert!(oldest < Duration::from_millis(1500) && told > 5, "{bytes_per_s} bytes a second: {oldest:?}, {told} states");
    }
}

#[tokio::test(start_paused = true)]
async fn what_was_begun_of_a_cell_is_given_up_with_it_and_the_next_cells_scene_comes() {
    let mut viewer = Viewer::new(100_000.0);
    viewer.outbox.put(Topic::Scene, ViewerMessage::Binary(scene(1).into()));
    viewer.outbox.put(Topic::Answer(1), ViewerMessage::Text("an answer".repeat(20_000).into()));
    for _ in 0..50 {
        viewer.look();
        advance(LOOK).await;
    }
    assert!(viewer.begun.contains_key("scene") && viewer.begun.contains_key("answer 1"));
    viewer.outbox.forget(Topic::is_of_cell);
    viewer.outbox.put(Topic::Scene, ViewerMessage::Binary(scene(2).into()));
    for _ in 0..3000 {
        viewer.look();
        advance(LOOK).await;
    }
    assert_eq!(viewer.bulks.len(), 2, "the answer and one scene");
    assert!(viewer.bulks[0] == "an answer".repeat(20_000).into_bytes() && viewer.bulks[1] == scene(2));
    // The next one waits for the word that this one was seen, as it does where nothing comes in parts.
    viewer.outbox.put(Topic::Scene, ViewerMessage::Binary(scene(3).into()));
    viewer.look();
    assert!(viewer.link.is_empty());
    viewer.outbox.seen(&Topic::Scene);
    viewer.look();
    assert!(!viewer.link.is_empty());
}
