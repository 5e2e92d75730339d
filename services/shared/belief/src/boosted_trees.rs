//! Boosted decision trees as they are served: the sum of the leaves that a row of numbers falls into.

use serde::{Deserialize, Serialize};

/// Where a split sends a row: on to another split of its tree, or to a leaf.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Branch {
    /// The split of this index.
    #[serde(rename = "s")]
    Split(u16),
    /// The leaf of this index.
    #[serde(rename = "l")]
    Leaf(u16),
}

/// A split: the number of the row that it reads, the value below which a row takes the first branch, and the two branches.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TreeSplit(pub u8, pub f32, pub [Branch; 2]);

/// The probability of these log-odds.
pub fn probability_of(log_odds: f64) -> f64 {
    1.0 / (1.0 + (-log_odds).exp())
}

/// One tree. The first split is its root; a tree without splits is its first leaf.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DecisionTree {
    /// The splits; each sends rows to later ones.
    pub splits: Vec<TreeSplit>,
    /// The leaves' values.
    pub leaves: Vec<f32>,
}

impl DecisionTree {
    /// Its value for a row.
    fn of(&self, row: &[f32]) -> f32 {
        let mut at = if self.splits.is_empty() { Branch::Leaf(0) } else { Branch::Split(0) };
        loop {
            match at {
                Branch::Leaf(leaf) => return self.leaves[usize::from(leaf)],
                Branch::Split(split) => {
                    let TreeSplit(number, below, branches) = &self.splits[usize::from(split)];
                    at = branches[usize::from(row[usize::from(*number)] >= *below)];
                }
            }
        }
    }

    /// Its largest value for the rows that agree with a row in all numbers but those that are open.
    fn most(&self, row: &[f32], is_open: &impl Fn(usize) -> bool) -> f32 {
        let root = if self.splits.is_empty() { Branch::Leaf(0) } else { Branch::Split(0) };
        self.most_from(root, row, is_open)
    }

    fn most_from(&self, at: Branch, row: &[f32], is_open: &impl Fn(usize) -> bool) -> f32 {
        match at {
            Branch::Leaf(leaf) => self.leaves[usize::from(leaf)],
            Branch::Split(split) => {
                let TreeSplit(number, below, branches) = &self.splits[usize::from(split)];
                let number = usize::from(*number);
                if is_open(number) {
                    return branches.iter().map(|to| self.most_from(*to, row, is_open)).fold(f32::NEG_INFINITY, f32::max);
                }
                self.most_from(branches[usize::from(row[number] >= *below)], row, is_open)
            }
        }
    }

    /// Whether every row of `numbers` numbers ends at a leaf with a finite value.
    fn is_sound(&self, numbers: usize) -> bool {
        let branch = |from: usize, to: &Branch| match to {
            Branch::Split(to) => usize::from(*to) > from && usize::from(*to) < self.splits.len(),
            Branch::Leaf(leaf) => usize::from(*leaf) < self.leaves.len(),
        };
        let split = |(i, TreeSplit(number, below, branches)): (usize, &TreeSplit)| {
            usize::from(*number) < numbers && below.is_finite() && branches.iter().all(|to| branch(i, to))
        };
        !self.leaves.is_empty() && self.leaves.iter().all(|l| l.is_finite()) && self.splits.iter().enumerate().all(split)
    }
}

/// Trees for lengths say the logarithm of the length and this, metres.
const OFFSET_M: f64 = 0.004;

/// What trees for lengths are fitted on, of a length in metres; what is shorter than nothing is nothing.
pub fn log_of_length(length_m: f32) -> f64 {
    (f64::from(length_m.max(0.0)) + OFFSET_M).ln()
}

/// The trees, and the value that they add to.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BoostedTrees {
    /// The value without any tree.
    pub bias: f64,
    /// The trees.
    pub trees: Vec<DecisionTree>,
}

impl BoostedTrees {
    /// The sum for a row of finite numbers.
    pub fn of(&self, row: &[f32]) -> f64 {
        self.trees.iter().fold(self.bias, |sum, tree| sum + f64::from(tree.of(row)))
    }

    /// The probability whose log-odds the sum for a row is.
    pub fn probability(&self, row: &[f32]) -> f64 {
        probability_of(self.of(row))
    }

