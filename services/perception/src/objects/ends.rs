//! Ends of one object on both sides of something in front of it, which the network for masks sees only as apart, joined.
//!
//! Geometry takes them for one where their surfaces go on behind what is between them. It also takes things for one that merely stand close
//! together; so what is between two ends must be seen to be in front of both, along most of the rows and columns that lead from one to
//! the other. Where parts of the same thing touch, the network saw a border, and all of them stay as they are.

use std::collections::{BTreeMap, BTreeSet};

use repose_geometry::{Image, Point3};

use super::find::Found;
use crate::readings::point_map::PointMap;
use crate::settings::HalvesSettings;

/// Least share of an id's pixels that makes it a part of one of geometry's objects.
const PART_FROM: f32 = 0.6;
/// Least share of the readings between two ends that are in front of both, along a line that says so.
const COVERED_FROM: f32 = 0.7;

/// A pair of ids, the lower one first.
type Pair = (u16, u16);

/// The network's ids `seen` with the ends of one object joined under the lowest of their ids.
pub fn joined(geometry: &Found, seen: &Image<u16>, in_camera: &PointMap, settings: &HalvesSettings) -> Image<u16> {
    let wholes = wholes(geometry, seen);
    let whole_of = |(one, other): &Pair| wholes.get(one).filter(|whole| wholes.get(other) == Some(*whole)).copied();
    let bordered: BTreeSet<u16> = touching(seen).iter().filter_map(whole_of).collect();
    let covered = covered_pairs(seen, in_camera, settings);
    let mut groups: Vec<BTreeSet<u16>> = Vec::new();
    for (one, other) in covered.into_iter().filter(|pair| whole_of(pair).is_some_and(|whole| !bordered.contains(&whole))) {
        let (with, without): (Vec<_>, Vec<_>) = groups.into_iter().partition(|group| group.contains(&one) || group.contains(&other));
        groups = without;
        groups.push(with.into_iter().flatten().chain([one, other]).collect());
    }
    let mut names: BTreeMap<u16, u16> = BTreeMap::new();
    for group in &groups {
        names.extend(group.iter().filter_map(|id| Some((*id, *group.first()?))));
    }
    seen.map(|id| names.get(id).copied().unwrap_or(*id))
}

/// Of the ids that are parts of one of geometry's objects, which one.
fn wholes(geometry: &Found, seen: &Image<u16>) -> BTreeMap<u16, u16> {
    let mut shares: BTreeMap<u16, BTreeMap<u16, usize>> = BTreeMap::new();
    for (id, of) in seen.pixels().iter().zip(geometry.ids.pixels()).filter(|(id, _)| **id != 0) {
        *shares.entry(*id).or_default().entry(*of).or_insert(0) += 1;
    }
    let whole = |(id, shares): (u16, BTreeMap<u16, usize>)| {
        let pixels: usize = shares.values().sum();
        let (of, _) = shares.into_iter().find(|(of, n)| *of != 0 && *n as f32 >= PART_FROM * pixels as f32)?;
        (!geometry.no_objects.contains_key(&of)).then_some((id, of))
    };
    shares.into_iter().filter_map(whole).collect()
}

/// Pairs of ids that are beside each other somewhere.
fn touching(seen: &Image<u16>) -> BTreeSet<Pair> {
    let (width, ids) = (seen.width(), seen.pixels());
    let mut touching = BTreeSet::new();
    for (i, id) in ids.iter().enumerate().filter(|(_, id)| **id != 0) {
        let beside = [((i + 1) % width != 0).then(|| i + 1), Some(i + width)];
        let others = beside.into_iter().flatten().filter_map(|j| ids.get(j)).filter(|other| **other != 0 && *other != id);
        touching.extend(others.map(|other| (*id.min(other), *id.max(other))));
    }
    touching
}

/// Pairs of ids with something in front of both between them, along most of the rows and columns on which they follow each other.
fn covered_pairs(seen: &Image<u16>, in_camera: &PointMap, settings: &HalvesSettings) -> Vec<Pair> {
    let (width, height) = (seen.width(), seen.height());
    let mut tallies: BTreeMap<Pair, [usize; 2]> = BTreeMap::new();
    let rows = (0..height).map(|v| (0..width).map(|u| v * width + u).collect::<Vec<_>>());
    let columns = (0..width).map(|u| (0..height).map(|v| v * width + u).collect::<Vec<_>>());
    for line in rows.chain(columns) {
        for (pair, covered) in told(&line, seen.pixels(), in_camera.pixels(), settings) {
            tallies.entry(pair).or_insert([0; 2])[usize::from(covered)] += 1;
        }
    }
    let says =
        |[open, covered]: [usize; 2]| covered >= settings.min_lines && covered as f64 >= settings.min_agreement * (open + covered) as f64;
    tallies.into_iter().filter(|(_, tally)| says(*tally)).map(|(pair, _)| pair).collect()
}

