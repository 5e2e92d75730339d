//! Scenes by id: the one bounded store that every worker keeps them in, and how a request that names a scene is sent.
//!
//! A request names its scene by id. A worker that does not hold it answers `not_found` on `scene_id`, and the caller sends the request again
//! with the scene enclosed: [`Caller::call_with_scene`] does both within one deadline.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use futures::StreamExt;
use futures::stream::FuturesOrdered;
use lru::LruCache;
use repose_proto::motion::{MotionPlan, MotionPlanRequest};
use repose_proto::perception::{ByteRange, LatestRequest, ScenePart, SceneRequest};
use repose_proto::{CallError, ErrorCode, Payload, PlaceRequest, PlaceResult, Scene, SceneSummary};
use tokio::time::Instant;

use crate::{Answer, CallOptions, Caller};

/// Scenes, in whatever form `T` a worker wants them, by id; bounded in number and in bytes, the least recently used goes first.
#[derive(Debug)]
pub struct SceneStore<T> {
    held: Mutex<Held<T>>,
    max_scenes: usize,
    max_bytes: usize,
    weigh: fn(&T) -> usize,
    /// Whether the metric of how many scenes the worker holds counts this store.
    is_counted: bool,
}

#[derive(Debug)]
struct Held<T> {
    /// Bounded by [`SceneStore::keep_over`], in number and in bytes.
    scenes: LruCache<String, Arc<T>>,
    bytes: usize,
}

impl<T> SceneStore<T> {
    /// An empty store for at most `max_scenes` scenes of at most `max_bytes` together, as `weigh` counts them. The newest scene is always
    /// kept, whatever its size.
    pub fn new(max_scenes: usize, max_bytes: usize, weigh: fn(&T) -> usize) -> Self {
        let held = Mutex::new(Held { scenes: LruCache::unbounded(), bytes: 0 });
        Self { held, max_scenes: max_scenes.max(1), max_bytes, weigh, is_counted: true }
    }

    /// The same for the scenes of the worker's main store in another form: they do not count in the metric of how many scenes it holds.
    pub fn beside_another(max_scenes: usize, max_bytes: usize, weigh: fn(&T) -> usize) -> Self {
        Self { is_counted: false, ..Self::new(max_scenes, max_bytes, weigh) }
    }

    /// The scene of that id.
    ///
    /// # Errors
    /// `not_found` on `scene_id`: the caller may send it whole.
    pub fn get(&self, scene_id: &str) -> Result<Arc<T>, CallError> {
        let missing = || CallError::not_found("scene_id", format!("this worker does not hold scene {scene_id}"));
        self.held().scenes.get(scene_id).cloned().ok_or_else(missing)
    }

    /// Keeps a scene and returns what is now held under its id: the one that was there already, if one was.
    pub fn keep(&self, scene_id: &str, scene: Arc<T>) -> Arc<T> {
        self.keep_over(scene_id, scene, |_| false)
    }

    /// The same, but the new scene takes the place of one that is held already where `replaces` says so of that.
    pub fn keep_over(&self, scene_id: &str, scene: Arc<T>, replaces: impl FnOnce(&T) -> bool) -> Arc<T> {
        let mut held = self.held();
        match held.scenes.get(scene_id).cloned() {
            Some(first) if !replaces(&first) => return first,
            Some(first) => held.bytes -= (self.weigh)(&first),
            None => {}
        }
        held.bytes += (self.weigh)(&scene);
        held.scenes.put(scene_id.to_owned(), scene.clone());
        while held.scenes.len() > 1 && (held.scenes.len() > self.max_scenes || held.bytes > self.max_bytes) {
            let Some((_, gone)) = held.scenes.pop_lru() else { break };
            held.bytes -= (self.weigh)(&gone);
        }
        self.count(&held);
        scene
    }

