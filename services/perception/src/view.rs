//! What a frame shows, before surfaces and objects are told: depth without stray readings and robots, the camera's pose, whose each pixel is.

use std::collections::BTreeSet;

use rand::SeedableRng;
use rand_pcg::Pcg64;
use repose_geometry::transform::from_row_major;
use repose_geometry::{Image, Isometry3, Pinhole};
use repose_proto::scene::WorldFrame;
use repose_proto::{CallError, Frame, limits};

use crate::error::SegmentError;
use crate::masks::stray;
use crate::objects::coarse::CoarsePicture;
use crate::objects::color::Rgb;
use crate::objects::find::Found;
use crate::objects::{holes, seen, spread};
use crate::readings::depth::DepthMap;
use crate::readings::flying::{self, Flying};
use crate::readings::point_map::{PointMap, strided};
use crate::robots::body::RobotBody;
use crate::robots::{held, self_filter};
use crate::settings::Settings;
use crate::supports::gravity;

/// A frame's depth readings with their camera's pose, robots removed.
pub struct DepthView {
    /// The camera, in full.
    pub camera: Pinhole,
    /// Its pose, given or estimated, metres.
    pub world_from_camera: Isometry3<f64>,
    /// Which of the two.
    pub world_frame: WorldFrame,
    /// The depth that is left.
    pub depth: DepthMap,
    /// The same before the robots' readings were taken out, metres.
    pub with_robots: Image<f32>,
    /// Pixels that had a reading, …
    pub readings: usize,
    /// … and how many of them lie between two surfaces.
    pub flying: usize,
    /// Whether most readings had none beside them.
    pub is_sparse: bool,
    /// The robots that were taken out.
    pub robots: self_filter::FilteredRobots,
    /// Whether the frame says whose each pixel is.
    is_labelled: bool,
    /// Every so many pixels one of the coarse picture.
    pub stride: usize,
    /// The coarse picture.
    pub coarse: CoarsePicture,
}

impl DepthView {
    /// The view that a frame shows.
    ///
    /// # Errors
    /// When the frame's depth or camera cannot be used, or nothing says which way is up.
    pub fn of(frame: &Frame, settings: &Settings) -> Result<Self, SegmentError> {
        let Readings { camera, mut depth, readings, flying: Flying { removed: flying, is_sparse } } = Readings::of(frame, settings)?;
        let given_pose = frame.camera.world_from_camera.map(|pose| from_row_major(&pose.0)).transpose()?;
        let with_robots = depth.depth_m().clone();
        let robots = self_filter::remove(&mut depth, &camera, &frame.robots, given_pose.as_ref(), &settings.self_filter);

        let stride = coarse_stride(&camera, settings.coarse_columns);
        let is_labelled = frame.labels.is_some();
        let in_camera = coarse_points(&depth, stride, is_labelled);
        let (world_from_camera, world_frame) = match given_pose {
            Some(pose) => (pose, WorldFrame::Extrinsics),
            None => (estimated_pose(&in_camera, settings)?, WorldFrame::SupportPlane),
        };
        check_reach(&depth, &world_from_camera)?;
        let coarse = CoarsePicture::new(in_camera, &world_from_camera, &camera, stride, settings);
        Ok(Self {
            camera,
            world_from_camera,
            world_frame,
            depth,
            with_robots,
            readings,
            flying,
            is_sparse,
            robots,
            is_labelled,
            stride,
            coarse,
        })
    }

    /// Whose each pixel is: as the frame says, else as it is found.
    ///
    /// # Errors
    /// When the frame's labels or colors are no picture.
    pub fn labelled(&mut self, frame: &Frame, settings: &Settings) -> Result<Found, SegmentError> {
        if let Some(labels) = &frame.labels {
            let labels = as_image(labels.clone(), &self.camera, "labels")?;
            let focal_px = self.camera.fx as f32 / self.depth.repeat_px() as f32;
            self.flying += stray::remove(&labels, self.depth.depth_m_mut(), focal_px, &settings.flying);
            self.coarse.leave_out_unread(self.depth.depth_m());
            return Ok(Found::objects(labels));
        }
        let colors = frame.color.clone().map(|colors| as_image(colors, &self.camera, "color")).transpose()?;
        let unread = self.with_robots.map(|z| z.is_nan());
        Ok(found(&self.coarse, &self.depth, &unread, colors.as_ref(), settings))
    }

    /// Takes out what a robot holds.
    pub fn leave_out_held(&mut self, labels: &mut Image<u16>, settings: &Settings) {
        let of_body =
            |(body, holding): &(RobotBody, Option<bool>)| held::labels(body, *holding, labels, &self.depth, &settings.self_filter);
        let held: BTreeSet<u16> = self.robots.bodies.iter().flat_map(of_body).collect();
        if !held.is_empty() {
            held::remove(&held, labels, &mut self.depth);
            let in_camera = coarse_points(&self.depth, self.stride, self.is_labelled);
            self.coarse = CoarsePicture::new(in_camera, &self.world_from_camera, &self.camera, self.stride, settings);
        }
    }
}

