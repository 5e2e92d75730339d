//! The masks after cleaning: what is left of each outside the uncertain bands, and what becomes of those of which too little is left.
//!
//! The band takes most of an object that is thin, small or hidden but for a little. So its mask is eroded only as far as enough is left of it.
//! Where any erosion leaves too little it is no object, but still in the way: all its readings stay in the scene, as nobody's (label 0). What is
//! dilated, the band beside it, is dropped as ever. So do the smallest of more objects than a scene may have. Thin parts of masks of which enough is
//! left, as handles are, stay along their middle.

use repose_geometry::Image;

use std::collections::BTreeMap;

use repose_proto::{LeftOutReason, limits};

use crate::masks::borders::border_band;
use crate::masks::left_out::LeftOutMasks;
use crate::masks::thin::{self, MaskedDepth};
use crate::settings::{BorderSettings, Settings};

/// Labels and the band around them, objects with enough readings only.
#[derive(Debug)]
pub struct CleanMasks {
    /// The object of each pixel, 0 = none.
    pub labels: Image<u16>,
    /// The pixels whose readings are dropped.
    pub band: Image<bool>,
    /// The masks that became 0, and why.
    pub left_out: LeftOutMasks,
    /// Readings outside the band.
    pub available: usize,
    /// The same of each object; of what is none at 0.
    pub readings: Vec<usize>,
    /// Readings in it.
    pub on_borders: usize,
}

impl CleanMasks {
    /// Cleans the masks of `labels`; `depth_m` holds NaN where there is no reading, `focal_px` is the focal length of the same picture. The
    /// masks in `no_objects` are taken out first. `None` where no reading of the background lies outside the bands, and no mask has enough of them
    /// however little it is eroded.
    pub fn new(
        mut labels: Image<u16>,
        no_objects: BTreeMap<u16, LeftOutReason>,
        depth_m: &Image<f32>,
        focal_px: f32,
        settings: &Settings,
    ) -> Option<Self> {
        let mut left_out = LeftOutMasks::none(labels.width(), labels.height());
        left_out.take(&mut labels, no_objects);
        let mut band = border_band(&labels, &settings.borders);
        let mut tally = Tally::of(depth_m, &labels, &band);
        let enough = |readings: usize| readings >= settings.min_object_points;
        let masks = || (0..=u16::MAX).zip(&tally.masks);
        let (kept, few): (Vec<_>, Vec<_>) =
            masks().filter(|(_, mask)| mask.pixels > 0).partition(|(id, mask)| *id == 0 || enough(mask.readings));
        let is_bare = kept.iter().all(|(_, mask)| mask.readings == 0);
        let small: Vec<u16> = few.into_iter().map(|(id, _)| id).collect();
        let middles = thin::middles(&MaskedDepth { labels: &labels, depth_m, focal_px }, &band, &small, settings);
        middles.iter().for_each(|at| band.pixels_mut()[*at] = false);
        let too_small = narrow(&mut band, &labels, depth_m, &small, settings);
        // What is eroded less may be all that there is: a pen before a wall that is too far away.
        if is_bare && too_small.len() == small.len() {
            return None;
        }
        left_out.take(&mut labels, too_small.into_iter().map(|id| (id, LeftOutReason::TooSmall)).collect());
        if !small.is_empty() || !middles.is_empty() {
            tally = Tally::of(depth_m, &labels, &band);
        }
        let surplus = tally.surplus();
        if !surplus.is_empty() {
            left_out.take(&mut labels, surplus.into_iter().map(|id| (id, LeftOutReason::TooMany)).collect());
            tally = Tally::of(depth_m, &labels, &band);
        }
        let readings: Vec<usize> = tally.masks.iter().map(|mask| mask.readings).collect();
        Some(Self { labels, band, left_out, available: readings.iter().sum(), readings, on_borders: tally.on_borders })
    }
}

/// Takes the pixels of some masks out of the band: of each those that remain under the widest erosion (halved until it does) that leaves
/// it enough readings, and all where none does; returns the masks of which that is so.
fn narrow(band: &mut Image<bool>, labels: &Image<u16>, depth_m: &Image<f32>, ids: &[u16], settings: &Settings) -> Vec<u16> {
    let mut waiting = ids.to_vec();
    let mut radius_px = settings.borders.radius_px;
    while radius_px > 0 && !waiting.is_empty() {
        radius_px /= 2;
        let narrower = border_band(labels, &BorderSettings { radius_px });
        let masks = Tally::of(depth_m, labels, &narrower).masks;
        let done = |id: &u16| radius_px == 0 || masks[usize::from(*id)].readings >= settings.min_object_points;
        let (now, later): (Vec<u16>, Vec<u16>) = waiting.iter().partition(|id| done(id));
        for ((banded, id), narrow) in band.pixels_mut().iter_mut().zip(labels.pixels()).zip(narrower.pixels()) {
            *banded &= *narrow || now.binary_search(id).is_err();
        }
        if radius_px == 0 {
            return now;
        }
        waiting = later;
    }
    waiting
}

