//! What generated scenes are like, in numbers: how often relations hold, how far things are apart, and what was rejected.
//!
//! Prevalence is over ordered pairs of objects that a view shows, as the paper labels "all visible pairs". Gaps and centre offsets are
//! over unordered pairs of a scene, whether seen or not: touching at 1 mm and centered at 1 mm can only be learned through a millimetre
//! of noise where few pairs lie just past the limit, and these histograms say whether that is so.

use std::collections::BTreeMap;

use repose_dataset::ViewRecord;
use repose_relations::RELATIONS;
use serde::{Deserialize, Serialize};

/// How many lengths fall into each bin.
///
/// Bins are fine where thresholds are and coarse beyond: 0.25 mm to 3 mm, 1 mm to 10 mm, 5 mm to 100 mm.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Histogram {
    /// Borders of the bins, millimetres, one more than bins; a bin includes its lower border.
    pub edges_mm: Vec<f64>,
    /// Lengths in each bin.
    pub counts: Vec<u64>,
    /// Lengths of 100 mm and more.
    pub beyond: u64,
}

impl Default for Histogram {
    fn default() -> Self {
        let fine = (0..12).map(|k| 0.25 * f64::from(k));
        let middle = (3..10).map(f64::from);
        let coarse = (2..=20).map(|k| 5.0 * f64::from(k));
        let edges_mm: Vec<f64> = fine.chain(middle).chain(coarse).collect();
        Self { counts: vec![0; edges_mm.len() - 1], edges_mm, beyond: 0 }
    }
}

impl Histogram {
    /// Counts a length, metres; what is not a number or negative is not counted.
    pub fn add(&mut self, length_m: f64) {
        let length_mm = 1000.0 * length_m;
        if length_mm.is_nan() || length_mm < 0.0 {
            return;
        }
        let past = self.edges_mm.partition_point(|edge| *edge <= length_mm);
        match self.counts.get_mut(past - 1) {
            Some(count) => *count += 1,
            None => self.beyond += 1,
        }
    }

    /// All lengths counted.
    pub fn total(&self) -> u64 {
        self.counts.iter().sum::<u64>() + self.beyond
    }

    /// Lengths in bins between two borders, millimetres.
    pub fn between(&self, low_mm: f64, high_mm: f64) -> u64 {
        let bins = self.edges_mm.windows(2).zip(&self.counts);
        bins.filter(|(edges, _)| edges[0] >= low_mm && edges[1] <= high_mm).map(|(_, count)| count).sum()
    }

    fn merge(&mut self, other: &Self) {
        self.beyond += other.beyond;
        for (sum, n) in self.counts.iter_mut().zip(&other.counts) {
            *sum += n;
        }
    }
}

/// Numbers of many scenes and their views; sums, so that the order in which scenes come does not matter.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Statistics {
    /// Scenes with at least one view.
    pub scenes: u64,
    /// Views.
    pub views: u64,
    /// Scenes by how many objects they have.
    pub objects_per_scene: BTreeMap<usize, u64>,
    /// Scenes by kind.
    pub scene_kinds: BTreeMap<String, u64>,
    /// Objects by what they are.
    pub objects: BTreeMap<String, u64>,
    /// Views by who holds the camera.
    pub viewpoints: BTreeMap<String, u64>,
    /// Draws that were no scene, by reason.
    pub rejections: BTreeMap<String, u64>,
    /// Ordered pairs of objects that are both seen, over all views.
    pub pairs: u64,
    /// Of those, the pairs for which each relation holds, in wire order.
    pub holding: [u64; RELATIONS],
    /// Distances between the surfaces of two objects of a scene; from 100 mm on they are not told apart.
    pub gaps: Histogram,
    /// Horizontal distances between the centres of the boxes of two objects of a scene.
    pub center_offsets: Histogram,
}

