//! The objects that the network for masks sees, and what geometry saw where the network sees none.
//!
//! The network tells objects from furniture better than geometry does. What geometry takes for an object and the network does not is in the way,
//! may be furniture, and is told with its reason.

use std::collections::{BTreeMap, BTreeSet};

use repose_geometry::{Aabb, Image, Point3};
use repose_proto::LeftOutReason;

use super::find::Found;
use super::{ends, islands};
use crate::readings::point_map::PointMap;
use crate::settings::Settings;

/// The network's ids `seen`, put together with what geometry found.
///
/// What geometry found is kept as it says where the network's objects cover little of it. Of the rest, what they leave open is told as no object where
/// it is more than the rims of what they cover.
pub fn put_right(geometry: &Found, seen: &Image<u16>, in_camera: &PointMap, in_world: &PointMap, settings: &Settings) -> Found {
    let seen = &islands::parted(seen, in_world, settings.components.max_extent_m);
    let seen = &ends::joined(geometry, seen, in_camera, &settings.components.halves);
    let of_network = seen.pixels().iter().copied().max().unwrap_or(0);
    let open = Open::of(geometry, seen);
    let keeps = |id: u16| open.covered_share(id) < settings.learned.uncovered;
    let tells = |id: u16| keeps(id) || open.deep(id) >= settings.components.min_pixels;
    let mut ids = seen.clone();
    for (id, other) in ids.pixels_mut().iter_mut().zip(geometry.ids.pixels()).filter(|(id, other)| **id == 0 && tells(**other)) {
        *id = of_network.saturating_add(*other);
    }
    let mut points: BTreeMap<u16, Vec<Point3<f32>>> = BTreeMap::new();
    for (id, p) in ids.pixels().iter().zip(in_world.pixels()).filter(|(id, _)| **id != 0) {
        points.entry(*id).or_default().push(*p);
    }
    let reason = |id: u16, points: &[Point3<f32>]| {
        if id > of_network {
            let of_geometry = geometry.no_objects.get(&(id - of_network)).copied();
            return if keeps(id - of_network) { of_geometry } else { of_geometry.or(Some(LeftOutReason::Unconfirmed)) };
        }
        let longest_m = Aabb::of(points).map_or(0.0, |bounds| bounds.extent().max());
        let few = points.len() < settings.learned.min_pixels;
        if few { Some(LeftOutReason::TooSmall) } else { (longest_m > settings.components.max_extent_m).then_some(LeftOutReason::TooLarge) }
    };
    let judged: Vec<(u16, Option<LeftOutReason>)> = points.iter().map(|(id, points)| (*id, reason(*id, points))).collect();
    let (mut objects, mut others): (Vec<_>, Vec<_>) = judged.into_iter().partition(|(_, reason)| reason.is_none());
    objects.sort_by_key(|(id, _)| (std::cmp::Reverse(points[id].len()), *id));
    let surplus = objects.drain(settings.components.max_count.min(objects.len())..);
    others.extend(surplus.map(|(id, _)| (id, Some(LeftOutReason::TooMany))));
    let mut numbers = BTreeMap::from([(0, 0)]);
    let (mut no_objects, mut furniture) = (BTreeMap::new(), BTreeSet::new());
    for ((id, reason), number) in objects.into_iter().chain(others).zip(1u16..) {
        numbers.insert(id, number);
        no_objects.extend(reason.map(|reason| (number, reason)));
        if id > of_network && !keeps(id - of_network) {
            furniture.insert(number);
        }
    }
    Found { ids: ids.map(|id| numbers.get(id).copied().unwrap_or(0)), no_objects, furniture }
}

/// Of each of geometry's ids, how much of it the network's objects leave open.
struct Open {
    /// Pixels without and with an object of the network.
    pixels: Vec<[usize; 2]>,
    /// Open pixels with only such around them.
    deep: Vec<usize>,
}

