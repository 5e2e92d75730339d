//! Scenes and placements as detections, poses, markers and a labelled cloud.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Vector3 as V3};
use repose_geometry::Aabb;
use repose_geometry::transform::from_row_major;
use repose_proto::scene::WorldFrame;
use repose_proto::{ObjectSummary, RigidTransform, Scene, SceneSummary};
use repose_ros_messages::{
    BoundingBox3D, ColorRgba, Detection3D, Detection3DArray, Header, Marker, MarkerArray, ObjectHypothesis, ObjectHypothesisWithPose,
    Point, PointCloud2, PointField, Pose, PoseArray, PoseWithCovariance, Quaternion, Time, Transform, Vector3, datatype, marker,
};
use serde_bytes::ByteBuf;

/// A point of a cloud: x, y, z, rgb (4 bytes each), label (2) and 2 of padding.
const POINT_STEP: u32 = 20;

/// The frame of a scene's coordinates: the cell's world, or where the camera has no pose the plane that it looks at.
pub fn frame_of(world_frame: &str, scene: &Scene) -> String {
    match scene.meta.world_frame {
        WorldFrame::Extrinsics => world_frame.to_owned(),
        WorldFrame::SupportPlane => format!("{}_support_plane", scene.camera_name),
    }
}

/// The header of what was seen at an instant.
pub fn header(frame_id: &str, stamp_ns: u64) -> Header {
    Header { stamp: Time::from_ns(stamp_ns), frame_id: frame_id.to_owned() }
}

/// Where the box around an object is. The object's pose will not do: it is at the mean of its points, which are on the sides that were seen.
fn box_pose(object: &ObjectSummary, boxes: &BTreeMap<u16, Aabb>) -> Pose {
    let mut pose = pose_of(object);
    if let Some(around) = boxes.get(&object.id) {
        let middle = around.center().cast::<f64>();
        pose.position = Point { x: middle.x, y: middle.y, z: middle.z };
    }
    pose
}

/// The objects, each as what it is known as: its id. What kind of thing it is nobody has looked at.
pub fn detections(header: &Header, summary: &SceneSummary, boxes: &BTreeMap<u16, Aabb>) -> Detection3DArray {
    let detection = |object: &ObjectSummary| {
        let pose = PoseWithCovariance { pose: pose_of(object), ..PoseWithCovariance::default() };
        let hypothesis = ObjectHypothesis { class_id: "object".to_owned(), score: object.score.unwrap_or(1.0) };
        Detection3D {
            header: header.clone(),
            results: vec![ObjectHypothesisWithPose { hypothesis, pose }],
            bbox: BoundingBox3D { center: box_pose(object, boxes), size: vector(object.extent_m) },
            id: object.id.to_string(),
        }
    };
    Detection3DArray { header: header.clone(), detections: summary.objects.iter().map(detection).collect() }
}

/// Where the objects are, in the order of their ids.
pub fn poses(header: &Header, summary: &SceneSummary) -> PoseArray {
    PoseArray { header: header.clone(), poses: summary.objects.iter().map(pose_of).collect() }
}

/// Boxes and ids to look at; those of before are taken away.
pub fn markers(header: &Header, summary: &SceneSummary, boxes: &BTreeMap<u16, Aabb>) -> MarkerArray {
    let clear = Marker { header: header.clone(), action: marker::DELETE_ALL, ..Marker::default() };
    let of = |object: &ObjectSummary| {
        let color = color_of(object.id);
        let base = Marker { header: header.clone(), id: i32::from(object.id), action: marker::ADD, ..Marker::default() };
        let [x, y, z] = object.extent_m.map(|edge| edge.max(1e-3));
        let block = Marker {
            ns: "objects".to_owned(),
            kind: marker::CUBE,
            pose: box_pose(object, boxes),
            scale: Vector3 { x, y, z },
            color: ColorRgba { a: 0.4, ..color },
            ..base.clone()
        };
        let mut above = box_pose(object, boxes);
        above.position.z += z / 2.0 + 0.03;
        let scale = Vector3 { z: 0.04, ..Vector3::default() };
        let words =
            Marker { ns: "ids".to_owned(), kind: marker::TEXT_VIEW_FACING, pose: above, scale, color, text: object.id.to_string(), ..base };
        [block, words]
    };
    MarkerArray { markers: std::iter::once(clear).chain(summary.objects.iter().flat_map(of)).collect() }
}

/// The cloud with the object of each point, 0 for none.
pub fn cloud(header: &Header, scene: &Scene) -> PointCloud2 {
    let mut data = Vec::with_capacity(scene.points.len() * POINT_STEP as usize);
    for (i, (point, label)) in scene.points.iter().zip(&scene.labels).enumerate() {
        point.iter().for_each(|c| data.extend(c.to_le_bytes()));
        let [red, green, blue] = scene.colors.as_ref().map_or([0; 3], |colors| colors[i]);
        data.extend([blue, green, red, 0]);
        data.extend(label.to_le_bytes());
        data.extend([0; 2]);
    }
    let float = |name: &str, offset| PointField { name: name.to_owned(), offset, datatype: datatype::FLOAT32, count: 1 };
    let label = PointField { name: "label".to_owned(), offset: 16, datatype: datatype::UINT16, count: 1 };
    let width = scene.points.len() as u32;
    PointCloud2 {
        header: header.clone(),
        height: 1,
        width,
        fields: vec![float("x", 0), float("y", 4), float("z", 8), float("rgb", 12), label],
        is_bigendian: false,
        point_step: POINT_STEP,
        row_step: POINT_STEP * width,
        data: ByteBuf::from(data),
        is_dense: true,
    }
}