impl Statistics {
    /// Counts a scene by its views, and the draws that were rejected before it. A scene without views counts for its rejections only.
    pub fn add_scene<'a>(&mut self, views: &[ViewRecord], rejections: impl IntoIterator<Item = &'a str>) {
        for reason in rejections {
            count(&mut self.rejections, reason);
        }
        for view in views {
            self.add_view(view);
        }
        let Some(scene) = views.first() else { return };
        self.scenes += 1;
        let n = scene.objects.len();
        *self.objects_per_scene.entry(n).or_default() += 1;
        count(&mut self.scene_kinds, &scene.scene_kind);
        for object in &scene.objects {
            count(&mut self.objects, &object.name);
        }
        for (i, j) in (0..n).flat_map(|i| (i + 1..n).map(move |j| (i, j))) {
            self.gaps.add(f64::from(scene.gap_m[i * n + j]));
            let apart = scene.objects[i].bounds.center() - scene.objects[j].bounds.center();
            self.center_offsets.add(apart.xy().norm());
        }
    }

    fn add_view(&mut self, view: &ViewRecord) {
        self.views += 1;
        count(&mut self.viewpoints, &view.viewpoint);
        let seen: Vec<usize> = (0..view.objects.len()).filter(|k| view.is_seen(*k)).collect();
        for (query, anchor) in seen.iter().flat_map(|q| seen.iter().map(move |a| (*q, *a))).filter(|(q, a)| q != a) {
            self.pairs += 1;
            for (sum, holds) in self.holding.iter_mut().zip(view.relations_of(query, anchor)) {
                *sum += u64::from(*holds);
            }
        }
    }

    /// The share of seen pairs for which each relation holds, percent, in wire order; 0 without pairs.
    pub fn prevalence_percent(&self) -> [f64; RELATIONS] {
        self.holding.map(|n| 100.0 * n as f64 / self.pairs.max(1) as f64)
    }

    /// Adds what others counted.
    pub fn merge(&mut self, other: &Self) {
        self.scenes += other.scenes;
        self.views += other.views;
        self.pairs += other.pairs;
        for (sum, n) in self.holding.iter_mut().zip(other.holding) {
            *sum += n;
        }
        for (n, count) in &other.objects_per_scene {
            *self.objects_per_scene.entry(*n).or_default() += count;
        }
        let tables = [
            (&mut self.scene_kinds, &other.scene_kinds),
            (&mut self.objects, &other.objects),
            (&mut self.viewpoints, &other.viewpoints),
            (&mut self.rejections, &other.rejections),
        ];
        for (into, from) in tables {
            for (name, count) in from {
                *into.entry(name.clone()).or_default() += count;
            }
        }
        self.gaps.merge(&other.gaps);
        self.center_offsets.merge(&other.center_offsets);
    }
}

fn count(table: &mut BTreeMap<String, u64>, name: &str) {
    match table.get_mut(name) {
        Some(n) => *n += 1,
        None => {
            table.insert(name.to_owned(), 1);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use proptest::prelude::*;
    use repose_dataset::Split;

    use super::*;
    use crate::generate::{GenerateSettings, scene_views};

    proptest! {
        #[test]
        fn every_length_is_in_the_bin_whose_borders_it_lies_between(length_m in 0.0..0.2f64) {
            let mut histogram = Histogram::default();
            histogram.add(length_m);
            prop_assert_eq!(histogram.total(), 1);
            match histogram.counts.iter().position(|n| *n == 1) {
                Some(bin) => {
                    let (low, high) = (histogram.edges_mm[bin], histogram.edges_mm[bin + 1]);
                    prop_assert!(low <= 1000.0 * length_m && 1000.0 * length_m < high);
                }
                None => prop_assert!(length_m >= 0.0999999),
            }
        }
    }

    #[test]
    fn borders_rise_and_thresholds_are_borders() {
        let histogram = Histogram::default();
        assert!(histogram.edges_mm.windows(2).all(|e| e[0] < e[1]));
        assert!([0.0, 1.0, 2.5, 3.0, 10.0, 50.0, 100.0].iter().all(|limit| histogram.edges_mm.contains(limit)));
        let mut empty = Histogram::default();
        empty.add(f64::NAN);
        empty.add(-0.001);
        assert_eq!(empty.total(), 0);
    }

    #[test]
    fn scenes_counted_apart_and_merged_are_scenes_counted_together() {
        let settings = GenerateSettings { views: 2, ..GenerateSettings::new(Path::new("unused"), Split::Validation, 4) };
        let first = Split::Validation.seeds().start;
        let scenes: Vec<_> = (first..first + 4).map(|seed| scene_views(seed, &settings).expect("a scene").0).collect();
        let counted = |scenes: &[Vec<ViewRecord>]| {
            let mut statistics = Statistics::default();
            for views in scenes {
                statistics.add_scene(views, ["moving"]);
            }
            statistics
        };
        let together = counted(&scenes);
        let mut merged = counted(&scenes[2..]);
        merged.merge(&counted(&scenes[..2]));
        assert_eq!(merged, together);
        assert_eq!((together.scenes, together.rejections["moving"]), (4, 4));
        let pairs: usize = scenes.iter().map(|views| views[0].objects.len() * (views[0].objects.len() - 1) / 2).sum();
        assert_eq!((together.gaps.total(), together.center_offsets.total()), (pairs as u64, pairs as u64));
        let percent = together.prevalence_percent();
        assert_eq!((percent[0], percent[2]), (percent[1], percent[3]), "left as often as right, front as often as behind");
        assert!(percent.iter().all(|p| (0.0..=100.0).contains(p)) && percent[6] > 0.0);
    }
}
