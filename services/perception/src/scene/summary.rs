//! What a scene says about each of its objects.

use repose_geometry::Image;
use repose_proto::ObjectSummary;

/// A neighbour this much nearer to the camera covers the object rather than ending beside it, metres.
const COVER_STEP_M: f32 = 0.015;

/// Readings with which an object that is told from everything else is half sure to be one.
const HALF_SURE_READINGS: f64 = 150.0;

/// Summaries of the objects that have points, by id. `points` are in the world, `labels` beside them.
pub fn summarise(points: &[[f32; 3]], labels: &[u16], completeness: &Completeness) -> Vec<ObjectSummary> {
    let most = labels.iter().copied().max().unwrap_or(0);
    let mut by_id = vec![Gathered::default(); usize::from(most) + 1];
    for (p, id) in points.iter().zip(labels).filter(|(_, id)| **id != 0) {
        by_id[usize::from(*id)].take(p);
    }
    let named = (0..=most).zip(by_id).filter(|(_, gathered)| gathered.points > 0);
    named.map(|(id, gathered)| gathered.summary(id, completeness.of(id))).collect()
}

/// What is gathered of one object's points.
#[derive(Debug, Clone, Copy)]
struct Gathered {
    points: usize,
    sum_m: [f64; 3],
    low_m: [f32; 3],
    high_m: [f32; 3],
}

impl Default for Gathered {
    fn default() -> Self {
        Self { points: 0, sum_m: [0.0; 3], low_m: [f32::INFINITY; 3], high_m: [f32::NEG_INFINITY; 3] }
    }
}

impl Gathered {
    fn take(&mut self, p: &[f32; 3]) {
        self.points += 1;
        for (k, coordinate) in p.iter().enumerate() {
            self.sum_m[k] += f64::from(*coordinate);
            self.low_m[k] = self.low_m[k].min(*coordinate);
            self.high_m[k] = self.high_m[k].max(*coordinate);
        }
    }

    fn summary(&self, id: u16, completeness: f64) -> ObjectSummary {
        let centroid_m = self.sum_m.map(|sum| sum / self.points as f64);
        let extent_m = std::array::from_fn(|k| f64::from(self.high_m[k] - self.low_m[k]));
        ObjectSummary { id, points: self.points, centroid_m, extent_m, completeness, score: None }
    }
}

/// Per object, how much of what this view could show of it was observed.
///
/// A mask's outline ends either at something farther away (all of that side was seen), at something nearer (it goes on behind it), or
/// at the picture's edge. The share of the outline that ends freely, times the share of the mask with a reading, is the estimate.
#[derive(Debug, Clone)]
pub struct Completeness {
    /// Indexed by id.
    tallies: Vec<Tally>,
}

#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    pixels: u32,
    readings: u32,
    outline: u32,
    cut: u32,
    /// Part of the outline where another object's reading is beside it without a jump in depth, or the picture ends.
    unsure: u32,
}

impl Completeness {
    /// Measured on masks before their borders are removed. `depth_m` and `covers_m` hold NaN where there is no reading; `covers_m` still has those of
    /// robots, which cover what is behind them.
    pub fn measure(depth_m: &Image<f32>, covers_m: &Image<f32>, labels: &Image<u16>) -> Self {
        let most = labels.pixels().iter().copied().max().unwrap_or(0);
        let mut tallies = vec![Tally::default(); usize::from(most) + 1];
        let (width, height) = (labels.width(), labels.height());
        let (depths, covers, ids) = (depth_m.pixels(), covers_m.pixels(), labels.pixels());
        for (i, &id) in ids.iter().enumerate() {
            if id == 0 {
                continue;
            }
            let tally = &mut tallies[usize::from(id)];
            let (u, v) = (i % width, i / width);
            tally.pixels += 1;
            tally.readings += u32::from(!depths[i].is_nan());
            let beside = [
                (u > 0).then(|| i.wrapping_sub(1)),
                (u + 1 < width).then_some(i + 1),
                (v > 0).then(|| i.wrapping_sub(width)),
                (v + 1 < height).then_some(i + width),
            ];
            for side in beside {
                match side {
                    None => {
                        tally.outline += 1;
                        tally.cut += 1;
                        tally.unsure += 1;
                    }
                    Some(j) if ids[j] != id => {
                        tally.outline += 1;
                        // With either reading missing this is false: an edge in the sensor's shadow counts as seen.
                        tally.cut += u32::from(covers[j] + COVER_STEP_M < depths[i]);
                        tally.unsure += u32::from(ids[j] != 0 && (depths[j] - depths[i]).abs() < COVER_STEP_M);
                    }
                    Some(_) => {}
                }
            }
        }
        Self { tallies }
    }