    /// Lets a scene go, if it is held.
    pub fn let_go(&self, scene_id: &str) {
        let mut held = self.held();
        if let Some(gone) = held.scenes.pop(scene_id) {
            held.bytes -= (self.weigh)(&gone);
        }
        self.count(&held);
    }

    /// Keeps a scene that a request enclosed, in the form that `form` gives it. Hashes the scene: not for async code.
    ///
    /// # Errors
    /// `invalid_argument` on `scene.scene_id` when its content has another id than the request says.
    pub fn admit(&self, scene_id: &str, scene: Scene, form: impl FnOnce(Scene) -> T) -> Result<Arc<T>, CallError> {
        check_scene_id(&scene, scene_id)?;
        Ok(self.keep(scene_id, Arc::new(form(scene))))
    }

    /// How many scenes are held, and their bytes.
    pub fn size(&self) -> (usize, usize) {
        let held = self.held();
        (held.scenes.len(), held.bytes)
    }

    fn count(&self, held: &Held<T>) {
        if self.is_counted {
            metrics::gauge!("repose_scenes_held").set(held.scenes.len() as f64);
        }
    }

    fn held(&self) -> MutexGuard<'_, Held<T>> {
        // Every change leaves the store whole, so a panic elsewhere under the lock does not spoil it.
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Refuses a scene whose content has another id than a request says. Hashes the scene, which takes milliseconds: not for async code.
///
/// # Errors
/// `invalid_argument` on `scene.scene_id`.
pub fn check_scene_id(scene: &Scene, scene_id: &str) -> Result<(), CallError> {
    if scene.goes_by(scene_id) {
        return Ok(());
    }
    Err(CallError::invalid("scene.scene_id", format!("the enclosed scene's id is {}, not {scene_id}", scene.id())))
}

/// How long perception may take to send a whole scene: a link of 1.3 Mbit/s, and a fifth of that where scenes come packed.
pub const SCENE_WITHIN: Duration = Duration::from_secs(30);

/// The newest scene of a camera, in short, from the perception worker that owns it.
///
/// # Errors
/// `not_found` on `camera` when it has no scene yet; those of [`Caller::call_any`].
pub async fn fetch_newest(perception: &Caller, camera: &str, options: &CallOptions) -> Result<SceneSummary, CallError> {
    let request = Payload::json(&LatestRequest { camera: camera.to_owned() })?;
    perception.call_any("latest", &request, options).await?.payload.decode_json()
}

/// When perception last saw a scene to be so, nanoseconds since the Unix epoch, without the scene itself; none where its worker does not say.
///
/// # Errors
/// `not_found` when no worker has the scene; those of [`Caller::call_any`].
pub async fn fetch_stamp(perception: &Caller, scene_id: &str, options: &CallOptions) -> Result<Option<u64>, CallError> {
    let part = ByteRange { offset: 0, length: 1 };
    let request = Payload::json(&SceneRequest { part: Some(part), ..SceneRequest::new(scene_id) })?;
    let answer = perception.call_any("scene", &request, options).await?;
    Ok(ScenePart::from_payload(&answer.payload)?.stamp_ns)
}

/// A scene, whole, from whichever perception worker has it.
///
/// # Errors
/// Those of [`fetch_scene_payload`].
pub async fn fetch_scene(perception: &Caller, scene_id: &str, options: &CallOptions) -> Result<Scene, CallError> {
    let request = SceneRequest { packed: perception.packs_scenes(), ..SceneRequest::new(scene_id) };
    let Fetched { payload, stamp_ns } = fetch(perception, &request, options).await?;
    let is_packed = payload.is_packed();
    let read = move || {
        let scene = Scene::from_bulk(&payload.decode_bulk(Scene::SCHEMA)?)?;
        Ok::<_, CallError>(Scene { stamp_ns: stamp_ns.unwrap_or(scene.stamp_ns), ..scene })
    };
    match is_packed {
        // Unpacking takes tens of milliseconds.
        true => tokio::task::spawn_blocking(read).await.map_err(|e| CallError::internal(format!("a scene was lost: {e}")))?,
        false => read(),
    }
}

/// A scene as it was sent; its stamp in packed form may be that of when its content was seen first. It comes in parts, several of them under way at
/// once: a message that takes seconds keeps others from a slow link, and one that takes more than five ends the link, with everything that goes by it.
///
/// # Errors
/// `not_found` when no worker has the scene; those of [`Caller::call_any`].
pub async fn fetch_scene_payload(perception: &Caller, request: &SceneRequest, options: &CallOptions) -> Result<Payload, CallError> {
    Ok(fetch(perception, request, options).await?.payload)
}

/// A scene's payload that came.
struct Fetched {
    payload: Payload,
    /// When its content was last seen, where the stamp in the payload may be an earlier one.
    stamp_ns: Option<u64>,
}

async fn fetch(perception: &Caller, request: &SceneRequest, options: &CallOptions) -> Result<Fetched, CallError> {
    let deadline = Instant::now() + options.deadline;
    let fetched = fetch_parts(perception, request, options, deadline).await;
    if !fetched.as_ref().is_err_and(|error| error.code == ErrorCode::InvalidArgument) {
        return fetched;
    }
    // Workers of release 1 know scenes in plain form and whole only.
    let plain = Payload::json(&SceneRequest::new(&request.scene_id))?;
    let payload = perception.call_any("scene", &plain, &options.until(deadline)).await?.payload;
    Ok(Fetched { payload, stamp_ns: None })
}

/// Bytes of a part. A router closes a link on which one message waits for five seconds: links of half a Mbit/s bear this, as does what TCP makes of
/// 300 ms to and fro with a packet in a hundred lost.
const PART_BYTES: u32 = 256 << 10;
/// Parts that are asked for before it is known how many there are, and most that are under way at once: all of a scene that is packed, and nearly all
/// of one that is not, come within a single round trip.
const PARTS_AT_ONCE: u32 = 16;

/// A scene's payload, put together from its parts.
async fn fetch_parts(perception: &Caller, request: &SceneRequest, options: &CallOptions, deadline: Instant) -> Result<Fetched, CallError> {
    let ask = |k: u32| async move {
        let part = ByteRange { offset: k * PART_BYTES, length: PART_BYTES };
        let request = Payload::json(&SceneRequest { part: Some(part), ..request.clone() })?;
        fetch_part(perception, &request, options, deadline).await
    };
    let mut under_way: FuturesOrdered<_> = (0..PARTS_AT_ONCE).map(ask).collect();
    let mut next = PARTS_AT_ONCE;
    let mut bytes = Vec::new();
    let mut stamp_ns = None;
    while let Some(answer) = under_way.next().await {
        let payload = answer?.payload;
        if payload.schema() != ScenePart::SCHEMA {
            return Ok(Fetched { payload, stamp_ns: None });
        }
        let part = ScenePart::from_payload(&payload)?;
        if part.offset != bytes.len() || part.bytes.is_empty() {
            return Err(CallError::internal(format!(
                "a part of the scene begins at byte {}, where {} was asked for",
                part.offset,
                bytes.len()
            )));
        }
        bytes.extend_from_slice(&part.bytes);
        // That of when the scene was asked for; it may be seen again while its parts come.
        stamp_ns = stamp_ns.or(part.stamp_ns);
        if bytes.len() == part.total_bytes {
            return Ok(Fetched { payload: Payload { encoding: part.encoding, bytes: bytes.into() }, stamp_ns });
        }
        if (next as usize) * (PART_BYTES as usize) < part.total_bytes {
            under_way.push_back(ask(next));
            next += 1;
        }
    }
    Err(CallError::internal("the scene has more parts than were asked for"))
}

/// Least time after which a part that was refused is asked for again.
const ASK_AGAIN: Duration = Duration::from_millis(20);

/// One part. All who look at a cell ask for a new scene at once, each for many parts, and a worker that is full refuses some: those are asked for again
/// while the others are on their way. The wait that a worker asks for is that of segmentations, which take far longer than a part does: a long one is no
/// reason to give up. That a part is long on its way, behind others, is no reason to ask for it again.
async fn fetch_part(perception: &Caller, request: &Payload, options: &CallOptions, deadline: Instant) -> Result<Answer, CallError> {
    loop {
        let once = CallOptions { leaves_slow: false, ..options.until(deadline) };
        let full = match perception.call_any("scene", request, &once).await {
            Err(error) if error.code == ErrorCode::ResourceExhausted => error,
            ended => return ended,
        };
        let left = deadline.saturating_duration_since(Instant::now());
        let wait = Duration::from_millis(full.retry_after_ms.unwrap_or(0)).min(left / 4).max(ASK_AGAIN);
        if wait * 2 > left {
            return Err(full);
        }
        options.pause(wait).await?;
    }
}

impl Caller {
    /// Asks a planner for a placement; sends the scene whole, where it is at hand, to a worker that does not hold it.
    ///
    /// # Errors
    /// Those of [`Caller::call_with_scene`].
    pub async fn place(
        &self,
        request: &PlaceRequest,
        scene: Option<&Scene>,
        options: CallOptions,
    ) -> Result<(PlaceResult, Answer), CallError> {
        let answer = self.call_with_scene("place", scene, |scene| Payload::with_scene(request, scene), options).await?;
        Ok((answer.payload.decode_json()?, answer))
    }

