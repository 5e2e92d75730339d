//! From a frame to a scene: take out flying readings, level, label, clean borders, find surfaces, name objects, tell what is unseen.
//!
//! Labels that come with the frame are taken as they are; without them objects are found from depth and color. Without a camera pose the world
//! is that of the main support plane. The same frame and settings give the same scene, bit for bit.

use repose_geometry::transform::to_row_major;
use repose_geometry::{Image, Point2, ViewerFrame};
use repose_proto::{CameraModel, Frame, ObjectSummary, RigidTransform, Scene, SceneMeta, Surface, Unseen, limits};

use crate::error::SegmentError;
use crate::masks::clean::CleanMasks;
use crate::masks::hints;
use crate::objects::find::Found;
use crate::readings::point_map::strided;
use crate::scene::cloud::Cloud;
use crate::scene::summary::{Completeness, summarise};
use crate::scene::unseen::{self, RayView};
use crate::scene::warnings;
use crate::settings::Settings;
use crate::supports::surfaces::{self, SupportSurface};
use crate::view::DepthView;

/// A scene with the masks that it was made from.
#[derive(Debug, Clone, PartialEq)]
pub struct Segmented {
    /// The scene.
    pub scene: Scene,
    /// The instance id of each pixel of the frame, given or found, of the objects in the scene; 0 is background. Borders belong to them.
    pub labels: Image<u16>,
    /// The same without the band around each mask: the pixels whose readings are the objects' points.
    pub cleaned: Image<u16>,
    /// What of the picture was told and is no object, each part with a number of its own; 0 elsewhere. The scene says why of each.
    pub left_out: Image<u16>,
}

/// The scene that a frame shows.
///
/// # Errors
/// [`SegmentError`] when the frame contradicts itself, has no readings, or nothing says which way is up.
pub fn segment(frame: &Frame, settings: &Settings) -> Result<Scene, SegmentError> {
    Ok(Parts::of(frame, settings)?.scene)
}

/// The scene that a frame shows, and the masks, for those who draw or measure them.
///
/// # Errors
/// As [`segment`].
pub fn segment_with_labels(frame: &Frame, settings: &Settings) -> Result<Segmented, SegmentError> {
    let Parts { scene, masks: CleanMasks { mut labels, band, left_out, .. } } = Parts::of(frame, settings)?;
    for id in labels.pixels_mut().iter_mut().filter(|id| **id != 0 && scene.object(**id).is_none()) {
        *id = 0;
    }
    let mut cleaned = labels.clone();
    for (id, _) in cleaned.pixels_mut().iter_mut().zip(band.pixels()).filter(|(_, banded)| **banded) {
        *id = 0;
    }
    Ok(Segmented { scene, labels, cleaned, left_out: left_out.parts })
}

/// A scene and what it was made with.
struct Parts {
    scene: Scene,
    masks: CleanMasks,
}

impl Parts {
    fn of(frame: &Frame, settings: &Settings) -> Result<Self, SegmentError> {
        frame.validate().map_err(SegmentError::Frame)?;
        let mut view = DepthView::of(frame, settings)?;
        let Found { mut ids, mut no_objects, furniture } = view.labelled(frame, settings)?;
        hints::follow(&mut ids, &mut no_objects, &view.depth, &frame.hints).map_err(SegmentError::Frame)?;
        view.leave_out_held(&mut ids, settings);
        let coarse_labels = strided(&ids, view.stride);
        // The band is as wide in readings, however many pixels each fills.
        let repeat_px = view.depth.repeat_px();
        let of_masks = Settings { borders: settings.borders.repeated(repeat_px), ..settings.clone() };
        let masks = CleanMasks::new(ids, no_objects, view.depth.depth_m(), view.camera.fx as f32 / repeat_px as f32, &of_masks);
        let masks = masks.ok_or_else(|| match view.depth.readings() {
            0 => SegmentError::RobotsOnly { readings: view.readings - view.flying },
            readings => SegmentError::NothingLeft { readings, border_px: of_masks.borders.radius_px },
        })?;

        let coarse_band = strided(&masks.band, view.stride);
        // What was left out is in the way, but no piece of furniture, unless it may well be one.
        let standing = |id: u16| match masks.left_out.reasons.contains_key(&id) {
            true => furniture.contains(&id).then_some(0),
            false => Some(id),
        };
        let clean_label = |i: usize| (!coarse_band.pixels()[i]).then(|| coarse_labels.pixels()[i]).and_then(standing);
        let surfaces = surfaces::find(view.coarse.upward(clean_label), &settings.surfaces, settings.levels.max_slope);
        Ok(Self { scene: scene(view, frame, &masks, surfaces, settings), masks })
    }
}

