//! The outline of the cells of a base that are carried.

use nalgebra::Point2;
use repose_geometry::Footprint;

/// Carried cells, in the order of the base's rows.
#[derive(Debug, Default)]
pub struct Contact {
    cells: Vec<Point2<f32>>,
    /// Where each row begins, and where its cells are on the base.
    rows: Vec<(usize, f32)>,
}

impl Contact {
    /// Adds a cell: the row of the base that it is in, told by the row's offset, and where it lands.
    #[inline]
    pub fn add(&mut self, row_m: f32, place: Point2<f32>) {
        if self.rows.last().is_none_or(|(_, last_m)| *last_m != row_m) {
            self.rows.push((self.cells.len(), row_m));
        }
        self.cells.push(place);
    }

    /// How many cells.
    pub fn cell_count(&self) -> usize {
        self.cells.len()
    }

    /// Their outline; none of a line.
    ///
    /// Between the first and the last row only the ends of rows can be corners, so that the hull is found among a few dozen cells: it is a
    /// large part of what trying a candidate takes.
    pub fn outline(&self) -> Option<Footprint> {
        let ends = self.rows.iter().skip(1).map(|(start, _)| *start).chain([self.cells.len()]);
        let rows = self.rows.iter().zip(ends).enumerate().map(|(i, ((start, _), end))| (i, &self.cells[*start..end]));
        let last = self.rows.len().saturating_sub(1);
        let corners = rows.flat_map(|(i, row)| match row {
            [first, .., end] if i > 0 && i < last => [std::slice::from_ref(first), std::slice::from_ref(end)],
            all => [all, &[]],
        });
        Footprint::of_places(corners.flatten().copied())
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;
    use repose_belief::offsets::Carry;

    use super::*;

    #[test]
    fn the_outline_is_that_of_all_cells() {
        let mut rng = Pcg64::seed_from_u64(11);
        for _ in 0..500 {
            let carry = Carry::new(Point2::new(rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0)), rng.random_range(-3.1..3.1));
            let (rows, share) = (rng.random_range(1..25), rng.random_range(0.02..1.0));
            let (mut contact, mut all) = (Contact::default(), Vec::new());
            for j in 0..rows {
                for i in 0..20 {
                    let offset = nalgebra::Vector2::new(i as f32, j as f32) * 0.005 - nalgebra::Vector2::new(0.031, 0.047);
                    if rng.random_range(0.0..1.0) < share {
                        let place = carry.place(&offset);
                        contact.add(offset.y, place);
                        all.push(place);
                    }
                }
            }
            assert_eq!(contact.cell_count(), all.len());
            assert_eq!(contact.outline(), Footprint::of_places(all));
        }
    }
}
