//! Where something can stand on an object or lie in it, read off its surface from above.
//!
//! Procedural objects know their tops and openings; a mesh has to be looked at. Its heights on a grid show both: a top is a level
//! rectangle at its highest, an opening a level spot that higher ground encloses all around.

use nalgebra::Point3;
use repose_geometry::TriMesh;

use crate::objects::{Top, VesselInterior};

/// Edge length of a cell, metres.
const CELL_M: f32 = 0.002;
/// What counts as level, metres: scanned faces are wavy.
const LEVEL_M: f32 = 0.0025;
/// How far something small may stand out above a top, metres.
const BUMP_M: f32 = 0.003;
/// What counts as an opening's floor, metres above its lowest: floors are dished.
const DISHED_M: f32 = 0.004;
/// Least share of a top that bears what stands on it.
const BEARING_SHARE: f32 = 0.9;
/// Least half edge of a top, metres.
const LEAST_TOP_M: f32 = 0.01;
/// Least radius of an opening's floor and its least depth, metres.
const LEAST_OPENING_M: f32 = 0.012;

/// Heights of a surface seen from above.
pub struct Heights {
    columns: usize,
    rows: usize,
    low: [f32; 2],
    /// Row-major; −∞ where there is nothing.
    cells: Vec<f32>,
}

impl Heights {
    /// The heights of a mesh (metres, z up).
    pub fn of(mesh: &TriMesh) -> Self {
        let Some(bounds) = mesh.aabb() else { return Self { columns: 0, rows: 0, low: [0.0; 2], cells: Vec::new() } };
        let cells = |k: usize| ((bounds.max[k] - bounds.min[k]) / CELL_M).ceil().max(1.0) as usize;
        let (columns, rows) = (cells(0), cells(1));
        let mut heights = Self { columns, rows, low: [bounds.min.x, bounds.min.y], cells: vec![f32::NEG_INFINITY; columns * rows] };
        for i in 0..mesh.triangles.len() {
            heights.draw(&mesh.corners(i));
        }
        heights
    }

    /// A level rectangle around the middle of what is highest and large enough to stand on; `None` when there is none.
    pub fn top(&self) -> Option<Top> {
        let mut sorted: Vec<f32> = self.cells.iter().copied().filter(|h| h.is_finite()).collect();
        sorted.sort_by(|a, b| b.total_cmp(a));
        // The highest level that has enough cells: a bump or a seam is not it.
        let enough = (2.0 * LEAST_TOP_M / CELL_M).powi(2) as usize;
        let window = sorted.windows(enough).find(|w| w[0] - w[enough - 1] <= LEVEL_M)?;
        let (middle, height_m) = (window[enough / 2], window[0]);
        if sorted[0] - height_m > BUMP_M {
            return None;
        }
        let level = |c: usize, r: usize| (self.cells[r * self.columns + c] - middle).abs() <= LEVEL_M;
        let (column, row) = self.middle(level)?;
        // Grooves and holes do not keep anything from standing; bumps do.
        let fits = |half_x: usize, half_y: usize| {
            if column < half_x || row < half_y || column + half_x >= self.columns || row + half_y >= self.rows {
                return false;
            }
            let (mut bearing, mut all) = (0, 0);
            for r in row - half_y..=row + half_y {
                for c in column - half_x..=column + half_x {
                    all += 1;
                    bearing += usize::from(level(c, r));
                    if self.cells[r * self.columns + c] > middle + LEVEL_M {
                        return false;
                    }
                }
            }
            bearing as f32 >= BEARING_SHARE * all as f32
        };
        // Grown in turns, so that a long face gives a long rectangle.
        let least = (LEAST_TOP_M / CELL_M).round() as usize;
        if !fits(least, least) {
            return None;
        }
        let mut half = [least; 2];
        loop {
            let (wider, deeper) = (fits(half[0] + 1, half[1]), fits(half[0], half[1] + 1));
            match (wider, deeper) {
                (true, _) if half[0] <= half[1] || !deeper => half[0] += 1,
                (_, true) => half[1] += 1,
                _ => break,
            }
        }
        let half_extents_m = half.map(|cells| cells as f32 * CELL_M);
        Some(Top { center_m: self.at(column, row), height_m, half_extents_m })
    }

