//! Labels for a frame that came without: what stands on the supports, split into objects.
//!
//! Worked out on the coarse picture: large horizontal surfaces are furniture, what rises above one of them is foreground, its
//! components are objects. The labels are then spread to the full picture by nearness in space.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use repose_geometry::{Aabb, Image, Point2, Point3};
use repose_proto::LeftOutReason;

use super::{components, halves, hollows};
use crate::readings::depth::DepthMap;
use crate::readings::point_map::{PointMap, is_reading};
use crate::settings::ComponentSettings;
use crate::supports::surfaces::SupportSurface;

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

/// What was found in the coarse picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Found {
    /// Ids 1, 2, … from the largest object down, then those of what is none; 0 where nothing rises above the supports.
    pub ids: Image<u16>,
    /// Why some of them are no objects.
    pub no_objects: BTreeMap<u16, LeftOutReason>,
}

/// Objects in the coarse picture. `surfaces` are those of the whole scene, tops of yet unknown objects among them.
pub fn find(view: &CoarseView<'_>, surfaces: &[SupportSurface], settings: &ComponentSettings) -> Found {
    let mut supports: Vec<&SupportSurface> = surfaces.iter().filter(|s| s.seen_m2 >= settings.min_support_area_m2).collect();
    if supports.is_empty() {
        // A close view of a small table: its largest surface has to do.
        supports.extend(surfaces.iter().max_by(|a, b| a.seen_m2.total_cmp(&b.seen_m2)));
    }
    let foreground = foreground(view, &supports, settings);
    let mut ids = components::find(view.in_camera, &foreground, view.focal_px, settings);
    hollows::join(&mut ids, view.in_camera, view.in_world, &settings.hollows);
    halves::join(&mut ids, view.in_camera, view.in_world, &settings.halves);
    let small = components::add_rest(&mut ids, view.in_camera, &foreground, view.focal_px, settings);
    judged(&ids, &small, view.in_world, &supports, settings)
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

/// Pixels that rise above the support under them and lie on none of the others.
///
/// Above the main support everything counts, wherever it is: what leans over the edge is an object, too. A lower support counts where it
/// is not under the main one; otherwise the sides of a table would stand on the floor.
fn foreground(view: &CoarseView<'_>, supports: &[&SupportSurface], settings: &ComponentSettings) -> Image<bool> {
    let mut foreground = Image::filled(view.in_world.width(), view.in_world.height(), false);
    let Some(main) = supports.iter().max_by(|a, b| a.seen_m2.total_cmp(&b.seen_m2)) else { return foreground };
    let lower: Vec<&&SupportSurface> = supports.iter().filter(|s| s.height_m < main.height_m).collect();
    let pixels = view.in_world.pixels().iter().zip(view.in_camera.pixels());
    for (out, (p, seen)) in foreground.pixels_mut().iter_mut().zip(pixels) {
        let clearance = settings.clearance_m + settings.noise_per_m2 * seen.z * seen.z;
        let above_lower = |s: &&&SupportSurface| p.z > s.height_m + clearance && s.outline.margin(&p.xy()) > 0.0;
        let stands = p.z > main.height_m + clearance
            || lower.iter().any(above_lower) && main.outline.margin(&p.xy()) < -OUTLINE_SLACK_M && p.z < main.height_m - clearance;
        let on = |s: &&SupportSurface| (p.z - s.height_m).abs() <= clearance && s.outline.margin(&p.xy()) > 0.0;
        *out = stands && !supports.iter().any(on);
    }
    foreground
}

/// Says of each component whether it is an object, and numbers the objects first. Those in `small` are too small.
fn judged(
    ids: &Image<u16>,
    small: &RangeInclusive<u16>,
    in_world: &PointMap,
    supports: &[&SupportSurface],
    settings: &ComponentSettings,
) -> Found {
    let most = usize::from(ids.pixels().iter().copied().max().unwrap_or(0));
    let mut points: Vec<Vec<Point3<f32>>> = vec![Vec::new(); most + 1];
    for (p, id) in in_world.pixels().iter().zip(ids.pixels()).filter(|(_, id)| **id != 0) {
        points[usize::from(*id)].push(*p);
    }
    let reason = |id: u16| {
        let bounds = Aabb::of(&points[usize::from(id)])?;
        let center: Point2<f32> = bounds.center().xy();
        let stands = supports.is_empty() || supports.iter().any(|s| s.outline.margin(&center) > -OUTLINE_SLACK_M);
        if small.contains(&id) {
            Some(LeftOutReason::TooSmall)
        } else if bounds.extent().max() > settings.max_extent_m {
            Some(LeftOutReason::TooLarge)
        } else {
            (!stands).then_some(LeftOutReason::BesideSupports)
        }
    };
    let present = (1..=most as u16).filter(|id| !points[usize::from(*id)].is_empty());
    let (objects, others): (Vec<_>, Vec<_>) = present.map(|id| (id, reason(id))).partition(|(_, reason)| reason.is_none());
    let mut renumbered = vec![0u16; most + 1];
    let mut no_objects = BTreeMap::new();
    for (number, (id, reason)) in (1..).zip(objects.into_iter().chain(others)) {
        renumbered[usize::from(id)] = number;
        if let Some(reason) = reason {
            no_objects.insert(number, reason);
        }
    }
    Found { ids: ids.map(|id| renumbered[usize::from(*id)]), no_objects }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::readings::point_map::transformed;
    use crate::settings::SurfaceSettings;
    use crate::synthetic::{Solid, cast, render};
    use crate::{readings::upward, supports::surfaces};
    use repose_geometry::transform::look_at;
    use repose_geometry::{Pinhole, Vector3};

    const CAMERA: Pinhole = Pinhole { width: 320, height: 240, fx: 262.0, fy: 262.0, cx: 159.5, cy: 119.5 };

    /// Per solid, the id that most of its pixels got.
    fn main_ids(solids: &[Solid]) -> Vec<u16> {
        let world_from_camera = look_at(&Point3::new(0.0, -0.9, 0.8), &Point3::new(0.0, 0.1, 0.0), &Vector3::z());
        let in_camera = render(solids, &CAMERA, &world_from_camera);
        let in_world = transformed(&in_camera, &world_from_camera);
        let settings = SurfaceSettings::default();
        let faces_up = upward::upward_facing(&in_world, &in_camera.map(|p| p.z), 262.0, settings.max_tilt_rad);
        let facing = in_world.pixels().iter().zip(faces_up.pixels()).filter(|(_, up)| **up).map(|(p, _)| (*p, 0));
        let surfaces = surfaces::find(facing, &settings);
        let view = CoarseView { in_camera: &in_camera, in_world: &in_world, focal_px: 262.0 };
        let found = find(&view, &surfaces, &ComponentSettings::default());
        let labels = found.ids.map(|id| if found.no_objects.contains_key(id) { 0 } else { *id });
        let seen = cast(solids, &CAMERA, &world_from_camera);
        (0..solids.len())
            .map(|solid| {
                let mut counts = BTreeMap::new();
                for (_, id) in seen.pixels().iter().zip(labels.pixels()).filter(|(s, _)| s.is_some_and(|(_, k)| k == solid)) {
                    *counts.entry(*id).or_insert(0usize) += 1;
                }
                counts.into_iter().max_by_key(|(_, n)| *n).map_or(0, |(id, _)| id)
            })
            .collect()
    }

    #[test]
    fn objects_on_two_tables_of_different_height_are_found_and_the_tables_are_not() {
        let higher = Solid::cuboid([-0.4, 0.1, -0.02], [0.3, 0.4, 0.02]);
        let lower = Solid::cuboid([0.4, 0.1, -0.22], [0.3, 0.4, 0.02]);
        let on_higher = Solid::cuboid([-0.35, 0.1, 0.05], [0.05, 0.05, 0.05]);
        let on_lower = Solid::cuboid([0.4, 0.1, -0.14], [0.05, 0.05, 0.06]);
        let ids = main_ids(&[higher, lower, on_higher, on_lower]);
        assert_eq!((ids[0], ids[1]), (0, 0));
        assert!(ids[2] != 0 && ids[3] != 0 && ids[2] != ids[3], "{ids:?}");
    }

    #[test]
    fn a_box_on_a_shelf_over_the_table_is_found_and_the_shelf_is_not() {
        let shelf = Solid::cuboid([0.0, 0.55, 0.3], [0.5, 0.15, 0.01]);
        let on_table = Solid::cuboid([0.1, -0.1, 0.04], [0.05, 0.05, 0.04]);
        let on_shelf = Solid::cuboid([-0.2, 0.5, 0.36], [0.05, 0.05, 0.05]);
        let ids = main_ids(&[Solid::table(0.0), shelf, on_table, on_shelf]);
        assert_eq!((ids[0], ids[1]), (0, 0));
        assert!(ids[2] != 0 && ids[3] != 0 && ids[2] != ids[3], "{ids:?}");
    }
}
