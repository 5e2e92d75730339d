//! The simulated camera shows the robot: what perception and motion make of that.

use nalgebra::{Isometry3, Point3, Vector3};
use repose_evaluation::scenes::problem::frame_drawn;
use repose_geometry::TriMesh;
use repose_geometry::transform::to_row_major;
use repose_motion::collision::{ArmCollisionSettings, CollisionChecker};
use repose_motion::obstacles::{ObstacleSettings, Obstacles};
use repose_motion::pick_place::settings::PickPlaceSettings;
use repose_motion::recovery::{Recovery, RecoverySettings};
use repose_motion::wire::surroundings;
use repose_panda::{FINGER_OPENING_MAX_M, InverseSettings, Joints, LinkFrames, READY, base_from_tcp, inverse_near, spheres_in_base};
use repose_perception::{Segmented, Settings, segment_with_labels};
use repose_proto::{CameraModel, Frame, RigidTransform, RobotInView};
use repose_sensor::SensorModel;
use repose_simulator::cell::{CellSettings, cell_of_seed};
use repose_simulator::objects::body::cuboid_mesh;
use repose_simulator::render::Drawable;
use repose_simulator::robot::body;
use repose_simulator::scene::SimulatedScene;

/// An arm and what its state says of it.
#[derive(Clone, Copy)]
struct Shown {
    joints: Joints,
    opening_m: f64,
    holding: bool,
}

const AT_HOME: Shown = Shown { joints: READY, opening_m: FINGER_OPENING_MAX_M, holding: false };

/// The arm stretched out over the table, between the camera and the objects.
fn over_the_table() -> Shown {
    let mut joints = READY;
    let mut target = base_from_tcp(&READY);
    for _ in 0..20 {
        target.translation.vector += Vector3::new(0.015, 0.003, -0.008);
        joints = inverse_near(&target, &joints, &InverseSettings::default()).expect("within reach");
    }
    Shown { joints, ..AT_HOME }
}

/// What the cell's camera sees of a scene, with an arm in it or without one; `held` hangs between the fingers.
fn frame(scene: &SimulatedScene, shown: Option<Shown>, held: Option<&TriMesh>, sensor: &SensorModel) -> Frame {
    seen_with(scene, shown, held, sensor, 7)
}

/// The same with another draw of the sensor's noise.
fn seen_with(scene: &SimulatedScene, shown: Option<Shown>, held: Option<&TriMesh>, sensor: &SensorModel, noise: u64) -> Frame {
    let cell = CellSettings::default();
    let mut drawables = scene.drawables();
    let mut robots = Vec::new();
    if let Some(Shown { joints, opening_m, holding }) = shown {
        drawables.extend(body::drawables(&joints, [opening_m as f32 / 2.0; 2]));
        drawables.extend(held.map(|mesh| Drawable { mesh, world_from_mesh: base_from_tcp(&joints), label: 99, color: [200, 90, 40] }));
        robots.push(RobotInView {
            name: "panda".to_owned(),
            model: "panda".to_owned(),
            joints_rad: joints,
            gripper_width_m: opening_m,
            holding: Some(holding),
            world_from_base: RigidTransform::IDENTITY,
        });
    }
    Frame { robots, ..frame_drawn(&drawables, &cell.camera, &cell.world_from_camera(), sensor, noise) }
}

fn segmented(frame: &Frame, found: bool) -> Segmented {
    let labels = if found { None } else { frame.labels.clone() };
    segment_with_labels(&Frame { labels, ..frame.clone() }, &Settings::default()).expect("a scene")
}

fn scenes() -> impl Iterator<Item = SimulatedScene> {
    (0..4).map(|seed| cell_of_seed(seed, &CellSettings::default()).expect("a scene"))
}

#[test]
fn an_arm_in_its_ready_pose_changes_no_object() {
    for sensor in [SensorModel::structured_light(), SensorModel::active_stereo()] {
        for (scene, found) in scenes().flat_map(|scene| [(scene.clone(), false), (scene, true)]) {
            let without = segmented(&frame(&scene, None, None, &sensor), found).scene.meta;
            let with = segmented(&frame(&scene, Some(AT_HOME), None, &sensor), found).scene.meta;
            let name = format!("seed {}, found {found}", scene.seed);
            assert_eq!(with.objects.len(), without.objects.len(), "{name}");
            assert!(with.warnings.is_empty(), "{name}: {:?}", with.warnings);
            for object in &without.objects {
                let at = Point3::from(object.centroid_m);
                let apart_m = with.objects.iter().map(|o| (Point3::from(o.centroid_m) - at).norm()).fold(f64::INFINITY, f64::min);
                assert!(apart_m < 0.005, "{name}: object {} is {apart_m} m away", object.id);
            }
        }
    }
}