/// The scene of a view, with its masks and the surfaces that things stand on.
fn scene(view: DepthView, frame: &Frame, masks: &CleanMasks, surfaces: Vec<SupportSurface>, settings: &Settings) -> Scene {
    let DepthView { world_from_camera, world_frame, depth, with_robots, coarse, readings, flying, is_sparse, robots, .. } = view;
    let cloud = Cloud::new(&depth, &world_from_camera, masks, frame.color.as_deref(), settings);
    let sight_m = unseen::sight_m(&coarse.depth_m, coarse.stride, frame, settings.max_depth_m);
    let rays = RayView { depth_m: &sight_m, camera: coarse.camera, world_from_camera: &world_from_camera };
    let space = unseen::space(&rays, &surfaces, &settings.unseen);
    // What a robot covers goes on behind it.
    let covers_m = if robots.bodies.is_empty() { depth.depth_m() } else { &with_robots };
    let completeness = Completeness::measure(depth.depth_m(), covers_m, &masks.labels);
    let mut warnings = robots.warnings;
    warnings.extend(is_sparse.then(warnings::sparse_depth));
    warnings.extend(warnings::doubts(&surfaces, &depth, &coarse, world_frame, frame.labels.is_some(), settings));
    let pixels = depth.depth_m().pixels().len();
    let meta = SceneMeta {
        objects: told(summarise(&cloud.points, &cloud.labels, &completeness), &completeness, frame.labels.is_none()),
        surfaces: on_the_wire(surfaces),
        camera: CameraModel {
            world_from_camera: Some(RigidTransform(to_row_major(&world_from_camera).map(|entry| rounded(entry, 1e9)))),
            ..frame.camera.clone()
        },
        world_frame,
        view_yaw_rad: rounded(ViewerFrame::from_camera(&world_from_camera).yaw_rad(), 1e9),
        unseen: Unseen {
            pixels_without_reading: pixels - readings,
            pixels_on_borders: masks.on_borders,
            pixels_flying: flying,
            share: micro(1.0 - masks.available as f64 / pixels as f64),
            space,
        },
        left_out: masks.left_out.described(&depth, &world_from_camera, frame.labels.is_some()),
        warnings,
    };
    let (camera_name, stamp_ns) = (frame.camera_name.clone(), frame.stamp_ns);
    Scene { camera_name, stamp_ns, points: cloud.points, labels: cloud.labels, colors: cloud.colors, meta, as_sent: None }
}

/// The objects as the scene tells of them, to a micrometre; those that were `found` with how sure that is.
fn told(mut objects: Vec<ObjectSummary>, completeness: &Completeness, found: bool) -> Vec<ObjectSummary> {
    for object in &mut objects {
        object.score = found.then(|| micro(completeness.score_of(object.id)));
        object.centroid_m = object.centroid_m.map(micro);
        object.extent_m = object.extent_m.map(micro);
        object.completeness = micro(object.completeness);
    }
    objects
}

/// Surfaces in the wire's form, largest outline first; no more, and with no more corners, than a scene may have.
fn on_the_wire(surfaces: Vec<SupportSurface>) -> Vec<Surface> {
    let mut surfaces: Vec<Surface> = surfaces
        .into_iter()
        .map(|s| Surface {
            height_m: micro(f64::from(s.height_m)),
            outline_m: fewer_corners(s.outline.corners()).map(|c| [micro(f64::from(c.x)), micro(f64::from(c.y))]).collect(),
            area_m2: micro(f64::from(s.outline.area())),
            object: s.object,
        })
        .collect();
    surfaces.sort_by(|a, b| b.area_m2.total_cmp(&a.area_m2));
    surfaces.truncate(limits::MAX_SURFACES);
    surfaces
}

