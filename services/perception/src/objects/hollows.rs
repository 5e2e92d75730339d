//! The inside of a bowl or mug joined with its outside.
//!
//! From above and in front, a hollow object's near wall covers part of its far wall, and the jump between them cuts the object in two.
//! A component is the inside of another when its lower end disappears behind that one, both end at the same height (the rim), and it
//! bends away from the camera: what stands behind something else and is whole bends towards it.

use repose_geometry::{Image, Point3};

use crate::readings::point_map::{PointMap, is_reading};
use crate::settings::HollowSettings;

/// Pairs of the inside and the outside of a hollow object. What lies between the two (a bowl's floor) is given to the outside.
///
/// `labels` are the components of the same picture as the points.
pub fn find(labels: &mut Image<u16>, in_camera: &PointMap, in_world: &PointMap, settings: &HollowSettings) -> Vec<(u16, u16)> {
    let mut pairs = Vec::new();
    let count = usize::from(labels.pixels().iter().copied().max().unwrap_or(0)) + 1;
    let rims_m = rims(labels, in_world, count);
    let below = Below::look(labels, count, settings);
    // Larger components have lower ids: an inside is judged against every other id, in order, so that the result is one and the same.
    for inside in 1..count {
        let Some(outside) = below.cover_of(inside, settings.min_covered) else { continue };
        let level = (rims_m[inside] - rims_m[outside]).abs() <= settings.rim_tolerance_m;
        if level && bends_away(labels, in_camera, inside as u16, settings) {
            fill(labels, in_camera, inside as u16, outside as u16, settings);
            pairs.push((inside as u16, outside as u16));
        }
    }
    pairs
}

/// Per id, the height that 95 % of its points stay below; NaN for an id without points. `count` is one more than the highest id.
pub(crate) fn rims(labels: &Image<u16>, in_world: &PointMap, count: usize) -> Vec<f32> {
    let mut heights: Vec<Vec<f32>> = vec![Vec::new(); count];
    for (id, p) in labels.pixels().iter().zip(in_world.pixels()).filter(|(id, p)| **id != 0 && is_reading(p)) {
        heights[usize::from(*id)].push(p.z);
    }
    let rim = |mut z: Vec<f32>| {
        let index = (z.len() * 95 / 100).min(z.len().saturating_sub(1));
        if z.is_empty() { f32::NAN } else { *z.select_nth_unstable_by(index, f32::total_cmp).1 }
    };
    heights.into_iter().map(rim).collect()
}

/// What each component's columns end on, looking down the picture.
struct Below {
    /// Per id, how many columns it has.
    columns: Vec<usize>,
    /// Per id, in how many of them each other id comes next.
    next: Vec<std::collections::BTreeMap<u16, usize>>,
}

impl Below {
    fn look(labels: &Image<u16>, count: usize, settings: &HollowSettings) -> Self {
        let mut below = Self { columns: vec![0; count], next: vec![std::collections::BTreeMap::new(); count] };
        for u in 0..labels.width() {
            // Walked upwards, the first pixel of an id in a column is its lowest.
            let mut last: Option<(u16, usize)> = None;
            for v in (0..labels.height()).rev() {
                let id = labels[(u, v)];
                if id == 0 {
                    continue;
                }
                if let Some((under, _)) = last.filter(|(under, at)| *under != id && at - v <= settings.max_floor_px) {
                    *below.next[usize::from(id)].entry(under).or_insert(0) += 1;
                }
                if last.is_none_or(|(under, _)| under != id) {
                    below.columns[usize::from(id)] += 1;
                }
                last = Some((id, v));
            }
        }
        below
    }

    /// The id that comes next in at least a share of a component's columns.
    fn cover_of(&self, id: usize, share: f64) -> Option<usize> {
        let (&cover, &columns) = self.next[id].iter().max_by_key(|(cover, n)| (**n, std::cmp::Reverse(**cover)))?;
        (columns as f64 >= share * self.columns[id] as f64).then_some(usize::from(cover))
    }
}

/// Whether most rows of a component sag away from the camera between their ends.
fn bends_away(labels: &Image<u16>, in_camera: &PointMap, id: u16, settings: &HollowSettings) -> bool {
    let width = labels.width();
    let (mut rows, mut sagging) = (0, 0);
    for (row, points) in labels.pixels().chunks_exact(width).zip(in_camera.pixels().chunks_exact(width)) {
        let of_id = |u: &usize| row[*u] == id && is_reading(&points[*u]);
        let (Some(left), Some(right)) = ((0..width).find(of_id), (0..width).rev().find(of_id)) else { continue };
        let middle = (left + right) / 2;
        if right - left < settings.min_row_px || !of_id(&middle) {
            continue;
        }
        rows += 1;
        sagging += usize::from(sag(&points[left], &points[middle], &points[right]) >= settings.min_sag);
    }
    rows > 0 && 2 * sagging > rows
}

