//! Readings of given masks that are not the object's: color and depth of a real camera are a few pixels apart, so that a mask drawn on color
//! holds a strip of what is behind or before the object.
//!
//! A mask falls into patches that jumps in depth separate. A patch much smaller than the mask's largest is a strip of something else, unless it stands
//! before what is seen beside the mask: a strip goes on there, and a handle that shows behind the rim of its mug does not. What was not read separates
//! nothing: dark objects lose every other reading, and each of those that are left would be a patch.

use repose_geometry::Image;

use crate::readings::flying::StepLimit;
use crate::settings::FlyingSettings;

/// A patch with less than this share of its mask's largest patch is hardly the object's. An object that another one covers in the middle has
/// larger ends.
const LEAST_SHARE: f64 = 0.05;

/// Replaces stray readings of the masks by NaN; how many there were. Neighbours lie on one surface as flying readings are judged; `focal_px` is that of
/// a picture of the readings, each in one pixel.
pub fn remove(labels: &Image<u16>, depth_m: &mut Image<f32>, focal_px: f32, settings: &FlyingSettings) -> usize {
    let is_stray = Patches::of(labels, depth_m, StepLimit::new(settings, focal_px)).are_stray();
    let mut removed = 0;
    for (z, _) in depth_m.pixels_mut().iter_mut().zip(is_stray).filter(|(_, is_stray)| *is_stray) {
        *z = f32::NAN;
        removed += 1;
    }
    removed
}

/// The patches of all masks.
struct Patches<'a> {
    labels: &'a Image<u16>,
    depth_m: &'a Image<f32>,
    step: StepLimit,
    /// The patch of each pixel; `u32::MAX` where it has none.
    of: Vec<u32>,
    /// How many readings each patch has.
    sizes: Vec<usize>,
    /// By label, how many its largest patch has.
    largest: Vec<usize>,
}

impl<'a> Patches<'a> {
    fn of(labels: &'a Image<u16>, depth_m: &'a Image<f32>, step: StepLimit) -> Self {
        let (ids, depths) = (labels.pixels(), depth_m.pixels());
        let largest = vec![0usize; usize::from(ids.iter().copied().max().unwrap_or(0)) + 1];
        let mut patches = Self { labels, depth_m, step, of: vec![u32::MAX; ids.len()], sizes: Vec::new(), largest };
        let mut open = Vec::new();
        for start in 0..ids.len() {
            if patches.of[start] != u32::MAX || ids[start] == 0 || depths[start].is_nan() {
                continue;
            }
            let patch = patches.sizes.len() as u32;
            let mut size = 0;
            patches.of[start] = patch;
            open.push(start);
            while let Some(i) = open.pop() {
                size += 1;
                let limit_m = step.at_m(depths[i]);
                for (j, _) in patches.nearest(i, |j| ids[j] != ids[i]).into_iter().flatten().filter(|(j, _)| ids[*j] == ids[i]) {
                    if patches.of[j] == u32::MAX && (depths[j] - depths[i]).abs() <= limit_m {
                        patches.of[j] = patch;
                        open.push(j);
                    }
                }
            }
            patches.sizes.push(size);
            let most = &mut patches.largest[usize::from(ids[start])];
            *most = (*most).max(size);
        }
        patches
    }

    /// The nearest pixels to the left, right, above and below that were read or where the way `ends`, with how far away they are, pixels.
    fn nearest(&self, i: usize, ends: impl Fn(usize) -> bool) -> [Option<(usize, usize)>; 4] {
        let (width, height) = (self.labels.width(), self.labels.height());
        let (u, v) = (i % width, i / width);
        let stops = |(j, _): &(usize, usize)| ends(*j) || !self.depth_m.pixels()[*j].is_nan();
        [
            (1..=u).map(|k| (i - k, k)).find(stops),
            (1..width - u).map(|k| (i + k, k)).find(stops),
            (1..=v).map(|k| (i - k * width, k)).find(stops),
            (1..height - v).map(|k| (i + k * width, k)).find(stops),
        ]
    }

