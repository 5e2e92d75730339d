//! Objects without labels: connected readings above the supports, cut at depth jumps and at creases.
//!
//! Two neighbouring pixels belong together when their points are close in space. Objects that touch meet in a crease (each single
//! convex object has none on its outside), seen as a pixel that lies deeper than the middle of two readings on either side of it; creases are cut out
//! first and given back to the nearest component afterwards.

use repose_geometry::{Image, Point3};

use crate::readings::point_map::{PointMap, is_reading};
use crate::readings::upward::arm_px;
use crate::settings::ComponentSettings;

/// Most components.
const MAX_PARTS: usize = 2000;
/// Longest arm over which a crease is looked for, pixels.
const MAX_ARM_PX: usize = 12;
/// A reading further than this many arms away lies beyond a jump and says nothing about a crease.
const MAX_ARM_STRETCH: f32 = 2.5;

/// Ids of the components among `foreground` pixels: 1, 2, … from the largest down (ties by first pixel), 0 elsewhere. Those that only
/// creases made small enough to be missed come last.
///
/// `in_camera` are points in the camera frame, `focal_px` the focal length of the same picture, and `parted` says where between two
/// neighbouring pixels one object ends and another begins.
pub fn find(
    in_camera: &PointMap,
    foreground: &Image<bool>,
    focal_px: f32,
    settings: &ComponentSettings,
    parted: &dyn Fn(usize, usize) -> bool,
) -> Image<u16> {
    let neighbours = Neighbours { in_camera, focal_px, settings, parted };
    let whole: Vec<bool> =
        (0..in_camera.pixels().len()).map(|i| foreground.pixels()[i] && !neighbours.is_crease(i, foreground.pixels())).collect();
    let mut ids = number_by_size(&neighbours, &whole, settings.min_part_pixels, 0);
    grow(&neighbours, foreground.pixels(), &mut ids);
    let rest: Vec<bool> = foreground.pixels().iter().zip(&ids).map(|(marked, id)| *marked && *id == 0).collect();
    let numbered = ids.iter().copied().max().unwrap_or(0);
    let small = number_by_size(&neighbours, &rest, settings.min_told_pixels, usize::from(numbered));
    for (id, small) in ids.iter_mut().zip(small).filter(|(_, small)| *small != 0) {
        *id = numbered + small;
    }
    // The count is the picture's own: a mismatch cannot happen, and nothing found is the harmless reading of it.
    Image::from_pixels(in_camera.width(), in_camera.height(), ids)
        .unwrap_or_else(|_| Image::filled(in_camera.width(), in_camera.height(), 0))
}

/// What decides whether pixels belong together.
struct Neighbours<'a> {
    in_camera: &'a PointMap,
    focal_px: f32,
    settings: &'a ComponentSettings,
    parted: &'a dyn Fn(usize, usize) -> bool,
}

impl Neighbours<'_> {
    fn point(&self, i: usize) -> &Point3<f32> {
        &self.in_camera.pixels()[i]
    }

    fn noise_m(&self, depth_m: f32) -> f32 {
        self.settings.noise_per_m2 * depth_m * depth_m
    }

    /// Whether two adjacent pixels show one surface: closer than the gap plus what a steep surface spans between two pixels.
    fn connected(&self, i: usize, j: usize) -> bool {
        let (a, b) = (self.point(i), self.point(j));
        let pixel_m = a.z / self.focal_px;
        let limit = self.settings.gap_m + self.noise_m(a.z) + pixel_m;
        (a - b).norm_squared() <= limit * limit && !(self.parted)(i, j)
    }

    /// Whether a pixel lies in a valley along any of four directions.
    fn is_crease(&self, i: usize, foreground: &[bool]) -> bool {
        let p = self.point(i);
        if !is_reading(p) {
            return false;
        }
        let (width, height) = (self.in_camera.width() as isize, self.in_camera.height() as isize);
        let (u, v) = (i as isize % width, i as isize / width);
        let arm = arm_px(p.z, self.focal_px, self.settings.crease_arm_m, MAX_ARM_PX) as isize;
        let diagonal = (arm * 7 + 5) / 10;
        let threshold = self.settings.crease_depth_m + self.noise_m(p.z);
        let reach = MAX_ARM_STRETCH * self.settings.crease_arm_m;
        let towards_camera = -p.coords.normalize();
        [(arm, 0), (0, arm), (diagonal, diagonal), (diagonal, -diagonal)].into_iter().any(|(du, dv)| {
            let end = |u: isize, v: isize| {
                let inside = (0..width).contains(&u) && (0..height).contains(&v);
                let j = (v * width + u) as usize;
                (inside && foreground[j]).then(|| self.point(j)).filter(|q| (*q - p).norm_squared() <= reach * reach)
            };
            match (end(u - du, v - dv), end(u + du, v + dv)) {
                (Some(a), Some(b)) => (nalgebra::center(a, b) - p).dot(&towards_camera) > threshold,
                _ => false,
            }
        })
    }
}

