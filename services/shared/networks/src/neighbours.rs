//! Lists of neighbours of differing lengths, one per centroid.
//!
//! Lists hold no padding. A repeated neighbour changes no maximum, it only costs time, and in training it multiplies gradients.

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

    #[test]
    fn short_lists_are_filled_up_with_their_first_point_and_none_may_be_empty() {
        let mut lists = Neighbours::new();
        lists.push(&[3, 1, 2]);
        lists.push(&[5]);
        assert_eq!(lists.padded().unwrap(), [3, 1, 2, 5, 5, 5]);
        lists.push(&[]);
        assert!(lists.padded().unwrap_err().to_string().contains("centroid 2"));
    }
}
