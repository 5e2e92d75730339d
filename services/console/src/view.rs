//! A scene as viewers get it: its picture, which object each pixel shows, and a cloud thin enough to draw.

use std::sync::Arc;

use bytes::Bytes;
use repose_pictures::labels::label_image;
use repose_proto::{Bulk, CallError, Payload, Scene, Tensor};
use serde::Serialize;

/// A scene as it is sent to viewers.
pub struct SceneView {
    /// The cell that it is of.
    pub cell: String,
    /// The scene's id.
    pub scene_id: String,
    /// The scene.
    pub scene: Arc<Scene>,
    /// The frame that it was made of, where it is at hand.
    pub frame: Option<Payload>,
    /// What viewers are sent: the bulk form.
    pub bytes: Bytes,
}

/// A camera picture as JPEG, with its time stamp.
#[derive(Debug, Clone)]
pub struct CameraPicture {
    /// Nanoseconds since the Unix epoch.
    pub stamp_ns: u64,
    /// JPEG.
    pub jpeg: Arc<[u8]>,
    /// The frame itself.
    pub frame: Payload,
}

/// Why a scene is sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ViewReason {
    /// It is a camera's newest.
    Live,
    /// A viewer has asked for an object in it.
    Segmented,
}

/// What is said of a cloud beside its tensors: a point is `low_m + step_m * (x, y, z)`, world frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
struct Grid {
    low_m: [f32; 3],
    step_m: f32,
}

impl SceneView {
    /// Encodes a scene for viewers; of its points at most `cloud_points`.
    ///
    /// # Errors
    /// `invalid_argument` when the scene's camera has no pose.
    pub fn new(
        kind: ViewReason,
        cell: String,
        scene_id: String,
        scene: Arc<Scene>,
        picture: Option<&CameraPicture>,
        cloud_points: usize,
    ) -> Result<Self, CallError> {
        let labels = runs(&label_image(&scene)?);
        let shown: Vec<usize> = thinned(scene.points.len(), cloud_points).collect();
        let (grid, points) = quantised(&scene.points, &shown);
        let mut bulk = Bulk::default();
        let mut meta = scene.meta.clone();
        // Tens of kilobytes that no viewer draws.
        meta.unseen.space = None;
        for (name, text) in [
            ("kind", (if kind == ViewReason::Live { "scene" } else { "segmented" }).to_owned()),
            ("scene_id", scene_id.clone()),
            ("camera", scene.camera_name.clone()),
            ("stamp_ns", scene.stamp_ns.to_string()),
            ("scene", json(&meta)),
            ("grid", json(&grid)),
        ] {
            bulk.metadata.insert(name.to_owned(), text);
        }
        let n = shown.len();
        bulk.tensors.insert("label_runs".to_owned(), Tensor::u16(&[labels.len(), 2], labels.as_flattened()));
        bulk.tensors.insert("points".to_owned(), Tensor::u16(&[n, 3], points.as_flattened()));
        bulk.tensors.insert("point_labels".to_owned(), Tensor::u16(&[n], &pick(&scene.labels, &shown)));
        if let Some(colors) = &scene.colors {
            bulk.tensors.insert("colors".to_owned(), Tensor::u8(&[n, 3], pick(colors, &shown).as_flattened()));
        }
        if let Some(picture) = picture {
            bulk.tensors.insert("jpeg".to_owned(), Tensor::u8(&[picture.jpeg.len()], &picture.jpeg));
        }
        let frame = picture.map(|picture| picture.frame.clone());
        Ok(Self { cell, scene_id, scene, frame, bytes: bulk.encode().into() })
    }
}

/// A live picture as viewers get it.
pub fn picture_bytes(camera: &str, picture: &CameraPicture) -> Bytes {
    let mut bulk = Bulk::default();
    for (name, text) in [("kind", "picture"), ("camera", camera), ("stamp_ns", &picture.stamp_ns.to_string())] {
        bulk.metadata.insert(name.to_owned(), text.to_owned());
    }
    bulk.tensors.insert("jpeg".to_owned(), Tensor::u8(&[picture.jpeg.len()], &picture.jpeg));
    bulk.encode().into()
}

/// A label image as runs, row by row: `[label, length]`; runs cross rows.
fn runs(labels: &[u16]) -> Vec<[u16; 2]> {
    let mut runs: Vec<[u16; 2]> = Vec::new();
    for label in labels {
        match runs.last_mut() {
            Some([same, length]) if same == label && *length < u16::MAX => *length += 1,
            _ => runs.push([*label, 1]),
        }
    }
    runs
}

fn json<T: Serialize>(value: &T) -> String {
    serde_json::to_string(value).unwrap_or_default()
}

fn pick<T: Copy>(values: &[T], indices: &[usize]) -> Vec<T> {
    indices.iter().map(|i| values[*i]).collect()
}

