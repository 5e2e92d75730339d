//! Labels for a frame that came without: what stands on the supports, split into objects.
//!
//! Worked out on the coarse picture: large horizontal surfaces are furniture, what rises above one of them is foreground, its
//! components are objects. The labels are then spread to the full picture by nearness in space.

use repose_geometry::{Aabb, Image, Point2, Point3};

use crate::depth::DepthMap;
use crate::point_map::{PointMap, is_reading};
use crate::settings::ComponentSettings;
use crate::surfaces::SupportSurface;
use crate::{components, halves, hollows};

/// How far outside the outline of a support's seen part its objects may stand, metres: they hide its rim.
const OUTLINE_SLACK_M: f32 = 0.05;

/// A picture coarse enough to be searched, with its points in both frames.
pub struct CoarseView<'a> {
    /// Points in the camera frame.
    pub in_camera: &'a PointMap,
    /// The same points in the world.
    pub in_world: &'a PointMap,
    /// Focal length of this picture, pixels.
    pub focal_px: f32,
}

/// Instance ids of the coarse picture, 1, 2, … from the largest down; 0 where there is no object.
///
/// `surfaces` are those of the whole scene, tops of yet unknown objects among them.
pub fn label(view: &CoarseView<'_>, surfaces: &[SupportSurface], settings: &ComponentSettings) -> Image<u16> {
    let mut supports: Vec<&SupportSurface> = surfaces.iter().filter(|s| s.seen_m2 >= settings.min_support_area_m2).collect();
    if supports.is_empty() {
        // A close view of a small table: its largest surface has to do.
        supports.extend(surfaces.iter().max_by(|a, b| a.seen_m2.total_cmp(&b.seen_m2)));
    }
    let foreground = foreground(view, &supports, settings);
    let mut labels = components::find(view.in_camera, &foreground, view.focal_px, settings);
    hollows::join(&mut labels, view.in_camera, view.in_world, &settings.hollows);
    halves::join(&mut labels, view.in_camera, view.in_world, &settings.halves);
    keep_objects(&mut labels, view.in_world, &supports, settings);
    labels
}

/// The full picture's labels: each pixel takes the label of the nearest (in space) of the coarse pixels around it.
///
/// `stride` is what `coarse` was thinned by; `depth` is the full picture.
pub fn spread(coarse: &Image<u16>, depth: &DepthMap, stride: usize) -> Image<u16> {
    let (width, height) = (depth.width(), depth.height());
    let mut labels = Image::filled(width, height, 0u16);
    for (row, v0) in (0..height).step_by(stride).enumerate() {
        let below = (row + 1).min(coarse.height() - 1);
        for (column, u0) in (0..width).step_by(stride).enumerate() {
            let right = (column + 1).min(coarse.width() - 1);
            let corners = [(column, row), (right, row), (column, below), (right, below)];
            let ids = corners.map(|at| coarse[at]);
            if ids == [0; 4] {
                continue;
            }
            for v in v0..(v0 + stride).min(height) {
                for u in u0..(u0 + stride).min(width) {
                    let p = depth.point(u, v);
                    if !is_reading(&p) {
                        continue;
                    }
                    if ids.iter().all(|id| *id == ids[0]) {
                        labels[(u, v)] = ids[0];
                        continue;
                    }
                    let mut nearest = (f32::INFINITY, 0);
                    for ((column, row), id) in corners.into_iter().zip(ids) {
                        let distance = (depth.point(column * stride, row * stride) - p).norm_squared();
                        if distance < nearest.0 {
                            nearest = (distance, id);
                        }
                    }
                    labels[(u, v)] = nearest.1;
                }
            }
        }
    }
    labels
}

/// Pixels that rise above the main support and lie on none of the others.
fn foreground(view: &CoarseView<'_>, supports: &[&SupportSurface], settings: &ComponentSettings) -> Image<bool> {
    let mut foreground = Image::filled(view.in_world.width(), view.in_world.height(), false);
    let main = supports.iter().max_by(|a, b| a.seen_m2.total_cmp(&b.seen_m2));
    let lowest_m = main.map_or(f32::NEG_INFINITY, |s| s.height_m);
    let pixels = view.in_world.pixels().iter().zip(view.in_camera.pixels());
    for (out, (p, seen)) in foreground.pixels_mut().iter_mut().zip(pixels) {
        let clearance = settings.clearance_m + settings.noise_per_m2 * seen.z * seen.z;
        let on = |s: &&SupportSurface| (p.z - s.height_m).abs() <= clearance && s.outline.margin(&p.xy()) > 0.0;
        *out = p.z > lowest_m + clearance && !supports.iter().any(on);
    }
    foreground
}

/// Drops what is too large for an object or stands beside every support, and closes the gaps in the numbering.
fn keep_objects(labels: &mut Image<u16>, in_world: &PointMap, supports: &[&SupportSurface], settings: &ComponentSettings) {
    let most = labels.pixels().iter().copied().max().unwrap_or(0);
    let mut points: Vec<Vec<Point3<f32>>> = vec![Vec::new(); usize::from(most) + 1];
    for (p, id) in in_world.pixels().iter().zip(labels.pixels()).filter(|(_, id)| **id != 0) {
        points[usize::from(*id)].push(*p);
    }
    let mut renumbered = vec![0u16; points.len()];
    let mut next = 1;
    for (id, points) in points.iter().enumerate().skip(1) {
        let Some(bounds) = Aabb::of(points) else { continue };
        let center: Point2<f32> = bounds.center().xy();
        let stands = supports.is_empty() || supports.iter().any(|s| s.outline.margin(&center) > -OUTLINE_SLACK_M);
        if bounds.extent().max() <= settings.max_extent_m && stands {
            renumbered[id] = next;
            next += 1;
        }
    }
    for id in labels.pixels_mut() {
        *id = renumbered[usize::from(*id)];
    }
}