impl Open {
    fn of(geometry: &Found, seen: &Image<u16>) -> Self {
        let (width, height) = (seen.width(), seen.height());
        let most = usize::from(geometry.ids.pixels().iter().copied().max().unwrap_or(0));
        let (mut pixels, mut deep) = (vec![[0; 2]; most + 1], vec![0; most + 1]);
        let is_open = |i: usize, id: u16| geometry.ids.pixels()[i] == id && seen.pixels()[i] == 0;
        for (i, id) in geometry.ids.pixels().iter().copied().enumerate().filter(|(_, id)| *id != 0) {
            pixels[usize::from(id)][usize::from(!is_open(i, id))] += 1;
            let (u, v) = (i % width, i / width);
            let inside = u > 0 && v > 0 && u + 1 < width && v + 1 < height;
            let around = || (i - width - 1..=i + width - 1).step_by(width).flat_map(|from| from..from + 3);
            deep[usize::from(id)] += usize::from(inside && around().all(|j| is_open(j, id)));
        }
        Self { pixels, deep }
    }

    /// The share of an id's pixels that the network's objects cover; nobody's pixels count as covered.
    fn covered_share(&self, id: u16) -> f32 {
        let [open, covered] = self.pixels.get(usize::from(id)).copied().unwrap_or_default();
        if open + covered == 0 { 1.0 } else { covered as f32 / (open + covered) as f32 }
    }

    /// How many pixels of it are open and so is everything around them.
    fn deep(&self, id: u16) -> usize {
        self.deep.get(usize::from(id)).copied().unwrap_or(0)
    }
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

    fn together(geometry: &Found, seen: &Image<u16>, settings: &Settings) -> Found {
        let points = points(seen);
        put_right(geometry, seen, &points, &points, settings)
    }

    #[test]
    fn the_network_cuts_what_geometry_took_for_one_and_geometry_keeps_what_it_does_not_see() {
        let geometry = Found::objects(picture(&["1111110222", "1111110222"]));
        let found = together(&geometry, &picture(&["1112220000", "1112220000"]), &settings());
        assert_eq!(found, Found::objects(picture(&["1112220333", "1112220333"])));
    }

    #[test]
    fn what_is_no_object_keeps_its_reason_and_small_and_large_groups_get_one() {
        let too_far = BTreeMap::from([(1, LeftOutReason::BesideSupports)]);
        let geometry = Found { no_objects: too_far, ..Found::objects(picture(&["1110000000"])) };
        let found = together(&geometry, &picture(&["0000220000"]), &settings());
        let reasons: Vec<LeftOutReason> = found.no_objects.values().copied().collect();
        assert_eq!((found.ids.pixels()[4], reasons), (1, vec![LeftOutReason::TooSmall, LeftOutReason::BesideSupports]));
        let wide = Settings { learned: settings().learned, ..Settings::default() };
        let mut narrow = wide.clone();
        narrow.components.max_extent_m = 0.02;
        let found = together(&Found::objects(picture(&["0000000000"])), &picture(&["1111110000"]), &narrow);
        assert_eq!(found.no_objects[&1], LeftOutReason::TooLarge);
    }

    #[test]
    fn of_more_objects_than_are_asked_for_the_largest_are_kept() {
        let mut settings = settings();
        settings.components.max_count = 2;
        let found = together(&Found::objects(picture(&["0000000000"; 2])), &picture(&["1122220333"; 2]), &settings);
        assert_eq!((found.ids, found.no_objects), (picture(&["3311110222"; 2]), BTreeMap::from([(3, LeftOutReason::TooMany)])));
    }

    #[test]
    fn what_geometry_alone_takes_for_an_object_is_told_and_may_be_furniture_and_a_rim_is_not_told() {
        let mut settings = settings();
        settings.learned.uncovered = 0.0;
        settings.components.min_pixels = 2;
        let geometry = Found::objects(picture(&["1111222222"; 3]));
        let found = together(&geometry, &picture(&["1110000000"; 3]), &settings);
        assert_eq!(found.ids, picture(&["1110222222"; 3]));
        assert_eq!((found.no_objects, found.furniture), (BTreeMap::from([(2, LeftOutReason::Unconfirmed)]), BTreeSet::from([2])));
    }
}
