//! What a person says about the masks: this is an object, these are one, this is more than one.

use std::collections::{BTreeMap, BTreeSet};

use repose_geometry::{Image, Point3, Vector3};
use repose_proto::{CallError, LeftOutReason, SegmentHints};

use crate::readings::depth::DepthMap;

/// A click may miss the object by this much, pixels.
const CLICK_PX: usize = 6;
/// A component belongs to a box that holds at least this share of it.
const IN_BOX: f64 = 0.6;
/// Rounds of moving the two middles of what is split.
const ROUNDS: usize = 12;

/// Follows the hints. `no_objects` are ids of `labels` that are none; one that a hint names becomes an object.
///
/// # Errors
/// `invalid_argument` that names the hint which cannot be followed.
pub fn follow(
    labels: &mut Image<u16>,
    no_objects: &mut BTreeMap<u16, LeftOutReason>,
    depth: &DepthMap,
    hints: &SegmentHints,
) -> Result<(), CallError> {
    // Ids are those before any hint.
    for (i, ids) in hints.merge.iter().enumerate() {
        known(labels, ids, &format!("hints.merge[{i}]"))?;
    }
    known(labels, &hints.split, "hints.split")?;
    // One that an earlier list has merged is found under the id that it has since.
    let mut since: BTreeMap<u16, u16> = BTreeMap::new();
    for ids in &hints.merge {
        let ids_now: Vec<u16> = ids.iter().map(|id| since.get(id).copied().unwrap_or(*id)).collect();
        join(labels, no_objects, &ids_now);
        let Some(first) = ids_now.first() else { continue };
        since.extend(ids.iter().map(|id| (*id, *first)));
        since.values_mut().filter(|id| ids_now.contains(id)).for_each(|id| *id = *first);
    }
    for (i, id) in hints.split.iter().enumerate() {
        split(labels, no_objects, depth, *id).ok_or_else(|| cannot_split(i, *id))?;
    }
    for (i, at) in hints.clicks_px.iter().enumerate() {
        let id = nearest_id(labels, *at).ok_or_else(|| {
            CallError::invalid(
                format!("hints.clicks_px[{i}]"),
                format!("nothing rises above its support within {CLICK_PX} pixels of {at:?}"),
            )
        })?;
        no_objects.remove(&id);
    }
    for (i, [left, top, right, bottom]) in hints.boxes_px.iter().enumerate() {
        let mut counts: BTreeMap<u16, [usize; 2]> = BTreeMap::new();
        for (k, id) in labels.pixels().iter().enumerate().filter(|(_, id)| **id != 0) {
            let (u, v) = (k % labels.width(), k / labels.width());
            let [inside, all] = counts.entry(*id).or_default();
            *inside += usize::from((*left..=*right).contains(&u) && (*top..=*bottom).contains(&v));
            *all += 1;
        }
        let within = |[inside, all]: &[usize; 2]| *inside as f64 >= IN_BOX * *all as f64;
        let ids: Vec<u16> = counts.iter().filter(|(_, counts)| within(counts)).map(|(id, _)| *id).collect();
        if ids.is_empty() {
            return Err(CallError::invalid(format!("hints.boxes_px[{i}]"), "nothing in this box rises above its support"));
        }
        join(labels, no_objects, &ids);
    }
    Ok(())
}

fn cannot_split(i: usize, id: u16) -> CallError {
    CallError::invalid(format!("hints.split[{i}]"), format!("{id} has too few readings to be two objects"))
}

/// Refuses ids that no pixel has.
fn known(labels: &Image<u16>, ids: &[u16], field: &str) -> Result<(), CallError> {
    let present: BTreeSet<u16> = labels.pixels().iter().copied().filter(|id| *id != 0).collect();
    let Some(id) = ids.iter().find(|id| !present.contains(id)) else { return Ok(()) };
    let present: Vec<String> = present.iter().map(u16::to_string).collect();
    Err(CallError::invalid(field, format!("there is no {id}; without hints the frame has {}", present.join(", "))))
}

/// Gives all ids the first.
fn join(labels: &mut Image<u16>, no_objects: &mut BTreeMap<u16, LeftOutReason>, ids: &[u16]) {
    let Some(first) = ids.first() else { return };
    labels.pixels_mut().iter_mut().filter(|id| ids.contains(id)).for_each(|id| *id = *first);
    ids.iter().for_each(|id| {
        no_objects.remove(id);
    });
}

