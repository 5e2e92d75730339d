//! The scene's points: every reading outside the border bands, thinned where there are too many.
//!
//! Each object, and all that is none, keeps the same share of its readings, evenly spread over the picture; but no object keeps fewer than make one while
//! it has them: what is small in a large picture would be left without a shape, or without a point.

use repose_geometry::{Isometry3, Vector3};

use crate::masks::clean::CleanMasks;
use crate::readings::depth::DepthMap;
use crate::settings::Settings;

/// Points in the picture's order.
#[derive(Debug)]
pub struct Cloud {
    /// Points, world frame, metres.
    pub points: Vec<[f32; 3]>,
    /// The object of each point, 0 = none.
    pub labels: Vec<u16>,
    /// The color of each point.
    pub colors: Option<Vec<[u8; 3]>>,
}

impl Cloud {
    /// Every reading outside the bands of the masks; at most `max_points` of the settings.
    pub fn new(
        depth: &DepthMap,
        world_from_camera: &Isometry3<f64>,
        masks: &CleanMasks,
        colors: Option<&[[u8; 3]]>,
        settings: &Settings,
    ) -> Self {
        if masks.available <= settings.max_points {
            return Self::of_taken(depth, world_from_camera, masks, colors, masks.available, |_, _, stays| stays);
        }
        let wanted = shares(&masks.readings, settings.max_points, settings.min_object_points);
        let firsts = Firsts::of(depth, masks, settings.max_points);
        let mut shares: Vec<[Share; 2]> =
            wanted.iter().zip(masks.readings.iter().zip(&firsts.counts)).map(|(wanted, (n, firsts))| split(*wanted, *n, *firsts)).collect();
        Self::of_taken(depth, world_from_camera, masks, colors, wanted.iter().sum(), |i, id, stays| {
            let [of_firsts, of_others] = &mut shares[usize::from(id)];
            if firsts.is_first[i] { of_firsts.takes(stays) } else { of_others.takes(stays) }
        })
    }

    /// The `wanted` readings that `takes` says, which is asked about every pixel, with its number, its object and whether it has a reading outside the
    /// bands.
    fn of_taken(
        depth: &DepthMap,
        world_from_camera: &Isometry3<f64>,
        masks: &CleanMasks,
        colors: Option<&[[u8; 3]]>,
        wanted: usize,
        mut takes: impl FnMut(usize, u16, bool) -> bool,
    ) -> Self {
        let depths = depth.depth_m().pixels();
        let (labels, band) = (masks.labels.pixels(), masks.band.pixels());

        // Every pixel is written, and the end moves on behind those that stay: no branch to guess wrong at every outline. The last
        // pixel that does not stay needs a place, too.
        let mut points = vec![[0f32; 3]; wanted + 1];
        let mut ids = vec![0u16; wanted + 1];
        let mut pixels = vec![0u32; wanted + 1];
        let mut end = 0;
        let to_world = RaysToWorld::new(world_from_camera);
        let width = depth.width();
        for (v, y) in depth.slope_y().iter().enumerate() {
            let row = v * width..(v + 1) * width;
            let of_row = to_world.row(*y);
            let (depths, labels, band) = (&depths[row.clone()], &labels[row.clone()], &band[row.clone()]);
            for (u, (((z, &id), banded), x)) in depths.iter().zip(labels).zip(band).zip(depth.slope_x()).enumerate() {
                let taken = takes(row.start + u, id, !z.is_nan() & !banded);
                points[end] = of_row.point(*x, *z);
                ids[end] = id;
                pixels[end] = (row.start + u) as u32;
                end += usize::from(taken);
            }
        }
        points.truncate(end);
        ids.truncate(end);
        let colors = colors.map(|colors| pixels[..end].iter().map(|i| colors[*i as usize]).collect());
        Self { points, labels: ids, colors }
    }
}

/// The readings that are the first of their object in their block of the picture. Taken before others, they leave no hole in a picture of such blocks,
/// where every so-many-th reading of each row would leave many.
struct Firsts {
    /// Of each pixel.
    is_first: Vec<bool>,
    /// How many each object has, by id.
    counts: Vec<usize>,
}

impl Firsts {
    /// With the smallest square blocks that are at most `max_blocks`.
    fn of(depth: &DepthMap, masks: &CleanMasks, max_blocks: usize) -> Self {
        let (width, height) = (depth.width(), depth.depth_m().height());
        let in_blocks = |side: usize| width.div_ceil(side) * height.div_ceil(side);
        let side = (1..width.max(height)).find(|side| in_blocks(*side) <= max_blocks).unwrap_or(width.max(height));
        // The objects that each block of the row of blocks has shown.
        let mut shown: Vec<Vec<u16>> = vec![Vec::new(); width.div_ceil(side)];
        let (mut is_first, mut counts) = (vec![false; width * height], vec![0; masks.readings.len()]);
        let pixels = depth.depth_m().pixels().iter().zip(masks.labels.pixels()).zip(masks.band.pixels());
        for (i, ((z, id), banded)) in pixels.enumerate() {
            let (u, v) = (i % width, i / width);
            if u == 0 && v % side == 0 {
                shown.iter_mut().for_each(Vec::clear);
            }
            let shown = &mut shown[u / side];
            if !z.is_nan() && !banded && !shown.contains(id) {
                shown.push(*id);
                is_first[i] = true;
                counts[usize::from(*id)] += 1;
            }
        }
        Self { is_first, counts }
    }
}

