//! Whether a placed object would be seen: the in-view constraint Π of the paper (equation 5), with occlusion.
//!
//! The picture is rebuilt from the scene's points. Pixels without a point, and those that the query covered before, are unknown: they
//! hide nothing. The same picture tells whether a place was seen to be empty, seen to be a surface, or hidden.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Point2, Point3, Vector2, Vector3};
use repose_geometry::{Image, Pinhole};
use repose_proto::CameraModel;
use repose_simd::InstructionSet;

use crate::meeting::{Edges, Meeting};
use crate::projection::{BLOCK, IntoCamera, NOWHERE, Projected, Projecting, fill};
use crate::settings::ViewSettings;

/// How much farther than a free place what was seen behind it must be, metres: depth is as uncertain.
const BEHIND_M: f32 = 0.008;
/// How much nearer than an object's outline what hides more of it is, metres: more than depth is uncertain by.
const NEARER_M: f32 = 0.015;
/// A fall that shows which way is down in the picture, metres.
const FALL_M: f64 = 0.01;
/// How many pixels around one without a reading are asked: cleaning takes two or three off each border.
const RINGS: usize = 4;

/// What the camera saw at one pixel.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Pixel {
    /// Along the optical axis, metres; 0 without a reading.
    pub depth_m: f32,
    /// Height of the point, world z, metres.
    pub height_m: f32,
    /// Whose it is, 0 for furniture.
    pub object: u16,
}

/// What is beside a pixel in the picture.
enum Beyond {
    /// The nearest pixel with a reading.
    Read(Pixel),
    /// The picture's edge.
    Edge,
    /// No reading near enough to tell.
    Nothing,
}

/// What the picture says of a place in the world.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sight {
    /// A surface was seen there, and whose it is.
    Surface(u16),
    /// The camera looked through it: nothing is there.
    Empty,
    /// Hidden, outside the picture, or without a reading.
    Unknown,
}

/// The depth reading in the direction of a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthReading {
    /// Whose surface it met, 0 for furniture.
    pub object: u16,
    /// How far behind the place that surface is, along the optical axis, metres; negative: it hides the place.
    pub behind_m: f32,
}

/// How well a cloud would be seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Visibility {
    /// Share of the points that fall in the picture.
    pub in_picture: f64,
    /// Share of the points that nothing observed hides (of all; a point outside the picture counts as hidden).
    pub unhidden: f64,
}

/// What an object's outline in the picture ends at.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct OutlineEnds {
    /// Share of it that ends at the picture's edge.
    pub cut_off: f64,
    /// Share of it that ends at something nearer, which may hide more of the object.
    pub hidden: f64,
}

/// The camera's picture of a scene.
#[derive(Debug, Clone)]
pub struct ObservedView {
    camera: Pinhole,
    camera_from_world: Isometry3<f64>,
    /// Focal length of the camera's own picture, pixels.
    focal_px: f32,
    pixels: Image<Pixel>,
    instruction_set: InstructionSet,
}

impl ObservedView {
    /// The picture that the points (world frame) make in a camera; `columns` at most.
    pub fn new(points: &[[f32; 3]], labels: &[u16], model: &CameraModel, world_from_camera: &Isometry3<f64>, columns: usize) -> Self {
        let whole = Pinhole { width: model.width, height: model.height, fx: model.fx, fy: model.fy, cx: model.cx, cy: model.cy };
        let camera = whole.shrunk(columns);
        let camera_from_world = world_from_camera.inverse();
        let mut pixels = Image::filled(camera.width, camera.height, Pixel::default());
        for (p, object) in points.iter().zip(labels) {
            let in_camera = camera_from_world * Point3::from(*p).cast::<f64>();
            if let Some(at) = camera.pixel_of(&in_camera) {
                let (pixel, depth_m) = (&mut pixels[at], in_camera.z as f32);
                if pixel.depth_m == 0.0 || depth_m < pixel.depth_m {
                    *pixel = Pixel { depth_m, height_m: p[2], object: *object };
                }
            }
        }
        Self { camera, camera_from_world, focal_px: model.fy as f32, pixels, instruction_set: InstructionSet::detect() }
    }

