//! The picture with some of the objects: the nearest layer wins each pixel.
//!
//! "Each object either hidden if it is query (to get scene and anchor embeddings) or hidden if it is *not* query" (paper, appendix A.1):
//! with one layer per object any such picture is exact, what was behind a hidden object included.

use crate::{
    layer::{INVERSE_DEPTH_STEP, Layer},
    record::ViewRecord,
};
use nalgebra::Point3;

/// Color where there is nothing.
const NOTHING: [u8; 3] = [205, 212, 220];

/// A composed depth picture with instance labels, and color where the view has it.
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
    /// Color as shaded, row-major; empty when the view has none.
    pub color: Vec<[u8; 3]>,
}

impl Composite {
    /// The picture with the background and those objects for whose index `present` holds.
    pub fn of(view: &ViewRecord, present: impl Fn(usize) -> bool) -> Self {
        let mut picture = Self::empty(view.camera.width, view.camera.height);
        if view.has_color() {
            picture.color = vec![NOTHING; picture.labels.len()];
        }
        picture.add(&view.background, 0);
        for (k, object) in view.objects.iter().enumerate().filter(|(k, _)| present(*k)) {
            picture.add(&object.alone, k as u16 + 1);
        }
        picture
    }

    /// A picture with nothing in it, without color.
    pub fn empty(width: usize, height: usize) -> Self {
        Self { width, height, depth_m: vec![0.0; width * height], labels: vec![0; width * height], color: Vec::new() }
    }

    /// Draws a layer under a label wherever it is nearer than what is there. Pixels outside the picture are skipped.
    pub fn add(&mut self, layer: &Layer, label: u16) {
        let x0 = (layer.x0 as usize).min(self.width);
        for (y, row) in layer.rows().take_while(|(y, _)| *y < self.height) {
            let at = y * self.width + x0;
            let (depth_m, labels) = (&mut self.depth_m[at..(y + 1) * self.width], &mut self.labels[at..(y + 1) * self.width]);
            for ((inverse, depth_m), here) in row.iter().zip(depth_m).zip(labels) {
                let z = 1.0 / (f32::from(*inverse) * INVERSE_DEPTH_STEP);
                if *inverse > 0 && (*depth_m == 0.0 || z < *depth_m) {
                    (*depth_m, *here) = (z, label);
                }
            }
        }
        if !self.color.is_empty() && !layer.color.is_empty() {
            self.add_color(layer, label);
        }
    }

    /// Colors the pixels that a layer has just won.
    fn add_color(&mut self, layer: &Layer, label: u16) {
        let width = layer.width.max(1) as usize;
        for ((y, row), color) in layer.rows().zip(layer.color.chunks_exact(width)).take_while(|((y, _), _)| *y < self.height) {
            for (k, (inverse, color)) in row.iter().zip(color).enumerate().take_while(|(k, _)| layer.x0 as usize + k < self.width) {
                let at = y * self.width + layer.x0 as usize + k;
                let z = 1.0 / (f32::from(*inverse) * INVERSE_DEPTH_STEP);
                if *inverse > 0 && self.labels[at] == label && self.depth_m[at] == z {
                    self.color[at] = *color;
                }
            }
        }
    }

    /// How many pixels each of `objects` objects fills.
    pub fn visible_px(&self, objects: usize) -> Vec<u32> {
        let mut counts = vec![0u32; objects + 1];
        for label in &self.labels {
            if let Some(count) = counts.get_mut(usize::from(*label)) {
                *count += 1;
            }
        }
        counts.split_off(1)
    }

    /// Drops the band around label borders: pixels with another label within `band_px` (Chebyshev) lose their depth, as in perception.
    ///
    /// Stands for dilating and eroding every mask and dropping what lies between, both objects' sides and the background's. Thin parts go as a whole
    /// here; perception keeps them along their middle.
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

    fn strip(x0: u32, inverse_depth: &[u16], color: u8) -> Layer {
        let n = inverse_depth.len();
        Layer { x0, y0: 0, width: n as u32, height: 1, inverse_depth: inverse_depth.to_vec(), color: vec![[color; 3]; n] }
    }

    #[test]
    fn the_nearer_layer_wins_and_hiding_it_shows_what_is_behind() {
        let (far, near) = (strip(0, &[10_000; 3], 9), strip(1, &[20_000], 7));
        let mut picture = Composite::empty(3, 1);
        picture.color = vec![NOTHING; 3];
        picture.add(&near, 1);
        picture.add(&far, 0);
        assert_eq!(picture.labels, [0, 1, 0]);
        assert_eq!(picture.depth_m, [1.0, 0.5, 1.0]);
        assert_eq!(picture.color, [[9; 3], [7; 3], [9; 3]]);
        assert_eq!(picture.visible_px(2), [1, 0]);
    }

    #[test]
    fn what_lies_outside_the_picture_is_skipped() {
        let mut picture = Composite::empty(2, 1);
        picture.add(&strip(1, &[10_000; 4], 0), 1);
        picture.add(&strip(5, &[10_000; 4], 0), 2);
        picture.add(&Layer { y0: 3, ..strip(0, &[10_000], 0) }, 3);
        assert_eq!(picture.labels, [0, 1]);
    }

    #[test]
    fn the_border_band_is_dropped_on_both_sides() {
        let mut picture = Composite::empty(6, 1);
        picture.add(&strip(0, &[10_000; 6], 0), 0);
        picture.add(&strip(3, &[20_000; 3], 0), 1);
        picture.drop_borders(1);
        assert_eq!(picture.depth_m, [1.0, 1.0, 0.0, 0.0, 0.5, 0.5]);
    }
}