/// What an object of `available` readings gives of the first ones in their blocks and of the others, so that `wanted` are taken.
fn split(wanted: usize, available: usize, firsts: usize) -> [Share; 2] {
    let of_firsts = wanted.min(firsts);
    [Share { wanted: of_firsts, available: firsts, owed: 0 }, Share { wanted: wanted - of_firsts, available: available - firsts, owed: 0 }]
}

/// How many of some readings are taken, and how many are owed so far.
#[derive(Debug, Clone, Copy)]
struct Share {
    wanted: usize,
    available: usize,
    owed: usize,
}

impl Share {
    /// Whether the next reading is taken, if it `stays`: of those available as many as wanted, as evenly as integers allow.
    fn takes(&mut self, stays: bool) -> bool {
        self.owed += if stays { self.wanted } else { 0 };
        let taken = stays & (self.owed >= self.available);
        self.owed -= if taken { self.available } else { 0 };
        taken
    }
}

/// How many readings of each object are taken, by id, where there are more than `max_points`. No object keeps fewer than `min_object_points` while it has them
/// and there is room for so many of each.
fn shares(readings: &[usize], max_points: usize, min_object_points: usize) -> Vec<usize> {
    let of_objects = || readings.iter().enumerate().skip(1);
    let least = min_object_points.min(max_points / of_objects().filter(|(_, n)| **n > 0).count().max(1));
    let mut wanted: Vec<Option<usize>> = vec![None; readings.len()];
    // What is kept of those that have little is missing to the others, of which some may have little then.
    let (left, waiting) = loop {
        let left = max_points - wanted.iter().flatten().sum::<usize>();
        let waiting: usize = readings.iter().zip(&wanted).filter(|(_, wanted)| wanted.is_none()).map(|(n, _)| n).sum();
        let has_little = |(id, n): &(usize, &usize)| wanted[*id].is_none() && **n * left < least.min(**n) * waiting;
        let few: Vec<usize> = of_objects().filter(has_little).map(|(id, _)| id).collect();
        if few.is_empty() {
            break (left, waiting);
        }
        few.into_iter().for_each(|id| wanted[id] = Some(least.min(readings[id])));
    };
    let share = |(n, wanted): (&usize, Option<usize>)| wanted.unwrap_or_else(|| (n * left).checked_div(waiting).unwrap_or(0));
    let mut wanted: Vec<usize> = readings.iter().zip(wanted).map(share).collect();
    // What rounding leaves over is nobody's.
    let of_named: usize = wanted.iter().skip(1).sum();
    if let (Some(first), Some(n)) = (wanted.first_mut(), readings.first()) {
        *first = (max_points - of_named).min(*n);
    }
    wanted
}

/// A camera's pose, applied to rays: the rotated ray of a pixel is linear in its slopes.
struct RaysToWorld {
    x: Vector3<f32>,
    y: Vector3<f32>,
    z: Vector3<f32>,
    origin: Vector3<f32>,
}

/// The part of it that a row shares.
struct RowToWorld {
    x: Vector3<f32>,
    forward: Vector3<f32>,
    origin: Vector3<f32>,
}

impl RaysToWorld {
    fn new(world_from_camera: &Isometry3<f64>) -> Self {
        let rotation = world_from_camera.rotation.to_rotation_matrix().into_inner().cast::<f32>();
        let axis = |k: usize| rotation.column(k).into_owned();
        Self { x: axis(0), y: axis(1), z: axis(2), origin: world_from_camera.translation.vector.cast() }
    }

    fn row(&self, slope_y: f32) -> RowToWorld {
        RowToWorld { x: self.x, forward: self.y * slope_y + self.z, origin: self.origin }
    }
}

