//! A scene's points by cells of the floor plan, so that those near a place are found without looking at all.

use nalgebra::{Point2, Point3};
use repose_geometry::Aabb;
use repose_proto::Scene;

/// Edge of a cell, metres: about a hundredth of a scene's points lie in the cells around an object.
const CELL_M: f32 = 0.02;
/// Cells along a side at most; points farther out count in the outermost.
const MOST: f32 = 512.0;

/// Points sorted into cells.
#[derive(Debug)]
pub struct PointGrid {
    low: Point2<f32>,
    cells: [usize; 2],
    starts: Vec<u32>,
    /// Points with their labels, cell by cell.
    points: Vec<(Point3<f32>, u16)>,
}

impl PointGrid {
    /// Of a scene's points.
    pub fn new(scene: &Scene) -> Self {
        let all: Vec<Point3<f32>> = scene.points.iter().map(|p| Point3::from(*p)).collect();
        let bounds = Aabb::of(&all).unwrap_or(Aabb { min: Point3::origin(), max: Point3::origin() });
        let cells = [0, 1].map(|k| ((bounds.max[k] - bounds.min[k]) / CELL_M).clamp(0.0, MOST - 1.0) as usize + 1);
        let mut grid = Self { low: bounds.min.xy(), cells, starts: vec![0; cells[0] * cells[1] + 1], points: Vec::new() };
        let keys: Vec<usize> = all.iter().map(|p| grid.along(1, p.y) * cells[0] + grid.along(0, p.x)).collect();
        for key in &keys {
            grid.starts[key + 1] += 1;
        }
        for cell in 0..cells[0] * cells[1] {
            grid.starts[cell + 1] += grid.starts[cell];
        }
        let mut next = grid.starts.clone();
        grid.points = vec![(Point3::origin(), 0); all.len()];
        for ((point, label), key) in all.into_iter().zip(&scene.labels).zip(keys) {
            grid.points[next[key] as usize] = (point, *label);
            next[key] += 1;
        }
        grid
    }

    /// The points of the cells within a distance of a box, seen from above: all that are so near, and others.
    pub fn around(&self, bounds: &Aabb, reach_m: f32) -> impl Iterator<Item = &(Point3<f32>, u16)> {
        let range = |k: usize| self.along(k, bounds.min[k] - reach_m)..=self.along(k, bounds.max[k] + reach_m);
        let (columns, rows) = (range(0), range(1));
        rows.flat_map(move |row| {
            let (first, last) = (row * self.cells[0] + columns.start(), row * self.cells[0] + columns.end());
            &self.points[self.starts[first] as usize..self.starts[last + 1] as usize]
        })
    }

    fn along(&self, k: usize, at_m: f32) -> usize {
        // Out of the grid is at its edge.
        (((at_m - self.low[k]) / CELL_M).max(0.0) as usize).min(self.cells[k] - 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::synthetic::SceneBuilder;

    #[test]
    fn no_point_that_is_near_is_left_out() {
        let scene = SceneBuilder::table().object(1, [0.0, 0.0], [0.1, 0.1, 0.1]).scene();
        let grid = PointGrid::new(&scene);
        for (x, y, reach_m) in [(0.0, 0.0, 0.03), (0.3, -0.2, 0.1), (-0.6, 0.5, 0.2), (3.0, 0.0, 0.1), (0.1, 0.1, f32::INFINITY)] {
            let bounds = Aabb { min: Point3::new(x - 0.05, y - 0.05, 0.0), max: Point3::new(x + 0.05, y + 0.05, 0.1) };
            let near = |p: &Point3<f32>| [0, 1].iter().all(|k| p[*k] >= bounds.min[*k] - reach_m && p[*k] <= bounds.max[*k] + reach_m);
            let expected = scene.points.iter().filter(|p| near(&Point3::from(**p))).count();
            assert_eq!(grid.around(&bounds, reach_m).filter(|(p, _)| near(p)).count(), expected, "{x} {y} {reach_m}");
        }
        assert!(grid.around(&Aabb { min: Point3::origin(), max: Point3::origin() }, 0.02).count() < scene.points.len() / 20);
        let labelled = grid.around(&Aabb { min: Point3::origin(), max: Point3::origin() }, 9.0).filter(|(_, label)| *label == 1).count();
        assert_eq!(labelled, scene.labels.iter().filter(|label| **label == 1).count());
    }
}