    /// The level floor that a wall encloses; `None` when there is no such thing.
    pub fn opening(&self) -> Option<VesselInterior> {
        let inside = self.enclosed()?;
        let floor = inside.iter().map(|&i| self.cells[i]).fold(f32::MAX, f32::min);
        let is_floor = {
            let mut floor_cells = vec![false; self.cells.len()];
            for &i in &inside {
                floor_cells[i] = self.cells[i] <= floor + DISHED_M;
            }
            move |c: usize, r: usize| floor_cells[r * self.columns + c]
        };
        let (column, row) = self.middle(&is_floor)?;
        let radius_m = self.clear_radius_m(column, row, &is_floor);
        let mouth = {
            let mut cells = vec![false; self.cells.len()];
            for &i in &inside {
                cells[i] = true;
            }
            self.clear_radius_m(column, row, |c, r| cells[r * self.columns + c])
        };
        let rim_m = self.rim_m(column, row, mouth);
        let half = radius_m * std::f32::consts::FRAC_1_SQRT_2;
        (radius_m >= LEAST_OPENING_M && rim_m - floor >= LEAST_OPENING_M).then(|| VesselInterior {
            center_m: self.at(column, row),
            // The highest of what counts as level: nothing is to be put into the floor.
            floor_m: self.highest_within(column, row, radius_m),
            rim_m,
            radius_m,
            mouth_radius_m: mouth.max(radius_m),
            half_extents_m: [half, half],
        })
    }

    /// Cells that cannot be reached from outside without climbing to within [`LEAST_OPENING_M`] of the rim, the lowest rim all around.
    fn enclosed(&self) -> Option<Vec<usize>> {
        // Priority flood from the border (Barnes, Lehman & Mulla 2014): the level to which water would stand in each cell.
        let mut level = vec![f32::INFINITY; self.cells.len()];
        let mut queue = std::collections::BinaryHeap::new();
        let key = |height: f32, index: usize| (std::cmp::Reverse(ordered(height)), std::cmp::Reverse(index));
        for r in 0..self.rows {
            for c in 0..self.columns {
                let i = r * self.columns + c;
                let border = r == 0 || c == 0 || r + 1 == self.rows || c + 1 == self.columns;
                if border || self.cells[i] == f32::NEG_INFINITY {
                    level[i] = self.cells[i];
                    queue.push(key(level[i], i));
                }
            }
        }
        while let Some((_, std::cmp::Reverse(i))) = queue.pop() {
            let (c, r) = (i % self.columns, i / self.columns);
            let neighbours = [(c.wrapping_sub(1), r), (c + 1, r), (c, r.wrapping_sub(1)), (c, r + 1)];
            for (c, r) in neighbours.into_iter().filter(|&(c, r)| c < self.columns && r < self.rows) {
                let j = r * self.columns + c;
                if level[j] == f32::INFINITY {
                    level[j] = level[i].max(self.cells[j]);
                    queue.push(key(level[j], j));
                }
            }
        }
        let deep: Vec<usize> = (0..self.cells.len()).filter(|&i| level[i] - self.cells[i] >= LEAST_OPENING_M).collect();
        (!deep.is_empty()).then_some(deep)
    }

    /// The lowest height that encloses the mouth: the highest on each of many rays outwards, the least of them.
    fn rim_m(&self, column: usize, row: usize, mouth_m: f32) -> f32 {
        (0..32)
            .map(|k| {
                let turn = std::f32::consts::TAU * k as f32 / 32.0;
                let mut highest = f32::NEG_INFINITY;
                let mut out = mouth_m;
                loop {
                    let (c, r) = (column as f32 + out / CELL_M * turn.cos(), row as f32 + out / CELL_M * turn.sin());
                    if c < 0.0 || r < 0.0 || c as usize >= self.columns || r as usize >= self.rows {
                        break highest;
                    }
                    highest = highest.max(self.cells[r as usize * self.columns + c as usize]);
                    out += CELL_M / 2.0;
                }
            })
            .fold(f32::INFINITY, f32::min)
    }

    fn clear_radius_m(&self, column: usize, row: usize, clear: impl Fn(usize, usize) -> bool) -> f32 {
        let mut nearest = f32::MAX;
        for r in 0..self.rows {
            for c in 0..self.columns {
                if !clear(c, r) {
                    let (dc, dr) = (c as f32 - column as f32, r as f32 - row as f32);
                    nearest = nearest.min((dc * dc + dr * dr).sqrt());
                }
            }
        }
        ((nearest - 1.0) * CELL_M).max(0.0)
    }

