//! What the fingers would close on at a pose, and whether hand and fingers have room around the object.
//!
//! All in the grasp centre's frame: fingers close along y, the hand comes along z. What the fingers close on is a run of the points between
//! the planes of the pads ([`super::run`]): a solid object across, a hollow one at a wall or across both.
//! A side that faces away from the camera ends later than it was seen to, by the border that was cleaned away: the fingers are centred on
//! where it is believed to end. One that would come down unseen, behind the object, gets all the room there is.

use std::cell::OnceCell;

use nalgebra::{Isometry3, Point3, Vector3};
use repose_belief::ObservedView;
use repose_geometry::footprint::ordinal;
use repose_panda::FINGER_OPENING_MAX_M;

use super::GraspCloud;
use super::contact::{
    SlabPoint, contact_depth_m, mean_slope_rad, outline_slope_rad, slope_rad, squareness, touched_normals, wall_turn_rad,
};
use super::run::{APART_M, closed_on};
use super::settings::GripperSettings;
use super::wedge::{self, Meeting};

/// How far the fingers reach beyond the grasp centre, metres.
pub const TIP_BEYOND_TCP_M: f64 = 0.013;
/// How far the grasp centre may be below the object's top, metres: then the palm touches it.
pub const DEPTH_MAX_M: f64 = 0.029;

/// What the fingers close on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GripperFit {
    /// How wide the object is believed to be between the fingers, metres.
    pub width_m: f64,
    /// Where the fingers close along y, metres: about its middle where they can, so that both come to it at the same time.
    pub offset_m: f64,
    /// How far from there along y the open hand comes down, metres: a finger that comes down unseen gets the room that the other does not need.
    pub aside_m: f64,
    /// Opening on approach, metres.
    pub opening_m: f64,
    /// How much of the surface that the fingers touch lies along the approach, on the side where that is more, metres.
    pub depth_m: f64,
    /// Mean alignment of the surface with the closing direction where the fingers touch, 0 to 1.
    pub squareness: f64,
    /// How much the surface where the fingers touch faces the hand, mean of both sides, radians: pressing on it pushes the object out of the
    /// fingers. A side that was not seen is taken for one like the other, and of something hollow for the other's back.
    pub slope_rad: f64,
    /// How far the pads turn a wall to lie flat against it, radians, and what is held with it. 0 where what is between them is no wall.
    pub turn_rad: f64,
    /// How the pads meet its outline.
    pub meeting: Meeting,
    /// Share of the worse finger that is seen to come down in free space, 0 to 1.
    pub seen: f64,
}

/// Why a pose is no grasp.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Misfit {
    /// Nothing lies between the fingers.
    Empty,
    /// The object is wider than the fingers open.
    TooWide,
    /// The fingers would slide off it.
    Slanted,
    /// A finger would run into the object.
    FingerBlocked,
    /// The palm would run into the object.
    PalmBlocked,
}

/// The hand's half sizes behind the fingers (x and y), metres.
const PALM_HALF_M: [f64; 2] = [0.03, 0.1];
/// How far behind the grasp centre fingers have left the hand, metres.
const FINGER_LENGTH_M: f64 = 0.045;

/// What is between the fingers at a pose, however far they open.
pub struct Between<'a> {
    world_from_tcp: &'a Isometry3<f64>,
    object: &'a GraspCloud,
    view: &'a ObservedView,
    settings: &'a GripperSettings,
    /// The object's points, and what is believed behind them, in the grasp centre's frame.
    points: Vec<Point3<f32>>,
    behind: OnceCell<Vec<Point3<f32>>>,
    /// The points between the planes of the pads, sorted along the closing direction, and those of them that the fingers close on.
    slab: Vec<SlabPoint>,
    run: std::ops::Range<usize>,
    believed: OnceCell<(f64, f64)>,
    contact: OnceCell<Contact>,
}

impl<'a> Between<'a> {
    /// With the grasp centre at `world_from_tcp`.
    ///
    /// # Errors
    /// [`Misfit::PalmBlocked`], or [`Misfit::Empty`].
    pub fn fingers(
        world_from_tcp: &'a Isometry3<f64>,
        object: &'a GraspCloud,
        view: &'a ObservedView,
        settings: &'a GripperSettings,
    ) -> Result<Self, Misfit> {
        let points = seen_from_tcp(&object.points, world_from_tcp);
        let slab = slab(&points, settings)?;
        let run = closed_on(&slab, settings).ok_or(Misfit::Empty)?;
        Ok(Self {
            world_from_tcp,
            object,
            view,
            settings,
            points,
            behind: OnceCell::new(),
            slab,
            run,
            believed: OnceCell::new(),
            contact: OnceCell::new(),
        })
    }