#[test]
fn an_arm_over_the_table_is_no_object_and_does_not_block_itself() {
    let shown = over_the_table();
    let spheres = spheres_in_base(&LinkFrames::at(&shown.joints), shown.opening_m);
    for (scene, found) in scenes().flat_map(|scene| [(scene.clone(), false), (scene, true)]) {
        let frame = frame(&scene, Some(shown), None, &SensorModel::structured_light());
        let Segmented { scene: seen, labels, .. } = segmented(&frame, found);
        let truth = frame.labels.as_ref().expect("labels");
        for object in &seen.meta.objects {
            let pixels = || labels.pixels().iter().zip(truth).filter(|(id, _)| **id == object.id);
            let true_pixels = pixels().filter(|(_, id)| **id != 0).count();
            assert!(2 * true_pixels > pixels().count(), "seed {}: object {} is none", scene.seed, object.id);
        }
        let on_arm = seen.points.iter().filter(|p| {
            let p = Point3::from(**p).cast::<f64>();
            spheres.iter().any(|s| (s.center - p).norm() < s.radius_m)
        });
        assert_eq!(on_arm.count(), 0, "seed {}: readings in the arm", scene.seed);
        let around = surroundings(&seen).expect("a calibrated camera");
        let obstacles = Obstacles::new(&around.points, &around.surfaces, &ObstacleSettings::default());
        let obstacles = [&obstacles];
        let arm = ArmCollisionSettings { finger_opening_m: shown.opening_m, ..ArmCollisionSettings::default() };
        assert_eq!(CollisionChecker::new(arm, &obstacles, None).contact(&shown.joints), None, "seed {}", scene.seed);
    }
}

#[test]
fn what_the_camera_mixes_at_the_edge_of_its_picture_does_not_stand_in_an_arms_way_home() {
    // The picture's top edge cuts the shoulder. With this noise a pixel there came to lie where the shoulder is to go.
    let mut joints = READY;
    (joints[0], joints[1], joints[3]) = (-0.6, 0.6, -1.7);
    let cell = CellSettings::default();
    let scene = cell_of_seed(2, &cell).expect("a scene");
    let settings = RecoverySettings::of(&PickPlaceSettings::default(), 0.2);
    for noise in [82, 188, 405, 462] {
        let frame = seen_with(&scene, Some(Shown { joints, ..AT_HOME }), None, &SensorModel::structured_light(), noise);
        let seen = segmented(&frame, false).scene;
        let around = surroundings(&seen).expect("a calibrated camera");
        let home = Recovery::new(&joints, FINGER_OPENING_MAX_M, Some(&around), &settings).home(&|| false);
        assert!(home.is_ok_and(|way| way.is_some()), "noise {noise}");
    }
}

#[test]
fn what_the_hand_holds_is_neither_object_nor_obstacle() {
    let shown = Shown { opening_m: 0.05, holding: true, ..over_the_table() };
    let held = cuboid_mesh(Vector3::new(0.03, 0.0249, 0.04));
    let tcp = base_from_tcp(&shown.joints);
    for (scene, found) in scenes().flat_map(|scene| [(scene.clone(), false), (scene, true)]) {
        let frame = frame(&scene, Some(shown), Some(&held), &SensorModel::structured_light());
        let seen = segmented(&frame, found).scene;
        let in_held = |p: &Point3<f64>| {
            let p = tcp.inverse_transform_point(p);
            p.x.abs() < 0.03 && p.y.abs() < 0.025 && p.z.abs() < 0.04
        };
        let left = seen.points.iter().filter(|p| in_held(&Point3::from(**p).cast())).count();
        assert!(left < 20, "seed {}, found {found}: {left} readings of the held object are left", scene.seed);
        assert!(seen.meta.objects.iter().all(|o| !in_held(&Point3::from(o.centroid_m))), "seed {}, found {found}", scene.seed);
    }
}

#[test]
fn a_calibration_off_by_two_centimetres_is_warned_of_and_a_good_one_is_not() {
    let scene = scenes().next().expect("a scene");
    let pose = CellSettings::default().world_from_camera();
    for shown in [AT_HOME, over_the_table()] {
        let frame = frame(&scene, Some(shown), None, &SensorModel::structured_light());
        let warnings = |off: Vector3<f64>| {
            let world_from_camera = Some(RigidTransform(to_row_major(&(Isometry3::from(off) * pose))));
            let camera = CameraModel { world_from_camera, ..frame.camera.clone() };
            segmented(&Frame { camera, ..frame.clone() }, true).scene.meta.warnings
        };
        assert!(warnings(Vector3::zeros()).is_empty(), "{:?}", warnings(Vector3::zeros()));
        for off in [Vector3::x(), Vector3::y(), Vector3::z(), -Vector3::y(), -Vector3::z()] {
            let told = warnings(off * 0.02);
            assert!(told.iter().any(|w| w.field == "world_from_camera" && w.message.contains(" mm from where")), "{off:?}: {told:?}");
        }
    }
}