    /// The length (metres) whose [`log_of_length`] the sum for a row is.
    pub fn length_m(&self, row: &[f32]) -> f32 {
        (self.of(row).exp() - OFFSET_M).max(0.0) as f32
    }

    /// No row that agrees with a row of finite numbers in all but those that are open has a larger sum.
    pub fn most(&self, row: &[f32], is_open: impl Fn(usize) -> bool) -> f64 {
        self.trees.iter().fold(self.bias, |sum, tree| sum + f64::from(tree.most(row, &is_open)))
    }

    /// Whether the sum is finite for every row of `numbers` numbers.
    pub fn is_sound(&self, numbers: usize) -> bool {
        self.bias.is_finite() && self.trees.iter().all(|t| t.is_sound(numbers))
    }

    /// Checks that these, a file's `field`, read this program's measures, with which the file's own are compared by name.
    pub(crate) fn check_reads(&self, field: &str, measures: &[String], expected: &[&str]) -> Result<(), UnreadableTrees> {
        if measures != expected {
            return Err(UnreadableTrees(format!("measures: expected {expected:?}, got {measures:?}")));
        }
        match self.is_sound(expected.len()) {
            true => Ok(()),
            false => {
                let message = "expected finite trees over the measures, each branch to a later split or a leaf";
                Err(UnreadableTrees(format!("{field}: {message}")))
            }
        }
    }
}

/// Why a file's trees are not read: it is of another form, its trees read other measures, or they are broken.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UnreadableTrees(String);

impl std::fmt::Display for UnreadableTrees {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for UnreadableTrees {}

impl From<serde_json::Error> for UnreadableTrees {
    fn from(error: serde_json::Error) -> Self {
        Self(error.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// −1 below 0.5 of the first number, from there on 2 below 3 of the second and 4 above.
    fn steps() -> DecisionTree {
        DecisionTree {
            splits: vec![TreeSplit(0, 0.5, [Branch::Leaf(0), Branch::Split(1)]), TreeSplit(1, 3.0, [Branch::Leaf(1), Branch::Leaf(2)])],
            leaves: vec![-1.0, 2.0, 4.0],
        }
    }

    #[test]
    fn a_row_falls_to_its_leaf_and_leaves_add_up() {
        let all = BoostedTrees { bias: 0.5, trees: vec![steps(), DecisionTree { splits: Vec::new(), leaves: vec![10.0] }] };
        let said = [[0.4, 9.0], [0.5, 2.9], [0.5, 3.0]].map(|row| all.of(&row));
        assert_eq!(said, [9.5, 12.5, 14.5]);
        let text = serde_json::to_string(&all).unwrap();
        assert_eq!(serde_json::from_str::<BoostedTrees>(&text).unwrap(), all);
    }

    #[test]
    fn the_most_is_over_all_that_open_numbers_may_be() {
        let all = BoostedTrees { bias: 0.5, trees: vec![steps(), DecisionTree { splits: Vec::new(), leaves: vec![10.0] }] };
        assert_eq!(all.most(&[0.4, 9.0], |_| false), all.of(&[0.4, 9.0]));
        assert_eq!(all.most(&[0.4, 2.0], |number| number == 0), 12.5);
        assert_eq!(all.most(&[0.4, 9.0], |number| number == 1), 9.5);
        assert_eq!(all.most(&[0.4, 2.0], |_| true), 14.5);
    }

    #[test]
    fn trees_that_lead_nowhere_are_not_sound() {
        let with = |change: fn(&mut DecisionTree)| {
            let mut tree = steps();
            change(&mut tree);
            BoostedTrees { bias: 0.0, trees: vec![tree] }.is_sound(2)
        };
        assert!(with(|_| ()));
        assert!(!with(|t| t.splits[1].2[0] = Branch::Split(0)), "a circle");
        assert!(!with(|t| t.splits[1].2[0] = Branch::Leaf(3)), "no such leaf");
        assert!(!with(|t| t.splits[0].0 = 2), "no such number");
        assert!(!with(|t| t.splits[0].1 = f32::NAN), "no number");
        assert!(!with(|t| t.leaves.clear()), "no leaf");
    }
}