    /// What the fingers close on, with this much room beside the object on approach, metres.
    ///
    /// # Errors
    /// [`Misfit::TooWide`], or [`Misfit::FingerBlocked`].
    pub fn fit(&self, clearance_m: f64) -> Result<GripperFit, Misfit> {
        let Self { world_from_tcp, view, settings, slab, run, .. } = self;
        let seen_span = (slab[run.start].0.y, slab[run.end - 1].0.y);
        let facing = [-1.0, 1.0].map(|side| facing(&(world_from_tcp.rotation * Vector3::y() * side), world_from_tcp, view));
        let widest_m = settings.widest_m();
        if seen_span.1 - seen_span.0 > widest_m {
            return Err(Misfit::TooWide);
        }
        let (low, high) = *self.believed.get_or_init(|| self.believed_span(seen_span, facing));
        let width_m = high - low;
        if width_m > widest_m {
            return Err(Misfit::TooWide);
        }
        let needed_m = (width_m + 2.0 * clearance_m).min(FINGER_OPENING_MAX_M);
        let middle_m = 0.5 * (low + high);
        let seen_at = |y: f64, side: f64| seen_share(world_from_tcp, y, side, view, settings);
        let seen_with = |down_m: f64, opening_m: f64| [seen_at(down_m - 0.5 * opening_m, -1.0), seen_at(down_m + 0.5 * opening_m, 1.0)];
        let seen = seen_with(middle_m, needed_m);
        let unseen = seen.map(|share| share < settings.seen_min);
        // How wide open and how far off the middle the hand may come down, and how much of the worse finger is seen there, the best first.
        let aside = (unseen[0] != unseen[1]).then(|| {
            let away_m = if unseen[0] { -away_m(width_m, settings) } else { away_m(width_m, settings) };
            let seen = seen_with(middle_m + away_m, FINGER_OPENING_MAX_M);
            (FINGER_OPENING_MAX_M, away_m, seen[0].min(seen[1]))
        });
        let mut ways = aside.into_iter().chain([(needed_m, 0.0, seen[0].min(seen[1]))]);
        let come_down = |(opening_m, away_m, seen): (f64, f64, f64)| {
            let down_m = middle_m + away_m;
            if self.is_more_between(down_m, opening_m) {
                return None;
            }
            // As far as the fingers come towards the middle with room all the way for the one inside of something hollow.
            let come = CENTERED.into_iter().find(|come| self.has_room([down_m, middle_m + (1.0 - come) * away_m], opening_m))?;
            Some((opening_m, middle_m + (1.0 - come) * away_m, come * away_m, seen))
        };
        let (opening_m, offset_m, aside_m, seen) = ways.find_map(come_down).ok_or(Misfit::FingerBlocked)?;
        let Contact { depth_m, squareness, slope_rad, turn_rad, meeting } = *self.contact.get_or_init(|| self.contact(seen_span, facing));
        Ok(GripperFit { width_m, offset_m, aside_m, opening_m, depth_m, squareness, slope_rad, turn_rad, meeting, seen })
    }

    /// Whether the open fingers come down around more of the object than what they are to close on: the one that should be inside of something
    /// hollow would be beyond its other wall, and both would close on that, too.
    fn is_more_between(&self, down_m: f64, opening_m: f64) -> bool {
        let apart = self.slab[..self.run.start].iter().chain(&self.slab[self.run.end..]);
        apart.filter(|(p, _)| (p.y - down_m).abs() < 0.5 * opening_m).nth(self.settings.strays).is_some()
    }

    /// Whether neither of the open fingers meets the object as it was seen and is believed to be, as their middle goes from one place along y to
    /// another.
    fn has_room(&self, [from, to]: [f64; 2], opening_m: f64) -> bool {
        let (half_m, thick_m) = (0.5 * opening_m, self.settings.finger_thickness_m);
        let (low, high) = (from.min(to), from.max(to));
        let is_met = |p: &Vector3<f64>| {
            let by_upper = p.y >= low + half_m && p.y < high + half_m + thick_m;
            by_upper || p.y <= high - half_m && p.y > low - half_m - thick_m
        };
        let points = self.slab.iter().map(|(p, _)| *p).chain(self.behind_between_pads());
        points.filter(is_met).nth(self.settings.strays).is_none()
    }

