//! What the network for masks says of the coarse picture: which pixels show objects, grouped into one id each.
//!
//! The network says of each pixel whether it shows an object, and of pairs of pixels whether they show the same one
//! ([`repose_networks::masks`]); a mutex watershed groups them ([`super::watershed`]). Geometry has the word where the network sees nothing.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::OnceLock;

use repose_geometry::{Aabb, Image, Pinhole, Point3, Vector3};
use repose_networks::WeightsError;
use repose_networks::masks::{Inputs, MaskLogits, MaskNetwork, OFFSETS};
use repose_proto::LeftOutReason;

use super::find::Found;
use super::watershed::{Pair, grouped};
use crate::readings::point_map::PointMap;
use crate::settings::{LearnedSettings, Settings};

/// The network with the weights that come with the program, or why they cannot be read.
fn network() -> Result<&'static MaskNetwork, &'static WeightsError> {
    static NETWORK: OnceLock<Result<MaskNetwork, WeightsError>> = OnceLock::new();
    NETWORK.get_or_init(MaskNetwork::embedded).as_ref()
}

/// What the network says of a picture; none without weights that can be read. `depth_m` holds NaN where there is no reading; `up` is the unit
/// vector against gravity in the camera's frame.
pub fn logits(depth_m: &Image<f32>, camera: &Pinhole, up: &Vector3<f64>) -> Option<MaskLogits> {
    let network = network().ok()?;
    Some(network.logits(&Inputs::new(depth_m.pixels(), camera, up)))
}

/// An id for each object that the network sees: 1, 2, … from the largest down (ties by first pixel), 0 elsewhere. `depth_m` holds NaN where there is
/// no reading, and no object.
pub fn ids(logits: &MaskLogits, depth_m: &Image<f32>, settings: &LearnedSettings) -> Image<u16> {
    let (width, height) = (depth_m.width(), depth_m.height());
    let shows_object = |i: usize| logits.pixels[i][0] > settings.object_from && !depth_m.pixels()[i].is_nan();
    let object: Vec<bool> = (0..width * height).map(shows_object).collect();
    let mut pairs = Vec::with_capacity(object.iter().filter(|o| **o).count() * OFFSETS.len());
    for i in (0..width * height).filter(|i| object[*i]) {
        let (u, v) = (i % width, i / width);
        for (k, [du, dv]) in OFFSETS.into_iter().enumerate() {
            let Some(column) = u.checked_add_signed(du).filter(|u| *u < width) else { continue };
            let Some(row) = v.checked_add_signed(dv).filter(|v| *v < height) else { continue };
            let j = row * width + column;
            if object[j] {
                let same = logits.pixels[i][1 + k] - settings.same_from;
                pairs.push(Pair { one: i as u32, other: j as u32, same });
            }
        }
    }
    numbered(&grouped(width * height, &pairs), &object, width, height)
}

/// The network's objects, and what geometry found where they are not.
///
/// `seen` are the network's ids. What geometry found is kept, under its own reason if it is no object, where they cover little of it; the readings
/// that they do not cover of the rest are furniture or doubtful, and stay in the way as nobody's.
pub fn put_right(geometry: &Found, seen: &Image<u16>, in_world: &PointMap, settings: &Settings) -> Found {
    let seen = &islands_joined(geometry, seen);
    let of_network = seen.pixels().iter().copied().max().unwrap_or(0);
    let own = covered_shares(geometry, seen);
    let keeps = |id: u16| own.get(usize::from(id)).is_some_and(|share| *share < settings.learned.uncovered);
    let mut ids = seen.clone();
    for (id, other) in ids.pixels_mut().iter_mut().zip(geometry.ids.pixels()).filter(|(id, other)| **id == 0 && keeps(**other)) {
        *id = of_network.saturating_add(*other);
    }
    let mut points: BTreeMap<u16, Vec<Point3<f32>>> = BTreeMap::new();
    for (id, p) in ids.pixels().iter().zip(in_world.pixels()).filter(|(id, _)| **id != 0) {
        points.entry(*id).or_default().push(*p);
    }
    let reason = |id: u16, points: &[Point3<f32>]| {
        if id > of_network {
            return geometry.no_objects.get(&(id - of_network)).copied();
        }
        let longest_m = Aabb::of(points).map_or(0.0, |bounds| bounds.extent().max());
        let few = points.len() < settings.learned.min_pixels;
        if few { Some(LeftOutReason::TooSmall) } else { (longest_m > settings.components.max_extent_m).then_some(LeftOutReason::TooLarge) }
    };
    let judged: Vec<(u16, Option<LeftOutReason>)> = points.iter().map(|(id, points)| (*id, reason(*id, points))).collect();
    let (mut objects, others): (Vec<_>, Vec<_>) = judged.into_iter().partition(|(_, reason)| reason.is_none());
    objects.sort_by_key(|(id, _)| (std::cmp::Reverse(points[id].len()), *id));
    let mut numbers = BTreeMap::from([(0, 0)]);
    let mut no_objects = BTreeMap::new();
    for ((id, reason), number) in objects.into_iter().chain(others).zip(1u16..) {
        numbers.insert(id, number);
        no_objects.extend(reason.map(|reason| (number, reason)));
    }
    Found { ids: ids.map(|id| numbers.get(id).copied().unwrap_or(0)), no_objects }
}

