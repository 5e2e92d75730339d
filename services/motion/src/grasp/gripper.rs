//! What the fingers would close on at a pose, and whether hand and fingers have room around the object.
//!
//! All in the grasp centre's frame: fingers close along y, the hand comes along z. The part of the cloud between the finger pads is searched
//! for the run of points nearest the middle; a gap wide enough for a finger ends it. So a solid object is taken across, a hollow one at its wall.
//! A side that faces away from the camera ends later than it was seen to, by the border that was cleaned away: the fingers are centred on
//! where it is believed to end. One that would come down unseen, behind the object, gets all the room there is.

use std::cell::OnceCell;

use nalgebra::{Isometry3, Point3, Vector3};
use repose_belief::ObservedView;
use repose_panda::FINGER_OPENING_MAX_M;

use super::GraspCloud;
use super::wedge::{self, Meeting};

/// How far the fingers reach beyond the grasp centre, metres.
pub const TIP_BEYOND_TCP_M: f64 = 0.013;
/// How far the grasp centre may be below the object's top, metres: then the palm touches it.
pub const DEPTH_MAX_M: f64 = 0.029;

/// The gripper's sizes and margins.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GripperSettings {
    /// Half the width of a finger across (along x), metres. Default 0.0105.
    pub finger_half_width_m: f64,
    /// How thick a finger is along the closing direction, metres. Default 0.022.
    pub finger_thickness_m: f64,
    /// Room between the object as it is believed to be and each open finger, metres. Default 0.011.
    pub clearance_m: f64,
    /// The same where something stands beside the object, metres. Default 0.005.
    pub clearance_beside_m: f64,
    /// The least room where the opening allows no more, metres. Default 0.003.
    pub clearance_min_m: f64,
    /// How much of the object is missing at a border of what was seen of it, as borders are cleaned away, metres across the line of sight.
    /// Default 0.005.
    pub border_m: f64,
    /// Points between the pads that make a grasp. Default 6.
    pub points_min: usize,
    /// Room for the finger that was seen to have some, where the other has not, metres. Default 0.006.
    pub clearance_seen_m: f64,
    /// Share of a finger that must be seen to be in free space to count as seen. Default 0.6.
    pub seen_min: f64,
    /// How deep points may be inside the palm, metres: the sensor's noise. Default 0.004.
    pub palm_slack_m: f64,
    /// Stray points that are tolerated inside a finger or the palm. Default 2.
    pub strays: usize,
}

impl Default for GripperSettings {
    fn default() -> Self {
        Self {
            finger_half_width_m: 0.0105,
            finger_thickness_m: 0.022,
            clearance_m: 0.011,
            clearance_beside_m: 0.005,
            clearance_min_m: 0.003,
            border_m: 0.005,
            points_min: 6,
            clearance_seen_m: 0.006,
            seen_min: 0.6,
            palm_slack_m: 0.004,
            strays: 2,
        }
    }
}

/// What the fingers close on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GripperFit {
    /// How wide the object is believed to be between the fingers, metres.
    pub width_m: f64,
    /// Where its middle is along y, metres.
    pub offset_m: f64,
    /// Opening on approach, metres.
    pub opening_m: f64,
    /// How much of the surface that the fingers touch lies along the approach, on the side where that is more, metres.
    pub depth_m: f64,
    /// Mean alignment of the surface with the closing direction where the fingers touch, 0 to 1.
    pub squareness: f64,
    /// How much the surface where the fingers touch faces the hand, mean of both sides, radians: pressing on it pushes the object out of the
    /// fingers. A side that was not seen is taken for one like the other, and of something hollow for the other's back.
    pub slope_rad: f64,
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

/// A point of the cloud in the grasp centre's frame, and its index.
type SlabPoint = (Vector3<f64>, usize);