    /// What is believed behind the object, between the planes of the pads.
    fn behind_between_pads(&self) -> impl Iterator<Item = Vector3<f64>> {
        self.behind().iter().map(|p| p.coords.cast::<f64>()).filter(|p| is_between_pads(p, self.settings))
    }

    /// What is believed behind the object, in the grasp centre's frame.
    fn behind(&self) -> &[Point3<f32>] {
        self.behind.get_or_init(|| seen_from_tcp(&self.object.behind, self.world_from_tcp))
    }

    /// Where what the fingers close on is believed to begin and to end. Behind a side that was seen alone the object goes on to its far side,
    /// unless it was seen to be hollow there; else what its border lost is missing.
    fn believed_span(&self, (low, high): (f64, f64), facing: [f64; 2]) -> (f64, f64) {
        let border_m = self.view.border_m(&Point3::from(self.world_from_tcp.translation.vector).cast(), self.settings.border_px);
        let believed = |extreme: f64, side: f64, facing: f64| {
            let cut_off = extreme + side * missing_m(facing, f64::from(border_m));
            if facing > FACING {
                return cut_off;
            }
            let beyond: Vec<f64> = self
                .behind_between_pads()
                .map(|p| side * (p.y - cut_off))
                .filter(|m| (APART_M..FINGER_OPENING_MAX_M).contains(m))
                .collect();
            let far = beyond.iter().copied().fold(0.0, f64::max);
            let is_solid = || {
                let place = |share: f64| self.world_from_tcp * Point3::new(0.0, cut_off + side * share * far, 0.0);
                [0.2, 0.4, 0.6, 0.8].into_iter().all(|share| !self.view.is_free(&place(share).cast()))
            };
            if beyond.len() > self.settings.strays && is_solid() { cut_off + side * far } else { cut_off }
        };
        (believed(low, -1.0, facing[0]), believed(high, 1.0, facing[1]))
    }

    /// How the fingers touch what they close on, between two extremes that face the camera so much: the same however far they open.
    fn contact(&self, (low, high): (f64, f64), facing: [f64; 2]) -> Contact {
        let run = &self.slab[self.run.clone()];
        let sides = [(low, -1.0), (high, 1.0)].map(|(y, side)| touched_normals(run, y, side, self.world_from_tcp, self.object));
        let (meeting, is_hollow) = meeting(&self.points, self.behind(), (low, high), self.settings);
        let slopes = [0, 1].map(|k| match facing[k] {
            facing if facing > FACING => slope_rad(&sides[k]),
            // What was seen of a side that faces away is not what the finger touches, and a wall's outline is that of both its faces.
            facing if facing > EDGE_ON && !is_hollow => outline_slope_rad(run, [low, high][k], [-1.0, 1.0][k]),
            _ => None,
        });
        Contact {
            depth_m: contact_depth_m(run, low).max(contact_depth_m(run, high)),
            squareness: squareness(&sides),
            slope_rad: mean_slope_rad(slopes, is_hollow),
            turn_rad: if is_hollow { wall_turn_rad(run, self.world_from_tcp, self.object) } else { 0.0 },
            meeting,
        }
    }
}

/// How the fingers touch what they close on; the fields are those of [`GripperFit`].
#[derive(Debug, Clone, Copy)]
struct Contact {
    depth_m: f64,
    squareness: f64,
    slope_rad: f64,
    turn_rad: f64,
    meeting: Meeting,
}

/// Points in the grasp centre's frame. By a matrix, which takes half of the multiplications of a quaternion.
fn seen_from_tcp(points: &[Point3<f32>], world_from_tcp: &Isometry3<f64>) -> Vec<Point3<f32>> {
    let tcp_from_world = world_from_tcp.inverse().cast::<f32>();
    let turn = tcp_from_world.rotation.to_rotation_matrix();
    points.iter().map(|p| turn * p + tcp_from_world.translation.vector).collect()
}

/// How far off the middle of what is between them wide open fingers come down, metres: so far that the finger on the unseen side has all the room that
/// the other does not need, or, where there is too little for both, half of it.
fn away_m(width_m: f64, settings: &GripperSettings) -> f64 {
    (0.5 * (FINGER_OPENING_MAX_M - width_m) - settings.clearance_seen_m).max(0.0)
}