/// A frame's depth without what lies between two surfaces.
struct Readings {
    camera: Pinhole,
    depth: DepthMap,
    /// Pixels that had a reading, …
    readings: usize,
    /// … and which of them were taken out.
    flying: Flying,
}

impl Readings {
    fn of(frame: &Frame, settings: &Settings) -> Result<Self, SegmentError> {
        let model = &frame.camera;
        let camera = Pinhole { width: model.width, height: model.height, fx: model.fx, fy: model.fy, cx: model.cx, cy: model.cy };
        let mut depth = DepthMap::new(&frame.depth, model.depth_unit_m, &camera, settings.max_depth_m);
        let readings = depth.readings();
        let repeat_px = depth.repeat_px();
        let flying = flying::remove(depth.depth_m_mut(), repeat_px, camera.fx as f32, &settings.flying);
        if readings > flying.removed {
            return Ok(Self { camera, depth, readings, flying });
        }
        let nearest = frame.depth.iter().copied().filter(|count| Frame::is_reading(*count)).min();
        let nearest_m = nearest.map(|count| f64::from(count) * model.depth_unit_m).filter(|m| *m > f64::from(settings.max_depth_m));
        Err(SegmentError::NoReadings { pixels: depth.depth_m().pixels().len(), max_depth_m: settings.max_depth_m, nearest_m })
    }
}

/// Of how many columns, and rows, of a picture the coarse one has one: the fewest with which it has no more pixels than it may.
fn coarse_stride(camera: &Pinhole, coarse_columns: usize) -> usize {
    // 1.4 times as many as a picture of 4:3 with so many columns, so that wider and higher ones are not thinned much further.
    let most = (1.05 * (coarse_columns as f64).powi(2)).max(1.0) as usize;
    let longest = camera.width.max(camera.height).max(1);
    let has_few = |stride: &usize| camera.width.div_ceil(*stride) * camera.height.div_ceil(*stride) <= most;
    (1..longest).find(has_few).unwrap_or(longest)
}

/// The points of the coarse picture. Given masks say which pixel is whose; found ones follow the readings.
fn coarse_points(depth: &DepthMap, stride: usize, is_labelled: bool) -> PointMap {
    if is_labelled { depth.points(stride) } else { depth.points_of_blocks(stride) }
}

/// The objects of a frame that came without labels, on its full picture. `unread` pixels had no reading before the robots' were taken out.
fn found(coarse: &CoarsePicture, depth: &DepthMap, unread: &Image<bool>, colors: Option<&Image<Rgb>>, settings: &Settings) -> Found {
    let coarse_colors = colors.map(|colors| strided(colors, coarse.stride));
    let found = seen::objects(coarse, coarse_colors.as_ref(), settings);
    let mut ids = spread::spread(&found.ids, &coarse.in_camera, depth, coarse.stride);
    spread::fill_gaps(&mut ids, depth.depth_m(), settings.components.max_gap_px);
    if let Some(colors) = colors {
        holes::complete(&mut ids, unread, colors, &settings.components.holes);
    }
    Found { ids, ..found }
}

/// The camera's pose above the main support plane.
fn estimated_pose(in_camera: &PointMap, settings: &Settings) -> Result<Isometry3<f64>, SegmentError> {
    let mut rng = Pcg64::seed_from_u64(settings.seed);
    let plane = gravity::support_plane(in_camera, &settings.gravity, &mut rng)
        .ok_or(SegmentError::NoSupport { share: 100.0 * settings.gravity.min_share })?;
    Ok(gravity::level(&plane))
}

/// Refuses what may lie farther from the origin than a scene's points: whoever asked for such a scene would refuse it whole, point by point.
fn check_reach(depth: &DepthMap, world_from_camera: &Isometry3<f64>) -> Result<(), SegmentError> {
    let reach_m = world_from_camera.translation.vector.amax() + depth.farthest_m();
    if reach_m <= f64::from(limits::MAX_COORDINATE_M) { Ok(()) } else { Err(SegmentError::TooFar { reach_m }) }
}

/// The frame's field as a picture.
fn as_image<T>(pixels: Vec<T>, camera: &Pinhole, field: &str) -> Result<Image<T>, SegmentError> {
    Image::from_pixels(camera.width, camera.height, pixels).map_err(|e| SegmentError::Frame(CallError::invalid(field, e.to_string())))
}

#[cfg(test)]
mod tests {
    use repose_geometry::transform::{look_at, to_row_major};
    use repose_geometry::{Point3, Translation3, UnitQuaternion, Vector3};
    use repose_proto::{CameraModel, RigidTransform, RobotInView};

    use super::*;
    use crate::synthetic::{Solid, cast};

