//! Pictures to look at: frames, scenes with numbered objects, places where an object can go. For the live page, recordings, commands, agents.
//!
//! [`scene`] draws a scene as its camera saw it; [`labels`] tells which object each pixel shows; [`drawing`] has text and numbers, [`colors`]
//! what stands for an object; [`encoded`] makes JPEG of it. Pure: no I/O, no async, no global state.

pub mod colors;
pub mod drawing;
pub mod encoded;
pub mod labels;
pub mod projection;
pub mod scene;

pub use encoded::{jpeg, jpeg_of};

/// Red, green, blue.
pub type Rgb = [u8; 3];

#[cfg(test)]
mod tests {
    use repose_proto::scene::WorldFrame;
    use repose_proto::{CameraModel, ObjectSummary, RigidTransform, Scene, Unseen};

    /// A scene of points with labels, seen straight down from a metre above the origin; every pixel of the 9 x 9 picture is 0.1 m of the floor.
    pub(crate) fn scene_of(points: &[([f32; 3], u16)]) -> Scene {
        let down = RigidTransform([1., 0., 0., 0., 0., -1., 0., 0., 0., 0., -1., 1., 0., 0., 0., 1.]);
        let camera =
            CameraModel { width: 9, height: 9, fx: 10.0, fy: 10.0, cx: 4.0, cy: 4.0, depth_unit_m: 1e-3, world_from_camera: Some(down) };
        let mut ids: Vec<u16> = points.iter().map(|p| p.1).filter(|id| *id > 0).collect();
        ids.sort_unstable();
        ids.dedup();
        let summary = |id: &u16| {
            let own: Vec<[f32; 3]> = points.iter().filter(|p| p.1 == *id).map(|p| p.0).collect();
            let centroid_m = std::array::from_fn(|k| own.iter().map(|p| f64::from(p[k])).sum::<f64>() / own.len() as f64);
            ObjectSummary { id: *id, points: own.len(), centroid_m, extent_m: [0.1; 3], completeness: 1.0, score: None }
        };
        let meta = serde_json::from_value(serde_json::json!({
            "objects": ids.iter().map(summary).collect::<Vec<_>>(), "surfaces": [], "camera": camera,
            "world_frame": WorldFrame::Extrinsics, "view_yaw_rad": 0.0, "unseen": Unseen::default()
        }))
        .expect("metadata");
        Scene {
            camera_name: "front".to_owned(),
            stamp_ns: 1,
            points: points.iter().map(|p| p.0).collect(),
            labels: points.iter().map(|p| p.1).collect(),
            colors: Some(points.iter().map(|p| [p.1 as u8; 3]).collect()),
            meta,
        }
    }
}
