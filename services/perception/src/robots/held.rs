//! What a robot holds: the object that shows between its fingers.

use std::collections::BTreeSet;

use nalgebra::Point3;
use repose_geometry::Image;

use super::body::Body;
use crate::readings::depth::DepthMap;
use crate::settings::SelfFilterSettings;

/// How far the space between the fingertips reaches: along the approach to either side of the grasp point, and across the fingers, metres.
/// The Panda's pads are 18 mm high and 20 mm wide; the rest is for calibration errors.
const TIPS_M: [f64; 2] = [0.03, 0.025];
/// How far readings may lie outside the opening, metres.
const BESIDE_M: f64 = 0.01;
/// Where nobody says whether something is held: the fingers are open less than this, metres, …
const HARDLY_OPEN_M: f64 = 0.075;
/// … and what is between them spans at least this share of the opening, seen from one side.
const SPANNED: f64 = 0.4;
/// Pixels around the mask of a held object whose readings mix it with what is behind it.
const RIM_PX: usize = 3;

/// The ids of the objects that show between a robot's fingers; `holding` is what the robot says of it.
pub fn labels(body: &Body, holding: Option<bool>, labels: &Image<u16>, depth: &DepthMap, settings: &SelfFilterSettings) -> BTreeSet<u16> {
    if holding == Some(false) || holding.is_none() && body.gripper_width_m > HARDLY_OPEN_M {
        return BTreeSet::new();
    }
    let tcp_from_camera = body.camera_from_tcp.inverse();
    let half_m = body.gripper_width_m / 2.0 + BESIDE_M;
    let mut between: Vec<(u16, f64)> = Vec::new();
    for (i, id) in labels.pixels().iter().enumerate().filter(|(_, id)| **id != 0) {
        let p: Point3<f64> = tcp_from_camera * depth.point(i % labels.width(), i / labels.width()).cast::<f64>();
        if p.z.abs() <= TIPS_M[0] && p.x.abs() <= TIPS_M[1] && p.y.abs() <= half_m {
            between.push((*id, p.y));
        }
    }
    let ids: BTreeSet<u16> = between.iter().map(|(id, _)| *id).collect();
    let is_held = |id: &u16| {
        let along = || between.iter().filter(|(other, _)| other == id).map(|(_, y)| *y);
        let spanned_m = along().fold(f64::NEG_INFINITY, f64::max) - along().fold(f64::INFINITY, f64::min);
        let is_gripped = holding == Some(true) || spanned_m >= SPANNED * body.gripper_width_m;
        along().count() >= settings.held_readings && is_gripped
    };
    ids.into_iter().filter(is_held).collect()
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
