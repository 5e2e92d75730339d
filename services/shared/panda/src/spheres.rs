//! The spheres that stand for the Panda's body in collision checks.
//!
//! Figures: the spherised Panda description that accompanies VAMP (`panda_spherized.urdf`): 59 spheres over links 0 to 7, hand and fingers,
//! each in its link's frame. There the fingers are drawn fixed; here they stand where the opening puts them.

use nalgebra::{Point3, Vector3};

use crate::{LinkFrames, kinematics::LinkFrame};

/// How many spheres cover the robot, hand and fingers included.
pub const SPHERE_COUNT: usize = 59;

/// Distance of the fingers' frames from the hand's, along z, metres.
pub const FINGER_M: f64 = 0.0584;

/// A rigid part of the robot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Link {
    /// The foot.
    Link0,
    /// Moved by joint 1.
    Link1,
    /// Moved by joint 2.
    Link2,
    /// Moved by joint 3.
    Link3,
    /// Moved by joint 4.
    Link4,
    /// Moved by joint 5.
    Link5,
    /// Moved by joint 6.
    Link6,
    /// Moved by joint 7; the flange.
    Link7,
    /// The gripper's body, fixed to the flange.
    Hand,
    /// The finger on the hand's +y side.
    LeftFinger,
    /// The finger on the hand's −y side.
    RightFinger,
}

/// All links, from the base outwards.
pub const LINKS: [Link; 11] = [
    Link::Link0,
    Link::Link1,
    Link::Link2,
    Link::Link3,
    Link::Link4,
    Link::Link5,
    Link::Link6,
    Link::Link7,
    Link::Hand,
    Link::LeftFinger,
    Link::RightFinger,
];

/// A sphere where it stands: in the base frame, unless said otherwise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlacedSphere {
    /// Its centre.
    pub center: Point3<f64>,
    /// Its radius, metres.
    pub radius_m: f64,
}

/// Centre x y z in the link's frame and radius, metres.
type Row = [f64; 4];

const LINK0: &[Row] = &[[0.0, 0.0, 0.05, 0.08]];
const LINK1: &[Row] = &[[0.0, -0.08, 0.0, 0.06], [0.0, -0.03, 0.0, 0.06], [0.0, 0.0, -0.12, 0.06], [0.0, 0.0, -0.17, 0.06]];
const LINK2: &[Row] = &[[0.0, 0.0, 0.03, 0.06], [0.0, 0.0, 0.08, 0.06], [0.0, -0.12, 0.0, 0.06], [0.0, -0.17, 0.0, 0.06]];
const LINK3: &[Row] = &[[0.0, 0.0, -0.1, 0.06], [0.0, 0.0, -0.06, 0.05], [0.08, 0.06, 0.0, 0.055], [0.08, 0.02, 0.0, 0.055]];
const LINK4: &[Row] = &[[-0.08, 0.095, 0.0, 0.06], [0.0, 0.0, 0.02, 0.055], [0.0, 0.0, 0.06, 0.055], [-0.08, 0.06, 0.0, 0.055]];
const LINK5: &[Row] = &[
    [0.0, 0.055, 0.0, 0.06],
    [0.0, 0.075, 0.0, 0.06],
    [0.0, 0.0, -0.22, 0.06],
    [0.0, 0.05, -0.18, 0.05],
    [0.01, 0.08, -0.14, 0.025],
    [0.01, 0.085, -0.11, 0.025],
    [0.01, 0.09, -0.08, 0.025],
    [0.01, 0.095, -0.05, 0.025],
    [-0.01, 0.08, -0.14, 0.025],
    [-0.01, 0.085, -0.11, 0.025],
    [-0.01, 0.09, -0.08, 0.025],
    [-0.01, 0.095, -0.05, 0.025],
];
const LINK6: &[Row] = &[[0.0, 0.0, 0.0, 0.05], [0.08, -0.01, 0.0, 0.05], [0.08, 0.035, 0.0, 0.052]];
const LINK7: &[Row] =
    &[[0.0, 0.0, 0.07, 0.05], [0.02, 0.04, 0.08, 0.025], [0.04, 0.02, 0.08, 0.025], [0.04, 0.06, 0.085, 0.02], [0.06, 0.04, 0.085, 0.02]];
const HAND: &[Row] = &[
    [0.0, -0.075, 0.01, 0.028],
    [0.0, -0.045, 0.01, 0.028],
    [0.0, -0.015, 0.01, 0.028],
    [0.0, 0.015, 0.01, 0.028],
    [0.0, 0.045, 0.01, 0.028],
    [0.0, 0.075, 0.01, 0.028],
    [0.0, -0.075, 0.03, 0.026],
    [0.0, -0.045, 0.03, 0.026],
    [0.0, -0.015, 0.03, 0.026],
    [0.0, 0.015, 0.03, 0.026],
    [0.0, 0.045, 0.03, 0.026],
    [0.0, 0.075, 0.03, 0.026],
    [0.0, -0.075, 0.05, 0.024],
    [0.0, -0.045, 0.05, 0.024],
    [0.0, -0.015, 0.05, 0.024],
    [0.0, 0.015, 0.05, 0.024],
    [0.0, 0.045, 0.05, 0.024],
    [0.0, 0.075, 0.05, 0.024],
];
const LEFT_FINGER: &[Row] = &[[0.0, 0.015, 0.022, 0.012], [0.0, 0.008, 0.044, 0.012]];
const RIGHT_FINGER: &[Row] = &[[0.0, -0.015, 0.022, 0.012], [0.0, -0.008, 0.044, 0.012]];

