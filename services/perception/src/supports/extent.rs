//! Where in the plan a level reaches, looked up for a picture of points: margins on a grid instead of a walk along the outline for each.

use repose_geometry::{Footprint, Point2, Point3};

/// Most cells along a side; a larger outline gets larger cells.
const MAX_SIDE: f32 = 160.0;
/// Edge of a cell at least, metres.
const CELL_M: f32 = 0.004;

/// The margins of an outline over its surroundings.
#[derive(Debug, Clone)]
pub struct Extent {
    low: Point2<f32>,
    per_m: f32,
    columns: usize,
    rows: usize,
    margins_m: Vec<f32>,
}

impl Extent {
    /// Of an outline and what lies up to `around_m` outside of it.
    pub fn new(outline: &Footprint, around_m: f32) -> Self {
        let (low, high) = outline
            .corners()
            .iter()
            .fold((Point2::new(f32::INFINITY, f32::INFINITY), Point2::new(f32::NEG_INFINITY, f32::NEG_INFINITY)), |(low, high), c| {
                (low.inf(c), high.sup(c))
            });
        let (low, high) = (low.map(|m| m - around_m), high.map(|m| m + around_m));
        let cell_m = CELL_M.max((high - low).max() / MAX_SIDE);
        let side = |k: usize| ((high[k] - low[k]) / cell_m) as usize + 1;
        let (columns, rows) = (side(0), side(1));
        // Each edge as a line's normal form, so that a cell asks no root.
        let corners = outline.corners();
        let edges: Vec<[f32; 3]> = (0..corners.len())
            .map(|i| (corners[i], corners[(i + 1) % corners.len()]))
            .map(|(a, b)| ((b - a).normalize(), a))
            .map(|(along, a)| [-along.y, along.x, along.y * a.x - along.x * a.y])
            .collect();
        let mut margins_m = Vec::with_capacity(columns * rows);
        for row in 0..rows {
            let y = low.y + (row as f32 + 0.5) * cell_m;
            for column in 0..columns {
                let x = low.x + (column as f32 + 0.5) * cell_m;
                margins_m.push(edges.iter().fold(f32::INFINITY, |least, [nx, ny, d]| least.min(nx * x + ny * y + d)));
            }
        }
        Self { low, per_m: 1.0 / cell_m, columns, rows, margins_m }
    }

    /// How far inside the outline a point's place is, metres, to a cell; minus infinity beyond the surroundings.
    pub fn margin_m(&self, p: &Point3<f32>) -> f32 {
        let (x, y) = ((p.x - self.low.x) * self.per_m, (p.y - self.low.y) * self.per_m);
        // False for a missing reading.
        if x >= 0.0 && y >= 0.0 && (x as usize) < self.columns && (y as usize) < self.rows {
            self.margins_m[y as usize * self.columns + x as usize]
        } else {
            f32::NEG_INFINITY
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
            #[test]
            fn margins_are_the_outlines_to_a_cell(corners in prop::collection::vec(prop::array::uniform2(-1.0..1.0f32), 3..12), at in prop::array::uniform2(-1.2..1.2f32)) {
                let corners: Vec<Point3<f32>> = corners.iter().map(|[x, y]| Point3::new(*x, *y, 0.0)).collect();
                let Some(outline) = Footprint::of(&corners) else { return Ok(()) };
                prop_assume!(outline.area() > 1e-3);
                let (p, extent) = (Point3::new(at[0], at[1], 0.3), Extent::new(&outline, 0.2));
                let (margin, looked_up) = (outline.margin(&p.xy()), extent.margin_m(&p));
    // Beyond the surroundings, which are a box, the margin may still be small: it is taken from lines.
                prop_assert!(if looked_up == f32::NEG_INFINITY { margin < 0.0 } else { (margin - looked_up).abs() < 0.03 }, "{margin} {looked_up}");
            }
        }

    #[test]
    fn a_missing_reading_is_nowhere() {
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]].map(Point3::from);
        let extent = Extent::new(&Footprint::of(&corners).unwrap(), 0.1);
        assert_eq!(extent.margin_m(&crate::readings::point_map::MISSING), f32::NEG_INFINITY);
    }
}