    /// Where the camera is, world frame, metres.
    pub fn eye(&self) -> Point3<f32> {
        Point3::from(self.camera_from_world.inverse().translation.vector.cast())
    }

    /// The picture.
    pub(crate) fn pixels(&self) -> &Image<Pixel> {
        &self.pixels
    }

    /// The camera of the picture.
    pub(crate) fn camera(&self) -> &Pinhole {
        &self.camera
    }

    /// How far up a ray goes through a place in the picture, pixels, per metre along the optical axis.
    pub(crate) fn rise(&self, u: f64, v: f64) -> f64 {
        let ray = self.camera.unproject(u, v, 1.0).coords;
        self.camera_from_world.inverse().rotation.transform_vector(&ray).z
    }

    /// Focal length of the camera's own picture, pixels.
    pub fn focal_px(&self) -> f32 {
        self.focal_px
    }

    /// How wide a border of so many pixels is at a place (world frame), metres across the line of sight; at most as far as the place is away, however
    /// short the focal length.
    pub fn border_m(&self, place: &Point3<f32>, border_px: f32) -> f32 {
        let distance_m = (place - self.eye()).norm();
        (border_px * distance_m / self.focal_px).min(distance_m)
    }

    /// What the camera read in the direction of a place (world frame); none outside the picture or without a reading.
    pub fn reading(&self, place: &Point3<f32>) -> Option<DepthReading> {
        let in_camera = self.camera_from_world * place.cast::<f64>();
        let pixel = self.camera.pixel_of(&in_camera).map(|at| &self.pixels[at]).filter(|p| p.depth_m > 0.0)?;
        Some(DepthReading { object: pixel.object, behind_m: pixel.depth_m - in_camera.z as f32 })
    }

    /// Whether a place (world frame) is within the picture's edges.
    pub fn shows(&self, place: &Point3<f32>) -> bool {
        self.camera.pixel_of(&(self.camera_from_world * place.cast::<f64>())).is_some()
    }

    /// Whether a place (world frame) is within the picture's edges, and the camera read nothing in its direction.
    pub fn is_unread(&self, place: &Point3<f32>) -> bool {
        self.camera.pixel_of(&(self.camera_from_world * place.cast::<f64>())).is_some_and(|at| self.pixels[at].depth_m <= 0.0)
    }

    /// Whether the camera saw past a place (world frame): something lies clearly behind it.
    ///
    /// Pixels without a reading (borders of objects are cleaned away) take the word of the nearest thing around them.
    pub fn is_free(&self, place: &Point3<f32>) -> bool {
        let in_camera = self.camera_from_world * place.cast::<f64>();
        let nearest_m = self.camera.pixel_of(&in_camera).and_then(|at| self.nearest_around_m(at));
        nearest_m.is_some_and(|read_m| read_m > in_camera.z as f32 + BEHIND_M)
    }

    /// The nearest of the readings at a pixel, or of those on the smallest ring around it that has any; none where that is too large.
    fn nearest_around_m(&self, (u, v): (usize, usize)) -> Option<f32> {
        (0..=RINGS).find_map(|ring| {
            let columns = || u.saturating_sub(ring)..=(u + ring).min(self.camera.width - 1);
            let rows = v.saturating_sub(ring)..=(v + ring).min(self.camera.height - 1);
            let read = rows.flat_map(|y| columns().map(move |x| (x, y))).map(|at| self.pixels[at].depth_m).filter(|depth_m| *depth_m > 0.0);
            read.reduce(f32::min)
        })
    }