/// An outline's corners, evenly fewer where there are too many for a scene: what is left lies within the outline.
fn fewer_corners(corners: &[Point2<f32>]) -> impl Iterator<Item = &Point2<f32>> {
    corners.iter().step_by(corners.len().div_ceil(limits::MAX_CORNERS).max(1))
}

/// A number to six decimals, a micrometre: short decimals come out of every JSON reader as they went in, and with them the scene's id.
fn micro(value: f64) -> f64 {
    rounded(value, 1e6)
}

/// A number to the nearest of `per_unit` steps per unit; no negative zero.
fn rounded(value: f64, per_unit: f64) -> f64 {
    (value * per_unit).round() / per_unit + 0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::{Solid, cast};
    use proptest::prelude::*;
    use repose_geometry::transform::look_at;
    use repose_geometry::{Isometry3, Pinhole, Point3, Vector3};
    use repose_proto::CallError;
    use repose_proto::scene::WorldFrame;

    /// A frame of a box of 12 x 10 x 8 cm on a table, with the box labelled 9, and the true camera pose.
    fn frame() -> (Frame, Isometry3<f64>) {
        frame_of(&[Solid::table(0.0), Solid::cuboid([0.05, 0.0, 0.04], [0.06, 0.05, 0.04])])
    }

    /// A frame of solids, of which the first is furniture and the others are labelled 9, and the true camera pose.
    fn frame_of(solids: &[Solid]) -> (Frame, Isometry3<f64>) {
        let camera = Pinhole { width: 320, height: 240, fx: 262.0, fy: 262.0, cx: 159.5, cy: 119.5 };
        let world_from_camera = look_at(&Point3::new(0.0, -0.7, 0.5), &Point3::origin(), &Vector3::z());
        let seen = cast(solids, &camera, &world_from_camera);
        let depth = seen.pixels().iter().map(|s| s.map_or(0, |(depth, _)| (depth * 1e4).round() as u16)).collect();
        let labels = seen.pixels().iter().map(|s| s.map_or(0, |(_, solid)| if solid > 0 { 9 } else { 0 })).collect();
        let model = CameraModel {
            width: 320,
            height: 240,
            fx: camera.fx,
            fy: camera.fy,
            cx: camera.cx,
            cy: camera.cy,
            depth_unit_m: 1e-4,
            world_from_camera: None,
        };
        let color = Some(vec![[1, 2, 3]; 320 * 240]);
        (Frame { color, labels: Some(labels), ..Frame::new("test".to_owned(), 3, model, depth) }, world_from_camera)
    }

    fn check(scene: &Scene, id: u16, z_m: f64) {
        let object = scene.object(id).unwrap();
        // Cleaning takes two pixels, 6 mm here, off each side.
        assert!((object.extent_m[0] - 0.108).abs() < 0.005 && object.extent_m[2] < 0.085, "{object:?}");
        assert_eq!(object.completeness, 1.0);
        let surface = |object| scene.meta.surfaces.iter().find(|s| s.object == object).unwrap();
        let (table, top) = (surface(None), surface(Some(id)));
        assert!((table.height_m - z_m).abs() < 0.002 && table.area_m2 > 0.5, "{table:?}");
        assert!((top.height_m - z_m - 0.08).abs() < 0.002, "{top:?}");
        assert_eq!(scene.colors.as_ref().map(Vec::len), Some(scene.points.len()));
    }

    #[test]
    fn a_box_on_a_table_is_found_given_and_levelled() {
        let (frame, truth) = frame();
        let given = segment(&frame, &Settings::default()).unwrap();
        check(&given, 9, 0.0);
        assert_eq!(given.meta.world_frame, WorldFrame::SupportPlane);
        let found = segment(&Frame { labels: None, ..frame.clone() }, &Settings::default()).unwrap();
        check(&found, 1, 0.0);
        let lifted = Isometry3::translation(0.0, 0.0, 0.3) * truth;
        let camera = CameraModel { world_from_camera: Some(RigidTransform(to_row_major(&lifted))), ..frame.camera.clone() };
        let calibrated = segment(&Frame { camera, labels: None, ..frame }, &Settings::default()).unwrap();
        check(&calibrated, 1, 0.3);
        assert_eq!(calibrated.meta.world_frame, WorldFrame::Extrinsics);
    }

    #[test]
    fn border_pixels_leave_the_cloud_and_are_counted() {
        let (frame, _) = frame();
        let scene = segment(&frame, &Settings::default()).unwrap();
        let mask = frame.labels.iter().flatten().filter(|id| **id == 9).count();
        let kept = scene.points_of(9).count();
        assert!(kept < mask && kept > mask / 2);
        let readings = frame.depth.iter().filter(|d| **d > 0).count();
        assert_eq!(scene.points.len() + scene.meta.unseen.pixels_on_borders + scene.meta.unseen.pixels_flying, readings);
        assert_eq!(scene.meta.unseen.pixels_without_reading, 320 * 240 - readings);
    }

    #[test]
    fn the_handle_of_a_mug_is_in_the_scene() {
        let mug = [Solid::table(0.0), Solid::cuboid([0.0, 0.0, 0.05], [0.04, 0.04, 0.05])];
        // Three to four pixels wide in the picture.
        let handle = [
            Solid::cuboid([0.055, 0.0, 0.075], [0.016, 0.003, 0.0045]),
            Solid::cuboid([0.055, 0.0, 0.025], [0.016, 0.003, 0.0045]),
            Solid::cuboid([0.068, 0.0, 0.05], [0.006, 0.003, 0.03]),
        ];
        let seen = |solids: &[Solid]| segment(&frame_of(solids).0, &Settings::default()).unwrap();
        let (plain, with_handle) = (seen(&mug), seen(&[&mug[..], &handle[..]].concat()));
        let beside = |scene: &Scene| scene.points_of(9).filter(|p| p[0] > 0.042).collect::<Vec<_>>();
        assert!(beside(&plain).is_empty());
        let of_handle = beside(&with_handle);
        assert!(of_handle.len() >= 30 && of_handle.iter().any(|p| p[0] > 0.065), "{of_handle:?}");
        assert!(of_handle.iter().all(|p| p[0] < 0.075 && (0.015..0.085).contains(&p[2])), "{of_handle:?}");
    }

    #[test]
    fn a_labelled_object_too_thin_to_be_one_stays_in_the_way() {
        let (mut frame, _) = frame();
        // Three of the box's columns.
        for (_, id) in frame.labels.iter_mut().flatten().enumerate().filter(|(i, _)| !(170..173).contains(&(i % 320))) {
            *id = 0;
        }
        let mask = frame.labels.iter().flatten().filter(|id| **id == 9).count();
        assert!(mask > 60, "{mask}");
        let segmented = segment_with_labels(&frame, &Settings::default()).unwrap();
        let scene = &segmented.scene;
        assert_eq!((scene.meta.objects.len(), scene.meta.left_out.len()), (0, 1));
        assert_eq!((scene.meta.left_out[0].label, scene.meta.left_out[0].reason), (Some(9), repose_proto::LeftOutReason::TooSmall));
        assert!(segmented.labels.pixels().iter().all(|id| *id == 0));
        // Of the readings without any mask only those go that the band takes beside it, two pixels wide.
        let unlabelled = segment(&Frame { labels: Some(vec![0; 320 * 240]), ..frame }, &Settings::default()).unwrap();
        let beside = scene.meta.unseen.pixels_on_borders;
        assert_eq!(scene.points.len() + beside, unlabelled.points.len());
        assert!(beside <= 7 * (mask / 3 + 6) - mask, "{beside} beside {mask}");
    }

    #[test]
    fn space_before_a_wall_that_is_too_far_away_is_seen() {
        let (frame, _) = frame();
        let hidden = |beyond: u16| {
            let depth = frame.depth.iter().map(|count| if *count == 0 { beyond } else { *count }).collect();
            let scene = segment(&Frame { depth, ..frame.clone() }, &Settings::default()).unwrap();
            scene.meta.unseen.space.unwrap().hidden.iter().map(|bits| bits.count_ones()).sum::<u32>()
        };
        let (nothing, wall, no_reading) = (hidden(0), hidden(50_000), hidden(u16::MAX));
        assert!(wall < nothing && no_reading == nothing, "{wall} before a wall, {no_reading}, {nothing} before nothing");
    }

    #[test]
    fn thinning_keeps_the_asked_number_evenly() {
        let (frame, _) = frame();
        let all = segment(&frame, &Settings::default()).unwrap();
        let thin = segment(&frame, &Settings { max_points: 5000, ..Settings::default() }).unwrap();
        assert_eq!(thin.points.len(), 5000);
        let share = |scene: &Scene| scene.points_of(9).count() as f64 / scene.points.len() as f64;
        assert!((share(&all) - share(&thin)).abs() < 0.01);
    }

    #[test]
    fn a_place_in_millimetres_is_doubted_and_a_right_one_is_not() {
        let (frame, world_from_camera) = frame();
        let warned = |unit: f64| {
            let mut pose = to_row_major(&world_from_camera);
            [3, 7, 11].into_iter().for_each(|k| pose[k] *= unit);
            let camera = CameraModel { world_from_camera: Some(RigidTransform(pose)), ..frame.camera.clone() };
            segment(&Frame { camera, ..frame.clone() }, &Settings::default()).unwrap().meta.warnings
        };
        assert!(warned(1.0).is_empty(), "{:?}", warned(1.0));
        let on_a_map = Isometry3::translation(300.0, -200.0, 2.0) * world_from_camera;
        let camera = CameraModel { world_from_camera: Some(RigidTransform(to_row_major(&on_a_map))), ..frame.camera.clone() };
        let scene = segment(&Frame { camera, ..frame.clone() }, &Settings::default()).unwrap();
        assert!(scene.meta.warnings.is_empty(), "{:?}", scene.meta.warnings);
        let told = warned(1000.0);
        assert!(told.len() == 1 && told[0].field == "world_from_camera" && told[0].message.contains("860 m"), "{told:?}");
    }

    #[test]
    fn what_lies_farther_than_a_scene_reaches_is_refused_and_what_does_not_can_be_read() {
        let (frame, world_from_camera) = frame();
        let seen_from = |east_m: f64| {
            let mut pose = to_row_major(&world_from_camera);
            pose[3] += east_m;
            let camera = CameraModel { world_from_camera: Some(RigidTransform(pose)), ..frame.camera.clone() };
            segment(&Frame { camera, ..frame.clone() }, &Settings::default())
        };
        let scene = seen_from(900.0).unwrap();
        assert!(Scene::from_bulk(&scene.to_bulk()).is_ok());
        for east_m in [1000.0, -1100.0, 500_000.0, 1e300] {
            let error = CallError::from(seen_from(east_m).unwrap_err());
            assert_eq!(error.field.as_deref(), Some("world_from_camera"), "{error}");
        }
    }

    #[test]
    fn masks_that_label_the_table_are_doubted_and_the_pose_is_not() {
        let (mut frame, truth) = frame();
        frame.labels.iter_mut().flatten().filter(|id| **id == 0).for_each(|id| *id = 5);
        let posed = CameraModel { world_from_camera: Some(RigidTransform(to_row_major(&truth))), ..frame.camera.clone() };
        for camera in [posed, frame.camera.clone()] {
            let warned = segment(&Frame { camera, ..frame.clone() }, &Settings::default()).unwrap().meta.warnings;
            assert!(warned.len() == 1 && warned[0].field == "labels" && warned[0].message.starts_with("label 5 "), "{warned:?}");
        }
    }

    #[test]
    fn what_a_mask_holds_of_the_table_is_no_surface_of_its_object() {
        let (mut frame, _) = frame_of(&[Solid::table(0.0), Solid::cuboid([0.0, 0.1, 0.1], [0.2, 0.15, 0.1])]);
        // As through the handle of something large: less than a twentieth of the mask.
        let is_held = |i: usize| (20..44).contains(&(i % 320)) && (200..224).contains(&(i / 320));
        frame.labels.iter_mut().flatten().enumerate().filter(|(i, _)| is_held(*i)).for_each(|(_, id)| *id = 9);
        let scene = segment(&frame, &Settings::default()).unwrap();
        assert!(scene.points_of(9).all(|p| p[1] > 0.5), "they are none of its points");
        let tops: Vec<f64> = scene.meta.surfaces.iter().filter(|s| s.object == Some(9)).map(|s| s.height_m).collect();
        assert!(tops.len() == 1 && (tops[0] - 0.2).abs() < 0.005, "{:?}", scene.meta.surfaces);
    }

    #[test]
    fn depth_in_a_larger_picture_is_used_and_told_of() {
        let (mut frame, _) = frame();
        for (_, count) in frame.depth.iter_mut().enumerate().filter(|(i, _)| i % 2 != 0 || i / 320 % 2 != 0) {
            *count = 0;
        }
        let scene = segment(&frame, &Settings { coarse_columns: 160, ..Settings::default() }).unwrap();
        assert_eq!(scene.meta.unseen.pixels_flying, 0);
        assert!(scene.meta.warnings.iter().any(|warning| warning.field == "depth"), "{:?}", scene.meta.warnings);
    }

    #[test]
    fn a_pose_two_degrees_off_loses_nothing_of_the_table_and_is_doubted() {
        let solids = [Solid::cuboid([0.0, 0.1, -0.01], [0.5, 0.5, 0.01]), Solid::cuboid([0.05, 0.0, 0.04], [0.06, 0.05, 0.04])];
        let (frame, truth) = frame_of(&solids);
        let seen = |tilt_deg: f64| {
            let pose = Isometry3::rotation(Vector3::x() * tilt_deg.to_radians()) * truth;
            let camera = CameraModel { world_from_camera: Some(RigidTransform(to_row_major(&pose))), ..frame.camera.clone() };
            let meta = segment(&Frame { camera, ..frame.clone() }, &Settings::default()).unwrap().meta;
            let furniture: Vec<f64> = meta.surfaces.iter().filter(|s| s.object.is_none()).map(|s| s.area_m2).collect();
            assert_eq!(furniture.len(), 1, "{tilt_deg}: {:?}", meta.surfaces);
            (furniture[0], meta.warnings)
        };
        let ((level_m2, none), (tilted_m2, told)) = (seen(0.0), seen(2.0));
        assert!(none.is_empty() && (tilted_m2 / level_m2 - 1.0).abs() < 0.02, "{none:?}, {tilted_m2} of {level_m2}");
        assert!(told.len() == 1 && told[0].field == "world_from_camera" && told[0].message.contains("slopes by 2.0°"), "{told:?}");
    }

    #[test]
    fn a_band_is_as_wide_in_readings_where_every_pixel_is_there_twice_in_both_directions() {
        let (own, _) = frame();
        let mut depth = own.depth.clone();
        // Where the box begins, in its rows, a pixel mixes it with what is behind, if that is 6 cm farther.
        for (i, id) in own.labels.iter().flatten().enumerate().skip(1) {
            let (near, far) = (own.depth[i], own.depth[i - 1]);
            if *id == 9 && own.labels.as_ref().is_some_and(|labels| labels[i - 1] == 0) && far > near + 600 {
                depth[i] = near + (far - near) / 2;
            }
        }
        let own = Frame { depth, color: None, ..own };
        let doubled = |picture: &[u16]| (0..640 * 480).map(|i| picture[i / 640 / 2 * 320 + i % 640 / 2]).collect::<Vec<u16>>();
        let camera = CameraModel { width: 640, height: 480, fx: 524.0, fy: 524.0, cx: 319.5, cy: 239.5, ..own.camera.clone() };
        let twice = Frame { camera, depth: doubled(&own.depth), labels: own.labels.as_deref().map(doubled), ..own.clone() };
        let [own, twice] = [own, twice].map(|frame| segment(&frame, &Settings::default()).unwrap());
        let told = |scene: &Scene, times: usize| {
            [scene.points_of(9).count(), scene.meta.unseen.pixels_on_borders, scene.meta.unseen.pixels_flying].map(|n| n * times)
        };
        assert_eq!(told(&twice, 1), told(&own, 4));
        assert!(own.meta.unseen.pixels_flying > 5, "{:?}", told(&own, 1));
    }

    #[test]
    fn what_cannot_be_segmented_says_why() {
        let (frame, _) = frame();
        let field = |frame: Frame| CallError::from(segment(&frame, &Settings::default()).unwrap_err()).field;
        assert_eq!(field(Frame { depth: vec![0; 320 * 240], ..frame.clone() }).as_deref(), Some("depth"));
        assert_eq!(field(Frame { labels: Some(vec![1; 7]), ..frame.clone() }).as_deref(), Some("labels"));
        assert_eq!(
            field(Frame { labels: Some((0..320 * 240).map(|i| (i % 2) as u16).collect()), ..frame.clone() }).as_deref(),
            Some("labels")
        );
        // A ceiling half a metre above the camera, and nothing else.
        let ceiling = (0..320 * 240)
            .map(|i| 119.5 - f64::from(i / 320))
            .map(|up| if up > 0.0 { (0.5 * 262.0 / up * 1e4).min(6e4) as u16 } else { 0 });
        assert_eq!(field(Frame { depth: ceiling.collect(), labels: None, ..frame }).as_deref(), Some("world_from_camera"));
    }

    #[test]
    fn a_hand_that_fills_the_picture_is_what_is_said_not_the_labels() {
        let (mut frame, truth) = frame();
        frame.camera.world_from_camera = Some(RigidTransform(to_row_major(&truth)));
        frame.robots = vec![repose_proto::RobotInView {
            name: "arm".to_owned(),
            model: "panda".to_owned(),
            joints_rad: repose_panda::READY,
            gripper_width_m: 0.04,
            holding: Some(false),
            world_from_base: RigidTransform::IDENTITY,
        }];
        let mut settings = Settings::default();
        // All that shows is this near to the arm.
        (settings.self_filter.margin_m, settings.self_filter.look_m) = (10.0, 10.0);
        let error = segment(&frame, &settings).unwrap_err();
        let readings = frame.depth.iter().filter(|count| **count > 0).count();
        assert!(matches!(error, SegmentError::RobotsOnly { readings: told } if told <= readings && told > readings / 2), "{error}");
        assert_eq!(CallError::from(error).field.as_deref(), Some("robots"));
    }

    proptest! {
        #[test]
        fn no_frame_makes_it_panic(
            width in 1usize..24, height in 1usize..24, seed in prop::collection::vec(0u16..3000, 24 * 24), labelled in 0u16..5,
            focal in prop::sample::select(vec![1e-300, 1.0, 30.0, 1e5]), center in prop::sample::select(vec![-1e300, 0.0, 10.0]), posed: bool,
        ) {
            let pixels = width * height;
            let camera = CameraModel {
                width, height, fx: focal, fy: focal, cx: center, cy: center, depth_unit_m: 0.001,
                world_from_camera: posed.then_some(RigidTransform::IDENTITY),
            };
            let labels = (labelled > 0).then(|| seed[..pixels].iter().map(|s| (s / 400) % labelled).collect());
            let frame = Frame { labels, ..Frame::new("test".to_owned(), 0, camera, seed[..pixels].to_vec()) };
            let mut settings = Settings { min_object_points: 1, ..Settings::default() };
            settings.components.min_pixels = 1;
            settings.components.halves.min_run_px = 0;
            if let Ok(scene) = segment(&frame, &settings) {
                prop_assert!(scene.points.as_flattened().iter().all(|c| c.is_finite()));
                prop_assert!(Scene::from_bulk(&scene.to_bulk()).is_ok());
            }
        }
    }
}
