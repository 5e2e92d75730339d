//! What was seen and is no object: kept in the scene as obstacles, and told with a reason each.

use std::collections::BTreeMap;

use repose_geometry::{Image, Isometry3, Vector3};
use repose_proto::{LeftOut, LeftOutReason};

use crate::readings::depth::DepthMap;

/// Pixels by what they were taken out of.
#[derive(Debug, Clone, PartialEq)]
pub struct LeftOutMasks {
    /// The part of each pixel, 0 = none.
    pub parts: Image<u16>,
    /// Why each part is no object.
    pub reasons: BTreeMap<u16, LeftOutReason>,
}

impl LeftOutMasks {
    /// Nothing, in a picture of this size.
    pub fn none(width: usize, height: usize) -> Self {
        Self { parts: Image::filled(width, height, 0), reasons: BTreeMap::new() }
    }

    /// Moves some of the masks of `labels` here: their pixels become 0 there.
    pub fn take(&mut self, labels: &mut Image<u16>, reasons: BTreeMap<u16, LeftOutReason>) {
        if reasons.is_empty() {
            return;
        }
        for (part, id) in self.parts.pixels_mut().iter_mut().zip(labels.pixels_mut()).filter(|(_, id)| reasons.contains_key(id)) {
            (*part, *id) = (*id, 0);
        }
        self.reasons.extend(reasons);
    }

    /// Each part with its readings, in order; parts without any are left out. `labelled`: whether the parts' numbers are the frame's labels.
    pub fn described(&self, depth: &DepthMap, world_from_camera: &Isometry3<f64>, labelled: bool) -> Vec<LeftOut> {
        if self.reasons.is_empty() {
            return Vec::new();
        }
        let width = depth.width();
        let mut sums: BTreeMap<u16, (usize, Vector3<f64>)> = BTreeMap::new();
        for (i, part) in self.parts.pixels().iter().enumerate().filter(|(i, part)| **part != 0 && !depth.depth_m().pixels()[*i].is_nan()) {
            let (points, sum) = sums.entry(*part).or_insert((0, Vector3::zeros()));
            *points += 1;
            *sum += depth.point(i % width, i / width).coords.cast::<f64>();
        }
        let described = sums.into_iter().filter_map(|(part, (points, sum))| {
            let reason = *self.reasons.get(&part)?;
            let center = world_from_camera * nalgebra::Point3::from(sum / points as f64);
            let centroid_m = [center.x, center.y, center.z].map(|m| (m * 1e6).round() / 1e6 + 0.0);
            Some(LeftOut { reason, points, centroid_m, label: labelled.then_some(part) })
        });
        described.collect()
    }
}