    /// What is seen right under a point of an object in the picture, up to `rows` further down, if it is level: whose, and where (world
    /// frame). It is level where a third as many rows further down still show the same thing at the same height.
    pub fn level_under(&self, point: &Point3<f32>, object: u16, rows: usize, level_m: f32) -> Option<(u16, Point3<f32>)> {
        let in_camera = self.camera_from_world * point.cast::<f64>();
        let from = self.camera.pixel_of(&in_camera)?;
        let down = self.step_down(&in_camera)?;
        let is_other = |at: &(usize, usize)| self.pixels[*at].depth_m > 0.0 && self.pixels[*at].object != object;
        let (k, at) = (1..=rows).find_map(|k| Some((k, self.stepped(from, down, k).filter(is_other)?)))?;
        let (near, further) = (&self.pixels[at], &self.pixels[self.stepped(from, down, k + rows / 3)?]);
        let is_level = further.object == near.object && further.depth_m > 0.0 && (further.height_m - near.height_m).abs() <= level_m;
        is_level.then(|| (near.object, self.place_of(at.0, at.1, near.depth_m)))
    }

    /// A step of a pixel down in the picture from a place (camera frame): to the row below, unless the camera is rolled so far that things fall
    /// across the rows. Looking straight down it is not rolled.
    pub(crate) fn step_down(&self, in_camera: &Point3<f64>) -> Option<Vector2<f64>> {
        let down = (self.camera_from_world.rotation * -Vector3::<f64>::z()).xy();
        let looks_down = down.norm() < 5f64.to_radians().sin();
        if looks_down || down.y >= down.norm() * 20f64.to_radians().cos() {
            return Some(Vector2::y());
        }
        self.falls(in_camera, self.camera.project(in_camera)?)
    }

    /// The direction in which the picture shows something fall from a place (camera frame) that it shows at a pixel; none where it stays there.
    fn falls(&self, in_camera: &Point3<f64>, at: Point2<f64>) -> Option<Vector2<f64>> {
        let fall = self.camera_from_world.rotation * (-Vector3::z() * FALL_M);
        self.camera.project(&(in_camera + fall)).and_then(|to| (to - at).try_normalize(1e-9))
    }

    /// The pixel so many steps away from another one; none outside the picture.
    fn stepped(&self, (u, v): (usize, usize), step: Vector2<f64>, count: usize) -> Option<(usize, usize)> {
        let (u, v) = ((u as f64 + step.x * count as f64).round(), (v as f64 + step.y * count as f64).round());
        let (u, v) = (u >= 0.0 && v >= 0.0).then_some((u as usize, v as usize))?;
        (u < self.camera.width && v < self.camera.height).then_some((u, v))
    }

    /// The place of a pixel's reading, world frame.
    fn place_of(&self, u: usize, v: usize, depth_m: f32) -> Point3<f32> {
        let in_camera = self.camera.unproject(u as f64, v as f64, f64::from(depth_m));
        (self.camera_from_world.inverse() * in_camera).cast()
    }

    /// Where the picture of each object ends: its own place there, and the next reading beyond it, up to `rows` pixels away. At the picture's edge,
    /// and where nothing was read beyond, nothing is told.
    pub fn edges(&self, rows: usize) -> BTreeMap<u16, Edges> {
        let width = self.camera.width;
        let mut edges: BTreeMap<u16, Edges> = BTreeMap::new();
        for (i, pixel) in self.pixels.pixels().iter().enumerate().filter(|(_, pixel)| pixel.depth_m > 0.0 && pixel.object != 0) {
            let at = [i % width, i / width];
            if self.is_inside(at, pixel.object) {
                continue;
            }
            let (u, v) = (at[0] as f64, at[1] as f64);
            let own = self.camera.unproject(u, v, f64::from(pixel.depth_m));
            let Some(down) = self.falls(&own, Point2::new(u, v)) else { continue };
            let aside = Vector2::new(-down.y, down.x);
            let meeting = |step: Vector2<f64>| self.meeting(at, pixel, step, rows);
            let of = edges.entry(pixel.object).or_default();
            of.lower.extend(meeting(down));
            of.upper.extend(meeting(-down));
            of.sides.extend(meeting(aside).into_iter().chain(meeting(-aside)));
        }
        edges
    }

