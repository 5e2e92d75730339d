//! Readings of given masks that are not the object's: color and depth of a real camera are a few pixels apart, so that a mask drawn on color
//! holds a strip of what is behind or before the object.
//!
//! A mask falls into patches that jumps in depth separate. A patch much smaller than the mask's largest is a strip of something else. What was not
//! read separates nothing: dark objects lose every other reading, and each of those that are left would be a patch.

use repose_geometry::Image;

use crate::readings::flying::StepLimit;
use crate::settings::FlyingSettings;

/// A patch with less than this share of its mask's largest patch is not the object's. An object that another one covers in the middle has
/// larger ends.
const LEAST_SHARE: f64 = 0.05;

/// Replaces stray readings of the masks by NaN; how many there were. Neighbours lie on one surface as flying readings are judged.
pub fn remove(labels: &Image<u16>, depth_m: &mut Image<f32>, focal_px: f32, settings: &FlyingSettings) -> usize {
    let (width, height) = (labels.width(), labels.height());
    let (ids, depths) = (labels.pixels(), depth_m.pixels_mut());
    let is_reading = |depths: &[f32], i: usize| ids[i] != 0 && !depths[i].is_nan();
    let step = StepLimit::new(settings, focal_px);
    let mut patch_of = vec![u32::MAX; ids.len()];
    let mut sizes: Vec<usize> = Vec::new();
    let mut largest = vec![0usize; usize::from(ids.iter().copied().max().unwrap_or(0)) + 1];
    let mut open = Vec::new();
    for start in 0..ids.len() {
        if patch_of[start] != u32::MAX || !is_reading(depths, start) {
            continue;
        }
        let patch = sizes.len() as u32;
        let mut size = 0;
        patch_of[start] = patch;
        open.push(start);
        while let Some(i) = open.pop() {
            size += 1;
            let (u, v) = (i % width, i / width);
            let limit_m = step.at_m(depths[i]);
            let next = [
                next_reading(ids, depths, i, (1..=u).map(|k| i - k)),
                next_reading(ids, depths, i, (u + 1..width).map(|u| v * width + u)),
                next_reading(ids, depths, i, (1..=v).map(|k| i - k * width)),
                next_reading(ids, depths, i, (v + 1..height).map(|v| v * width + u)),
            ];
            for j in next.into_iter().flatten() {
                if patch_of[j] == u32::MAX && (depths[j] - depths[i]).abs() <= limit_m {
                    patch_of[j] = patch;
                    open.push(j);
                }
            }
        }
        sizes.push(size);
        let most = &mut largest[usize::from(ids[start])];
        *most = (*most).max(size);
    }
    let mut removed = 0;
    for i in 0..ids.len() {
        let Some(size) = sizes.get(patch_of[i] as usize) else { continue };
        if (*size as f64) < LEAST_SHARE * largest[usize::from(ids[i])] as f64 {
            depths[i] = f32::NAN;
            removed += 1;
        }
    }
    removed
}

/// The first reading on a way through the mask of a pixel.
fn next_reading(ids: &[u16], depths: &[f32], i: usize, mut way: impl Iterator<Item = usize>) -> Option<usize> {
    way.find(|j| ids[*j] != ids[i] || !depths[*j].is_nan()).filter(|j| ids[*j] == ids[i])
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
