//! Readings of no object near objects, connected without a step.

use std::ops::Range;

use repose_geometry::Image;
use repose_proto::LeftOutReason;

use super::coarse::CoarsePicture;
use super::find::Found;
use crate::settings::InsideSettings;

/// Farthest beyond a region's border that is looked for a rim, pixels.
pub const MAX_LOOK_PX: usize = 24;

/// Readings of no object, connected without a step.
pub struct Regions {
    /// The region of each pixel: 1, 2, …; 0 for objects and where nothing was read.
    pub of: Image<u32>,
    /// How many pixels each has, and which of all they lie among.
    pub sizes: Vec<(usize, Range<usize>)>,
}

impl Regions {
    /// Those of a picture with what was found in it.
    pub fn of(found: &Found, picture: &CoarsePicture, settings: &InsideSettings) -> Self {
        let (width, height) = (picture.camera.width, picture.camera.height);
        let points = picture.in_world.pixels();
        let mut free = beside_objects(found);
        for ((free, id), p) in free.iter_mut().zip(found.ids.pixels()).zip(points) {
            *free &= is_nobodys(found, *id) && !p.z.is_nan();
        }
        let mut regions = Self { of: Image::filled(width, height, 0), sizes: Vec::new() };
        let mut open = Vec::new();
        for start in 0..free.len() {
            if !free[start] || regions.of.pixels()[start] != 0 {
                continue;
            }
            let number = regions.sizes.len() as u32 + 1;
            regions.of.pixels_mut()[start] = number;
            open.push(start);
            // Whoever asks for the pixels of a region looks through these only; the first of them is where it starts.
            let (mut size, mut last) = (0, start);
            while let Some(i) = open.pop() {
                (size, last) = (size + 1, last.max(i));
                let depth_m = picture.depth_m.pixels()[i];
                let step_m = settings.step_m + settings.noise_per_m2 * depth_m * depth_m;
                for j in beside(i, width, height).into_iter().flatten() {
                    if free[j] && regions.of.pixels()[j] == 0 && (points[j].z - points[i].z).abs() <= step_m {
                        regions.of.pixels_mut()[j] = number;
                        open.push(j);
                    }
                }
            }
            regions.sizes.push((size, start..last + 1));
        }
        regions
    }
}

/// Whether an id is no object's, or that of something which only geometry takes for one.
pub fn is_nobodys(found: &Found, id: u16) -> bool {
    id == 0 || found.no_objects.get(&id) == Some(&LeftOutReason::Unconfirmed)
}

/// Which pixels lie in the bounding box of an object or up to `MAX_LOOK_PX` beside it: nothing elsewhere is surrounded by it.
fn beside_objects(found: &Found) -> Vec<bool> {
    let (width, height) = (found.ids.width(), found.ids.height());
    let most = found.ids.pixels().iter().copied().max().unwrap_or(0);
    // Of each id the first and the last column and row.
    let mut boxes = vec![[usize::MAX, 0, usize::MAX, 0]; usize::from(most) + 1];
    for (v, row) in found.ids.pixels().chunks_exact(width).enumerate() {
        for (u, id) in row.iter().enumerate().filter(|(_, id)| **id != 0) {
            let [left, right, top, bottom] = &mut boxes[usize::from(*id)];
            (*left, *right, *top, *bottom) = ((*left).min(u), (*right).max(u), (*top).min(v), (*bottom).max(v));
        }
    }
    let mut beside = vec![false; width * height];
    let objects = boxes.iter().zip(0u16..).filter(|([left, ..], id)| *left < width && !found.no_objects.contains_key(id));
    for ([left, right, top, bottom], _) in objects {
        let (left, right) = (left.saturating_sub(MAX_LOOK_PX), (right + MAX_LOOK_PX).min(width - 1));
        let (top, bottom) = (top.saturating_sub(MAX_LOOK_PX), (bottom + MAX_LOOK_PX).min(height - 1));
        (top..=bottom).for_each(|v| beside[v * width + left..=v * width + right].fill(true));
    }
    beside
}

/// The pixels beside one.
fn beside(i: usize, width: usize, height: usize) -> [Option<usize>; 4] {
    let (u, v) = (i % width, i / width);
    [(u > 0).then(|| i - 1), (u + 1 < width).then(|| i + 1), (v > 0).then(|| i - width), (v + 1 < height).then(|| i + width)]
}