    #[test]
    fn taking_out_what_a_robot_holds_leaves_what_sparse_depth_shows_of_the_rest() {
        let turned = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let down = Isometry3::from_parts(Translation3::new(0.0, 0.0, 1.0), turned);
        let world_from_camera = Some(RigidTransform(to_row_major(&down)));
        let camera =
            CameraModel { width: 320, height: 240, fx: 262.0, fy: 262.0, cx: 159.5, cy: 119.5, depth_unit_m: 0.001, world_from_camera };
        // A table at 1 m and a thing of 40 pixels at 0.9 m, of which every second column and row was read.
        let is_thing = |i: usize| (140..180).contains(&(i % 320)) && (100..140).contains(&(i / 320));
        let count = |i: usize| match (i % 2, i / 320 % 2) {
            (0, 0) if is_thing(i) => 900,
            (0, 0) => 1000,
            _ => 0,
        };
        let frame = Frame::new("test".to_owned(), 0, camera, (0..320 * 240).map(count).collect());
        let settings = Settings { coarse_columns: 107, ..Settings::default() };
        let mut view = DepthView::of(&frame, &settings).unwrap();
        assert_eq!(view.stride, 3);
        let told = |view: &DepthView| view.coarse.depth_m.pixels().iter().filter(|z| !z.is_nan()).count();
        let before = told(&view);
        let hand = RobotBody { balls: Vec::new(), camera_from_tcp: Isometry3::translation(0.0, 0.0, 0.9), gripper_width_m: 0.04 };
        view.robots.bodies.push((hand, Some(true)));
        let mut labels = Image::from_pixels(320, 240, (0..320 * 240).map(|i| u16::from(is_thing(i))).collect()).unwrap();
        view.leave_out_held(&mut labels, &settings);
        assert!(labels.pixels().iter().all(|id| *id == 0), "it is held");
        let (after, held) = (told(&view), 46 * 46 / 9);
        assert!(after < before && after + held + 100 > before, "{after} of {before}");
    }

    #[test]
    fn a_box_beside_a_hand_that_holds_something_small_stays() {
        let robot = RobotInView {
            name: "arm".to_owned(),
            model: "panda".to_owned(),
            joints_rad: repose_panda::READY,
            gripper_width_m: 0.015,
            holding: Some(true),
            world_from_base: RigidTransform::IDENTITY,
        };
        // 1: a cube of 1.5 cm in the hand; 2: a box from 5 to 9 cm beside the grasp point. All that shows of the arm would be taken out.
        let grasp = repose_panda::base_from_tcp(&robot.joints_rad).translation.vector;
        let from_grasp = |away_m: [f64; 3], half_m: [f64; 3]| Solid::cuboid((grasp + Vector3::from(away_m)).into(), half_m);
        let solids = [Solid::table(0.0), from_grasp([0.0; 3], [0.0075; 3]), from_grasp([0.07, 0.0, -0.04], [0.02, 0.1, 0.06])];
        let (width, height, focal) = (320, 240, 262.0);
        let pinhole = Pinhole { width, height, fx: focal, fy: focal, cx: 159.5, cy: 119.5 };
        let pose = look_at(&Point3::from(grasp + Vector3::new(0.4, -0.4, 0.56)), &Point3::from(grasp), &Vector3::z());
        let seen = cast(&solids, &pinhole, &pose);
        let world_from_camera = Some(RigidTransform(to_row_major(&pose)));
        let camera = CameraModel { width, height, fx: focal, fy: focal, cx: 159.5, cy: 119.5, depth_unit_m: 0.001, world_from_camera };
        let depth = seen.pixels().iter().map(|hit| hit.map_or(0, |(z, _)| (z * 1e3).round() as u16)).collect();
        let labels = seen.pixels().iter().map(|hit| hit.map_or(0, |(_, solid)| solid as u16)).collect();
        let frame = Frame { labels: Some(labels), robots: vec![robot], ..Frame::new("test".to_owned(), 0, camera, depth) };
        let settings = Settings::default();
        let mut view = DepthView::of(&frame, &settings).unwrap();
        let mut ids = view.labelled(&frame, &settings).unwrap().ids;
        let readings = |view: &DepthView, ids: &Image<u16>, of: u16| {
            ids.pixels().iter().zip(view.depth.depth_m().pixels()).filter(|(id, z)| **id == of && !z.is_nan()).count()
        };
        let before = [1, 2].map(|id| readings(&view, &ids, id));
        assert!(before[0] == 0 && before[1] > 1000, "{before:?}: the cube is too near to the fingers to be told from them");
        view.leave_out_held(&mut ids, &settings);
        assert_eq!(readings(&view, &ids, 2), before[1]);
    }

    #[test]
    fn pictures_of_every_shape_are_thinned_to_about_as_many_pixels() {
        let stride = |width: usize, height: usize, columns: usize| {
            coarse_stride(&Pinhole { width, height, fx: 500.0, fy: 500.0, cx: 0.0, cy: 0.0 }, columns)
        };
        let of_cameras = [
            ((320, 240), 1),
            ((640, 480), 2),
            ((640, 576), 2),
            ((1280, 960), 4),
            ((480, 848), 2),
            ((848, 480), 2),
            ((1280, 720), 3),
            ((1920, 1080), 5),
        ];
        for ((width, height), expected) in of_cameras {
            assert_eq!(stride(width, height, 320), expected, "{width} x {height}");
        }
        assert_eq!([stride(160, 120, 160), stride(320, 240, 160), stride(7, 3, 1), stride(1, 1, 320)], [1, 2, 7, 1]);
    }
}