/// What the spheres of the shoulder leave out: between them the arm's surface stands out by up to 27 mm (measured on the meshes of Franka's
/// description). With these it does by 4 mm. For who looks at the arm; those who plan its motion keep to the 59.
const SHOULDER: [(Link, Row); 2] = [(Link::Link1, [0.0, -0.04, -0.06, 0.065]), (Link::Link2, [0.0, -0.06, 0.04, 0.065])];

/// The spheres by link, in the order of [`LINKS`].
const BY_LINK: [&[Row]; LINKS.len()] = [LINK0, LINK1, LINK2, LINK3, LINK4, LINK5, LINK6, LINK7, HAND, LEFT_FINGER, RIGHT_FINGER];

/// First sphere of each link; the last entry is [`SPHERE_COUNT`].
const STARTS: [usize; LINKS.len() + 1] = {
    let mut starts = [0; LINKS.len() + 1];
    let mut i = 0;
    while i < LINKS.len() {
        starts[i + 1] = starts[i] + BY_LINK[i].len();
        i += 1;
    }
    starts
};

/// The link that each sphere belongs to.
pub const SPHERE_LINKS: [Link; SPHERE_COUNT] = {
    let mut links = [Link::Link0; SPHERE_COUNT];
    let mut i = 0;
    while i < LINKS.len() {
        let mut k = STARTS[i];
        while k < STARTS[i + 1] {
            links[k] = LINKS[i];
            k += 1;
        }
        i += 1;
    }
    links
};

/// Which of the placed spheres are the gripper's: hand and fingers.
pub const GRIPPER_SPHERES: std::ops::Range<usize> = STARTS[Link::Hand as usize]..SPHERE_COUNT;

impl Link {
    /// Which of the placed spheres are this link's.
    pub fn sphere_range(self) -> std::ops::Range<usize> {
        STARTS[self as usize]..STARTS[self as usize + 1]
    }
}

/// The spheres of one link, in its own frame.
///
/// For planning: what shows of a link is [`visible_spheres_in_link`].
pub fn spheres_in_link(link: Link) -> impl Iterator<Item = PlacedSphere> {
    BY_LINK[link as usize].iter().map(|row| placed_row(&LinkFrame::BASE, row))
}

/// All spheres where the links are, in the base frame; the fingers `finger_opening_m` apart.
///
/// For planning: what shows of the robot is [`visible_spheres_in_base`].
pub fn spheres_in_base(frames: &LinkFrames, finger_opening_m: f64) -> [PlacedSphere; SPHERE_COUNT] {
    let mut placed = [PlacedSphere { center: Point3::origin(), radius_m: 0.0 }; SPHERE_COUNT];
    place(&mut placed, Link::Link0, &LinkFrame::BASE);
    for (link, frame) in LINKS[1..].iter().zip(&frames.links) {
        place(&mut placed, *link, frame);
    }
    placed[GRIPPER_SPHERES].copy_from_slice(&gripper_spheres(&frames.hand, finger_opening_m));
    placed
}

/// The spheres that cover what shows of one link, in its own frame: its [spheres](spheres_in_link), then what those of the shoulder leave out.
///
/// For drawing the robot.
pub fn visible_spheres_in_link(link: Link) -> impl Iterator<Item = PlacedSphere> {
    let shoulder = SHOULDER.iter().filter(move |(of, _)| *of == link).map(|(_, row)| placed_row(&LinkFrame::BASE, row));
    spheres_in_link(link).chain(shoulder)
}

/// The spheres that cover what shows of the robot, in the base frame, the fingers `finger_opening_m` apart: its [spheres](spheres_in_base), then
/// what those of the shoulder leave out.
///
/// For telling the robot from the rest of a picture, and for others that keep clear of it.
pub fn visible_spheres_in_base(frames: &LinkFrames, finger_opening_m: f64) -> [PlacedSphere; SPHERE_COUNT + SHOULDER.len()] {
    let mut placed = [PlacedSphere { center: Point3::origin(), radius_m: 0.0 }; SPHERE_COUNT + SHOULDER.len()];
    placed[..SPHERE_COUNT].copy_from_slice(&spheres_in_base(frames, finger_opening_m));
    placed[SPHERE_COUNT..].copy_from_slice(&SHOULDER.map(|(link, row)| placed_row(&frames.links[link as usize - 1], &row)));
    placed
}

