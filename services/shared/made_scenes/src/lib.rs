//! Scenes made for tests: a table and boxes, rendered as the cloud that a camera would see; and single points seen from above.
//!
//! Every pixel's ray is cut with the table and the boxes; no noise, no border cleaning. The camera stands at y = −0.8 m, 0.7 m high,
//! and looks along +y at the origin, so that the viewer's axes are the world's.
//!
//! ```
//! let scene = repose_made_scenes::SceneBuilder::table().object(1, [0.1, 0.0], [0.05, 0.05, 0.1]).scene();
//! assert_eq!(scene.meta.objects[0].id, 1);
//! ```

use nalgebra::{Isometry3, Point3, Vector3};
use repose_geometry::{Pinhole, transform};
use repose_proto::scene::WorldFrame;
use repose_proto::{CameraModel, ObjectSummary, RigidTransform, Scene, SceneMeta, Surface, Unseen};

const CAMERA: Pinhole = Pinhole { width: 320, height: 240, fx: 290.0, fy: 290.0, cx: 159.5, cy: 119.5 };

/// The camera's pose.
pub fn world_from_camera() -> Isometry3<f64> {
    transform::look_at(&Point3::new(0.0, -0.8, 0.7), &Point3::origin(), &Vector3::z())
}

/// An upright box.
#[derive(Debug, Clone, Copy)]
struct UprightBox {
    label: u16,
    min: Point3<f64>,
    max: Point3<f64>,
}

/// A scene in the making.
#[derive(Debug, Clone)]
pub struct SceneBuilder {
    table: [f64; 4],
    solids: Vec<UprightBox>,
}

impl SceneBuilder {
    /// A table of 1 m by 0.8 m at height 0 around the origin.
    pub fn table() -> Self {
        Self::table_within([-0.5, -0.4, 0.5, 0.4])
    }

    /// A table at height 0 within `[min x, min y, max x, max y]`.
    pub fn table_within(table: [f64; 4]) -> Self {
        Self { table, solids: Vec::new() }
    }

    /// Adds an object that stands on the table.
    pub fn object(self, label: u16, center: [f64; 2], size: [f64; 3]) -> Self {
        self.object_at(label, center, 0.0, size)
    }

    /// Adds an object that stands at a height.
    pub fn object_at(mut self, label: u16, [x, y]: [f64; 2], bottom_m: f64, [dx, dy, dz]: [f64; 3]) -> Self {
        let min = Point3::new(x - dx / 2.0, y - dy / 2.0, bottom_m);
        self.solids.push(UprightBox { label, min, max: min + Vector3::new(dx, dy, dz) });
        self
    }

    /// The scene as seen.
    pub fn scene(&self) -> Scene {
        let world_from_camera = world_from_camera();
        let eye = Point3::from(world_from_camera.translation.vector);
        let (mut points, mut labels) = (Vec::new(), Vec::new());
        for v in 0..CAMERA.height {
            for u in 0..CAMERA.width {
                let direction = world_from_camera * CAMERA.unproject(u as f64, v as f64, 1.0).coords;
                if let Some((distance, label)) = self.first_hit(&eye, &direction) {
                    points.push((eye + direction * distance).cast::<f32>().coords.into());
                    labels.push(label);
                }
            }
        }
        let meta = self.meta(&points, &labels, &world_from_camera);
        Scene { camera_name: "test".to_owned(), stamp_ns: 0, points, labels, colors: None, meta, as_sent: None }
    }

    fn first_hit(&self, eye: &Point3<f64>, direction: &Vector3<f64>) -> Option<(f64, u16)> {
        let mut hits: Vec<(f64, u16)> = Vec::new();
        let down = -eye.z / direction.z;
        let on_table = eye + direction * down;
        let [x0, y0, x1, y1] = self.table;
        if down > 0.0 && (x0..=x1).contains(&on_table.x) && (y0..=y1).contains(&on_table.y) {
            hits.push((down, 0));
        }
        for solid in &self.solids {
            let (mut enter, mut leave) = (0.0f64, f64::INFINITY);
            for k in 0..3 {
                let (a, b) = ((solid.min[k] - eye[k]) / direction[k], (solid.max[k] - eye[k]) / direction[k]);
                enter = enter.max(a.min(b));
                leave = leave.min(a.max(b));
            }
            if enter < leave {
                hits.push((enter, solid.label));
            }
        }
        hits.into_iter().min_by(|a, b| a.0.total_cmp(&b.0))
    }

    fn meta(&self, points: &[[f32; 3]], labels: &[u16], world_from_camera: &Isometry3<f64>) -> SceneMeta {
        let rectangle = |[x0, y0, x1, y1]: [f64; 4], height_m: f64, object: Option<u16>| Surface {
            height_m,
            outline_m: vec![[x0, y0], [x1, y0], [x1, y1], [x0, y1]],
            area_m2: (x1 - x0) * (y1 - y0),
            object,
        };
        let mut surfaces = vec![rectangle(self.table, 0.0, None)];
        let mut objects = Vec::new();
        for s in &self.solids {
            surfaces.push(rectangle([s.min.x, s.min.y, s.max.x, s.max.y], s.max.z, (s.label != 0).then_some(s.label)));
            let own: Vec<&[f32; 3]> = points.iter().zip(labels).filter(|(_, l)| **l == s.label).map(|(p, _)| p).collect();
            if s.label == 0 || own.is_empty() {
                continue;
            }
            let mean = |k: usize| own.iter().map(|p| f64::from(p[k])).sum::<f64>() / own.len() as f64;
            let size = s.max - s.min;
            objects.push(ObjectSummary {
                id: s.label,
                points: own.len(),
                centroid_m: [mean(0), mean(1), mean(2)],
                extent_m: size.into(),
                completeness: 1.0,
                score: None,
            });
        }
        let camera = CameraModel {
            width: CAMERA.width,
            height: CAMERA.height,
            fx: CAMERA.fx,
            fy: CAMERA.fy,
            cx: CAMERA.cx,
            cy: CAMERA.cy,
            depth_unit_m: 0.001,
            world_from_camera: Some(RigidTransform(transform::to_row_major(world_from_camera))),
        };
        let unseen = Unseen::default();
        SceneMeta {
            objects,
            surfaces,
            camera,
            world_frame: WorldFrame::Extrinsics,
            view_yaw_rad: 0.0,
            unseen,
            left_out: Vec::new(),
            warnings: Vec::new(),
        }
    }
}

/// A scene of points with labels, seen straight down from a metre above the origin; every pixel of the 9 x 9 picture is 0.1 m of the floor. The
/// color of a point is its object's id.
pub fn seen_from_above(points: &[([f32; 3], u16)]) -> Scene {
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
    Scene {
        camera_name: "front".to_owned(),
        stamp_ns: 1,
        points: points.iter().map(|p| p.0).collect(),
        labels: points.iter().map(|p| p.1).collect(),
        colors: Some(points.iter().map(|p| [p.1 as u8; 3]).collect()),
        meta: SceneMeta {
            objects: ids.iter().map(summary).collect(),
            surfaces: Vec::new(),
            camera,
            world_frame: WorldFrame::Extrinsics,
            view_yaw_rad: 0.0,
            unseen: Unseen::default(),
            left_out: Vec::new(),
            warnings: Vec::new(),
        },
        as_sent: None,
    }
}