/// At most `most` of `n` indices, spread evenly but in no regular pattern: each is moved within its share by multiples of the golden ratio.
fn thinned(n: usize, most: usize) -> impl Iterator<Item = usize> {
    let share = (n as f64 / most as f64).max(1.0);
    let count = n.min(most);
    (0..count).map(move |k| {
        let within = (k as f64 * 0.618_033_988_749_895).fract();
        (((k as f64 + within * (1.0 - 1.0 / share)) * share) as usize).min(n - 1)
    })
}

/// The points on the finest cubic grid over them that 16 bits span.
fn quantised(points: &[[f32; 3]], shown: &[usize]) -> (Grid, Vec<[u16; 3]>) {
    let start = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    let (low_m, high_m) = shown
        .iter()
        .map(|i| points[*i])
        .fold(start, |(low, high), p| (std::array::from_fn(|k| low[k].min(p[k])), std::array::from_fn(|k| high[k].max(p[k]))));
    if shown.is_empty() {
        return (Grid { low_m: [0.0; 3], step_m: 1.0 }, Vec::new());
    }
    let span_m = (0..3).map(|k| high_m[k] - low_m[k]).fold(f32::MIN_POSITIVE, f32::max);
    let step_m = span_m / f32::from(u16::MAX);
    let cell = |p: [f32; 3]| std::array::from_fn(|k| ((p[k] - low_m[k]) / step_m).round() as u16);
    (Grid { low_m, step_m }, shown.iter().map(|i| cell(points[*i])).collect())
}

#[cfg(test)]
mod tests {
    use repose_made_scenes::seen_from_above;
    use repose_proto::SceneMeta;

    use super::*;

    #[test]
    fn a_viewer_can_read_back_what_was_seen() {
        let points: Vec<([f32; 3], u16)> = (0..100).map(|i| ([i as f32 * 0.01, 0.5 - i as f32 * 0.003, 0.0], (i % 4) as u16)).collect();
        let scene = Arc::new(Scene { stamp_ns: 7, ..seen_from_above(&points) });
        let frame = Payload { encoding: String::new(), bytes: Bytes::new() };
        let picture = CameraPicture { stamp_ns: 7, jpeg: vec![1, 2, 3].into(), frame };
        let view = SceneView::new(ViewReason::Live, "lab".to_owned(), "ab".to_owned(), scene, Some(&picture), 1000).expect("a view");
        let bulk = Bulk::decode(&view.bytes).expect("bulk");
        assert_eq!((bulk.text("kind"), bulk.text("scene_id")), (Ok("scene"), Ok("ab")));
        let meta: SceneMeta = serde_json::from_str(bulk.text("scene").expect("metadata")).expect("readable");
        assert_eq!(meta.objects.len(), 3);
        let grid: serde_json::Value = serde_json::from_str(bulk.text("grid").expect("grid")).expect("readable");
        let (step, low_x) = (grid["step_m"].as_f64().expect("a step"), grid["low_m"][0].as_f64().expect("a corner"));
        let (_, cells) = bulk.values::<u16>("points", safetensors_u16(), "[n, 3]", |s| s.len() == 2).expect("points");
        for (k, (point, _)) in points.iter().enumerate() {
            let x = low_x + step * f64::from(cells[3 * k]);
            assert!((x - f64::from(point[0])).abs() < 1e-4, "point {k}: {x} for {}", point[0]);
        }
        assert_eq!(bulk.tensors["jpeg"].bytes, [1, 2, 3]);
        assert_eq!(bulk.tensors["colors"].shape, [100, 3]);
    }

    fn safetensors_u16() -> safetensors::Dtype {
        safetensors::Dtype::U16
    }

    #[test]
    fn runs_give_the_image_back() {
        let labels: Vec<u16> = (0..70_000).map(|i| if i < 66_000 { 3 } else { (i % 2) as u16 }).collect();
        let back: Vec<u16> = runs(&labels).iter().flat_map(|[label, n]| std::iter::repeat_n(*label, usize::from(*n))).collect();
        assert_eq!(back, labels);
    }

    #[test]
    fn thinning_keeps_the_bound_and_every_part_of_the_cloud() {
        for (n, most) in [(5, 10), (1000, 1000), (307_200, 60_000), (60_001, 60_000), (0, 10)] {
            let shown: Vec<usize> = thinned(n, most).collect();
            assert_eq!(shown.len(), n.min(most));
            assert!(shown.windows(2).all(|w| w[0] < w[1]) && shown.last().is_none_or(|last| *last < n), "{n} {most}");
            let widest = shown.windows(2).map(|w| w[1] - w[0]).max().unwrap_or(0);
            assert!(widest as f64 <= 2.0 * (n as f64 / most as f64).max(1.0), "a gap of {widest} among {n}");
        }
    }
}