    /// The estimate for one object, 0 to 1.
    pub fn of(&self, id: u16) -> f64 {
        let Some(tally) = self.tallies.get(usize::from(id)).filter(|t| t.pixels > 0) else { return 0.0 };
        let free = 1.0 - f64::from(tally.cut) / f64::from(tally.outline.max(1));
        free * f64::from(tally.readings) / f64::from(tally.pixels)
    }

    /// How sure it is that a found mask is one whole object, 0 to 1: the share of its outline that a jump in depth or the support tells,
    /// times how many readings it has beside [`HALF_SURE_READINGS`]. Not calibrated: it ranks.
    pub fn score_of(&self, id: u16) -> f64 {
        let Some(tally) = self.tallies.get(usize::from(id)).filter(|t| t.pixels > 0) else { return 0.0 };
        let told = 1.0 - f64::from(tally.unsure) / f64::from(tally.outline.max(1));
        let readings = f64::from(tally.readings);
        told * readings / (readings + HALF_SURE_READINGS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A 20 x 20 picture of a background at 2 m with `masks` (id, depth, columns, rows) in front of it, later ones over earlier ones.
    fn measured(masks: &[(u16, f32, std::ops::Range<usize>, std::ops::Range<usize>)]) -> Completeness {
        let mut depth_m = Image::filled(20, 20, 2.0);
        let mut labels = Image::filled(20, 20, 0);
        for (id, depth, columns, rows) in masks.iter().cloned() {
            for v in rows {
                for u in columns.clone() {
                    depth_m[(u, v)] = depth;
                    labels[(u, v)] = id;
                }
            }
        }
        depth_m[(7, 7)] = f32::NAN;
        Completeness::measure(&depth_m, &depth_m, &labels)
    }

    #[test]
    fn an_object_in_the_open_is_complete() {
        assert_eq!(measured(&[(3, 1.0, 8..14, 8..14)]).of(3), 1.0);
        assert_eq!(measured(&[(3, 1.0, 8..14, 8..14)]).of(4), 0.0);
    }

    #[test]
    fn what_covers_it_the_pictures_edge_and_holes_take_from_it() {
        let covered = measured(&[(1, 1.0, 8..14, 8..14), (2, 0.8, 8..14, 12..18)]);
        assert!((covered.of(1) - (1.0 - 6.0 / 20.0)).abs() < 1e-9 && covered.of(2) == 1.0);
        assert!((measured(&[(1, 1.0, 0..5, 8..13)]).of(1) - 0.75).abs() < 1e-9);
        assert!((measured(&[(1, 1.0, 6..8, 6..8)]).of(1) - 0.75).abs() < 1e-9);
    }

    #[test]
    fn an_arm_that_was_taken_out_of_the_picture_covers_what_is_behind_it() {
        let of = |arm_m: f32| {
            let (mut depth_m, mut labels) = (Image::filled(20, 20, 2.0), Image::filled(20, 20, 0));
            for (u, v) in (8..14).flat_map(|v| (8..14).map(move |u| (u, v))) {
                (depth_m[(u, v)], labels[(u, v)]) = (1.0, 4);
            }
            let mut covers_m = depth_m.clone();
            for (u, v) in (12..15).flat_map(|v| (0..20).map(move |u| (u, v))) {
                (depth_m[(u, v)], covers_m[(u, v)], labels[(u, v)]) = (f32::NAN, arm_m, 0);
            }
            Completeness::measure(&depth_m, &covers_m, &labels).of(4)
        };
        assert!((of(0.7) - (1.0 - 6.0 / 20.0)).abs() < 1e-9, "before it: {}", of(0.7));
        assert_eq!(of(1.3), 1.0, "behind it");
    }

    #[test]
    fn a_summary_is_of_the_points_given() {
        let points = [[0.0, 0.0, 0.0], [1.0, 2.0, 3.0], [9.0, 9.0, 9.0]];
        let objects = summarise(&points, &[4, 4, 0], &measured(&[(4, 1.0, 8..14, 8..14)]));
        let expected =
            ObjectSummary { id: 4, points: 2, centroid_m: [0.5, 1.0, 1.5], extent_m: [1.0, 2.0, 3.0], completeness: 1.0, score: None };
        assert_eq!(objects, [expected]);
    }
}
