//! What a robot holds: the object that shows between its fingers.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Point3;
use repose_geometry::Image;

use super::body::RobotBody;
use crate::readings::depth::DepthMap;
use crate::settings::SelfFilterSettings;

/// How far the space between the fingertips reaches: along the approach to either side of the grasp point, and across the fingers, metres.
/// The Panda's pads are 18 mm high and 20 mm wide; the rest is for calibration errors.
const TIPS_M: [f64; 2] = [0.03, 0.025];
/// How far from it across the fingers the side of something that is surely held may show before it, metres: half of what a hand grasps at its middle.
const WIDE_M: f64 = 0.1;
/// How far readings may lie outside the opening, and their rays beside the grasp point, metres.
const BESIDE_M: f64 = 0.01;
/// Where nobody says whether something is held: the fingers are open less than this, metres, …
const HARDLY_OPEN_M: f64 = 0.075;
/// … and what is between them spans at least this share of the opening, seen from one side.
const SPANNED: f64 = 0.4;
/// Pixels around the mask of a held object whose readings mix it with what is behind it.
const RIM_PX: usize = 3;

/// The ids of the objects that show between a robot's fingers; `holding` is what the robot says of it.
pub fn labels(
    body: &RobotBody,
    holding: Option<bool>,
    labels: &Image<u16>,
    depth: &DepthMap,
    settings: &SelfFilterSettings,
) -> BTreeSet<u16> {
    match holding {
        Some(true) => {
            let shown = between(body, WIDE_M, labels, depth);
            nearest(&shown, &covering(body, labels, depth), settings).into_iter().collect()
        }
        None if body.gripper_width_m <= HARDLY_OPEN_M => spanning(body, &between(body, TIPS_M[1], labels, depth), settings),
        Some(false) | None => BTreeSet::new(),
    }
}

/// By id, where readings between the fingers lie: across the fingers (x) and along the opening (y), up to `wide_m` from the grasp point.
fn between(body: &RobotBody, wide_m: f64, labels: &Image<u16>, depth: &DepthMap) -> BTreeMap<u16, Vec<[f64; 2]>> {
    let tcp_from_camera = body.camera_from_tcp.inverse();
    let half_m = body.gripper_width_m / 2.0 + BESIDE_M;
    let mut between: BTreeMap<u16, Vec<[f64; 2]>> = BTreeMap::new();
    for (i, id) in labels.pixels().iter().enumerate().filter(|(_, id)| **id != 0) {
        let p: Point3<f64> = tcp_from_camera * depth.point(i % labels.width(), i / labels.width()).cast::<f64>();
        if p.z.abs() <= TIPS_M[0] && p.x.abs() <= wide_m && p.y.abs() <= half_m {
            between.entry(*id).or_default().push([p.x, p.y]);
        }
    }
    between
}

/// The ids of what the camera sees before the grasp point.
fn covering(body: &RobotBody, labels: &Image<u16>, depth: &DepthMap) -> BTreeSet<u16> {
    let grasp_in_camera = Point3::from(body.camera_from_tcp.translation.vector);
    // False without a reading.
    let covers = |i: usize| {
        let p: Point3<f64> = depth.point(i % labels.width(), i / labels.width()).cast();
        p.z <= grasp_in_camera.z && (p * (grasp_in_camera.z / p.z) - grasp_in_camera).norm() <= BESIDE_M
    };
    labels.pixels().iter().enumerate().filter(|(i, id)| **id != 0 && covers(*i)).map(|(_, id)| *id).collect()
}

/// Of something that is surely held, one sees the side that faces the camera, wherever that is: the nearest to the grasp point is it, of what shows at
/// the fingertips or is `covering` the grasp point. Anything else stands beside the hand: of something small, all that shows is taken for the fingers.
fn nearest(between: &BTreeMap<u16, Vec<[f64; 2]>>, covering: &BTreeSet<u16>, settings: &SelfFilterSettings) -> Option<u16> {
    let at_tips_m = TIPS_M[1] + f64::from(settings.margin_m);
    let away_m = |readings: &[[f64; 2]]| {
        let mut away_m: Vec<f64> = readings.iter().map(|[x, _]| x.abs()).collect();
        away_m.sort_by(f64::total_cmp);
        away_m.get(settings.held_readings.saturating_sub(1)).copied()
    };
    let away = between.iter().filter_map(|(id, readings)| Some((away_m(readings)?, *id)));
    let may_be_held = away.filter(|(away_m, id)| *away_m <= at_tips_m || covering.contains(id));
    may_be_held.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, id)| id)
}