    /// Whether all pixels around one are the same object's.
    fn is_inside(&self, [u, v]: [usize; 2], object: u16) -> bool {
        let (width, height) = (self.camera.width, self.camera.height);
        let is_own = |u: usize, v: usize| self.pixels.get(u, v).is_some_and(|p| p.depth_m > 0.0 && p.object == object);
        let is_within = u > 0 && v > 0 && u + 1 < width && v + 1 < height;
        is_within && (v - 1..=v + 1).all(|v| (u - 1..=u + 1).all(|u| is_own(u, v)))
    }

    /// The next reading from a pixel on in steps of one, if it is not the same object's.
    fn meeting(&self, [u, v]: [usize; 2], pixel: &Pixel, step: Vector2<f64>, rows: usize) -> Option<Meeting> {
        let is_read = |at: &(usize, usize)| self.pixels[*at].depth_m > 0.0;
        let (to_u, to_v) = (1..=rows).find_map(|k| self.stepped((u, v), step, k).filter(is_read))?;
        let beyond = &self.pixels[(to_u, to_v)];
        let meets = beyond.object != pixel.object;
        meets.then(|| Meeting {
            object: beyond.object,
            own: self.place_of(u, v, pixel.depth_m),
            beyond: self.place_of(to_u, to_v, beyond.depth_m),
        })
    }

    /// What an object's outline in the picture ends at, row by row and column by column.
    ///
    /// Cleaning takes a few pixels off each border, so that what is beyond it is looked for that far away.
    pub fn outline_ends(&self, object: u16) -> OutlineEnds {
        let width = self.camera.width;
        let own = self.pixels.pixels().iter().enumerate().filter(|(_, pixel)| pixel.depth_m > 0.0 && pixel.object == object);
        let (mut all, mut cut_off, mut hidden) = (0usize, 0usize, 0usize);
        for ((i, pixel), towards) in own.flat_map(|own| [[1, 0], [-1, 0], [0, 1], [0, -1]].map(|towards| (own, towards))) {
            match self.beyond([i % width, i / width], towards) {
                Beyond::Read(other) if other.object == object => continue,
                Beyond::Read(other) => hidden += usize::from(other.depth_m + NEARER_M < pixel.depth_m),
                Beyond::Edge => cut_off += 1,
                Beyond::Nothing => {}
            }
            all += 1;
        }
        let share = |count: usize| count as f64 / all.max(1) as f64;
        OutlineEnds { cut_off: share(cut_off), hidden: share(hidden) }
    }

    /// The next reading beside a pixel in a direction.
    fn beyond(&self, [u, v]: [usize; 2], [du, dv]: [isize; 2]) -> Beyond {
        for step in 1..=2 * RINGS as isize {
            let at = u.checked_add_signed(step * du).zip(v.checked_add_signed(step * dv));
            match at.and_then(|(u, v)| self.pixels.get(u, v)) {
                None => return Beyond::Edge,
                Some(pixel) if pixel.depth_m > 0.0 => return Beyond::Read(*pixel),
                Some(_) => {}
            }
        }
        Beyond::Nothing
    }

    /// How well points (world frame) of the `query` would be seen, moved by `placed_from_observed`.
    pub fn visibility(
        &self,
        points: &[Point3<f64>],
        placed_from_observed: &Isometry3<f64>,
        query: u16,
        settings: &ViewSettings,
    ) -> Visibility {
        let (n, mut inside, mut unhidden) = (points.len(), 0usize, 0usize);
        let motion = IntoCamera::new(&(self.camera_from_world * placed_from_observed));
        self.project(points, &motion, |pixel, depth_m| {
            let Some(pixel) = pixel else { return };
            inside += 1;
            let known = pixel.depth_m > 0.0 && pixel.object != query;
            unhidden += usize::from(!known || depth_m as f32 <= pixel.depth_m + settings.behind_m);
        });
        let share = |count: usize| count as f64 / n.max(1) as f64;
        Visibility { in_picture: share(inside), unhidden: share(unhidden) }
    }