impl RowToWorld {
    fn point(&self, slope_x: f32, depth_m: f32) -> [f32; 3] {
        (self.origin + (self.x * slope_x + self.forward) * depth_m).into()
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::settings::BorderSettings;
    use proptest::prelude::*;
    use repose_geometry::{Image, Pinhole, Point3};

    /// How many points the labels of a picture of 200 x 100 readings have in a cloud of at most so many.
    fn counts(label: impl Fn(usize) -> u16, max_points: usize) -> BTreeMap<u16, usize> {
        let camera = Pinhole { width: 200, height: 100, fx: 200.0, fy: 200.0, cx: 99.5, cy: 49.5 };
        let depth = DepthMap::new(&[1000; 200 * 100], 0.001, &camera, 5.0);
        let labels = Image::from_pixels(200, 100, (0..200 * 100).map(label).collect()).unwrap();
        let settings = Settings { max_points, min_object_points: 30, borders: BorderSettings { radius_px: 0 }, ..Settings::default() };
        let masks = CleanMasks::new(labels, BTreeMap::new(), depth.depth_m(), 200.0, &settings).unwrap();
        let cloud = Cloud::new(&depth, &Isometry3::identity(), &masks, None, &settings);
        assert!(cloud.points.len() <= max_points && cloud.labels.len() == cloud.points.len());
        cloud.labels.iter().fold(BTreeMap::new(), |mut counts, label| {
            *counts.entry(*label).or_default() += 1;
            counts
        })
    }

    #[test]
    fn what_is_small_in_a_large_picture_keeps_enough_points_for_an_object() {
        // A block of 5000 readings, a pen of 40, a can of 300.
        let label = |i: usize| match (i % 200, i / 200) {
            (0..=99, 0..=49) => 1,
            (150..=189, 60) => 2,
            (100..=119, 70..=84) => 7,
            _ => 0,
        };
        // Of every fifty readings one stays.
        let thinned = counts(label, 400);
        assert_eq!([thinned[&2], thinned[&7], thinned.values().sum()], [30, 30, 400]);
        assert!((80..=100).contains(&thinned[&1]), "an even share of what is left: {thinned:?}");
        assert_eq!(counts(label, 20_000).values().sum::<usize>(), 20_000);
        // Where there is no room for so many of each, they share what there is.
        assert_eq!(counts(|i| 1 + (i / 2000) as u16, 100), (1..=10).map(|id| (id, 10)).collect());
    }

    #[test]
    fn a_large_picture_thinned_leaves_no_hole_in_one_of_half_the_size() {
        let (width, height) = (320, 200);
        let camera = Pinhole { width, height, fx: 300.0, fy: 300.0, cx: 159.5, cy: 99.5 };
        // A hole of the sensor's here and there, and an object in the middle.
        let count = |i: usize| if i % 7 == 3 { 0 } else { 1000 };
        let depth = DepthMap::new(&(0..width * height).map(count).collect::<Vec<_>>(), 0.001, &camera, 5.0);
        let is_object = |i: usize| (100..200).contains(&(i % width)) && (60..120).contains(&(i / width));
        let labels = Image::from_pixels(width, height, (0..width * height).map(|i| u16::from(is_object(i))).collect()).unwrap();
        let settings = Settings { max_points: 20_000, borders: BorderSettings { radius_px: 0 }, ..Settings::default() };
        let masks = CleanMasks::new(labels, BTreeMap::new(), depth.depth_m(), 300.0, &settings).unwrap();
        let cloud = Cloud::new(&depth, &Isometry3::identity(), &masks, None, &settings);
        assert_eq!(cloud.points.len(), 20_000);
        let half = camera.shrunk(width / 2);
        let mut shown = Image::filled(half.width, half.height, false);
        for point in &cloud.points {
            shown[half.pixel_of(&Point3::from(*point).cast()).unwrap()] = true;
        }
        assert_eq!(shown.pixels().iter().filter(|shown| !**shown).count(), 0);
    }

    proptest! {
        #[test]
        fn points_are_the_readings_moved_by_the_cameras_pose(
            axis_angle in prop::array::uniform3(-2.0..2.0f64), shift in prop::array::uniform3(-3.0..3.0f64), counts in prop::collection::vec(0u16..4000, 20),
        ) {
            let camera = Pinhole { width: 5, height: 4, fx: 6.0, fy: 7.0, cx: 2.2, cy: 1.4 };
            let world_from_camera = Isometry3::new(Vector3::from(shift), Vector3::from(axis_angle));
            let depth = DepthMap::new(&counts, 0.001, &camera, 5.0);
            let masks = CleanMasks::new(Image::filled(5, 4, 0), BTreeMap::new(), depth.depth_m(), 6.0, &Settings::default());
            prop_assume!(masks.is_some());
            let cloud = Cloud::new(&depth, &world_from_camera, &masks.unwrap(), None, &Settings::default());
            let seen = counts.iter().enumerate().filter(|(_, count)| **count > 0);
            let expected: Vec<Point3<f64>> =
                seen.map(|(i, count)| world_from_camera * camera.unproject((i % 5) as f64, (i / 5) as f64, f64::from(*count) * 0.001)).collect();
            prop_assert_eq!(cloud.points.len(), expected.len());
            for (p, q) in cloud.points.iter().zip(&expected) {
                prop_assert!((Point3::from(*p).cast::<f64>() - q).norm() < 2e-5);
            }
        }
    }
}
