//! How well found instance masks match labelled ones: overlap and boundary precision, recall and F.
//!
//! The definition is that of Xie et al., "The Best of Both Modes: Separately Leveraging RGB and Depth for Unseen Object Instance
//! Segmentation" (CoRL 2019), after Dave et al., "Towards Segmenting Anything That Moves" (ICCV workshops 2019). Found masks are assigned
//! to labelled ones by the Hungarian method on their pairwise overlap F; background takes no part. With c a found mask and g(c) the
//! labelled one assigned to it, precision is Σ|c ∩ g(c)| / Σ|c| over all found masks and recall Σ|c ∩ g(c)| / Σ|g| over all labelled
//! ones. The boundary figures are the same on one-pixel contours, where a contour pixel matches within a disk of [`tolerance_px`].

use std::collections::{BTreeMap, BTreeSet};

use repose_geometry::Image;
use serde::Serialize;

use crate::statistics::mask_faults::MaskFaults;

use crate::statistics::assignment::best_assignment;

/// Share of the picture's diagonal within which contours match, as in the published evaluation (and DAVIS before it).
const TOLERANCE_OF_DIAGONAL: f64 = 0.003;
/// An object counts as found when its mask's overlap F exceeds this.
const FOUND_FROM: f64 = 0.75;

/// Precision, recall and their harmonic mean, 0 to 1.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct PrecisionRecall {
    /// Share of what was found that is right.
    pub precision: f64,
    /// Share of what is there that was found.
    pub recall: f64,
    /// The harmonic mean of the two.
    pub f: f64,
}

impl PrecisionRecall {
    /// From matched pixels of the found masks and their total, and the same of the labelled ones. Nothing found is never wrong, and
    /// nothing labelled never missed.
    fn of(matched_found: usize, found: usize, matched_labelled: usize, labelled: usize) -> Self {
        let share = |matched: usize, all: usize| if all == 0 { 1.0 } else { matched as f64 / all as f64 };
        let (precision, recall) = (share(matched_found, found), share(matched_labelled, labelled));
        let sum = precision + recall;
        Self { precision, recall, f: if sum > 0.0 { 2.0 * precision * recall / sum } else { 0.0 } }
    }
}

/// The figures of one frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct MaskScores {
    /// Labelled objects.
    pub labelled: usize,
    /// Found objects.
    pub found: usize,
    /// Labelled objects whose assigned mask has an overlap F above 0.75.
    pub above_75: usize,
    /// On whole masks.
    pub overlap: PrecisionRecall,
    /// On contours.
    pub boundary: PrecisionRecall,
    /// What went wrong with the rest.
    pub faults: MaskFaults,
}

impl MaskScores {
    /// Share of the labelled objects that were found with an overlap F above 0.75; 1 where there is none to find.
    pub fn share_75(&self) -> f64 {
        if self.labelled == 0 { 1.0 } else { self.above_75 as f64 / self.labelled as f64 }
    }
}

/// Radius within which contours match, pixels: 3 for 640 × 480.
pub fn tolerance_px(width: usize, height: usize) -> usize {
    (TOLERANCE_OF_DIAGONAL * (width as f64).hypot(height as f64)).ceil() as usize
}

/// Scores found masks against labelled ones, both instance ids with 0 for background. The pictures must have one size.
pub fn score_masks(labelled: &Image<u16>, found: &Image<u16>) -> MaskScores {
    debug_assert_eq!((labelled.width(), labelled.height()), (found.width(), found.height()));
    let (labelled_px, found_px) = (sizes(labelled), sizes(found));
    let shared = shared_px(labelled, found);
    let matches = matched(labelled, found);
    let good: BTreeSet<u16> = matches.iter().filter(|(_, _, f)| *f > FOUND_FROM).map(|(g, _, _)| *g).collect();
    let pairs: Vec<(u16, u16)> = matches.into_iter().map(|(g, c, _)| (g, c)).collect();
    let in_common: usize = pairs.iter().filter_map(|pair| shared.get(pair)).sum();
    let overlap = PrecisionRecall::of(in_common, found_px.values().sum(), in_common, labelled_px.values().sum());

    let faults = MaskFaults::of(&labelled_px, &found_px, &shared, |g| good.contains(&g));

    let disk = disk(tolerance_px(labelled.width(), labelled.height()));
    let (labelled_contours, found_contours) = (contours(labelled), contours(found));
    let (mut matched_found, mut matched_labelled) = (0, 0);
    for (g, c) in &pairs {
        matched_found += matching(&found_contours[c], &labelled_contours[g], labelled, &disk);
        matched_labelled += matching(&labelled_contours[g], &found_contours[c], labelled, &disk);
    }
    let total = |contours: &BTreeMap<u16, Vec<usize>>| contours.values().map(Vec::len).sum::<usize>();
    let boundary = PrecisionRecall::of(matched_found, total(&found_contours), matched_labelled, total(&labelled_contours));
    MaskScores { labelled: labelled_px.len(), found: found_px.len(), above_75: good.len(), overlap, boundary, faults }
}

