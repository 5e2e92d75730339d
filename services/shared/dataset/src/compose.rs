//! The picture with some of the objects: the nearest layer wins each pixel.
//!
//! "Each object either hidden if it is query (to get scene and anchor embeddings) or hidden if it is *not* query" (paper, appendix A.1):
//! with one layer per object any such picture is exact, what was behind a hidden object included.

use crate::{DEPTH_UNIT_M, Layer, ViewRecord};
use nalgebra::Point3;

/// A composed depth picture with instance labels.
#[derive(Debug, Clone, PartialEq)]
pub struct Composite {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Depth along the optical axis, metres, row-major, 0 = nothing.
    pub depth_m: Vec<f32>,
    /// 0 = background or nothing, else 1 + the object's index in [`ViewRecord::objects`] (not its id).
    pub labels: Vec<u16>,
}

impl Composite {
    /// The picture with the background and those objects for whose index `present` holds.
    pub fn of(view: &ViewRecord, present: impl Fn(usize) -> bool) -> Self {
        let mut picture = Self::empty(view.camera.width, view.camera.height);
        picture.add(&view.background, 0);
        for (k, object) in view.objects.iter().enumerate().filter(|(k, _)| present(*k)) {
            picture.add(&object.alone, k as u16 + 1);
        }
        picture
    }

    /// A picture with nothing in it.
    pub fn empty(width: usize, height: usize) -> Self {
        Self { width, height, depth_m: vec![0.0; width * height], labels: vec![0; width * height] }
    }

    /// Draws a layer under a label wherever it is nearer than what is there. Pixels outside the picture are skipped.
    pub fn add(&mut self, layer: &Layer, label: u16) {
        for (x, y, depth) in layer.pixels() {
            let (x, y) = (x as usize, y as usize);
            if x < self.width && y < self.height {
                let (i, z) = (y * self.width + x, f32::from(depth) * DEPTH_UNIT_M);
                if self.depth_m[i] == 0.0 || z < self.depth_m[i] {
                    (self.depth_m[i], self.labels[i]) = (z, label);
                }
            }
        }
    }

    /// Drops the band around label borders: pixels with another label within `band_px` (Chebyshev) lose their depth, as in perception.
    ///
    /// Stands for dilating and eroding every mask and dropping what lies between, both objects' sides and the background's.
    pub fn drop_borders(&mut self, band_px: usize) {
        let (w, h) = (self.width, self.height);
        // Separable: the lowest and highest label along the row, then along the column; they differ where a border is near.
        let mut low = vec![0u16; w * h];
        let mut high = vec![0u16; w * h];
        for y in 0..h {
            let row = &self.labels[y * w..(y + 1) * w];
            for x in 0..w {
                let span = &row[x.saturating_sub(band_px)..(x + band_px + 1).min(w)];
                let (first, rest) = (span[0], &span[1..]);
                (low[y * w + x], high[y * w + x]) = rest.iter().fold((first, first), |(l, h), v| (l.min(*v), h.max(*v)));
            }
        }
        for y in 0..h {
            let (y0, y1) = (y.saturating_sub(band_px), (y + band_px + 1).min(h));
            for x in 0..w {
                let l = (y0..y1).map(|y| low[y * w + x]).min();
                let u = (y0..y1).map(|y| high[y * w + x]).max();
                if l != u {
                    self.depth_m[y * w + x] = 0.0;
                }
            }
        }
    }

    /// The points with depth, in the world, with their labels, row by row.
    pub fn points_in_world(&self, view: &ViewRecord) -> (Vec<Point3<f32>>, Vec<u16>) {
        let world_from_camera = view.world_from_camera;
        let mut points = Vec::new();
        let mut labels = Vec::new();
        for (i, z) in self.depth_m.iter().enumerate().filter(|(_, z)| **z > 0.0) {
            let in_camera = view.camera.unproject((i % self.width) as f64, (i / self.width) as f64, f64::from(*z));
            points.push((world_from_camera * in_camera).cast::<f32>());
            labels.push(self.labels[i]);
        }
        (points, labels)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearer_layer_wins_and_hiding_it_shows_what_is_behind() {
        let far = Layer { x0: 0, y0: 0, width: 3, height: 1, depth: vec![10_000; 3] };
        let near = Layer { x0: 1, y0: 0, width: 1, height: 1, depth: vec![5_000] };
        let mut picture = Composite::empty(3, 1);
        picture.add(&near, 1);
        picture.add(&far, 0);
        assert_eq!(picture.labels, [0, 1, 0]);
        assert_eq!(picture.depth_m, [1.0, 0.5, 1.0]);
    }

    #[test]
    fn the_border_band_is_dropped_on_both_sides() {
        let mut picture = Composite::empty(6, 1);
        picture.add(&Layer { x0: 0, y0: 0, width: 6, height: 1, depth: vec![10_000; 6] }, 0);
        picture.add(&Layer { x0: 3, y0: 0, width: 3, height: 1, depth: vec![5_000; 3] }, 1);
        picture.drop_borders(1);
        assert_eq!(picture.depth_m, [1.0, 1.0, 0.0, 0.0, 0.5, 0.5]);
    }
}
