//! Places of an object as offsets, and which cells of the map they fall on where a candidate puts the object.
//!
//! A search looks at thousands of places for every candidate, so they lie in blocks that are carried a vector at a time. The arithmetic is plain:
//! every instruction set gives the same places and cells, to the bit.

use nalgebra::{Point2, Rotation2, Vector2};
use repose_simd::{Lanes, Work};

/// Places carried at once.
pub(crate) const BLOCK: usize = 32;

/// Horizontal offsets from the point about which an object turns, metres.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Offsets {
    /// x and y of so many offsets; the last block is filled up with zeros.
    blocks: Vec<[[f32; BLOCK]; 2]>,
    count: usize,
}

impl FromIterator<Vector2<f32>> for Offsets {
    fn from_iter<I: IntoIterator<Item = Vector2<f32>>>(offsets: I) -> Self {
        let mut all = Self::default();
        for offset in offsets {
            let place = all.count % BLOCK;
            if place == 0 {
                all.blocks.push([[0.0; BLOCK]; 2]);
            }
            if let Some([x, y]) = all.blocks.last_mut() {
                (x[place], y[place]) = (offset.x, offset.y);
            }
            all.count += 1;
        }
        all
    }
}

impl Offsets {
    /// How many there are.
    pub fn len(&self) -> usize {
        self.count
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The y of one of them, metres.
    #[inline]
    pub fn y_m(&self, number: usize) -> f32 {
        self.blocks[number / BLOCK][1][number % BLOCK]
    }

    /// All of them, in order.
    pub fn iter(&self) -> impl Iterator<Item = Vector2<f32>> + '_ {
        let all = self.blocks.iter().flat_map(|[x, y]| x.iter().zip(y));
        all.map(|(x, y)| Vector2::new(*x, *y)).take(self.count)
    }

    /// Blocks, each with how many offsets it has.
    pub(crate) fn blocks(&self) -> impl Iterator<Item = (&[[f32; BLOCK]; 2], usize)> {
        self.blocks.iter().enumerate().map(|(b, block)| (block, (self.count - b * BLOCK).min(BLOCK)))
    }
}

/// How offsets are carried into the world, seen from above: turned, then shifted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Carry {
    /// Where the point about which the object turns goes.
    pub at: Point2<f32>,
    /// Cosine and sine of the turn.
    turn: [f32; 2],
}

impl Carry {
    /// To a place, turned counter-clockwise.
    pub fn new(at: Point2<f32>, yaw_rad: f32) -> Self {
        let turn = Rotation2::new(yaw_rad);
        Self { at, turn: [turn.matrix()[(0, 0)], turn.matrix()[(1, 0)]] }
    }

    /// Where one offset goes.
    #[inline(always)]
    pub fn place(&self, offset: &Vector2<f32>) -> Point2<f32> {
        let [cos, sin] = self.turn;
        Point2::new(self.at.x + (cos * offset.x - sin * offset.y), self.at.y + (sin * offset.x + cos * offset.y))
    }
}

/// The grid of a map: where it begins, the edge of a cell, and how many cells there are along x and y.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Grid {
    pub origin: Point2<f32>,
    pub cell_m: f32,
    pub cells: [usize; 2],
}

impl Grid {
    /// How many cells there are, which is the number of the cell of all that is off the map.
    #[inline(always)]
    pub fn count(&self) -> usize {
        self.cells[0] * self.cells[1]
    }

    /// The cell of a place.
    #[inline(always)]
    pub fn cell_of(&self, x: f32, y: f32) -> Option<usize> {
        let (u, v) = ((x - self.origin.x) / self.cell_m, (y - self.origin.y) / self.cell_m);
        let [columns, rows] = self.cells;
        (u >= 0.0 && v >= 0.0 && u < columns as f32 && v < rows as f32).then(|| v as usize * columns + u as usize)
    }
}

/// Carries a block of offsets and finds their cells.
pub(crate) struct Landing<'a> {
    pub block: &'a [[f32; BLOCK]; 2],
    pub carry: &'a Carry,
    pub grid: &'a Grid,
}

/// Where a block of offsets lands: x, y, and the cells, [`Grid::count`] off the map.
pub(crate) struct Landed {
    pub x: [f32; BLOCK],
    pub y: [f32; BLOCK],
    pub cells: [u32; BLOCK],
}

impl Work for Landing<'_> {
    type Output = Landed;

    // A plain loop without branches, which the compiler turns into the caller's vectors.
    #[inline(always)]
    unsafe fn run<L: Lanes>(self) -> Landed {
        let Self { block: [x, y], carry, grid } = self;
        let [columns, rows] = grid.cells;
        let (width, depth, outside) = (columns as f32, rows as f32, grid.count() as u32);
        let mut landed = Landed { x: [0.0; BLOCK], y: [0.0; BLOCK], cells: [0; BLOCK] };
        for i in 0..BLOCK {
            let place = carry.place(&Vector2::new(x[i], y[i]));
            let (u, v) = ((place.x - grid.origin.x) / grid.cell_m, (place.y - grid.origin.y) / grid.cell_m);
            let is_on = (u >= 0.0) & (v >= 0.0) & (u < width) & (v < depth);
            // SAFETY: zero, or below the number of columns or rows of a map that fits memory.
            let (column, row): (i32, i32) =
                unsafe { ((if is_on { u } else { 0.0 }).to_int_unchecked(), (if is_on { v } else { 0.0 }).to_int_unchecked()) };
            let cell = (row as u32).wrapping_mul(columns as u32).wrapping_add(column as u32);
            (landed.x[i], landed.y[i]) = (place.x, place.y);
            landed.cells[i] = if is_on { cell } else { outside };
        }
        landed
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;
    use repose_simd::InstructionSet;

    use super::*;

    #[test]
    fn every_instruction_set_lands_offsets_as_one_by_one() {
        let mut rng = Pcg64::seed_from_u64(3);
        let offsets: Vec<Vector2<f32>> = (0..77).map(|_| Vector2::new(rng.random_range(-0.2..0.2), rng.random_range(-0.2..0.2))).collect();
        let blocks: Offsets = offsets.iter().copied().collect();
        assert_eq!(blocks.len(), 77);
        assert!(blocks.iter().eq(offsets.iter().copied()));
        let grid = Grid { origin: Point2::new(-0.1, 0.03), cell_m: 0.005, cells: [61, 17] };
        for yaw_rad in [0.0, 0.7, -2.9] {
            let carry = Carry::new(Point2::new(0.08, 0.05), yaw_rad);
            let turn = Rotation2::new(yaw_rad);
            for set in InstructionSet::available() {
                let mut all = offsets.iter();
                for (block, count) in blocks.blocks() {
                    let landed = set.run(Landing { block, carry: &carry, grid: &grid });
                    for i in 0..count {
                        let place = carry.at + turn * all.next().unwrap();
                        assert_eq!([landed.x[i], landed.y[i]], [place.x, place.y], "{set:?}");
                        assert_eq!(landed.cells[i] as usize, grid.cell_of(place.x, place.y).unwrap_or(grid.count()), "{set:?}");
                    }
                }
                assert!(all.next().is_none());
            }
        }
    }
}