/// Pairs (labelled, found, overlap F) of masks with the greatest sum of F; those that do not overlap are no pairs.
pub fn matched(labelled: &Image<u16>, found: &Image<u16>) -> Vec<(u16, u16, f64)> {
    let (labelled_px, found_px, shared) = (sizes(labelled), sizes(found), shared_px(labelled, found));
    let overlap_f = |g: u16, c: u16| 2.0 * shared.get(&(g, c)).map_or(0.0, |n| *n as f64) / (labelled_px[&g] + found_px[&c]) as f64;
    let pairs = assign(&labelled_px.keys().copied().collect::<Vec<_>>(), &found_px.keys().copied().collect::<Vec<_>>(), overlap_f);
    pairs.into_iter().map(|(g, c)| (g, c, overlap_f(g, c))).collect()
}

/// Pixels that a labelled and a found mask share.
fn shared_px(labelled: &Image<u16>, found: &Image<u16>) -> BTreeMap<(u16, u16), usize> {
    let mut shared = BTreeMap::new();
    for (g, c) in labelled.pixels().iter().zip(found.pixels()).filter(|(g, c)| **g != 0 && **c != 0) {
        *shared.entry((*g, *c)).or_insert(0) += 1;
    }
    shared
}

/// Pixels per id.
fn sizes(ids: &Image<u16>) -> BTreeMap<u16, usize> {
    let mut sizes = BTreeMap::new();
    for id in ids.pixels().iter().filter(|id| **id != 0) {
        *sizes.entry(*id).or_insert(0) += 1;
    }
    sizes
}

/// Pairs (labelled, found) with the greatest sum of F; those that do not overlap are no pairs.
fn assign(labelled: &[u16], found: &[u16], f: impl Fn(u16, u16) -> f64) -> Vec<(u16, u16)> {
    if labelled.is_empty() || found.is_empty() {
        return Vec::new();
    }
    // The method wants no more rows than columns.
    let turned = labelled.len() > found.len();
    let (rows, columns) = if turned { (found, labelled) } else { (labelled, found) };
    let pair = |row: usize, column: usize| if turned { (columns[column], rows[row]) } else { (rows[row], columns[column]) };
    let columns_of_rows = best_assignment(rows.len(), columns.len(), |row, column| {
        let (g, c) = pair(row, column);
        f(g, c)
    });
    columns_of_rows.into_iter().enumerate().map(|(row, column)| pair(row, column)).filter(|(g, c)| f(*g, *c) > 0.0).collect()
}

/// Per id, the pixels of its mask's contour: those that differ from the mask to the right, below, or diagonally below.
///
/// A contour pixel may lie just outside its mask, up and to the left, as in the published evaluation.
fn contours(ids: &Image<u16>) -> BTreeMap<u16, Vec<usize>> {
    let (width, height) = (ids.width(), ids.height());
    let mut contours: BTreeMap<u16, Vec<usize>> = sizes(ids).into_keys().map(|id| (id, Vec::new())).collect();
    for i in 0..width * height {
        let (u, v) = (i % width, i / width);
        let (right, below) = (u + 1 < width, v + 1 < height);
        let here = ids.pixels()[i];
        let beside = [right.then(|| i + 1), below.then(|| i + width), (right && below).then(|| i + width + 1)];
        let beside = beside.map(|j| j.map(|j| ids.pixels()[j]));
        if beside.iter().flatten().all(|other| *other == here) {
            continue;
        }
        let mut involved = [Some(here), beside[0], beside[1], beside[2]];
        involved.sort_unstable();
        for (k, id) in involved.iter().enumerate() {
            if let Some(id) = id.filter(|id| *id != 0 && (k == 0 || involved[k - 1] != Some(*id))) {
                contours.entry(id).or_default().push(i);
            }
        }
    }
    contours
}

/// Offsets within a radius.
fn disk(radius: usize) -> Vec<(isize, isize)> {
    let r = radius as isize;
    (-r..=r).flat_map(|dv| (-r..=r).map(move |du| (du, dv))).filter(|(du, dv)| du * du + dv * dv <= r * r).collect()
}

