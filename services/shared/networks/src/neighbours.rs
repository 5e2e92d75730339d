//! Ragged neighbour lists: for each centroid the first k points in sampling order within a radius.
//!
//! Lists hold no padding. A repeated neighbour changes no maximum, it only costs time, and in training it multiplies gradients.

use crate::kernel::{Kernel, PointColumns};

/// One list of point indices per centroid, concatenated.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Neighbours {
    /// `[centroids + 1]`: where each list starts, and the end of the last.
    starts: Vec<u32>,
    indices: Vec<u32>,
}

impl Neighbours {
    /// No lists yet.
    pub fn new() -> Self {
        Self { starts: vec![0], indices: Vec::new() }
    }

    /// The first `most` of `points` (in the order given) within `radius_m` of each of the first `centroids` points.
    pub fn within(kernel: Kernel, points: &[[f32; 3]], centroids: usize, most: usize, radius_m: f32) -> Self {
        let columns = PointColumns::new(points);
        let mut lists = Self::new();
        for center in points.iter().take(centroids) {
            kernel.within(&columns, *center, radius_m, most, &mut lists.indices);
            lists.starts.push(lists.indices.len() as u32);
        }
        lists
    }

    /// One list with all of `points` points: the grouping of a global layer.
    pub fn all(points: usize) -> Self {
        Self { starts: vec![0, points as u32], indices: (0..points as u32).collect() }
    }

    /// Appends one list.
    pub fn push(&mut self, list: &[u32]) {
        self.indices.extend_from_slice(list);
        self.starts.push(self.indices.len() as u32);
    }

    /// Appends another's lists, its point indices raised by `first_point`.
    pub fn append(&mut self, other: &Self, first_point: usize) {
        let end = self.indices.len() as u32;
        self.starts.extend(other.starts[1..].iter().map(|s| s + end));
        self.indices.extend(other.indices.iter().map(|i| i + first_point as u32));
    }

    /// How many lists there are.
    pub fn centroids(&self) -> usize {
        self.starts.len() - 1
    }

    /// The list of centroid `i`.
    pub fn of(&self, i: usize) -> &[u32] {
        &self.indices[self.starts[i] as usize..self.starts[i + 1] as usize]
    }

    /// All lists, one after another.
    pub fn indices(&self) -> &[u32] {
        &self.indices
    }

    /// All lists one after another, each filled up to the length of the longest with its first point: `[centroids × most]`.
    ///
    /// # Errors
    /// When a list is empty.
    pub fn padded(&self) -> candle_core::Result<Vec<u32>> {
        let most = self.most();
        let mut padded = Vec::with_capacity(self.centroids() * most);
        for (i, list) in (0..self.centroids()).map(|i| (i, self.of(i))) {
            let Some(first) = list.first() else { candle_core::bail!("centroid {i} has no neighbours") };
            padded.extend_from_slice(list);
            padded.resize((i + 1) * most, *first);
        }
        Ok(padded)
    }

    /// The length of the longest list.
    pub fn most(&self) -> usize {
        self.starts.windows(2).map(|w| (w[1] - w[0]) as usize).max().unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn short_lists_are_filled_up_with_their_first_point_and_none_may_be_empty() {
        let mut lists = Neighbours::new();
        lists.push(&[3, 1, 2]);
        lists.push(&[5]);
        assert_eq!(lists.padded().unwrap(), [3, 1, 2, 5, 5, 5]);
        lists.push(&[]);
        assert!(lists.padded().unwrap_err().to_string().contains("centroid 2"));
    }

    proptest! {
        #[test]
        fn lists_hold_the_first_points_within_the_radius_for_every_kernel(
            points in prop::collection::vec(prop::array::uniform3(-0.2..0.2f32), 1..120), most in 1usize..20,
        ) {
            for kernel in Kernel::available() {
                let lists = Neighbours::within(kernel, &points, 10, most, 0.1);
                prop_assert_eq!(lists.centroids(), points.len().min(10));
                for i in 0..lists.centroids() {
                    let near = |p: &[f32; 3]| (0..3).map(|k| (p[k] - points[i][k]).powi(2)).sum::<f32>() <= 0.1f32 * 0.1;
                    let expected: Vec<u32> = (0..points.len() as u32).filter(|j| near(&points[*j as usize])).take(most).collect();
                    prop_assert_eq!(lists.of(i), &expected[..]);
                }
            }
        }
    }
}
