//! What went wrong with the labelled objects that were not found, and with the found ones that are none.
//!
//! An object is found when the mask assigned to it overlaps with an F above 0.75. One that is not has exactly one fault, the first of these
//! that fits: *missed* (found masks cover less than 40 % of it), *merged* (the mask that covers most of it also covers 40 % or more of another
//! object), *split* (two or more masks each cover 10 % or more of it), or *inexact*. A found mask that lies on the background for the most
//! part is *invented*.

use std::collections::BTreeMap;

use serde::Serialize;

/// Covered by less than this share, an object is missed.
const SEEN_FROM: f64 = 0.4;
/// Covered by this share or more, an object is part of a mask.
const PART_FROM: f64 = 0.1;

/// Counts of faults.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct MaskFaults {
    /// Objects that share their mask with others.
    pub merged: usize,
    /// Objects in several masks.
    pub split: usize,
    /// Objects without a mask.
    pub missed: usize,
    /// Objects whose mask is too large, too small or beside them.
    pub inexact: usize,
    /// Masks without an object.
    pub invented: usize,
}

impl MaskFaults {
    /// From the pixels of each labelled object and of each found mask, those of each pair, and whether an object is found.
    pub fn of(
        labelled_px: &BTreeMap<u16, usize>,
        found_px: &BTreeMap<u16, usize>,
        shared: &BTreeMap<(u16, u16), usize>,
        is_found: impl Fn(u16) -> bool,
    ) -> Self {
        let mut faults = Self::default();
        let share = |g: u16, c: u16| shared.get(&(g, c)).map_or(0.0, |n| *n as f64) / labelled_px[&g] as f64;
        for g in labelled_px.keys().copied().filter(|g| !is_found(*g)) {
            let masks = || found_px.keys().copied().map(|c| (share(g, c), c));
            let Some((_, most)) = masks().max_by(|a, b| a.0.total_cmp(&b.0)) else {
                faults.missed += 1;
                continue;
            };
            let has_others = labelled_px.keys().any(|other| *other != g && share(*other, most) >= SEEN_FROM);
            if masks().map(|(share, _)| share).sum::<f64>() < SEEN_FROM {
                faults.missed += 1;
            } else if has_others {
                faults.merged += 1;
            } else if masks().filter(|(share, _)| *share >= PART_FROM).count() > 1 {
                faults.split += 1;
            } else {
                faults.inexact += 1;
            }
        }
        let on_objects = |c: u16| labelled_px.keys().filter_map(|g| shared.get(&(*g, c))).sum::<usize>();
        faults.invented = found_px.iter().filter(|(c, pixels)| 2 * on_objects(**c) < **pixels).count();
        faults
    }

    /// The sum with another frame's.
    #[must_use]
    pub fn plus(self, other: Self) -> Self {
        Self {
            merged: self.merged + other.merged,
            split: self.split + other.split,
            missed: self.missed + other.missed,
            inexact: self.inexact + other.inexact,
            invented: self.invented + other.invented,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_object_that_is_not_found_has_one_fault() {
        // 1 and 2 share mask 7; 3 is in masks 8 and 9; 4 has none; 5 is a part of mask 10; 6 is found; mask 12 lies on nothing.
        let labelled = (1..=6).map(|g| (g, 100)).collect();
        let found = BTreeMap::from([(7, 200), (8, 50), (9, 50), (10, 300), (11, 100), (12, 80)]);
        let shared = BTreeMap::from([((1, 7), 100), ((2, 7), 100), ((3, 8), 50), ((3, 9), 50), ((5, 10), 100), ((6, 11), 100)]);
        let faults = MaskFaults::of(&labelled, &found, &shared, |g| g == 6);
        assert_eq!(faults, MaskFaults { merged: 2, split: 1, missed: 1, inexact: 1, invented: 2 });
    }
}