/// How many of the first pixels lie within the disk of one of the second; `picture` gives the size.
fn matching(pixels: &[usize], others: &[usize], picture: &Image<u16>, disk: &[(isize, isize)]) -> usize {
    let (width, height) = (picture.width() as isize, picture.height() as isize);
    let mut dilated = vec![false; picture.pixels().len()];
    for &i in others {
        let (u, v) = (i as isize % width, i as isize / width);
        for (du, dv) in disk {
            let (u, v) = (u + du, v + dv);
            if (0..width).contains(&u) && (0..height).contains(&v) {
                dilated[(v * width + u) as usize] = true;
            }
        }
    }
    pixels.iter().filter(|i| dilated[**i]).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A 100 x 100 picture of rectangles (id, first column, first row, columns, rows), later ones over earlier ones.
    fn picture(rectangles: &[(u16, usize, usize, usize, usize)]) -> Image<u16> {
        let mut ids = Image::filled(100, 100, 0);
        for &(id, u0, v0, width, height) in rectangles {
            for v in v0..v0 + height {
                for u in u0..u0 + width {
                    ids[(u, v)] = id;
                }
            }
        }
        ids
    }

    #[test]
    fn the_same_masks_under_other_ids_are_perfect() {
        let scores =
            score_masks(&picture(&[(1, 10, 10, 20, 20), (2, 50, 50, 30, 10)]), &picture(&[(9, 10, 10, 20, 20), (3, 50, 50, 30, 10)]));
        assert_eq!((scores.overlap.f, scores.boundary.f, scores.share_75()), (1.0, 1.0, 1.0));
        assert_eq!((scores.labelled, scores.found), (2, 2));
    }

    #[test]
    fn a_split_object_loses_recall_and_its_smaller_part_precision() {
        // 20 x 20 in one piece of 15 and one of 5 columns: the larger is assigned, the smaller is a false one.
        let scores = score_masks(&picture(&[(1, 10, 10, 20, 20)]), &picture(&[(1, 10, 10, 15, 20), (2, 25, 10, 5, 20)]));
        assert!((scores.overlap.precision - 0.75).abs() < 1e-12 && (scores.overlap.recall - 0.75).abs() < 1e-12);
        // F of the assigned pair: 2 * 300 / (400 + 300).
        assert_eq!(scores.above_75, 1);
    }

    #[test]
    fn merged_objects_count_once() {
        let scores = score_masks(&picture(&[(1, 10, 10, 20, 20), (2, 30, 10, 20, 20)]), &picture(&[(5, 10, 10, 40, 20)]));
        assert_eq!((scores.overlap.precision, scores.overlap.recall), (0.5, 0.5));
        // 2 * 400 / (800 + 400) is below 0.75.
        assert_eq!((scores.above_75, scores.labelled), (0, 2));
    }

    #[test]
    fn the_assignment_is_the_best_in_sum_and_not_the_first_come() {
        // Labelled 1 overlaps found 8 best (F 0.65), but then found 7 and labelled 2 are left alone: 1 with 7 (0.56) and 2 with 8 (0.48)
        // is more in sum, and has 140 + 100 pixels in common instead of 220.
        let labelled = picture(&[(1, 0, 0, 36, 10), (2, 36, 0, 10, 10)]);
        let found = picture(&[(7, 0, 0, 14, 10), (8, 14, 0, 32, 10)]);
        let scores = score_masks(&labelled, &found);
        assert!((scores.overlap.precision - 240.0 / 460.0).abs() < 1e-12);
    }

    #[test]
    fn contours_match_within_the_tolerance_and_not_beyond() {
        assert_eq!((tolerance_px(640, 480), tolerance_px(100, 100)), (3, 1));
        let truth = picture(&[(1, 20, 20, 40, 40)]);
        // All but the corners, which lie a diagonal away.
        assert!(score_masks(&truth, &picture(&[(1, 21, 21, 38, 38)])).boundary.f > 0.98);
        assert!(score_masks(&truth, &picture(&[(1, 23, 23, 34, 34)])).boundary.f < 0.01);
    }

    #[test]
    fn nothing_found_and_nothing_to_find_are_told_apart() {
        let (none, one) = (picture(&[]), picture(&[(1, 5, 5, 9, 9)]));
        let missed = score_masks(&one, &none);
        assert_eq!((missed.overlap.precision, missed.overlap.recall, missed.overlap.f, missed.share_75()), (1.0, 0.0, 0.0, 0.0));
        let invented = score_masks(&none, &one);
        assert_eq!((invented.overlap.precision, invented.overlap.recall, invented.boundary.f), (0.0, 1.0, 0.0));
        assert_eq!(score_masks(&none, &none).overlap.f, 1.0);
    }
}