/// Connected components of the marked pixels, numbered from the largest down; small ones stay 0. `numbered` are counted already.
fn number_by_size(neighbours: &Neighbours<'_>, marked: &[bool], min_pixels: usize, numbered: usize) -> Vec<u16> {
    let (width, height) = (neighbours.in_camera.width(), neighbours.in_camera.height());
    let mut component = vec![u32::MAX; marked.len()];
    let mut sizes: Vec<(usize, u32)> = Vec::new();
    let mut open = Vec::new();
    for start in 0..marked.len() {
        if !marked[start] || component[start] != u32::MAX {
            continue;
        }
        let id = sizes.len() as u32;
        let mut size = 0;
        component[start] = id;
        open.push(start);
        while let Some(i) = open.pop() {
            size += 1;
            for j in adjacent(i, width, height) {
                if marked[j] && component[j] == u32::MAX && neighbours.connected(i, j) {
                    component[j] = id;
                    open.push(j);
                }
            }
        }
        sizes.push((size, id));
    }
    let mut ranked: Vec<(usize, u32)> = sizes.iter().copied().filter(|(size, _)| *size >= min_pixels).collect();
    ranked.sort_by_key(|&(size, id)| (std::cmp::Reverse(size), id));
    ranked.truncate(MAX_PARTS.saturating_sub(numbered));
    let mut rank = vec![0u16; sizes.len()];
    for (k, (_, id)) in ranked.into_iter().enumerate() {
        rank[id as usize] = k as u16 + 1;
    }
    component.into_iter().map(|c| if c == u32::MAX { 0 } else { rank[c as usize] }).collect()
}

/// Gives foreground pixels without an id that of the nearest component they are connected to, in rings of one pixel.
fn grow(neighbours: &Neighbours<'_>, foreground: &[bool], ids: &mut [u16]) {
    let (width, height) = (neighbours.in_camera.width(), neighbours.in_camera.height());
    let mut ring: Vec<usize> = (0..ids.len()).filter(|&i| ids[i] != 0).collect();
    while !ring.is_empty() {
        let mut next = Vec::new();
        for i in ring {
            for j in adjacent(i, width, height) {
                if foreground[j] && ids[j] == 0 && neighbours.connected(i, j) {
                    ids[j] = ids[i];
                    next.push(j);
                }
            }
        }
        ring = next;
    }
}

/// The four pixels beside a pixel, inside the picture.
fn adjacent(i: usize, width: usize, height: usize) -> impl Iterator<Item = usize> {
    let (u, v) = (i % width, i / width);
    [(u > 0).then(|| i - 1), (u + 1 < width).then(|| i + 1), (v > 0).then(|| i - width), (v + 1 < height).then(|| i + width)]
        .into_iter()
        .flatten()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::{Solid, cast, render};
    use repose_geometry::transform::look_at;
    use repose_geometry::{Pinhole, Vector3};

    const CAMERA: Pinhole = Pinhole { width: 320, height: 240, fx: 262.0, fy: 262.0, cx: 159.5, cy: 119.5 };

    /// For each solid but the table, the ids its pixels got, most frequent first.
    fn ids_per_solid(solids: &[Solid]) -> Vec<Vec<u16>> {
        let world_from_camera = look_at(&Point3::new(0.15, -0.7, 0.55), &Point3::new(0.0, 0.0, 0.05), &Vector3::z());
        let in_camera = render(solids, &CAMERA, &world_from_camera);
        let seen = cast(solids, &CAMERA, &world_from_camera);
        let foreground = seen.map(|s| s.is_some_and(|(_, solid)| solid > 0));
        let ids = find(&in_camera, &foreground, 262.0, &ComponentSettings::default(), &|_, _| false);
        (1..solids.len())
            .map(|solid| {
                let mut counts = std::collections::BTreeMap::new();
                for (s, id) in seen.pixels().iter().zip(ids.pixels()) {
                    if s.is_some_and(|(_, k)| k == solid) {
                        *counts.entry(*id).or_insert(0usize) += 1;
                    }
                }
                let total: usize = counts.values().sum();
                let mut main: Vec<_> =
                    counts.into_iter().filter(|(_, n)| *n * 10 > total).map(|(id, n)| (std::cmp::Reverse(n), id)).collect();
                main.sort_unstable();
                main.into_iter().map(|(_, id)| id).collect()
            })
            .collect()
    }

    #[test]
    fn objects_apart_get_an_id_each() {
        let solids = [
            Solid::table(0.0),
            Solid::cuboid([-0.15, 0.0, 0.05], [0.05, 0.05, 0.05]),
            Solid::cuboid([0.15, 0.0, 0.08], [0.05, 0.05, 0.08]),
        ];
        let ids = ids_per_solid(&solids);
        assert!(ids.iter().all(|ids| ids.len() == 1 && ids[0] != 0) && ids[0] != ids[1], "{ids:?}");
    }

    #[test]
    fn a_stack_is_cut_at_its_crease() {
        let solids =
            [Solid::table(0.0), Solid::cuboid([0.0, 0.0, 0.04], [0.12, 0.12, 0.04]), Solid::cuboid([0.0, 0.03, 0.13], [0.05, 0.05, 0.05])];
        let ids = ids_per_solid(&solids);
        assert!(ids.iter().all(|ids| ids.len() == 1 && ids[0] != 0) && ids[0] != ids[1], "{ids:?}");
    }

    #[test]
    fn a_box_in_front_of_another_is_cut_at_the_jump() {
        let solids =
            [Solid::table(0.0), Solid::cuboid([0.0, 0.1, 0.1], [0.1, 0.03, 0.1]), Solid::cuboid([0.0, -0.05, 0.05], [0.05, 0.05, 0.05])];
        let ids = ids_per_solid(&solids);
        assert!(ids.iter().all(|ids| ids.len() == 1 && ids[0] != 0) && ids[0] != ids[1], "{ids:?}");
    }

    #[test]
    fn specks_are_not_objects() {
        let mut in_camera = PointMap::filled(40, 40, Point3::new(0.0, 0.0, 1.0));
        let mut foreground = Image::filled(40, 40, false);
        for u in 0..5 {
            in_camera[(u, 0)] = Point3::new(u as f32 * 0.002, 0.0, 0.9);
            foreground[(u, 0)] = true;
        }
        assert!(find(&in_camera, &foreground, 50.0, &ComponentSettings::default(), &|_, _| false).pixels().iter().all(|id| *id == 0));
    }
}