/// Least share of an id's pixels that makes it a part of one of geometry's objects.
const PART_FROM: f32 = 0.6;

/// The network's ids, those joined that geometry takes for one object and that touch nowhere: ends of something behind another thing, of which the
/// network sees only that they are apart. Where two of them touch it saw a border, and all stay as they are.
fn islands_joined(geometry: &Found, seen: &Image<u16>) -> Image<u16> {
    let mut shared: BTreeMap<u16, BTreeMap<u16, usize>> = BTreeMap::new();
    let mut touching = BTreeSet::new();
    let width = seen.width();
    for (i, id) in seen.pixels().iter().enumerate().filter(|(_, id)| **id != 0) {
        *shared.entry(*id).or_default().entry(geometry.ids.pixels()[i]).or_insert(0) += 1;
        let beside = [((i + 1) % width != 0).then(|| i + 1), Some(i + width)];
        let others = beside.into_iter().flatten().filter_map(|j| seen.pixels().get(j)).filter(|other| **other != 0 && *other != id);
        touching.extend(others.map(|other| (*id.min(other), *id.max(other))));
    }
    let mut parts: BTreeMap<u16, Vec<u16>> = BTreeMap::new();
    for (id, shares) in &shared {
        let pixels: usize = shares.values().sum();
        let whole = shares.iter().find(|(of, n)| **of != 0 && **n as f32 >= PART_FROM * pixels as f32);
        if let Some((of, _)) = whole.filter(|(of, _)| !geometry.no_objects.contains_key(of)) {
            parts.entry(*of).or_default().push(*id);
        }
    }
    let apart =
        |parts: &[u16]| parts.iter().enumerate().all(|(k, one)| parts[k + 1..].iter().all(|other| !touching.contains(&(*one, *other))));
    let mut joined: BTreeMap<u16, u16> = BTreeMap::new();
    for parts in parts.values().filter(|parts| apart(parts)) {
        joined.extend(parts.iter().map(|part| (*part, parts[0])));
    }
    seen.map(|id| joined.get(id).copied().unwrap_or(*id))
}

/// Of each of geometry's ids, the share of its pixels that `seen` has an id for.
fn covered_shares(geometry: &Found, seen: &Image<u16>) -> Vec<f32> {
    let most = usize::from(geometry.ids.pixels().iter().copied().max().unwrap_or(0));
    let mut counts = vec![[0usize; 2]; most + 1];
    for (id, seen) in geometry.ids.pixels().iter().zip(seen.pixels()) {
        counts[usize::from(*id)][usize::from(*seen != 0)] += 1;
    }
    // Nobody's pixels are nobody's to keep.
    counts[0] = [0, 1];
    counts.into_iter().map(|[open, covered]| covered as f32 / (open + covered).max(1) as f32).collect()
}

/// Fewest pixels of a group that is told of at all.
const LEAST_TOLD: u32 = 12;

