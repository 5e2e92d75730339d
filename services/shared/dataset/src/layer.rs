//! One thing as a camera would see it with nothing else there: inverse depth, and color where it is kept.

/// One step of stored inverse depth, 1/m. `u16` then reaches from 15 cm to beyond any room.
pub const INVERSE_DEPTH_STEP: f32 = 1e-4;

/// A picture cropped to the rectangle that it fills.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Layer {
    /// Column of the rectangle's left edge in the full picture.
    pub x0: u32,
    /// Row of the rectangle's upper edge in the full picture.
    pub y0: u32,
    /// Columns of the rectangle.
    pub width: u32,
    /// Rows of the rectangle.
    pub height: u32,
    /// One over the depth along the optical axis, in [`INVERSE_DEPTH_STEP`], row-major `[height, width]`, 0 = nothing.
    pub inverse_depth: Vec<u16>,
    /// Color as shaded, `[height, width]`, or empty where color was not kept.
    pub color: Vec<[u8; 3]>,
}

impl Layer {
    /// Crops and rounds a full picture of inverse depth (1/m, row-major `[rows, columns]`, 0 = nothing), and with it a picture of color of the same
    /// size (or an empty slice for none). NaN, infinite and negative inverse depth is nothing; what is nearer than 15 cm counts as at 15 cm.
    pub fn from_inverse_depth(inverse_depth: &[f32], color: &[[u8; 3]], columns: usize) -> Self {
        let columns = columns.max(1);
        let steps = |w: f32| if w.is_finite() { (w / INVERSE_DEPTH_STEP).round() as u16 } else { 0 };
        let is_filled = |w: &f32| steps(*w) > 0;
        let mut rows = inverse_depth.chunks_exact(columns).enumerate().filter(|(_, row)| row.iter().any(is_filled)).map(|(y, _)| y);
        let Some(y0) = rows.next() else { return Self::default() };
        let y1 = rows.next_back().unwrap_or(y0) + 1;
        let (mut x0, mut x1) = (columns, 0);
        for row in inverse_depth[y0 * columns..y1 * columns].chunks_exact(columns) {
            x0 = row.iter().position(is_filled).map_or(x0, |x| x0.min(x));
            x1 = row.iter().rposition(is_filled).map_or(x1, |x| x1.max(x + 1));
        }
        let kept = |y: usize| y * columns + x0..y * columns + x1;
        Self {
            x0: x0 as u32,
            y0: y0 as u32,
            width: (x1 - x0) as u32,
            height: (y1 - y0) as u32,
            inverse_depth: (y0..y1).flat_map(|y| &inverse_depth[kept(y)]).map(|w| steps(*w)).collect(),
            color: if color.len() == inverse_depth.len() { (y0..y1).flat_map(|y| &color[kept(y)]).copied().collect() } else { Vec::new() },
        }
    }

    /// As [`Layer::from_inverse_depth`], from depth in metres and without color.
    pub fn from_depth_m(depth_m: &[f32], columns: usize) -> Self {
        let inverse: Vec<f32> = depth_m.iter().map(|z| if *z > 0.0 { 1.0 / z } else { 0.0 }).collect();
        Self::from_inverse_depth(&inverse, &[], columns)
    }

    /// Pixels of the rectangle.
    pub fn area(&self) -> usize {
        self.width as usize * self.height as usize
    }

    /// The rectangle's rows: (row of the full picture, inverse depth of its `width` pixels in [`INVERSE_DEPTH_STEP`]).
    pub fn rows(&self) -> impl Iterator<Item = (usize, &[u16])> {
        self.inverse_depth.chunks_exact(self.width.max(1) as usize).enumerate().map(|(y, row)| (self.y0 as usize + y, row))
    }

    /// How many pixels are filled.
    pub fn count(&self) -> usize {
        self.inverse_depth.iter().filter(|w| **w > 0).count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_layer_keeps_the_rectangle_that_is_filled() {
        let mut depth_m = vec![0.0f32; 6 * 4];
        depth_m[8] = 0.5; // column 2, row 1
        depth_m[2 * 6 + 4] = 0.8;
        depth_m[3] = f32::NAN;
        let layer = Layer::from_depth_m(&depth_m, 6);
        assert_eq!((layer.x0, layer.y0, layer.width, layer.height, layer.count()), (2, 1, 3, 2, 2));
        assert_eq!(layer.rows().collect::<Vec<_>>(), [(1, &[20_000, 0, 0][..]), (2, &[0, 0, 12_500][..])]);
        assert_eq!(Layer::from_depth_m(&[0.0; 24], 6), Layer::default());
    }

    #[test]
    fn color_is_cropped_with_the_depth() {
        let color: Vec<[u8; 3]> = (0..8).map(|i| [i, 0, 0]).collect();
        let layer = Layer::from_inverse_depth(&[0.0, 0.0, 1.0, 2.0, 0.0, 0.0, 0.0, f32::INFINITY], &color, 4);
        assert_eq!((layer.x0, layer.width, layer.height), (2, 2, 1));
        assert_eq!(layer.color, [[2, 0, 0], [3, 0, 0]]);
    }

    #[test]
    fn a_step_is_a_tenth_of_a_millimetre_at_a_metre() {
        let layer = Layer::from_depth_m(&[1.0, 1.0001], 2);
        assert_eq!(layer.inverse_depth[0] - layer.inverse_depth[1], 1);
    }
}