/// What lies where.
struct Tally {
    /// By id, 0 among them.
    masks: Vec<Mask>,
    /// Readings in the band.
    on_borders: usize,
}

#[derive(Debug, Clone, Copy, Default)]
struct Mask {
    pixels: usize,
    /// Readings outside the band.
    readings: usize,
}

impl Tally {
    fn of(depth_m: &Image<f32>, labels: &Image<u16>, band: &Image<bool>) -> Self {
        let labels = labels.pixels();
        let most = labels.iter().copied().max().unwrap_or(0);
        let mut masks = vec![Mask::default(); usize::from(most) + 1];
        let mut on_borders = 0;
        // Runs of one label are summed up before they are booked.
        let (mut current, mut run) = (0u16, Mask::default());
        let mut book = |id: u16, run: Mask| {
            masks[usize::from(id)].pixels += run.pixels;
            masks[usize::from(id)].readings += run.readings;
        };
        for ((z, &id), banded) in depth_m.pixels().iter().zip(labels).zip(band.pixels()) {
            if id != current {
                book(current, run);
                (current, run) = (id, Mask::default());
            }
            run.pixels += 1;
            run.readings += usize::from(!z.is_nan() & !banded);
            on_borders += usize::from(!z.is_nan() & banded);
        }
        book(current, run);
        Self { masks, on_borders }
    }