/// A rigid motion as ROS says it; none of one that is no rigid motion.
pub fn transform(motion: &RigidTransform) -> Option<(Isometry3<f64>, Transform)> {
    let motion: Isometry3<f64> = from_row_major(&motion.0).ok()?;
    let (t, r) = (motion.translation.vector, motion.rotation.coords);
    let rotation = Quaternion { x: r.x, y: r.y, z: r.z, w: r.w };
    Some((motion, Transform { translation: Vector3 { x: t.x, y: t.y, z: t.z }, rotation }))
}

/// Where a motion takes an object's centroid, with its turn.
pub fn moved(motion: &Isometry3<f64>, turn: Quaternion, object: &ObjectSummary) -> Pose {
    let at = motion * nalgebra::Point3::from(V3::from(object.centroid_m));
    Pose { position: Point { x: at.x, y: at.y, z: at.z }, orientation: turn }
}

fn pose_of(object: &ObjectSummary) -> Pose {
    let [x, y, z] = object.centroid_m;
    Pose { position: Point { x, y, z }, orientation: Quaternion::default() }
}

fn vector([x, y, z]: [f64; 3]) -> Vector3 {
    Vector3 { x, y, z }
}

/// Colors that differ from one id to the next: steps of the golden section around the wheel.
fn color_of(id: u16) -> ColorRgba {
    let hue = f32::from(id) * 0.618_034 % 1.0 * 6.0;
    let part = |shift: f32| (((hue + shift) % 6.0 - 3.0).abs() - 1.0).clamp(0.0, 1.0);
    ColorRgba { r: part(0.0), g: part(4.0), b: part(2.0), a: 1.0 }
}

#[cfg(test)]
mod tests {
    use repose_proto::{CameraModel, SceneMeta, Unseen};

    use super::*;

    fn scene() -> Scene {
        let object =
            ObjectSummary { id: 3, points: 1, centroid_m: [0.5, 0.1, 0.2], extent_m: [0.1, 0.2, 0.3], completeness: 0.5, score: None };
        let camera = CameraModel {
            width: 2,
            height: 1,
            fx: 1.0,
            fy: 1.0,
            cx: 0.0,
            cy: 0.0,
            depth_unit_m: 0.001,
            world_from_camera: Some(RigidTransform::IDENTITY),
        };
        let meta = SceneMeta {
            objects: vec![object],
            surfaces: Vec::new(),
            camera,
            world_frame: WorldFrame::Extrinsics,
            view_yaw_rad: 0.0,
            unseen: Unseen::default(),
            left_out: Vec::new(),
            warnings: Vec::new(),
        };
        Scene {
            camera_name: "front".to_owned(),
            stamp_ns: 7_000_000_005,
            points: vec![[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [6.0, 7.0, 8.0]],
            labels: vec![0, 3, 3],
            colors: Some(vec![[1, 2, 3], [4, 5, 6], [7, 8, 9]]),
            meta,
            as_sent: None,
        }
    }

    #[test]
    fn a_scene_is_shown_with_its_ids_in_its_frame() {
        let scene = scene();
        let header = header(&frame_of("world", &scene), scene.stamp_ns);
        assert_eq!((header.frame_id.as_str(), header.stamp.nanosec), ("world", 5));
        let summary = scene.summary("0".repeat(64));
        let boxes = Aabb::of_labels(&scene.points, &scene.labels);
        let found = detections(&header, &summary, &boxes);
        assert_eq!((found.detections[0].id.as_str(), found.detections[0].bbox.size.z), ("3", 0.3));
        assert_eq!(poses(&header, &summary).poses[0].position.x, 0.5);
        // The pose is the mean of the points, the box is around them.
        let (of_box, of_object) = (&found.detections[0].bbox.center.position, &found.detections[0].results[0].pose.pose.position);
        assert_eq!(([of_box.x, of_box.y, of_box.z], of_object.x), ([5.0, 6.0, 7.0], 0.5));
        let shown = markers(&header, &summary, &boxes).markers;
        assert_eq!(shown[1].pose.position.x, 5.0);
        assert_eq!(shown.iter().map(|m| m.action).collect::<Vec<_>>(), [marker::DELETE_ALL, marker::ADD, marker::ADD]);
        assert_eq!(shown[2].text, "3");
        let cloud = cloud(&header, &scene);
        let points: Vec<_> = cloud.points().expect("a cloud").collect();
        assert_eq!(points[..2], [([1.0, 2.0, 3.0], Some([1, 2, 3])), ([4.0, 5.0, 6.0], Some([4, 5, 6]))]);
        assert_eq!((cloud.data[36], cloud.data.len()), (3, 60));
        let mut unplaced = scene;
        unplaced.meta.world_frame = WorldFrame::SupportPlane;
        assert_eq!(frame_of("world", &unplaced), "front_support_plane");
    }
}