    /// What the picture says of places (world frame): a surface within `tolerance_m` of their height, empty where it was seen at least `through_m` past
    /// them, or unknown; in their order.
    ///
    /// Points of `without` are not surfaces to stand on, but what is seen through their place is still seen.
    pub fn sights(&self, places: &[Point3<f64>], tolerance_m: f32, through_m: f32, without: u16) -> Vec<Sight> {
        let mut sights = Vec::with_capacity(places.len());
        self.project(places, &IntoCamera::new(&self.camera_from_world), |pixel, depth_m| {
            let height_m = places[sights.len()].z as f32;
            sights.push(match pixel.filter(|p| p.depth_m > 0.0) {
                None => Sight::Unknown,
                Some(p) if p.depth_m > depth_m as f32 + through_m => Sight::Empty,
                // At flat lines of sight what was seen behind a place before an edge, the face below it, is hardly lower.
                Some(p) if p.depth_m > depth_m as f32 + BEHIND_M => Sight::Unknown,
                Some(p) if p.object != without && (p.height_m - height_m).abs() <= tolerance_m => Sight::Surface(p.object),
                Some(_) => Sight::Unknown,
            });
        });
        sights
    }

    /// Tells the pixel of each point, none outside the picture, and how far away the point is along the optical axis.
    #[inline]
    fn project(&self, points: &[Point3<f64>], motion: &IntoCamera, mut tell: impl FnMut(Option<&Pixel>, f64)) {
        let mut columns = [[0.0; BLOCK]; 3];
        for points in points.chunks(BLOCK) {
            fill(&mut columns, points);
            let work = Projecting { points: &columns, motion, camera: &self.camera };
            let Projected { pixels, depths_m } = self.instruction_set.run(work);
            for (pixel, depth_m) in pixels.into_iter().zip(depths_m).take(points.len()) {
                tell((pixel != NOWHERE).then(|| &self.pixels.pixels()[pixel as usize]), depth_m);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use repose_geometry::transform::look_at;
    use repose_made_scenes::{SceneBuilder, world_from_camera};

    use super::*;
    use crate::settings::MeetingSettings;

    #[test]
    fn a_place_on_the_table_is_a_surface_behind_a_box_unknown_and_in_the_air_empty() {
        let scene = SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.15]).scene();
        let view = ObservedView::new(&scene.points, &scene.labels, &scene.meta.camera, &world_from_camera(), 640);
        let sight = |x: f64, y: f64, z: f64| view.sights(&[Point3::new(x, y, z)], 0.008, 0.03, 9)[0];
        assert_eq!(sight(0.2, 0.0, 0.0), Sight::Surface(0));
        assert_eq!(sight(0.0, 0.0, 0.15), Sight::Surface(1));
        assert_eq!(sight(0.2, 0.0, 0.1), Sight::Empty);
        assert_eq!(sight(0.0, 0.1, 0.0), Sight::Unknown);
        assert_eq!(sight(5.0, 0.0, 0.0), Sight::Unknown);
    }

    #[test]
    fn a_border_is_wider_farther_away_and_in_smaller_pictures() {
        let camera = |fy| CameraModel { fy, ..SceneBuilder::table().scene().meta.camera };
        let view = |fy| ObservedView::new(&[], &[], &camera(fy), &world_from_camera(), 640);
        let is = |value: f32, expected: f32| assert!((value - expected).abs() < 1e-6, "{value}, not {expected}");
        let eye = view(600.0).eye();
        let away = |m: f32| eye - Vector3::z() * m;
        is(view(600.0).border_m(&away(1.2), 2.5), 0.005);
        is(view(600.0).border_m(&away(2.4), 2.5), 0.01);
        is(view(300.0).border_m(&away(1.2), 2.5), 0.01);
        is(view(1e-300).border_m(&away(1.2), 2.5), 1.2);
    }

    #[test]
    fn a_board_that_is_looked_at_flatly_ends_at_its_edge_and_not_where_the_face_below_it_is_seen() {
        // A board 3 cm thick and its front, every 4 mm, from 10 cm above it and half a metre away.
        let across = || (-50..=50).map(|x| x as f32 * 0.004);
        let top = across().flat_map(|x| (0..=60).map(move |y| [x, y as f32 * 0.004, 0.0]));
        let front = across().flat_map(|x| (1..=7).map(move |z| [x, 0.0, z as f32 * -0.004]));
        let points: Vec<[f32; 3]> = top.chain(front).collect();
        let camera = CameraModel {
            width: 320,
            height: 240,
            fx: 240.0,
            fy: 240.0,
            cx: 159.5,
            cy: 119.5,
            depth_unit_m: 0.001,
            world_from_camera: None,
        };
        let held = look_at(&Point3::new(0.0, -0.5, 0.1), &Point3::origin(), &Vector3::z());
        let view = ObservedView::new(&points, &vec![0; points.len()], &camera, &held, 80);
        const PLACES: usize = 81;
        let surfaces = |y: f64| {
            let there: Vec<Point3<f64>> = (0..PLACES).map(|k| Point3::new(0.002 * (k as f64 - 40.0), y, 0.0)).collect();
            view.sights(&there, 0.008, 0.025, 9).iter().filter(|sight| matches!(sight, Sight::Surface(_))).count()
        };
        assert!(surfaces(0.04) * 10 > PLACES * 9, "{} of {PLACES}", surfaces(0.04));
        for before_m in [0.015, 0.02, 0.03, 0.04] {
            assert_eq!(surfaces(-before_m), 0, "{before_m} m before the edge");
        }
    }

    #[test]
    fn what_stands_behind_something_is_hidden_unless_the_query_itself_was_there() {
        let scene = SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.15]).scene();
        let view = ObservedView::new(&scene.points, &scene.labels, &scene.meta.camera, &world_from_camera(), 640);
        let points: Vec<Point3<f64>> = (0..20).map(|i| Point3::new(-0.02 + 0.002 * f64::from(i), 0.09, 0.02)).collect();
        let moved = |y: f64, x: f64| Isometry3::translation(x, y, 0.0);
        let settings = ViewSettings::default();
        assert!(view.visibility(&points, &moved(0.0, 0.0), 2, &settings).unhidden < 0.1);
        assert_eq!(view.visibility(&points, &moved(0.0, 0.0), 1, &settings).unhidden, 1.0);
        assert_eq!(view.visibility(&points, &moved(-0.2, 0.0), 2, &settings).unhidden, 1.0);
        assert_eq!(view.visibility(&points, &moved(0.0, 3.0), 2, &settings).in_picture, 0.0);
    }

    #[test]
    fn the_lower_edge_of_a_load_touches_its_carrier_however_the_camera_is_held() {
        let scene =
            SceneBuilder::table().object(1, [0.0, 0.0], [0.12, 0.12, 0.1]).object_at(2, [0.0, 0.0], 0.1, [0.06, 0.06, 0.08]).scene();
        let settings = MeetingSettings::default();
        for roll_rad in [0.0, 1.2, 2.8] {
            let held = world_from_camera() * nalgebra::UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll_rad);
            let mut camera = scene.meta.camera.clone();
            (camera.width, camera.height, camera.cx, camera.cy) = (400, 400, 199.5, 199.5);
            let view = ObservedView::new(&scene.points, &scene.labels, &camera, &held, 640);
            let edges = view.edges(settings.rows);
            // A few pixels of sides, which are jagged in a picture that is turned, have something else below.
            let is_most = |edge: &[Meeting], keep: &dyn Fn(&&Meeting) -> bool| edge.iter().filter(keep).count() * 3 >= edge.len() * 2;
            let (of_load, of_carrier) = (&edges[&2].lower, &edges[&1].lower);
            assert!(is_most(of_load, &|m| m.object == 1 && m.is_contact(&settings)), "{roll_rad}: {of_load:?}");
            assert!(is_most(of_carrier, &|m| m.object == 0), "{roll_rad}: {of_carrier:?}");
            let at_load = edges[&1].upper.iter().filter(|m| m.object == 2 && m.reversed().is_contact(&settings)).count();
            assert!(at_load > 5, "{roll_rad}: {at_load} of {}", edges[&1].upper.len());
        }
    }

    #[test]
    fn the_top_under_a_loads_lowest_points_is_found_however_the_camera_is_held() {
        let scene = SceneBuilder::table().object(1, [0.0, 0.0], [0.2, 0.2, 0.1]).object_at(2, [0.0, 0.0], 0.1, [0.06, 0.06, 0.08]).scene();
        let of_load = scene.points.iter().zip(&scene.labels).filter(|(p, label)| **label == 2 && p[2] < 0.106);
        let lowest: Vec<Point3<f32>> = of_load.map(|(p, _)| Point3::from(*p)).collect();
        let mut camera = scene.meta.camera.clone();
        (camera.width, camera.height, camera.cx, camera.cy) = (400, 400, 199.5, 199.5);
        for roll_rad in [0.0, 0.2, 1.2, 2.8] {
            let held = world_from_camera() * nalgebra::UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll_rad);
            let view = ObservedView::new(&scene.points, &scene.labels, &camera, &held, 640);
            let is_top = |p: &&Point3<f32>| {
                view.level_under(p, 2, 12, 0.004).is_some_and(|(object, under)| object == 1 && (under.z - 0.1).abs() < 0.004)
            };
            let found = lowest.iter().filter(is_top).count();
            // A picture that is turned has pixels without a point.
            assert!(lowest.len() > 10 && 2 * found >= lowest.len(), "{roll_rad}: {found} of {}", lowest.len());
        }
    }

    #[test]
    fn an_outline_is_hidden_by_what_lies_behind_and_cut_off_by_the_pictures_edge() {
        let scene = SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.15]).object(2, [0.04, 0.14], [0.1, 0.1, 0.1]).scene();
        let view = ObservedView::new(&scene.points, &scene.labels, &scene.meta.camera, &world_from_camera(), 640);
        let (near, far) = (view.outline_ends(1), view.outline_ends(2));
        assert!(near.hidden < 0.02 && near.cut_off == 0.0, "{near:?}");
        assert!(far.hidden > 0.1 && far.cut_off == 0.0, "{far:?}");
        let mut narrow = scene.meta.camera.clone();
        narrow.cx -= narrow.width as f64 / 2.0;
        let cut = ObservedView::new(&scene.points, &scene.labels, &narrow, &world_from_camera(), 640).outline_ends(1);
        assert!(cut.cut_off > 0.1, "{cut:?}");
        assert_eq!(view.outline_ends(9), OutlineEnds::default());
    }

    #[test]
    fn before_and_beside_an_object_is_free_and_behind_it_is_not_known() {
        let scene = SceneBuilder::table().object(1, [0.0, 0.0], [0.05, 0.05, 0.1]).scene();
        let view = ObservedView::new(&scene.points, &scene.labels, &scene.meta.camera, &world_from_camera(), 160);
        let free = |x: f32, y: f32| view.is_free(&Point3::new(x, y, 0.05));
        assert!(free(0.0, -0.06), "towards the camera");
        assert!(free(0.06, 0.0) && free(-0.06, 0.0), "to both sides");
        assert!(!free(0.0, 0.05) && !free(0.0, 0.0), "behind and inside");
        assert!(!free(0.0, -3.0), "behind the camera");
        let blind = ObservedView::new(&[], &[], &scene.meta.camera, &world_from_camera(), 160);
        assert!(!blind.is_free(&Point3::new(0.0, 0.0, 0.3)), "without points nothing is known");
    }
}