    fn highest_within(&self, column: usize, row: usize, radius_m: f32) -> f32 {
        let reach = radius_m / CELL_M;
        (0..self.cells.len())
            .filter(|i| {
                let (dc, dr) = ((i % self.columns) as f32 - column as f32, (i / self.columns) as f32 - row as f32);
                dc * dc + dr * dr <= reach * reach
            })
            .map(|i| self.cells[i])
            .fold(f32::NEG_INFINITY, f32::max)
    }

    /// The cell at the middle of those that are `wanted`.
    fn middle(&self, wanted: impl Fn(usize, usize) -> bool) -> Option<(usize, usize)> {
        let (mut columns, mut rows, mut count) = (0, 0, 0);
        for r in 0..self.rows {
            for c in 0..self.columns {
                if wanted(c, r) {
                    (columns, rows, count) = (columns + c, rows + r, count + 1);
                }
            }
        }
        (count > 0).then(|| (columns / count, rows / count))
    }

    fn at(&self, column: usize, row: usize) -> [f32; 2] {
        [self.low[0] + (column as f32 + 0.5) * CELL_M, self.low[1] + (row as f32 + 0.5) * CELL_M]
    }

    /// Raises the cells whose middles a triangle covers.
    fn draw(&mut self, corners: &[Point3<f32>; 3]) {
        // In double precision: thinned meshes have slivers, between which single precision leaves gaps.
        let [a, b, c] = corners.map(|p| p.cast::<f64>());
        let (cell, grid_low) = (f64::from(CELL_M), self.low.map(f64::from));
        let area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
        if area == 0.0 {
            return;
        }
        let span = |k: usize, count: usize| {
            let low = a[k].min(b[k]).min(c[k]) - grid_low[k];
            let high = a[k].max(b[k]).max(c[k]) - grid_low[k];
            ((low / cell - 0.5).ceil().max(0.0) as usize, ((high / cell - 0.5).floor() + 1.0).clamp(0.0, count as f64) as usize)
        };
        let ((c0, c1), (r0, r1)) = (span(0, self.columns), span(1, self.rows));
        for row in r0..r1 {
            for column in c0..c1 {
                let (x, y) = (grid_low[0] + (column as f64 + 0.5) * cell, grid_low[1] + (row as f64 + 0.5) * cell);
                let weight = |p: &Point3<f64>, q: &Point3<f64>| ((q.x - p.x) * (y - p.y) - (q.y - p.y) * (x - p.x)) / area;
                let weights = [weight(&b, &c), weight(&c, &a), weight(&a, &b)];
                if weights.iter().all(|w| *w >= -1e-9) {
                    let height = &mut self.cells[row * self.columns + column];
                    *height = height.max((weights[0] * a.z + weights[1] * b.z + weights[2] * c.z) as f32);
                }
            }
        }
    }
}

/// A float as an integer of the same order.
fn ordered(value: f32) -> i32 {
    let bits = value.to_bits() as i32;
    if bits < 0 { i32::MIN - bits - 1 } else { bits }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    use super::*;
    use crate::objects::Family;

    #[test]
    fn a_mesh_shows_the_tops_and_openings_that_families_know() {
        let mut rng = Pcg64::seed_from_u64(1);
        for family in [Family::Box, Family::Can, Family::Mug, Family::Pot, Family::Bowl, Family::Tray] {
            let (mut tops, mut openings) = (0, 0);
            for _ in 0..12 {
                let shape = family.sample(1.0, &mut rng);
                let heights = Heights::of(&shape.mesh);
                let (top, opening) = (heights.top(), heights.opening());
                if let (Some(known), Some(seen)) = (shape.top, top) {
                    tops += 1;
                    assert!((known.height_m - seen.height_m).abs() < 0.001, "{}: {known:?} {seen:?}", shape.name);
                }
                if let (Some(known), Some(seen)) = (shape.opening, opening) {
                    openings += 1;
                    assert!((known.floor_m - seen.floor_m).abs() < 0.0045, "{}: {known:?} {seen:?}", shape.name);
                    assert!((known.rim_m - seen.rim_m).abs() < 0.004, "{}: {known:?} {seen:?}", shape.name);
                    assert!(seen.radius_m < known.mouth_radius_m + 0.002, "{}: {known:?} {seen:?}", shape.name);
                }
                assert!(shape.opening.is_some() || opening.is_none(), "{} holds nothing: {opening:?}", shape.name);
            }
            match family {
                Family::Box | Family::Can => assert!(tops >= 8, "{family:?}: {tops}"),
                _ => assert!(openings >= 7, "{family:?}: {openings}"),
            }
        }
    }
}