/// What is between the fingers at a pose, however far they open.
pub struct Between<'a> {
    world_from_tcp: &'a Isometry3<f64>,
    object: &'a GraspCloud,
    view: &'a ObservedView,
    settings: &'a GripperSettings,
    /// The object's points, and what is believed behind them, in the grasp centre's frame.
    points: Vec<Point3<f32>>,
    behind: Vec<Point3<f32>>,
    /// The points between the planes of the pads, sorted along the closing direction, and those of them that the fingers close on.
    slab: Vec<SlabPoint>,
    run: std::ops::Range<usize>,
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
        let tcp_from_world = world_from_tcp.inverse().cast::<f32>();
        let points: Vec<Point3<f32>> = object.points.iter().map(|p| tcp_from_world * p).collect();
        let slab = slab(&points, settings)?;
        let run = run_at_the_middle(&slab, settings)?;
        let behind = object.behind.iter().map(|p| tcp_from_world * p).collect();
        Ok(Self { world_from_tcp, object, view, settings, points, behind, slab, run, contact: OnceCell::new() })
    }

    /// What the fingers close on, with this much room beside the object on approach, metres.
    ///
    /// # Errors
    /// [`Misfit::TooWide`], or [`Misfit::FingerBlocked`].
    pub fn fit(&self, clearance_m: f64) -> Result<GripperFit, Misfit> {
        let Self { world_from_tcp, view, settings, slab, run, .. } = self;
        let (seen_low, seen_high) = (slab[run.start].0.y, slab[run.end - 1].0.y);
        let missing_at = |side: f64| missing_m(&(world_from_tcp.rotation * Vector3::y() * side), world_from_tcp, view, settings.border_m);
        let missing_m = [-1.0, 1.0].map(missing_at);
        let (low, high) = (seen_low - missing_m[0], seen_high + missing_m[1]);
        let width_m = high - low;
        let mut opening_m = (width_m + 2.0 * clearance_m).min(FINGER_OPENING_MAX_M);
        if opening_m - width_m < 2.0 * settings.clearance_min_m {
            return Err(Misfit::TooWide);
        }
        let mut offset_m = 0.5 * (low + high);
        let seen_at = |y: f64, side: f64| seen_share(world_from_tcp, y, side, view, settings);
        let mut seen = [seen_at(offset_m - 0.5 * opening_m, -1.0), seen_at(offset_m + 0.5 * opening_m, 1.0)];
        if (seen[0] < settings.seen_min) != (seen[1] < settings.seen_min) {
            opening_m = FINGER_OPENING_MAX_M;
            offset_m = match seen[0] < settings.seen_min {
                true => high + settings.clearance_seen_m - 0.5 * opening_m,
                false => low - settings.clearance_seen_m + 0.5 * opening_m,
            };
            seen = [seen_at(offset_m - 0.5 * opening_m, -1.0), seen_at(offset_m + 0.5 * opening_m, 1.0)];
        }
        let in_finger = |p: &Vector3<f64>| {
            let beyond_m = (p.y - offset_m).abs() - 0.5 * opening_m;
            (0.0..settings.finger_thickness_m).contains(&beyond_m)
        };
        let behind_pads = self.behind.iter().map(|p| p.coords.cast::<f64>()).filter(|p| is_between_pads(p, settings));
        if slab.iter().map(|(p, _)| *p).chain(behind_pads).filter(in_finger).count() > settings.strays {
            return Err(Misfit::FingerBlocked);
        }
        let Contact { depth_m, squareness, slope_rad, meeting } =
            *self.contact.get_or_init(|| self.contact((seen_low, seen_high), missing_m.map(|missing_m| missing_m == 0.0)));
        Ok(GripperFit { width_m, offset_m, opening_m, depth_m, squareness, slope_rad, meeting, seen: seen[0].min(seen[1]) })
    }

    /// How the fingers touch what they close on, between two extremes of which each side is seen or not: the same however far they open.
    fn contact(&self, (low, high): (f64, f64), is_seen: [bool; 2]) -> Contact {
        let run = &self.slab[self.run.clone()];
        let sides = [(low, -1.0), (high, 1.0)].map(|(y, side)| touched_normals(run, y, side, self.world_from_tcp, self.object));
        let (meeting, is_hollow) = meeting(&self.points, &self.behind, (low, high), self.settings);
        Contact {
            depth_m: contact_depth_m(run, low).max(contact_depth_m(run, high)),
            squareness: squareness(&sides),
            slope_rad: slope_rad(&sides, is_seen, is_hollow),
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
    meeting: Meeting,
}

/// Further from the rest than the noise of depth is apart, metres.
const APART_M: f64 = 0.006;

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

/// How much further than seen an object reaches in a direction, metres: nothing where that side faces the camera, and behind a border what was
/// cleaned away of it, which is more the flatter it is looked at.
pub fn missing_m(outwards: &Vector3<f64>, world_from_tcp: &Isometry3<f64>, view: &ObservedView, border_m: f64) -> f64 {
    let to_eye = view.eye().coords.cast::<f64>() - world_from_tcp.translation.vector;
    let facing = outwards.dot(&to_eye.normalize());
    if facing > FACING { 0.0 } else { border_m / (1.0 - facing * facing).sqrt().max(0.5) }
}

/// The points between the planes of the finger pads, sorted along the closing direction.
fn slab(points: &[Point3<f32>], settings: &GripperSettings) -> Result<Vec<SlabPoint>, Misfit> {
    let reach = FINGER_OPENING_MAX_M + settings.finger_thickness_m;
    let palm_m = -(DEPTH_MAX_M + settings.palm_slack_m);
    let mut slab: Vec<SlabPoint> = Vec::new();
    let mut palm_points = 0;
    for (i, point) in points.iter().enumerate() {
        let p = point.coords.cast::<f64>();
        if is_between_pads(&p, settings) && p.y.abs() <= reach {
            slab.push((p, i));
        }
        palm_points += usize::from(p.z < palm_m && p.z > -0.15 && p.x.abs() < PALM_HALF_M[0] && p.y.abs() < PALM_HALF_M[1]);
    }
    if palm_points > settings.strays {
        return Err(Misfit::PalmBlocked);
    }
    slab.sort_by(|a, b| a.0.y.total_cmp(&b.0.y).then(a.1.cmp(&b.1)));
    Ok(slab)
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

/// The run of points (sorted along y) around the one nearest y = 0, ended by gaps that a finger and its room fit into.
fn run_at_the_middle(slab: &[SlabPoint], settings: &GripperSettings) -> Result<std::ops::Range<usize>, Misfit> {
    let middle = (0..slab.len()).min_by(|a, b| slab[*a].0.y.abs().total_cmp(&slab[*b].0.y.abs())).ok_or(Misfit::Empty)?;
    if slab[middle].0.y.abs() > 0.5 * FINGER_OPENING_MAX_M {
        return Err(Misfit::Empty);
    }
    let gap_m = settings.finger_thickness_m + settings.clearance_min_m;
    let (mut start, mut end) = (middle, middle + 1);
    while start > 0 && slab[start].0.y - slab[start - 1].0.y < gap_m {
        start -= 1;
    }
    while end < slab.len() && slab[end].0.y - slab[end - 1].0.y < gap_m {
        end += 1;
    }
    if end - start < settings.points_min { Err(Misfit::Empty) } else { Ok(start..end) }
}

/// How far from the outermost point of a side the finger's pad touches it, metres: the noise of depth, and what gives way.
const TOUCHED_M: f64 = 0.004;

/// How much of the surface on one side lies along the approach where a flat pad would touch it, metres: much on a wall, little on a shoulder
/// or a rounded edge, down which the fingers slide.
fn contact_depth_m(run: &[SlabPoint], extreme: f64) -> f64 {
    let touched = run.iter().filter(|(p, _)| (p.y - extreme).abs() < TOUCHED_M).map(|(p, _)| p.z);
    let (nearest, farthest) = touched.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), z| (a.min(z), b.max(z)));
    (farthest - nearest).max(0.0)
}