/// Those that fill much of the opening.
fn spanning(body: &RobotBody, between: &BTreeMap<u16, Vec<[f64; 2]>>, settings: &SelfFilterSettings) -> BTreeSet<u16> {
    let spanned_m = |readings: &[[f64; 2]]| {
        let along = || readings.iter().map(|[_, y]| *y);
        along().fold(f64::NEG_INFINITY, f64::max) - along().fold(f64::INFINITY, f64::min)
    };
    let is_held = |readings: &[[f64; 2]]| readings.len() >= settings.held_readings && spanned_m(readings) >= SPANNED * body.gripper_width_m;
    between.iter().filter(|(_, readings)| is_held(readings)).map(|(id, _)| *id).collect()
}

/// Takes held objects out of the labels and out of the depth picture, with the rim around each.
pub fn remove(held: &BTreeSet<u16>, labels: &mut Image<u16>, depth: &mut DepthMap) {
    let (width, height) = (labels.width(), labels.height());
    let of_held: Vec<usize> = (0..width * height).filter(|i| held.contains(&labels.pixels()[*i])).collect();
    for i in of_held {
        let (u, v) = (i % width, i / width);
        for row in v.saturating_sub(RIM_PX)..(v + RIM_PX + 1).min(height) {
            for column in u.saturating_sub(RIM_PX)..(u + RIM_PX + 1).min(width) {
                let beside = row * width + column;
                if labels.pixels()[beside] == 0 || held.contains(&labels.pixels()[beside]) {
                    depth.depth_m_mut().pixels_mut()[beside] = f32::NAN;
                }
            }
        }
    }
    labels.pixels_mut().iter_mut().filter(|id| held.contains(id)).for_each(|id| *id = 0);
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;
    use std::ops::Range;

    use nalgebra::{Isometry3, Vector3};
    use repose_geometry::Pinhole;

    use super::*;

    const CAMERA: Pinhole = Pinhole { width: 320, height: 240, fx: 262.0, fy: 262.0, cx: 159.5, cy: 119.5 };

    /// What a hand that is shut on 1.5 cm, 90 cm before the camera, is told to hold where object 3 shows in these columns, so far away. The camera looks
    /// along the hand's approach, or `across` the fingers.
    fn held(across: bool, columns: Range<usize>, depth_mm: u16) -> BTreeSet<u16> {
        let turn = if across { Vector3::y() * FRAC_PI_2 } else { Vector3::zeros() };
        let camera_from_tcp = Isometry3::new(Vector3::new(0.0, 0.0, 0.9), turn);
        let body = RobotBody { balls: Vec::new(), camera_from_tcp, gripper_width_m: 0.015 };
        let is_object = |i: usize| columns.contains(&(i % 320)) && (90..150).contains(&(i / 320));
        let counts: Vec<u16> = (0..320 * 240).map(|i| if is_object(i) { depth_mm } else { 1200 }).collect();
        let ids = Image::from_pixels(320, 240, (0..320 * 240).map(|i| 3 * u16::from(is_object(i))).collect()).unwrap();
        labels(&body, Some(true), &ids, &DepthMap::new(&counts, 0.001, &CAMERA, 4.0), &SelfFilterSettings::default())
    }

    #[test]
    fn what_stands_beside_a_hand_that_holds_something_small_is_not_held() {
        // From 5 to 9 cm beside the grasp point, and from 2 cm on.
        assert_eq!(held(false, 175..187, 900), BTreeSet::new());
        assert_eq!(held(false, 166..187, 900), BTreeSet::from([3]));
    }

    #[test]
    fn what_is_wide_is_held_where_its_near_side_covers_the_grasp_point() {
        // 8 cm before the grasp point; beside the ray to it, it is another thing.
        assert_eq!(held(true, 130..190, 820), BTreeSet::from([3]));
        assert_eq!(held(true, 165..190, 820), BTreeSet::new());
        // As far behind the grasp point, something else shows past the hand.
        assert_eq!(held(true, 130..190, 980), BTreeSet::new());
    }
}
