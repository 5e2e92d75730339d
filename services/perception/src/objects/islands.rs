//! Groups of pixels cut where nothing holds them together.
//!
//! The network for masks compares pixels at a distance, too. So a pixel on the outline of something upright that shows the floor far behind it may
//! come into its group, and make a box of several metres of a book. What is connected pixel by pixel stays together; of what is not, a few
//! pixels are strays, and what reaches too far for one object is several.

use std::collections::BTreeMap;

use repose_geometry::{Aabb, Image, Point3};

use crate::readings::point_map::PointMap;

/// Neighbouring pixels further apart than this show no one surface, metres.
const STEP_M: f32 = 0.05;
/// An island of fewer pixels, and of less than this share of its group's largest, is a stray.
const STRAY_PIXELS: usize = 12;
const STRAY_SHARE: f32 = 0.05;

/// The ids `seen` without strays, those that are longer than `longest_m` cut into islands: the largest keeps the id, the others get new ones.
pub fn parted(seen: &Image<u16>, in_world: &PointMap, longest_m: f32) -> Image<u16> {
    let mut by_id: BTreeMap<u16, Vec<Vec<usize>>> = BTreeMap::new();
    for island in islands(seen, in_world) {
        by_id.entry(seen.pixels()[island[0]]).or_default().push(island);
    }
    let mut next = by_id.keys().last().copied().unwrap_or(0);
    let mut parted = seen.clone();
    for mut islands in by_id.into_values() {
        islands.sort_by_key(|pixels| std::cmp::Reverse(pixels.len()));
        let largest = islands[0].len();
        let is_stray = |pixels: &Vec<usize>| pixels.len() < STRAY_PIXELS && (pixels.len() as f32) < STRAY_SHARE * largest as f32;
        let (strays, islands): (Vec<_>, Vec<_>) = islands.into_iter().partition(is_stray);
        strays.concat().into_iter().for_each(|i| parted.pixels_mut()[i] = 0);
        let points: Vec<Point3<f32>> = islands.iter().flatten().map(|i| in_world.pixels()[*i]).collect();
        if Aabb::of(&points).is_none_or(|bounds| bounds.extent().max() <= longest_m) {
            continue;
        }
        for pixels in islands.into_iter().skip(1) {
            let Some(new) = next.checked_add(1) else { return parted };
            next = new;
            pixels.into_iter().for_each(|i| parted.pixels_mut()[i] = new);
        }
    }
    parted
}

/// The connected pixels of one id each.
fn islands(seen: &Image<u16>, in_world: &PointMap) -> Vec<Vec<usize>> {
    let (width, height) = (seen.width(), seen.height());
    let (ids, points) = (seen.pixels(), in_world.pixels());
    let mut reached = vec![false; ids.len()];
    let mut islands = Vec::new();
    for start in 0..ids.len() {
        if ids[start] == 0 || reached[start] {
            continue;
        }
        reached[start] = true;
        let (mut island, mut at) = (vec![start], 0);
        while let Some(&i) = island.get(at) {
            at += 1;
            let (u, v) = (i % width, i / width);
            let beside = [
                (u > 0).then(|| i - 1),
                (u + 1 < width).then_some(i + 1),
                (v > 0).then(|| i - width),
                (v + 1 < height).then_some(i + width),
            ];
            for j in beside.into_iter().flatten() {
                // False where there is no reading.
                let near = (points[i] - points[j]).norm_squared() <= STEP_M * STEP_M;
                if ids[j] == ids[i] && !reached[j] && near {
                    reached[j] = true;
                    island.push(j);
                }
            }
        }
        islands.push(island);
    }
    islands
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows of pixels a centimetre apart, those from the seventh column on two metres behind.
    fn parts(row: &[u16], longest_m: f32) -> Vec<u16> {
        const ROWS: usize = 20;
        let point = |i: usize| {
            let (u, v) = (i % row.len(), i / row.len());
            Point3::new(u as f32 * 0.01, if u < 6 { 0.0 } else { 2.0 }, v as f32 * 0.01)
        };
        let in_world = Image::from_pixels(row.len(), ROWS, (0..row.len() * ROWS).map(point).collect()).unwrap();
        let mut seen = Image::from_pixels(row.len(), ROWS, row.repeat(ROWS)).unwrap();
        // A stray: one pixel of the background is in the first group.
        seen[(7, 3)] = 1;
        let parted = parted(&seen, &in_world, longest_m);
        assert_eq!(parted[(7, 3)], if row[7] == 1 { parted[(7, 0)] } else { 0 }, "a stray is nobody's");
        parted.pixels()[..row.len()].to_vec()
    }

    #[test]
    fn what_reaches_too_far_is_cut_where_it_is_not_connected_and_the_largest_part_keeps_its_id() {
        assert_eq!(parts(&[1, 1, 1, 2, 1, 1, 1, 1], 0.8), [1, 1, 1, 2, 3, 3, 4, 4]);
    }

    #[test]
    fn a_stray_far_behind_makes_nothing_too_long() {
        assert_eq!(parts(&[1, 1, 1, 2, 1, 1, 0, 0], 0.8), [1, 1, 1, 2, 1, 1, 0, 0], "an object behind another stays one");
    }
}