/// Shares of the way from where the open hand comes down to the middle of the object that are tried, the whole first.
const CENTERED: [f64; 5] = [1.0, 0.75, 0.5, 0.25, 0.0];
/// How the pads meet the outline of what is between them, and whether that is a wall of something hollow: then nothing is amiss, as the outline says
/// nothing of it.
fn meeting(points: &[Point3<f32>], behind: &[Point3<f32>], (low, high): (f64, f64), settings: &GripperSettings) -> (Meeting, bool) {
    // The pads reach as far behind the grasp centre as beyond it.
    let is_level = |p: &&Point3<f32>| p.z.abs() <= TIP_BEYOND_TCP_M as f32;
    let mut level: Vec<Point3<f32>> = points.iter().filter(is_level).copied().collect();
    let half_m = settings.finger_half_width_m as f32;
    // What was seen between the pads, but apart from what they close on, is the other side of something hollow.
    let apart = |p: &Point3<f32>| p.x.abs() <= half_m && (f64::from(p.y) < low - APART_M || f64::from(p.y) > high + APART_M);
    if level.iter().any(apart) {
        return (Meeting::default(), true);
    }
    level.extend(behind.iter().filter(is_level));
    (wedge::meeting(&level, half_m).unwrap_or_default(), false)
}

/// The cosine to the line of sight from which a side counts as seen: less of a surface gives readings at some places only.
const FACING: f64 = 0.2;
/// The same from which the outline of what was seen is that of the side: one that faces away further goes on behind it.
const EDGE_ON: f64 = -0.35;

/// How much a side whose outward normal this is faces the camera: the cosine to the line of sight.
fn facing(outwards: &Vector3<f64>, world_from_tcp: &Isometry3<f64>, view: &ObservedView) -> f64 {
    let to_eye = view.eye().coords.cast::<f64>() - world_from_tcp.translation.vector;
    outwards.dot(&to_eye.normalize())
}

/// How much further than seen an object reaches to a side that faces the camera so much, metres: nothing where it does, and behind a border what was
/// cleaned away of it, which is more the flatter it is looked at.
fn missing_m(facing: f64, border_m: f64) -> f64 {
    if facing > FACING { 0.0 } else { border_m / (1.0 - facing * facing).sqrt().max(0.5) }
}

/// The points between the planes of the finger pads, sorted along the closing direction.
fn slab(points: &[Point3<f32>], settings: &GripperSettings) -> Result<Vec<SlabPoint>, Misfit> {
    let reach = (FINGER_OPENING_MAX_M + settings.finger_thickness_m) as f32;
    let palm_m = -(DEPTH_MAX_M + settings.palm_slack_m) as f32;
    let half_m = settings.finger_half_width_m as f32;
    let [palm_x, palm_y] = PALM_HALF_M.map(|half| half as f32);
    // Keys of one number each, in the order of `f32::total_cmp` and then of the points, sort faster than what they stand for.
    let mut keys: Vec<u64> = Vec::new();
    let mut palm_points = 0;
    for (i, p) in points.iter().enumerate() {
        let (x, y) = (p.x.abs(), p.y.abs());
        // Without branches but the one that is seldom taken: all points of the object are asked at every pose.
        if (x <= half_m) & (y <= reach) & (p.z >= -FINGER_LENGTH_M as f32) & (p.z <= TIP_BEYOND_TCP_M as f32) {
            keys.push(u64::from(ordinal(p.y)) << 32 | i as u64);
        }
        palm_points += usize::from((p.z < palm_m) & (p.z > -0.15) & (x < palm_x) & (y < palm_y));
    }
    if palm_points > settings.strays {
        return Err(Misfit::PalmBlocked);
    }
    keys.sort_unstable();
    let point = |key: u64| key as u32 as usize;
    Ok(keys.into_iter().map(|key| (points[point(key)].coords.cast(), point(key))).collect())
}

/// Whether a place is as far along and across as the fingers are.
fn is_between_pads(p: &Vector3<f64>, settings: &GripperSettings) -> bool {
    p.x.abs() <= settings.finger_half_width_m && (-FINGER_LENGTH_M..=TIP_BEYOND_TCP_M).contains(&p.z)
}