    /// Asks motion for a plan, likewise. A plan can be carried out only while its scene is young, and a worker may hold the same content, under the same
    /// id, with the stamp of an older sighting: it is sent the younger one then, and plans again.
    ///
    /// # Errors
    /// Those of [`Caller::call_with_scene`].
    pub async fn plan_motion(
        &self,
        request: &MotionPlanRequest,
        scene: Option<&Scene>,
        options: CallOptions,
    ) -> Result<MotionPlan, CallError> {
        self.plan_with_scene(scene, |scene| Payload::with_scene(request, scene), options).await?.payload.decode_json()
    }

    /// The same with a request that `encode` makes, as for [`Caller::call_with_scene`]: the answer, which is a [`MotionPlan`].
    ///
    /// # Errors
    /// Those of [`Caller::call_with_scene`].
    pub async fn plan_with_scene(
        &self,
        scene: Option<&Scene>,
        encode: impl Fn(Option<&Scene>) -> Result<Payload, CallError>,
        options: CallOptions,
    ) -> Result<Answer, CallError> {
        let deadline = Instant::now() + options.deadline;
        let answer = self.call_with_scene("plan", scene, &encode, options.clone()).await?;
        // One that cannot be read is for who asked to refuse, or to hand on: it may be of a later version.
        let Ok(plan) = answer.payload.decode_json::<MotionPlan>() else { return Ok(answer) };
        // A plan that has half of its time left is young enough.
        let older_ms = |scene: &Scene| scene.stamp_ns.saturating_sub(plan.scene_stamp_ns) / 1_000_000;
        let Some(younger) = scene.filter(|&scene| older_ms(scene) > plan.max_scene_age_ms / 2) else { return Ok(answer) };
        let again = self.call("plan", encode(Some(younger))?, options.until(deadline)).await;
        // Where there is no time for another the first one stands, as old as it says.
        Ok(again.unwrap_or(answer))
    }