/// The id at a pixel, or the nearest around it.
fn nearest_id(labels: &Image<u16>, [u, v]: [usize; 2]) -> Option<u16> {
    let around = |at: usize| at.saturating_sub(CLICK_PX)..=at + CLICK_PX;
    let pixels = around(v).flat_map(|row| around(u).map(move |column| (column, row)));
    let distance = |(column, row): &(usize, usize)| column.abs_diff(u).pow(2) + row.abs_diff(v).pow(2);
    let shown = pixels.filter(|(column, row)| labels.get(*column, *row).is_some_and(|id| *id != 0));
    shown.min_by_key(distance).map(|at| labels[at])
}

/// Parts an object in two where its readings gather around two middles (k-means, from the two ends of its longest extent); the part with
/// fewer readings gets a new id. `None` where it has too few readings.
fn split(labels: &mut Image<u16>, no_objects: &mut BTreeMap<u16, LeftOutReason>, depth: &DepthMap, id: u16) -> Option<()> {
    let width = labels.width();
    let of_id: Vec<usize> = (0..labels.pixels().len()).filter(|i| labels.pixels()[*i] == id).collect();
    let point = |i: usize| depth.point(i % width, i / width);
    let readings: Vec<(usize, Point3<f32>)> = of_id.into_iter().map(|i| (i, point(i))).filter(|(_, p)| !p.x.is_nan()).collect();
    if readings.len() < 2 {
        return None;
    }
    let mean = |points: &mut dyn Iterator<Item = Point3<f32>>| {
        let (sum, n) = points.fold((Vector3::<f64>::zeros(), 0usize), |(sum, n), p| (sum + p.coords.cast::<f64>(), n + 1));
        (n > 0).then(|| Point3::from((sum / n as f64).cast::<f32>()))
    };
    let farthest = |from: &Point3<f32>| {
        readings.iter().map(|(_, p)| *p).max_by(|a, b| (a - from).norm_squared().total_cmp(&(b - from).norm_squared()))
    };
    let middle = mean(&mut readings.iter().map(|(_, p)| *p))?;
    let one = farthest(&middle)?;
    let mut middles = [one, farthest(&one)?];
    let is_second = |middles: &[Point3<f32>; 2], p: &Point3<f32>| (p - middles[1]).norm_squared() < (p - middles[0]).norm_squared();
    for _ in 0..ROUNDS {
        let part = |second: bool| mean(&mut readings.iter().map(|(_, p)| *p).filter(|p| is_second(&middles, p) == second));
        middles = [part(false)?, part(true)?];
    }
    let second: Vec<usize> = readings.iter().filter(|(_, p)| is_second(&middles, p)).map(|(i, _)| *i).collect();
    let first: Vec<usize> = readings.iter().filter(|(_, p)| !is_second(&middles, p)).map(|(i, _)| *i).collect();
    // What is no object keeps its number and its reason though no pixel may be left of it.
    let told = no_objects.keys().copied();
    let used: BTreeSet<u16> = labels.pixels().iter().copied().chain(told).collect();
    // Labels that use the last number, as a name for nothing, leave others.
    let fresh = used.last()?.checked_add(1).or_else(|| (1..=u16::MAX).find(|id| !used.contains(id)))?;
    for i in if second.len() <= first.len() { second } else { first } {
        labels.pixels_mut()[i] = fresh;
    }
    no_objects.remove(&id);
    Some(())
}

#[cfg(test)]
mod tests {
    use repose_geometry::Pinhole;

    use super::*;

    /// Three blocks of 20 x 20 pixels at 1 m: 1, 2, and 3, which is no object.
    fn picture() -> (Image<u16>, BTreeMap<u16, LeftOutReason>, DepthMap) {
        let camera = Pinhole { width: 100, height: 40, fx: 100.0, fy: 100.0, cx: 50.0, cy: 20.0 };
        let label = |i: usize| match (i % 100, i / 100) {
            (5..25, 10..30) => 1,
            (35..55, 10..30) => 2,
            (70..90, 10..30) => 3,
            _ => 0u16,
        };
        let labels = Image::from_pixels(100, 40, (0..4000).map(label).collect()).unwrap();
        let no_objects = BTreeMap::from([(3, LeftOutReason::BesideSupports)]);
        (labels, no_objects, DepthMap::new(&[1000; 4000], 0.001, &camera, 4.0))
    }