/// What a side counts whose surface was not seen.
const UNSEEN: f64 = 0.7;

/// The outward normals in the grasp centre's frame, y along `side`, of what was seen within 6 mm of an extreme: those that lie more along the closing
/// direction than across it.
fn touched_normals(run: &[SlabPoint], extreme: f64, side: f64, world_from_tcp: &Isometry3<f64>, object: &GraspCloud) -> Vec<Vector3<f64>> {
    let tcp_from_world = world_from_tcp.rotation.inverse();
    let normal = |i: &usize| tcp_from_world * object.normals[*i].cast::<f64>();
    let touched = run.iter().filter(|(p, _)| (p.y - extreme).abs() < 0.006).map(|(_, i)| normal(i));
    let outwards = touched.map(|n| if n.y * side < 0.0 { -n } else { n }).map(|n| Vector3::new(n.x, n.y * side, n.z));
    outwards.filter(|n| n.y > 0.5).collect()
}

/// Mean `|n · y|` of both sides; one on which no such surface was seen counts as one that lies across.
fn squareness(sides: &[Vec<Vector3<f64>>; 2]) -> f64 {
    let mean = |normals: &Vec<Vector3<f64>>| match normals.len() {
        0 => UNSEEN,
        count => normals.iter().map(|n| n.y).sum::<f64>() / count as f64,
    };
    0.5 * (mean(&sides[0]) + mean(&sides[1]))
}

/// How much both sides together face the hand. Of a side that faces away from the camera what was seen is not what the finger touches.
fn slope_rad(sides: &[Vec<Vector3<f64>>; 2], is_seen: [bool; 2], is_hollow: bool) -> f64 {
    let mean = |normals: &Vec<Vector3<f64>>| normals.iter().map(|n| (-n.z).atan2(n.y)).sum::<f64>() / normals.len() as f64;
    let seen: Vec<f64> =
        sides.iter().zip(is_seen).filter(|(side, is_seen)| *is_seen && !side.is_empty()).map(|(side, _)| mean(side)).collect();
    match seen[..] {
        [one] if !is_hollow => one,
        [one, other] => 0.5 * (one + other),
        _ => 0.0,
    }
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
        let missing = |outwards: Vector3<f64>| missing_m(&outwards, &tcp, &view, border_m);
        assert_eq!(missing(-Vector3::x()), 0.0, "the side before the camera was seen to its end");
        assert!((missing(Vector3::y()) - border_m).abs() < 1e-9, "a side seen edge on ends a border further");
        let behind = missing(Vector3::x());
        assert!(behind > 1.3 * border_m && behind <= 2.0 * border_m, "{behind}");
    }
}