    /// Which pixels' readings are not their masks'.
    fn are_stray(&self) -> Vec<bool> {
        let ids = self.labels.pixels();
        let size = |i: usize| self.sizes.get(self.of[i] as usize);
        let is_small = |i: usize| size(i).is_some_and(|size| (*size as f64) < LEAST_SHARE * self.largest[usize::from(ids[i])] as f64);
        let small: Vec<bool> = (0..ids.len()).map(is_small).collect();
        // Of each small patch, on how many sides of its pixels something else shows, and how often clearly behind it.
        let mut beside = vec![[0usize; 2]; self.sizes.len()];
        for i in (0..ids.len()).filter(|i| small[*i]) {
            let [looks, behind] = &mut beside[self.of[i] as usize];
            for (j, away_px) in self.nearest(i, |_| false).into_iter().flatten().filter(|(j, _)| ids[*j] != ids[i]) {
                let depths = self.depth_m.pixels();
                *looks += 1;
                *behind += usize::from(depths[j] - depths[i] > away_px as f32 * self.step.at_m(depths[i]));
            }
        }
        let stands_out = |i: usize| beside.get(self.of[i] as usize).is_some_and(|[looks, behind]| 2 * behind > *looks);
        small.into_iter().enumerate().map(|(i, is_small)| is_small && !stands_out(i)).collect()
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};

    use super::*;

    #[test]
    fn a_mask_of_which_half_was_not_read_keeps_what_was_and_loses_a_strip_of_the_background() {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(5);
        let labels = Image::filled(120, 90, 3u16);
        let mut of = |i: usize| match (i % 120, rng.random_range(0..2)) {
            (_, 0) => f32::NAN,
            (118.., _) => 1.2,
            _ => 1.0,
        };
        let mut depth_m = Image::from_pixels(120, 90, (0..120 * 90).map(&mut of).collect()).unwrap();
        let before = depth_m.clone();
        remove(&labels, &mut depth_m, 525.0, &FlyingSettings::default());
        let pixels = before.pixels().iter().zip(depth_m.pixels());
        assert!(pixels.enumerate().all(|(i, (before, after))| before.is_nan() || after.is_nan() == (i % 120 >= 118)));
    }

    #[test]
    fn a_handle_behind_the_rim_of_its_mug_stays_and_the_table_within_it_does_not() {
        // On a table at 1.2 m a mug at 1 m; its handle, 3 cm lower, goes around a place where the table shows, and which the mask holds.
        let is_mug = |u: usize, v: usize| (20..80).contains(&u) && (10..60).contains(&v);
        let is_within = |u: usize, v: usize| (80..84).contains(&u) && (32..38).contains(&v);
        let is_handle = |u: usize, v: usize| (80..88).contains(&u) && (28..42).contains(&v) && !is_within(u, v);
        let pixels = || (0..120 * 80).map(|i| (i % 120, i / 120));
        let label = |(u, v): (usize, usize)| u16::from(is_mug(u, v) || is_handle(u, v) || is_within(u, v));
        let labels = Image::from_pixels(120, 80, pixels().map(label).collect()).unwrap();
        let depth = |(u, v): (usize, usize)| match (is_mug(u, v), is_handle(u, v)) {
            (true, _) => 1.0,
            (false, true) => 1.03,
            _ => 1.2,
        };
        let mut depth_m = Image::from_pixels(120, 80, pixels().map(depth).collect()).unwrap();
        assert_eq!(remove(&labels, &mut depth_m, 525.0, &FlyingSettings::default()), 4 * 6);
        assert!(pixels().all(|(u, v)| depth_m[(u, v)].is_nan() == is_within(u, v)));
    }

    #[test]
    fn a_strip_of_the_background_leaves_the_mask_and_a_covered_objects_ends_stay() {
        // On a table at 1.2 m an object at 1 m in columns 20 to 79, its mask shifted by two columns; another in ends of 10 and 35 columns.
        let label = |u: usize, v: usize| match (u, v) {
            (22..82, 10..50) => 1,
            (90..100 | 105..140, 10..30) => 2,
            _ => 0u16,
        };
        let is_near = |u: usize, v: usize| (20..80).contains(&u) && (10..50).contains(&v) || label(u, v) == 2;
        let pixels = || (0..150 * 60).map(|i| (i % 150, i / 150));
        let labels = Image::from_pixels(150, 60, pixels().map(|(u, v)| label(u, v)).collect()).unwrap();
        let depths = pixels().map(|(u, v)| if is_near(u, v) { 1.0 } else { 1.2 });
        let mut depth_m = Image::from_pixels(150, 60, depths.collect()).unwrap();
        assert_eq!(remove(&labels, &mut depth_m, 525.0, &FlyingSettings::default()), 2 * 40);
        for (u, v) in pixels() {
            assert_eq!(depth_m[(u, v)].is_nan(), (80..82).contains(&u) && (10..50).contains(&v), "({u}, {v})");
        }
    }
}