    fn followed(hints: &SegmentHints) -> Result<(Image<u16>, BTreeMap<u16, LeftOutReason>), CallError> {
        let (mut labels, mut no_objects, depth) = picture();
        follow(&mut labels, &mut no_objects, &depth, hints).map(|()| (labels, no_objects))
    }

    #[test]
    fn objects_are_merged_and_split_as_said() {
        let (labels, _) = followed(&SegmentHints { merge: vec![vec![1, 2]], ..SegmentHints::default() }).unwrap();
        assert_eq!(labels.pixels().iter().filter(|id| **id == 1).count(), 800);
        for merge in [vec![vec![1, 2], vec![2, 3]], vec![vec![1, 2], vec![3, 2]], vec![vec![2, 1], vec![3, 1]]] {
            let (labels, no_objects) = followed(&SegmentHints { merge: merge.clone(), ..SegmentHints::default() }).unwrap();
            let ids: BTreeSet<u16> = labels.pixels().iter().copied().filter(|id| *id != 0).collect();
            assert!(ids.len() == 1 && no_objects.is_empty(), "lists with an id in common are one object: {merge:?} gave {ids:?}");
        }
        let (labels, _) = followed(&SegmentHints { split: vec![2], ..SegmentHints::default() }).unwrap();
        let counts = [2, 4].map(|id| labels.pixels().iter().filter(|other| **other == id).count());
        assert!(counts[0] + counts[1] == 400 && counts[1] >= 150, "{counts:?}");
    }

    #[test]
    fn an_object_is_split_though_the_last_number_is_taken() {
        let (mut labels, mut no_objects, depth) = picture();
        labels.pixels_mut()[0] = u16::MAX;
        follow(&mut labels, &mut no_objects, &depth, &SegmentHints { split: vec![2], ..SegmentHints::default() }).unwrap();
        let counts = [2, 4].map(|id| labels.pixels().iter().filter(|other| **other == id).count());
        assert!(counts[0] + counts[1] == 400 && counts[1] >= 150, "{counts:?}");
    }

    #[test]
    fn a_part_that_was_split_off_is_not_taken_for_something_that_was_left_out() {
        let (mut labels, mut no_objects, depth) = picture();
        // Nothing shows of it any more.
        no_objects.insert(4, LeftOutReason::Unconfirmed);
        let hints = SegmentHints { split: vec![2], ..SegmentHints::default() };
        follow(&mut labels, &mut no_objects, &depth, &hints).unwrap();
        let ids: BTreeSet<u16> = labels.pixels().iter().copied().collect();
        assert_eq!(ids, BTreeSet::from([0, 1, 2, 3, 5]));
    }

    #[test]
    fn a_click_or_a_box_makes_an_object_of_what_was_left_out() {
        let clicked = followed(&SegmentHints { clicks_px: vec![[68, 20]], ..SegmentHints::default() }).unwrap();
        let boxed = followed(&SegmentHints { boxes_px: vec![[66, 5, 95, 35]], ..SegmentHints::default() }).unwrap();
        assert!(clicked.1.is_empty() && boxed.1.is_empty());
        let (labels, _) = followed(&SegmentHints { boxes_px: vec![[0, 0, 60, 39]], ..SegmentHints::default() }).unwrap();
        assert_eq!(labels.pixels().iter().filter(|id| **id == 1).count(), 800, "what is in one box is one object");
    }

    #[test]
    fn a_hint_that_cannot_be_followed_is_named() {
        let field = |hints: SegmentHints| followed(&hints).unwrap_err().field.unwrap();
        assert_eq!(field(SegmentHints { merge: vec![vec![1, 9]], ..SegmentHints::default() }), "hints.merge[0]");
        assert_eq!(field(SegmentHints { split: vec![9], ..SegmentHints::default() }), "hints.split");
        assert_eq!(field(SegmentHints { clicks_px: vec![[1, 1]], ..SegmentHints::default() }), "hints.clicks_px[0]");
        assert_eq!(field(SegmentHints { boxes_px: vec![[0, 0, 9, 5]], ..SegmentHints::default() }), "hints.boxes_px[0]");
    }
}
