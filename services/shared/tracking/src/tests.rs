//! Views made for tests, and goal terms judged on one.

use nalgebra::{Isometry3, Point3, Vector3};
use repose_geometry::{Pinhole, transform};
use repose_proto::scene::WorldFrame;
use repose_proto::{CameraModel, GoalTerm, ObjectSummary, Relation, RigidTransform, Scene, SceneMeta, Unseen};

use crate::holds;

const CAMERA: Pinhole = Pinhole { width: 320, height: 240, fx: 290.0, fy: 290.0, cx: 159.5, cy: 119.5 };

/// An upright block.
#[derive(Debug, Clone, Copy)]
pub struct Block {
    pub label: u16,
    pub min: [f64; 3],
    pub max: [f64; 3],
}

/// A block of 6 cm by 6 cm by 8 cm with the middle of its bottom at a place.
pub fn block(label: u16, [x, y, z]: [f64; 3]) -> Block {
    Block { label, min: [x - 0.03, y - 0.03, z], max: [x + 0.03, y + 0.03, z + 0.08] }
}

/// What a camera at y = −0.8 m, 0.7 m high, that looks along +y sees of blocks (0: no object) on a table of 1 m by 0.8 m.
pub fn scene_of(blocks: &[Block]) -> Scene {
    let world_from_camera: Isometry3<f64> = transform::look_at(&Point3::new(0.0, -0.8, 0.7), &Point3::origin(), &Vector3::z());
    let table = Block { label: 0, min: [-0.5, -0.4, -0.01], max: [0.5, 0.4, 0.0] };
    let eye = Point3::from(world_from_camera.translation.vector);
    let (mut points, mut labels): (Vec<[f32; 3]>, Vec<u16>) = (Vec::new(), Vec::new());
    for (u, v) in (0..CAMERA.width).flat_map(|u| (0..CAMERA.height).map(move |v| (u, v))) {
        let direction = world_from_camera * CAMERA.unproject(u as f64, v as f64, 1.0).coords;
        let hit = |block: &Block| {
            let (mut enter, mut leave) = (0.0f64, f64::INFINITY);
            for k in 0..3 {
                let (a, b) = ((block.min[k] - eye[k]) / direction[k], (block.max[k] - eye[k]) / direction[k]);
                (enter, leave) = (enter.max(a.min(b)), leave.min(a.max(b)));
            }
            (enter < leave).then_some((enter, block.label))
        };
        if let Some((distance, label)) = blocks.iter().chain([&table]).filter_map(hit).min_by(|a, b| a.0.total_cmp(&b.0)) {
            points.push((eye + direction * distance).cast::<f32>().coords.into());
            labels.push(label);
        }
    }
    let summary = |block: &Block| {
        let own: Vec<Point3<f64>> =
            points.iter().zip(&labels).filter(|(_, l)| **l == block.label).map(|(p, _)| Point3::from(*p).cast()).collect();
        let sum: Vector3<f64> = own.iter().map(|p| p.coords).sum();
        let extent_m = [0, 1, 2].map(|k| block.max[k] - block.min[k]);
        let centroid_m = (sum / own.len().max(1) as f64).into();
        ObjectSummary { id: block.label, points: own.len(), centroid_m, extent_m, completeness: 1.0, score: None }
    };
    let objects = blocks.iter().filter(|b| b.label != 0).map(summary).filter(|o| o.points > 0).collect();
    let camera = CameraModel {
        width: CAMERA.width,
        height: CAMERA.height,
        fx: CAMERA.fx,
        fy: CAMERA.fy,
        cx: CAMERA.cx,
        cy: CAMERA.cy,
        depth_unit_m: 0.001,
        world_from_camera: Some(RigidTransform(transform::to_row_major(&world_from_camera))),
    };
    let meta = SceneMeta {
        objects,
        surfaces: Vec::new(),
        camera,
        world_frame: WorldFrame::Extrinsics,
        view_yaw_rad: 0.0,
        unseen: Unseen::default(),
        left_out: Vec::new(),
        warnings: Vec::new(),
    };
    Scene { camera_name: "test".to_owned(), stamp_ns: 0, points, labels, colors: None, meta }
}

#[test]
fn terms_are_judged_on_what_is_seen() {
    let scene = scene_of(&[block(1, [-0.3, 0.0, 0.0]), block(2, [0.1, 0.0, 0.0])]);
    let term = |relation: Relation, holds: bool| GoalTerm { relation, anchor: 2, holds };
    let terms = [term(Relation::LeftOf, true), term(Relation::RightOf, true), term(Relation::Near, false)];
    assert_eq!(holds(&scene, 0.0, 1, &terms), [true, false, true]);
    assert_eq!(holds(&scene, 0.0, 9, &terms[..1]), [false], "what is not seen is not said to hold");
}