/// How far the middle lies behind the line between the ends, as a share of that line's length.
fn sag(left: &Point3<f32>, middle: &Point3<f32>, right: &Point3<f32>) -> f32 {
    let away = middle.coords.normalize();
    (middle - nalgebra::center(left, right)).dot(&away) / (right - left).norm()
}

/// Gives `outside` what is seen between `inside` and it in a column.
fn fill(labels: &mut Image<u16>, in_camera: &PointMap, inside: u16, outside: u16, settings: &HollowSettings) {
    for u in 0..labels.width() {
        let mut floor = Vec::new();
        let mut from_inside = None;
        for v in 0..labels.height() {
            match labels[(u, v)] {
                id if id == inside => {
                    floor.clear();
                    from_inside = Some(v);
                }
                0 if from_inside.is_some_and(|from| v - from <= settings.max_floor_px) => {
                    if is_reading(&in_camera[(u, v)]) {
                        floor.push(v);
                    }
                }
                id => {
                    if id == outside && from_inside.is_some() {
                        for v in floor.drain(..) {
                            labels[(u, v)] = outside;
                        }
                    }
                    from_inside = None;
                    floor.clear();
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::objects::components;
    use crate::objects::parts::Parts;
    use crate::readings::point_map::transformed;
    use crate::settings::ComponentSettings;
    use crate::synthetic::{Solid, cast, render};
    use repose_geometry::transform::look_at;
    use repose_geometry::{Pinhole, Vector3};

    const CAMERA: Pinhole = Pinhole { width: 320, height: 240, fx: 262.0, fy: 262.0, cx: 159.5, cy: 119.5 };

    /// The ids, before and after joining, of all solids but the table that have at least 40 pixels.
    fn ids(solids: &[Solid]) -> (Vec<u16>, Vec<u16>) {
        let world_from_camera = look_at(&Point3::new(0.0, -0.6, 0.45), &Point3::new(0.0, 0.0, 0.05), &Vector3::z());
        let in_camera = render(solids, &CAMERA, &world_from_camera);
        let in_world = transformed(&in_camera, &world_from_camera);
        let seen = cast(solids, &CAMERA, &world_from_camera);
        let foreground = seen.map(|s| s.is_some_and(|(_, solid)| solid > 0));
        let mut labels = components::find(&in_camera, &foreground, 262.0, &ComponentSettings::default(), &|_, _| false);
        let distinct = |labels: &Image<u16>| {
            let mut ids: Vec<u16> = labels.pixels().iter().copied().filter(|id| *id != 0).collect();
            ids.sort_unstable();
            ids.dedup();
            ids
        };
        let before = distinct(&labels);
        let together = find(&mut labels, &in_camera, &in_world, &HollowSettings::default());
        (before, distinct(&Parts { ids: labels, together: Vec::new() }.joined(&together)))
    }

    /// Four walls 5 mm thick, 10 cm wide and 8 cm high, without a floor.
    fn pot() -> [Solid; 4] {
        let wall = |x: f64, y: f64, half_x: f64, half_y: f64| Solid::cuboid([x, y, 0.04], [half_x, half_y, 0.04]);
        [wall(0.0, -0.05, 0.05, 0.0025), wall(0.0, 0.05, 0.05, 0.0025), wall(-0.05, 0.0, 0.0025, 0.05), wall(0.05, 0.0, 0.0025, 0.05)]
    }

    #[test]
    fn the_walls_of_a_pot_are_one_object() {
        let mut solids = vec![Solid::table(0.0)];
        solids.extend(pot());
        let (_, after) = ids(&solids);
        assert_eq!(after.len(), 1, "{after:?}");
    }

    #[test]
    fn a_box_behind_a_box_of_its_height_stays_another() {
        let solids = [
            Solid::table(0.0),
            Solid::cuboid([0.0, -0.05, 0.05], [0.06, 0.02, 0.05]),
            Solid::cuboid([0.0, 0.09, 0.05], [0.06, 0.02, 0.05]),
        ];
        let (before, after) = ids(&solids);
        assert_eq!(before, after);
        assert_eq!(after.len(), 2);
    }
}