/// The groups of object pixels as ids, from the largest down; those of a few pixels have none.
fn numbered(groups: &[u32], object: &[bool], width: usize, height: usize) -> Image<u16> {
    let mut sizes = vec![0u32; groups.len()];
    for (group, _) in groups.iter().zip(object).filter(|(_, object)| **object) {
        sizes[*group as usize] += 1;
    }
    let mut order: Vec<usize> = (0..sizes.len()).filter(|group| sizes[*group] >= LEAST_TOLD).collect();
    order.sort_by_key(|group| (std::cmp::Reverse(sizes[*group]), *group));
    order.truncate(usize::from(u16::MAX));
    let mut ids = vec![0u16; sizes.len()];
    for (group, id) in order.into_iter().zip(1..) {
        ids[group] = id;
    }
    let mut picture = Image::filled(width, height, 0u16);
    for ((id, group), object) in picture.pixels_mut().iter_mut().zip(groups).zip(object) {
        *id = if *object { ids[*group as usize] } else { 0 };
    }
    picture
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(rows: &[&str]) -> Image<u16> {
        let ids = rows.iter().flat_map(|row| row.chars()).map(|c| c.to_digit(10).unwrap_or(0) as u16).collect();
        Image::from_pixels(rows[0].len(), rows.len(), ids).unwrap()
    }

    fn settings() -> Settings {
        let mut settings = Settings::default();
        settings.learned.min_pixels = 3;
        settings.learned.uncovered = 0.2;
        settings
    }

    /// A point for each pixel, a centimetre apart.
    fn points(like: &Image<u16>) -> PointMap {
        let width = like.width();
        let points = (0..like.pixels().len()).map(|i| Point3::new((i % width) as f32 * 0.01, (i / width) as f32 * 0.01, 0.0));
        Image::from_pixels(width, like.height(), points.collect()).unwrap()
    }

    #[test]
    fn the_network_cuts_what_geometry_took_for_one_and_geometry_keeps_what_it_does_not_see() {
        let geometry = Found { ids: picture(&["1111110222", "1111110222"]), no_objects: BTreeMap::new() };
        let seen = picture(&["1112220000", "1112220000"]);
        let found = put_right(&geometry, &seen, &points(&seen), &settings());
        assert_eq!(found, Found { ids: picture(&["1112220333", "1112220333"]), no_objects: BTreeMap::new() });
    }

    #[test]
    fn ends_that_geometry_joins_behind_another_thing_are_one_and_what_touches_is_not() {
        let geometry = Found { ids: picture(&["1112222111", "1112222111"]), no_objects: BTreeMap::new() };
        let seen = picture(&["1112222333", "1112222333"]);
        let found = put_right(&geometry, &seen, &points(&seen), &settings());
        assert_eq!(found.ids, picture(&["1112222111", "1112222111"]));
        let chain = Found { ids: picture(&["1111111111"]), no_objects: BTreeMap::new() };
        let seen = picture(&["1112222333"]);
        assert_eq!(islands_joined(&chain, &seen), seen);
    }

    #[test]
    fn what_is_no_object_keeps_its_reason_and_small_and_large_groups_get_one() {
        let too_far = BTreeMap::from([(1, LeftOutReason::BesideSupports)]);
        let geometry = Found { ids: picture(&["1110000000"]), no_objects: too_far };
        let seen = picture(&["0000220000"]);
        let found = put_right(&geometry, &seen, &points(&seen), &settings());
        let reasons: Vec<LeftOutReason> = found.no_objects.values().copied().collect();
        assert_eq!((found.ids.pixels()[4], reasons), (1, vec![LeftOutReason::TooSmall, LeftOutReason::BesideSupports]));
        let wide = Settings { learned: settings().learned, ..Settings::default() };
        let mut narrow = wide.clone();
        narrow.components.max_extent_m = 0.02;
        let seen = picture(&["1111110000"]);
        let found = put_right(&Found { ids: picture(&["0000000000"]), no_objects: BTreeMap::new() }, &seen, &points(&seen), &narrow);
        assert_eq!(found.no_objects[&1], LeftOutReason::TooLarge);
    }

    #[test]
    fn pixels_are_grouped_by_what_the_network_says_of_pairs() {
        // Two rows of eight: objects in columns 0 to 2 and 3 to 5, furniture in 6, no reading in 7.
        let same = |u: usize, du: isize| {
            let other = u as isize + du;
            if (0..6).contains(&other) && u / 3 == other as usize / 3 { 5.0 } else { -5.0 }
        };
        let pixel = |u: usize| {
            let mut logits = [0.0; 1 + OFFSETS.len()];
            logits[0] = if u == 6 { -4.0 } else { 4.0 };
            for (out, [du, _]) in logits[1..].iter_mut().zip(OFFSETS) {
                *out = same(u, du);
            }
            logits
        };
        let logits = MaskLogits { width: 8, height: 4, pixels: (0..32).map(|i| pixel(i % 8)).collect() };
        let depth_m = Image::from_pixels(8, 4, (0..32).map(|i| if i % 8 == 7 { f32::NAN } else { 0.8 }).collect()).unwrap();
        let ids = ids(&logits, &depth_m, &LearnedSettings::default());
        assert_eq!(ids, picture(&["11122200"; 4]));
    }
}