    /// The objects with the fewest readings beyond as many as a scene may have.
    fn surplus(&self) -> Vec<u16> {
        let of_objects = (0..=u16::MAX).zip(&self.masks).skip(1).filter(|(_, mask)| mask.pixels > 0);
        let mut largest_first: Vec<(u16, usize)> = of_objects.map(|(id, mask)| (id, mask.readings)).collect();
        largest_first.sort_by_key(|(id, readings)| (std::cmp::Reverse(*readings), *id));
        largest_first.into_iter().skip(limits::MAX_OBJECTS).map(|(id, _)| id).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A picture of 60 x 40 with a block (1) of 20 x 20, a pen (2) of 40 x 3 and a crumb (3) of 5 x 5, all with readings.
    fn labels() -> Image<u16> {
        let label = |i: usize| match (i % 60, i / 60) {
            (3..=22, 3..=22) => 1,
            (10..=49, 30..=32) => 2,
            (40..=44, 10..=14) => 3,
            _ => 0,
        };
        Image::from_pixels(60, 40, (0..60 * 40).map(label).collect()).unwrap()
    }

    fn cleaned(min_object_points: usize) -> CleanMasks {
        let settings = Settings { min_object_points, ..Settings::default() };
        CleanMasks::new(labels(), BTreeMap::new(), &Image::filled(60, 40, 1.0), 60.0, &settings).unwrap()
    }

    /// Readings of the picture's mask `id` that stay.
    fn staying(masks: &CleanMasks, id: u16) -> usize {
        let pixels = labels().pixels().iter().zip(masks.band.pixels()).filter(|(of, banded)| **of == id && !**banded).count();
        let relabelled = labels().pixels().iter().zip(masks.labels.pixels()).filter(|(of, _)| **of == id).all(|(_, now)| *now == 0);
        assert_eq!(relabelled, masks.left_out.reasons.contains_key(&id));
        pixels
    }

    #[test]
    fn what_is_thin_is_eroded_less_and_what_is_too_small_stays_as_nobodys() {
        // The pen's middle row is left at a radius of 1 px, shortened by one at each end; the crumb has 25 readings in all.
        let masks = cleaned(30);
        assert!(masks.left_out.reasons.keys().eq(&[3]), "the pen is an object, eroded less");
        assert_eq!([staying(&masks, 1), staying(&masks, 2), staying(&masks, 3)], [16 * 16, 38, 25]);
        // Beside them the band is what it was.
        let band = border_band(&labels(), &Settings::default().borders);
        let beside = |band: &Image<bool>| labels().pixels().iter().zip(band.pixels()).filter(|(id, banded)| **id < 2 && **banded).count();
        assert_eq!(beside(&masks.band), beside(&band));
        assert_eq!(masks.available + masks.on_borders, 60 * 40);
    }

    #[test]
    fn where_every_object_has_enough_nothing_but_the_band_is_taken() {
        let masks = cleaned(1);
        assert!(masks.left_out.reasons.is_empty(), "no pixel of the pen is two pixels from its border, but some are one");
        let wide = Image::from_pixels(60, 40, labels().pixels().iter().map(|id| if *id == 1 { 7 } else { 0 }).collect()).unwrap();
        let masks = CleanMasks::new(wide.clone(), BTreeMap::new(), &Image::filled(60, 40, 1.0), 60.0, &Settings::default()).unwrap();
        assert_eq!((&masks.labels, &masks.band, masks.left_out.reasons.len()), (&wide, &border_band(&wide, &BorderSettings::default()), 0));
    }

    #[test]
    fn a_thin_part_stays_along_its_middle_and_its_readings_count() {
        // A pan of 20 x 20 with a handle of 30 x 3.
        let pan = |i: usize| u16::from(matches!((i % 60, i / 60), (3..=22, 3..=22) | (23..=52, 12..=14)));
        let labels = Image::from_pixels(60, 40, (0..60 * 40).map(pan).collect()).unwrap();
        let cleaned = |around_m: f32| {
            let depth_m = labels.map(|id| if *id == 0 { around_m } else { 0.9 });
            CleanMasks::new(labels.clone(), BTreeMap::new(), &depth_m, 525.0, &Settings::default()).unwrap()
        };
        let masks = cleaned(1.0);
        let of_handle: Vec<usize> = (0..60 * 40).filter(|i| i % 60 > 22 && pan(*i) == 1 && !masks.band.pixels()[*i]).collect();
        assert_eq!(of_handle, (23..=51).map(|u| 13 * 60 + u).collect::<Vec<usize>>());
        assert_eq!((masks.readings[1], masks.available + masks.on_borders), (16 * 16 + 29, 60 * 40));
        assert_eq!(cleaned(0.9).band, border_band(&labels, &BorderSettings::default()), "nothing says that it is one");
    }

    #[test]
    fn of_more_objects_than_a_scene_may_have_the_smallest_stay_as_nobodys() {
        // Two pixels each, but for the first ten with one.
        let label = |i: usize| (i / 2 + 1) as u16;
        let crowd = Image::from_pixels(60, 40, (0..60 * 40).map(label).collect()).unwrap();
        let mut depth_m = Image::filled(60, 40, 1.0);
        (0..10).for_each(|k| depth_m.pixels_mut()[2 * k] = f32::NAN);
        let settings = Settings { min_object_points: 1, borders: BorderSettings { radius_px: 0 }, ..Settings::default() };
        let masks = CleanMasks::new(crowd, BTreeMap::new(), &depth_m, 60.0, &settings).unwrap();
        let objects = masks.labels.pixels().iter().filter(|id| **id != 0).collect::<std::collections::BTreeSet<_>>();
        assert_eq!((objects.len(), masks.left_out.reasons.len()), (limits::MAX_OBJECTS, 1200 - limits::MAX_OBJECTS));
        assert!((1..=10).all(|id| masks.left_out.reasons.get(&id) == Some(&LeftOutReason::TooMany)));
        assert_eq!(masks.available, 60 * 40 - 10, "all that was read stays in the scene");
    }

    #[test]
    fn a_thin_thing_alone_with_nothing_read_behind_it_is_an_object() {
        let pen = labels().map(|id| if *id == 2 { 2 } else { 0 });
        let depth_m = pen.map(|id| if *id == 2 { 1.0 } else { f32::NAN });
        let settings = Settings { min_object_points: 30, ..Settings::default() };
        let masks = CleanMasks::new(pen, BTreeMap::new(), &depth_m, 60.0, &settings).unwrap();
        assert_eq!((masks.readings[2], masks.left_out.reasons.len()), (38, 0));
    }

    #[test]
    fn with_nothing_outside_the_bands_there_are_no_masks() {
        let stripes = Image::from_pixels(20, 20, (0..400).map(|i| (i % 2) as u16).collect()).unwrap();
        assert!(CleanMasks::new(stripes, BTreeMap::new(), &Image::filled(20, 20, 1.0), 20.0, &Settings::default()).is_none());
        let unseen = Image::filled(20, 20, f32::NAN);
        assert!(CleanMasks::new(Image::filled(20, 20, 0), BTreeMap::new(), &unseen, 20.0, &Settings::default()).is_none());
    }
}