/// The spheres of the hand and the fingers only, in the frame that `hand` is given in; the fingers `finger_opening_m` apart.
///
/// For grasps, which are judged before any joint angles are known.
pub fn gripper_spheres(hand: &LinkFrame, finger_opening_m: f64) -> [PlacedSphere; GRIPPER_SPHERES.end - GRIPPER_SPHERES.start] {
    let finger = |side: f64| LinkFrame {
        rotation: hand.rotation,
        origin: hand.carry(&Vector3::new(0.0, side * finger_opening_m / 2.0, FINGER_M)).coords,
    };
    let (left, right) = (finger(1.0), finger(-1.0));
    let rows = HAND.iter().map(|row| (hand, row));
    let rows = rows.chain(LEFT_FINGER.iter().map(|row| (&left, row))).chain(RIGHT_FINGER.iter().map(|row| (&right, row)));
    let mut placed = [PlacedSphere { center: Point3::origin(), radius_m: 0.0 }; GRIPPER_SPHERES.end - GRIPPER_SPHERES.start];
    for (sphere, (frame, row)) in placed.iter_mut().zip(rows) {
        *sphere = placed_row(frame, row);
    }
    placed
}

fn place(placed: &mut [PlacedSphere; SPHERE_COUNT], link: Link, frame: &LinkFrame) {
    for (sphere, row) in placed[link.sphere_range()].iter_mut().zip(BY_LINK[link as usize]) {
        *sphere = placed_row(frame, row);
    }
}

fn placed_row(frame: &LinkFrame, [x, y, z, radius_m]: &Row) -> PlacedSphere {
    PlacedSphere { center: frame.carry(&Vector3::new(*x, *y, *z)), radius_m: *radius_m }
}

#[cfg(test)]
#[path = "../../../../tests/common/real_data.rs"]
mod real_data;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{READY, base_from_tcp};

    #[test]
    fn there_are_fifty_nine_spheres_and_each_knows_its_link() {
        assert_eq!(STARTS[LINKS.len()], SPHERE_COUNT);
        assert_eq!(SPHERE_LINKS[0], Link::Link0);
        assert_eq!(SPHERE_LINKS[SPHERE_COUNT - 1], Link::RightFinger);
        assert_eq!(Link::Hand.sphere_range().len(), 18);
    }

    #[test]
    fn the_shoulder_is_covered_where_its_surface_stands_out_most() {
        let frames = LinkFrames::at(&READY);
        // The farthest places of the meshes of Franka's description, in their links' frames.
        for (link, place) in [(0, Vector3::new(0.0443, -0.0549, -0.0699)), (1, Vector3::new(-0.0448, -0.0696, 0.0544))] {
            let place = frames.links[link].carry(&place);
            let outside_m = |s: &PlacedSphere| (s.center - place).norm() - s.radius_m;
            let nearest_m = |spheres: &[PlacedSphere]| spheres.iter().map(outside_m).fold(f64::INFINITY, f64::min);
            assert!(nearest_m(&spheres_in_base(&frames, 0.04)) > 0.025);
            assert!(nearest_m(&visible_spheres_in_base(&frames, 0.04)) < 0.0);
        }
    }

    #[test]
    fn the_fingertips_are_at_the_grasp_centre_and_part_with_the_opening() {
        let spheres = spheres_in_base(&LinkFrames::at(&READY), 0.06);
        let (left, right) = (spheres[SPHERE_COUNT - 3].center, spheres[SPHERE_COUNT - 1].center);
        assert!(((left - right).norm() - (0.06 + 2.0 * 0.008)).abs() < 1e-12);
        let tcp = base_from_tcp(&READY);
        assert!((nalgebra::center(&left, &right) - Point3::from(tcp.translation.vector)).norm() < 0.0011);
    }

    #[test]
    fn the_table_agrees_with_the_description_file_where_it_is_present() {
        let Some(path) = real_data::real_data("panda/panda_spherized.urdf") else { return };
        let text = std::fs::read_to_string(path).unwrap();
        let attribute = |line: &str, name: &str| -> Option<String> {
            let at = line.find(&format!("{name}=\""))? + name.len() + 2;
            Some(line[at..].split('"').next()?.to_owned())
        };
        let mut found = Vec::new();
        let mut radius = None;
        for line in text.lines().map(str::trim) {
            if line.starts_with("<sphere") {
                radius = attribute(line, "radius").map(|r| r.parse::<f64>().unwrap());
            } else if let (true, Some(r)) = (line.starts_with("<origin"), radius) {
                radius = None;
                let xyz: Vec<f64> = attribute(line, "xyz").unwrap().split(' ').map(|v| v.parse().unwrap()).collect();
                found.push([xyz[0], xyz[1], xyz[2], r]);
            }
        }
        let ours: Vec<Row> = BY_LINK.iter().flat_map(|rows| rows.iter().copied()).collect();
        assert_eq!(found, ours);
    }
}