    /// Calls with a request that names a scene by its id. A worker that lacks the scene is sent it whole, where it is at hand, within what is
    /// left of the deadline. `encode` makes the request by id of `None`, and with the scene enclosed of `Some`; [`Payload::with_scene`] does
    /// so for any JSON request. Not for what is carried out at most once under an id of the caller's: the second request would not be the first.
    ///
    /// # Errors
    /// Those of [`Caller::call`]; `not_found` on `scene_id` when nobody holds the scene and it is not at hand.
    pub async fn call_with_scene(
        &self,
        method: &str,
        scene: Option<&Scene>,
        encode: impl Fn(Option<&Scene>) -> Result<Payload, CallError>,
        options: CallOptions,
    ) -> Result<Answer, CallError> {
        let deadline = Instant::now() + options.deadline;
        let by_id = self.call(method, encode(None)?, options.clone()).await;
        match (by_id, scene) {
            (Err(error), Some(scene)) if lacks_scene(&error) => {
                // Another request than the first, and so under another id, unless its caller chose one.
                self.call(method, encode(Some(scene))?, options.until(deadline)).await
            }
            (answered, _) => answered,
        }
    }
}

/// Whether a worker refused a request because it does not hold the request's scene.
pub fn lacks_scene(error: &CallError) -> bool {
    error.code == ErrorCode::NotFound && error.field.as_deref().is_some_and(|field| field == "scene_id" || field.ends_with(".scene_id"))
}

#[cfg(test)]
mod tests {
    use metrics_exporter_prometheus::PrometheusBuilder;

