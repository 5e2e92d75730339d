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
/// How far from it across the fingers the side of something that is surely held may show, metres: half of what a hand grasps at its middle.
const WIDE_M: f64 = 0.1;
/// How far readings may lie outside the opening, metres.
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
        Some(true) => nearest(&between(body, WIDE_M, labels, depth), settings).into_iter().collect(),
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

/// Of something that is surely held, one sees the side that faces the camera, wherever that is: the nearest to the grasp point is it.
fn nearest(between: &BTreeMap<u16, Vec<[f64; 2]>>, settings: &SelfFilterSettings) -> Option<u16> {
    let away_m = |readings: &[[f64; 2]]| {
        let mut away_m: Vec<f64> = readings.iter().map(|[x, _]| x.abs()).collect();
        away_m.sort_by(f64::total_cmp);
        away_m.get(settings.held_readings.saturating_sub(1)).copied()
    };
    let away = between.iter().filter_map(|(id, readings)| Some((away_m(readings)?, *id)));
    away.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, id)| id)
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