/// The share of a finger that is in space that was seen to be free; `y` is its inner face, `side` where its bulk lies.
fn seen_share(world_from_tcp: &Isometry3<f64>, y: f64, side: f64, view: &ObservedView, settings: &GripperSettings) -> f64 {
    let mut free = 0;
    let mut asked = 0;
    for z in [-0.022, -0.008, 0.006] {
        for x in [-0.6, 0.6] {
            for share in [0.15, 0.6] {
                let place = Point3::new(x * settings.finger_half_width_m, y + side * share * settings.finger_thickness_m, z);
                free += usize::from(view.is_free(&(world_from_tcp * place).cast()));
                asked += 1;
            }
        }
    }
    free as f64 / f64::from(asked)
}

#[cfg(test)]
mod tests {
    use repose_proto::CameraModel;

    use super::*;

    /// Seen from the front, half from above: the camera is as far away as it is high.
    fn from_the_front() -> ObservedView {
        let camera = CameraModel {
            width: 640,
            height: 480,
            fx: 600.0,
            fy: 600.0,
            cx: 320.0,
            cy: 240.0,
            depth_unit_m: 0.001,
            world_from_camera: None,
        };
        let looks = nalgebra::Rotation3::look_at_lh(&Vector3::new(1.0, 0.0, -1.0), &Vector3::z()).inverse();
        let at = Isometry3::from_parts(Vector3::new(-1.0, 0.0, 1.0).into(), nalgebra::UnitQuaternion::from_rotation_matrix(&looks));
        ObservedView::new(&[], &[], &camera, &at, 64)
    }

    #[test]
    fn what_borders_left_out_is_missing_where_a_side_faces_away_and_more_where_it_is_looked_at_flatly() {
        let (view, tcp, border_m) = (from_the_front(), Isometry3::identity(), 0.005);
        let missing = |outwards: Vector3<f64>| missing_m(facing(&outwards, &tcp, &view), border_m);
        assert_eq!(missing(-Vector3::x()), 0.0, "the side before the camera was seen to its end");
        assert!((missing(Vector3::y()) - border_m).abs() < 1e-9, "a side seen edge on ends a border further");
        let behind = missing(Vector3::x());
        assert!(behind > 1.3 * border_m && behind <= 2.0 * border_m, "{behind}");
    }

    /// The near half of an upright cylinder, as a camera in front of it sees it, with the far half believed behind; its top is as dark as a lid.
    fn cylinder(radius_m: f64, height_m: f64) -> GraspCloud {
        let at = |k: i32, z: f64| {
            let angle = std::f64::consts::PI * (1.0 + 0.5 * f64::from(k) / 20.0);
            Point3::new(radius_m * angle.cos(), radius_m * angle.sin(), z).cast::<f32>()
        };
        let levels = (0..(height_m / 0.004) as i32).map(|k| 0.004 * f64::from(k));
        let points: Vec<Point3<f32>> = levels.flat_map(|z| (-18..=18).map(move |k| at(k, z))).collect();
        let normals = points.iter().map(|p| Vector3::new(p.x, p.y, 0.0).normalize()).collect();
        let behind = points.iter().map(|p| Point3::new(-p.x, -p.y, p.z)).collect();
        let bounds = repose_geometry::Aabb::of(&points).expect("it has points");
        let (axis, middle_m) = (nalgebra::Vector2::zeros(), 0.5 * height_m);
        GraspCloud { points, normals, axis, behind, bounds, middle_m, floor_m: 0.017 }
    }

    /// A hand that comes straight down and closes along the line of sight.
    fn along_the_view(x: f64, z: f64) -> Isometry3<f64> {
        crate::grasp::pose(&Point3::new(x, 0.0, z), &-Vector3::z(), &Vector3::x()).expect("a pose")
    }

    #[test]
    fn what_was_seen_from_one_side_only_is_as_wide_as_it_is_believed_to_be_and_not_a_thin_wall() {
        let (view, settings, object) = (from_the_front(), GripperSettings::default(), cylinder(0.03, 0.10));
        let tcp = along_the_view(-0.02, 0.08);
        let fit = Between::fingers(&tcp, &object, &view, &settings).unwrap().fit(settings.clearance_m).unwrap();
        assert!((fit.width_m - 0.06).abs() < 0.004, "{fit:?}");
        let middle = tcp * Point3::new(0.0, fit.offset_m, 0.0);
        assert!(middle.x.abs() < 0.003, "the fingers close about its axis: {middle}");
    }