    use super::*;

    fn store(max_scenes: usize, max_bytes: usize) -> SceneStore<Vec<u8>> {
        SceneStore::new(max_scenes, max_bytes, Vec::len)
    }

    fn bytes(size: usize) -> Arc<Vec<u8>> {
        Arc::new(vec![0; size])
    }

    #[test]
    fn the_least_recently_used_scene_goes_first() {
        let store = store(2, usize::MAX);
        store.keep("a", bytes(1));
        store.keep("b", bytes(1));
        store.get("a").expect("held");
        store.keep("c", bytes(1));
        assert!(store.get("a").is_ok() && store.get("b").is_err() && store.get("c").is_ok());
    }

    #[test]
    fn bytes_are_bounded_and_the_newest_scene_is_kept_whatever_its_size() {
        let store = store(10, 100);
        store.keep("a", bytes(60));
        store.keep("b", bytes(60));
        assert!(store.get("a").is_err() && store.get("b").is_ok());
        store.keep("c", bytes(5000));
        assert_eq!(store.size(), (1, 5000));
        store.keep("d", bytes(10));
        assert_eq!(store.size(), (1, 10));
    }

    #[test]
    fn the_same_scene_counts_once_and_the_first_one_stays_unless_it_is_replaced() {
        let store = store(10, 1000);
        assert_eq!(store.keep("a", bytes(1)).len(), 1);
        assert_eq!(store.keep("a", bytes(2)).len(), 1);
        assert_eq!(store.keep_over("a", bytes(3), |held| held.len() > 1).len(), 1);
        assert_eq!(store.keep_over("a", bytes(4), |held| held.len() == 1).len(), 4);
        assert_eq!(store.size(), (1, 4));
    }

    #[test]
    fn a_store_beside_another_leaves_the_metric_to_that_one() {
        let recorder = PrometheusBuilder::new().build_recorder();
        metrics::with_local_recorder(&recorder, || {
            let held = store(4, usize::MAX);
            let packed = SceneStore::<Vec<u8>>::beside_another(4, usize::MAX, Vec::len);
            for scene_id in ["a", "b", "c"] {
                held.keep(scene_id, bytes(1));
            }
            packed.keep("a", bytes(1));
            packed.let_go("a");
        });
        let told = recorder.handle().render();
        assert!(told.contains("repose_scenes_held 3"), "{told}");
    }

    #[test]
    fn a_missing_scene_is_said_in_a_way_that_makes_the_caller_send_it() {
        let error = store(1, 1).get("a").expect_err("nothing is held");
        assert!(lacks_scene(&error));
        assert!(lacks_scene(&CallError::not_found("scene.scene_id", "")));
        assert!(!lacks_scene(&CallError::not_found("query", "")));
        assert!(!lacks_scene(&CallError::invalid("scene_id", "")));
    }
}
