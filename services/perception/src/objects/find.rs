//! Labels for a frame that came without: what stands on the furniture, split into objects.
//!
//! Worked out on the coarse picture: what rises above the furniture's levels falls into parts, parts that belong together are objects,
//! and each is judged.

use std::collections::{BTreeMap, BTreeSet};

use repose_geometry::{Aabb, Image, Point3};
use repose_proto::LeftOutReason;

use super::coarse::CoarseView;
use super::foreground::{self, Foreground};
use super::parts::{self, Parts};
use crate::readings::point_map::PointMap;
use crate::settings::{ComponentSettings, LevelSettings};
use crate::supports::levels::Levels;

/// What was found in the coarse picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Found {
    /// Ids 1, 2, … from the largest object down, then those of what is none; 0 where nothing rises above the supports.
    pub ids: Image<u16>,
    /// Why some of them are no objects.
    pub no_objects: BTreeMap<u16, LeftOutReason>,
    /// Those of these that may well be furniture, on which things can stand.
    pub furniture: BTreeSet<u16>,
}

impl Found {
    /// Ids of which nothing is known but that they are objects.
    pub fn objects(ids: Image<u16>) -> Self {
        Self { ids, no_objects: BTreeMap::new(), furniture: BTreeSet::new() }
    }

    /// Puts objects whose masks have changed in order again, from the largest down; what is no object keeps its id.
    pub fn renumber(&mut self) {
        let mut sizes: BTreeMap<u16, usize> = BTreeMap::new();
        for id in self.ids.pixels().iter().filter(|id| **id != 0 && !self.no_objects.contains_key(id)) {
            *sizes.entry(*id).or_insert(0) += 1;
        }
        let numbers: Vec<u16> = sizes.keys().copied().collect();
        let mut by_size: Vec<u16> = numbers.clone();
        by_size.sort_by_key(|id| (std::cmp::Reverse(sizes[id]), *id));
        let renumbered: BTreeMap<u16, u16> = by_size.into_iter().zip(numbers).collect();
        self.ids = self.ids.map(|id| renumbered.get(id).copied().unwrap_or(*id));
    }
}

/// Objects in the coarse picture. `together` says which parts belong together: [`Parts::together`] is what geometry says.
pub fn find(
    view: &CoarseView<'_>,
    levels: &Levels,
    settings: &ComponentSettings,
    level_settings: &LevelSettings,
    together: impl FnOnce(&Parts) -> Vec<(u16, u16)>,
) -> Found {
    let foreground = foreground::find(view.in_camera, view.in_world, levels, view.camera_m, &settings.foreground, level_settings);
    let parts = parts::find(view, &foreground, settings);
    let joined = parts.joined(&together(&parts));
    judged(&joined, &foreground, view.in_world, settings)
}

/// Says of each object whether it is one, and numbers those first, from the largest down.
fn judged(ids: &Image<u16>, foreground: &Foreground, in_world: &PointMap, settings: &ComponentSettings) -> Found {
    let most = usize::from(ids.pixels().iter().copied().max().unwrap_or(0));
    let mut points: Vec<Vec<Point3<f32>>> = vec![Vec::new(); most + 1];
    let mut inside = vec![0usize; most + 1];
    for (i, id) in ids.pixels().iter().enumerate().filter(|(_, id)| **id != 0) {
        points[usize::from(*id)].push(in_world.pixels()[i]);
        inside[usize::from(*id)] += usize::from(foreground.inside.pixels()[i]);
    }
    let reason = |id: u16| {
        let own = &points[usize::from(id)];
        let bounds = Aabb::of(own)?;
        if own.len() < settings.min_pixels {
            Some(LeftOutReason::TooSmall)
        } else if bounds.extent().max() > settings.max_extent_m {
            Some(LeftOutReason::TooLarge)
        } else {
            let stands = inside[usize::from(id)] as f32 >= settings.min_inside * own.len() as f32;
            (!stands).then_some(LeftOutReason::BesideSupports)
        }
    };
    let mut present: Vec<u16> = (1..=most as u16).filter(|id| !points[usize::from(*id)].is_empty()).collect();
    present.sort_by_key(|id| (std::cmp::Reverse(points[usize::from(*id)].len()), *id));
    let (mut objects, mut others): (Vec<_>, Vec<_>) =
        present.into_iter().map(|id| (id, reason(id))).partition(|(_, reason)| reason.is_none());
    others.extend(objects.drain(settings.max_count.min(objects.len())..).map(|(id, _)| (id, Some(LeftOutReason::TooMany))));
    let mut renumbered = vec![0u16; most + 1];
    let mut no_objects = BTreeMap::new();
    for (number, (id, reason)) in (1..).zip(objects.into_iter().chain(others)) {
        renumbered[usize::from(id)] = number;
        if let Some(reason) = reason {
            no_objects.insert(number, reason);
        }
    }
    Found { ids: ids.map(|id| renumbered[usize::from(*id)]), no_objects, furniture: BTreeSet::new() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::readings::point_map::transformed;
    use crate::readings::upward;
    use crate::settings::Settings;
    use crate::supports::levels::{self, Viewpoint};
    use crate::supports::surfaces;
    use crate::synthetic::{Solid, cast, render};
    use repose_geometry::transform::look_at;
    use repose_geometry::{Pinhole, Vector3};

    const CAMERA: Pinhole = Pinhole { width: 320, height: 240, fx: 262.0, fy: 262.0, cx: 159.5, cy: 119.5 };

    /// Per solid, the id that most of its pixels got.
    fn main_ids(solids: &[Solid]) -> Vec<u16> {
        let world_from_camera = look_at(&Point3::new(0.0, -0.9, 0.8), &Point3::new(0.0, 0.1, 0.0), &Vector3::z());
        let in_camera = render(solids, &CAMERA, &world_from_camera);
        let in_world = transformed(&in_camera, &world_from_camera);
        let settings = Settings::default();
        let faces_up = upward::upward_facing(&in_world, &in_camera.map(|p| p.z), 262.0, settings.surfaces.max_tilt_rad);
        let facing = in_world.pixels().iter().zip(faces_up.pixels()).filter(|(_, up)| **up).map(|(p, _)| (*p, 0));
        let pieces = surfaces::find(facing, &settings.surfaces, settings.levels.max_slope);
        let levels = levels::find(&pieces, &in_camera, &in_world, &Viewpoint::new(&CAMERA, &world_from_camera), &settings.levels);
        let view = CoarseView { in_camera: &in_camera, in_world: &in_world, faces_up: &faces_up, focal_px: 262.0, camera_m: 0.8 };
        let found = find(&view, &levels, &settings.components, &settings.levels, |parts| parts.together.clone());
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