    /// A bowl with a level rim whose wall, 4 mm thick, narrows downwards; seen from the front: the outside of its near wall and the inside of its far one.
    fn bowl(rim_m: f64, foot_m: f64, height_m: f64) -> GraspCloud {
        let levels = (2..=(height_m / 0.003) as i32).map(|k| 0.003 * f64::from(k));
        let angles = || (0..90).map(|k| std::f64::consts::TAU * f64::from(k) / 90.0);
        let wall = levels.flat_map(|z| {
            let radius_m = foot_m + (rim_m - foot_m) * z / height_m;
            angles().map(move |angle| (angle, if angle.cos() < 0.0 { radius_m } else { radius_m - 0.004 }, z))
        });
        let slope = ((rim_m - foot_m) / height_m).atan();
        let (points, normals) = wall
            .map(|(angle, radius_m, z)| {
                let (level, up) = (Vector3::new(angle.cos(), angle.sin(), 0.0), Vector3::z());
                let outwards = level * slope.cos() - up * slope.sin();
                let normal = if angle.cos() < 0.0 { outwards } else { -outwards };
                (Point3::new(radius_m * angle.cos(), radius_m * angle.sin(), z).cast::<f32>(), normal.cast::<f32>())
            })
            .unzip::<_, _, Vec<Point3<f32>>, Vec<Vector3<f32>>>();
        let bounds = repose_geometry::Aabb::of(&points).expect("it has points");
        let (axis, middle_m) = (nalgebra::Vector2::zeros(), 0.5 * height_m);
        GraspCloud { points, normals, axis, behind: Vec::new(), bounds, middle_m, floor_m: 0.017 }
    }

    #[test]
    fn a_bowl_that_goes_between_the_fingers_is_as_wide_as_both_its_walls() {
        let (view, settings, object) = (from_the_front(), GripperSettings::default(), bowl(0.027, 0.015, 0.05));
        let tcp = along_the_view(0.004, 0.03);
        let fit = Between::fingers(&tcp, &object, &view, &settings).unwrap().fit(settings.clearance_m).unwrap();
        assert!((0.05..0.065).contains(&fit.width_m), "{fit:?}");
        let middle = tcp * Point3::new(0.0, fit.offset_m, 0.0);
        assert!(middle.x.abs() < 0.006, "the fingers close about its middle: {middle}");
    }

    #[test]
    fn a_finger_that_comes_down_unseen_gets_no_less_room_than_the_other() {
        let settings = GripperSettings::default();
        for width_m in [0.03, 0.06, 0.068, 0.07, 0.074] {
            let (away_m, half_m) = (away_m(width_m, &settings), 0.5 * (FINGER_OPENING_MAX_M - width_m));
            let [unseen_m, seen_m] = [half_m + away_m, half_m - away_m];
            assert!(unseen_m >= seen_m && seen_m >= half_m.min(settings.clearance_seen_m) - 1e-12, "{unseen_m} and {seen_m} at {width_m}");
        }
    }

    #[test]
    fn a_finger_that_came_down_inside_of_a_cup_is_not_drawn_through_its_far_wall() {
        let (view, settings) = (from_the_front(), GripperSettings::default());
        let wall = |x: f32| (0..5).flat_map(move |k| [-0.006, 0.0, 0.006].map(|y| Point3::new(x, y, 0.07 + 0.004 * k as f32)));
        let points: Vec<Point3<f32>> = wall(0.0).chain(wall(-0.037)).collect();
        let normals = vec![Vector3::x(); points.len()];
        let bounds = repose_geometry::Aabb::of(&points).expect("it has points");
        let (axis, behind) = (nalgebra::Vector2::zeros(), Vec::new());
        let object = GraspCloud { points, normals, axis, behind, bounds, middle_m: 0.045, floor_m: 0.017 };
        let tcp = along_the_view(0.0, 0.08);
        let between = Between::fingers(&tcp, &object, &view, &settings).expect("the near wall is between them");
        let (inside, over) = (0.03, 0.0);
        let has_room = |way: [f64; 2]| between.has_room(way, FINGER_OPENING_MAX_M);
        assert!(has_room([inside, inside]) && has_room([over, over]), "there is room at both ends");
        assert!(!has_room([inside, over]) && has_room([inside, 0.9 * inside]), "and not on the way between them");
    }
}