/// The pairs that follow each other along a line of the picture, with whether what is between them is in front of both.
fn told(line: &[usize], ids: &[u16], points: &[Point3<f32>], settings: &HalvesSettings) -> Vec<(Pair, bool)> {
    // Where each id was last, in the order of these places: what lies between then lies between them.
    let mut last: BTreeMap<u16, usize> = BTreeMap::new();
    let mut told = Vec::new();
    for (at, &i) in line.iter().enumerate().filter(|(_, i)| ids[**i] != 0) {
        let id = ids[i];
        let begins = at == 0 || ids[line[at - 1]] != id;
        if begins {
            for (other, from) in last.iter().filter(|(other, _)| **other != id) {
                let between = &line[from + 1..at];
                if between.iter().any(|j| ids[*j] == id) || between.is_empty() {
                    continue;
                }
                let (near, far) = (points[line[*from]].z, points[i].z);
                let front_m = near.min(far) - settings.cover_step_m;
                let readings = || between.iter().map(|j| points[*j].z).filter(|z| !z.is_nan());
                let in_front = readings().filter(|z| *z < front_m).count();
                let covered = in_front > 0 && in_front as f32 >= COVERED_FROM * readings().count() as f32;
                told.push(((id.min(*other), id.max(*other)), covered));
            }
        }
        last.insert(id, at);
    }
    told
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(row: &str) -> Image<u16> {
        let ids = row.chars().map(|c| c.to_digit(10).unwrap_or(0) as u16);
        Image::from_pixels(row.len(), ROWS, ids.collect::<Vec<_>>().repeat(ROWS)).unwrap()
    }

    const ROWS: usize = 6;

    /// The ids of a row `seen` where geometry has `whole`, the readings at so many decimetres.
    fn named(whole: &str, seen: &str, depth_dm: &str) -> String {
        let depth = depth_dm.chars().map(|c| c.to_digit(10).map_or(f32::NAN, |dm| dm as f32 * 0.1));
        let points: Vec<Point3<f32>> = depth.map(|z| Point3::new(0.0, 0.0, z)).collect();
        let in_camera = Image::from_pixels(seen.len(), ROWS, points.repeat(ROWS)).unwrap();
        let joined = joined(&Found::objects(picture(whole)), &picture(seen), &in_camera, &HalvesSettings::default());
        joined.pixels()[..seen.len()].iter().map(|id| id.to_string()).collect()
    }

    #[test]
    fn ends_behind_another_thing_are_one() {
        assert_eq!(named("1112222111", "1112222333", "9995555999"), "1112222111");
        assert_eq!(named("1112222111", "1110220333", "999.55.999"), "1110220111", "shadows beside it say nothing");
        assert_eq!(named("1112211331", "1112244335", "9995599559"), "1112211331", "all ends behind two things");
    }

    #[test]
    fn what_has_nothing_in_front_of_it_stays_apart() {
        assert_eq!(named("1111111111", "1110000333", "9999999999"), "1110000333", "a seam");
        assert_eq!(named("1111111111", "1110000333", "7779999777"), "1110000333", "one sees past both");
        assert_eq!(named("1112222333", "1112222333", "9995555999"), "1112222333", "not one for geometry");
    }

    #[test]
    fn where_ends_touch_the_network_saw_a_border() {
        let rows = ["1112222333"; ROWS].iter().chain(&["1111133333"]).flat_map(|row| row.chars());
        let seen: Vec<u16> = rows.map(|c| c.to_digit(10).unwrap_or(0) as u16).collect();
        let points: Vec<Point3<f32>> = seen.iter().map(|id| Point3::new(0.0, 0.0, if *id == 2 { 0.5 } else { 0.9 })).collect();
        let whole: Vec<u16> = seen.iter().map(|id| if *id == 2 { 2 } else { 1 }).collect();
        let image = |ids: Vec<u16>| Image::from_pixels(10, ROWS + 1, ids).unwrap();
        let in_camera = Image::from_pixels(10, ROWS + 1, points).unwrap();
        let seen = image(seen);
        assert_eq!(joined(&Found::objects(image(whole)), &seen, &in_camera, &HalvesSettings::default()), seen);
    }
}
