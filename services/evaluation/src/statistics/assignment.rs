//! The assignment problem: rows to columns with the greatest sum of weights, by the Hungarian method in O(rows² · columns).
//!
//! Jonker & Volgenant, "A shortest augmenting path algorithm for dense and sparse linear assignment problems" (Computing 38, 1987), in
//! the form with potentials: rows are added one after the other, each along the cheapest augmenting path.

/// For every row its column, such that the sum of `weight(row, column)` is greatest and no column is taken twice. There must be at least as
/// many columns as rows, and weights must be finite.
pub fn best_assignment(rows: usize, columns: usize, weight: impl Fn(usize, usize) -> f64) -> Vec<usize> {
    assert!(rows <= columns, "{rows} rows cannot have a column each of {columns}");
    // Row and column numbers start at 1 here: 0 is the row that is being added, and the column that no row has.
    let mut row_potential = vec![0.0; rows + 1];
    let mut column_potential = vec![0.0; columns + 1];
    let mut row_of = vec![0; columns + 1];
    for row in 1..=rows {
        row_of[0] = row;
        let mut least = vec![f64::INFINITY; columns + 1];
        let mut came_from = vec![0; columns + 1];
        let mut visited = vec![false; columns + 1];
        let mut column = 0;
        while row_of[column] != 0 {
            visited[column] = true;
            let at = row_of[column];
            let (mut step, mut next) = (f64::INFINITY, 0);
            for j in (1..=columns).filter(|j| !visited[*j]) {
                let reduced = -weight(at - 1, j - 1) - row_potential[at] - column_potential[j];
                if reduced < least[j] {
                    (least[j], came_from[j]) = (reduced, column);
                }
                if least[j] < step {
                    (step, next) = (least[j], j);
                }
            }
            for j in 0..=columns {
                if visited[j] {
                    row_potential[row_of[j]] += step;
                    column_potential[j] -= step;
                } else {
                    least[j] -= step;
                }
            }
            column = next;
        }
        while column != 0 {
            row_of[column] = row_of[came_from[column]];
            column = came_from[column];
        }
    }
    let mut column_of = vec![0; rows];
    for column in (1..=columns).filter(|column| row_of[*column] != 0) {
        column_of[row_of[column] - 1] = column - 1;
    }
    column_of
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn sum(weights: &[Vec<f64>], columns: &[usize]) -> f64 {
        columns.iter().enumerate().map(|(row, column)| weights[row][*column]).sum()
    }

    /// The greatest sum, by trying every assignment.
    fn greatest(weights: &[Vec<f64>], row: usize, taken: &mut Vec<bool>) -> f64 {
        if row == weights.len() {
            return 0.0;
        }
        let mut best = f64::NEG_INFINITY;
        for column in 0..taken.len() {
            if !taken[column] {
                taken[column] = true;
                best = best.max(weights[row][column] + greatest(weights, row + 1, taken));
                taken[column] = false;
            }
        }
        best
    }

    #[test]
    fn the_best_sum_goes_before_the_best_single_pair() {
        let weights = [[0.65, 0.56], [0.48, 0.0]];
        assert_eq!(best_assignment(2, 2, |row, column| weights[row][column]), [1, 0]);
        assert!(best_assignment(0, 3, |_, _| 0.0).is_empty());
    }

    proptest! {
        #[test]
        fn no_other_assignment_has_a_greater_sum(
            (rows, columns, drawn) in (1usize..5, 0usize..3).prop_flat_map(|(rows, more)| {
                (Just(rows), Just(rows + more), prop::collection::vec(0u8..20, rows * (rows + more)))
            })
        ) {
            let weights: Vec<Vec<f64>> = drawn.chunks(columns).map(|row| row.iter().map(|w| f64::from(*w) / 20.0).collect()).collect();
            let found = best_assignment(rows, columns, |row, column| weights[row][column]);
            let mut distinct = found.clone();
            distinct.sort_unstable();
            distinct.dedup();
            prop_assert_eq!(distinct.len(), rows);
            prop_assert!((sum(&weights, &found) - greatest(&weights, 0, &mut vec![false; columns])).abs() < 1e-9);
        }
    }
}
