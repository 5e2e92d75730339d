//! Labels of the coarse picture spread to the full one.
//!
//! Each pixel takes the label of the nearest (in space) of the coarse pixels around it. A pixel without a reading belongs to a mask that
//! lies on both sides of it: slanted and dark surfaces lose readings in the middle. Where the two sides differ it is a shadow, or an
//! outline that nobody saw.

use repose_geometry::Image;

use crate::readings::depth::DepthMap;
use crate::readings::point_map::{PointMap, is_reading};

/// The full picture's labels. `stride` is what `coarse` was thinned by, `in_camera` its points; `depth` is the full picture.
pub fn spread(coarse: &Image<u16>, in_camera: &PointMap, depth: &DepthMap, stride: usize) -> Image<u16> {
    let (width, height) = (depth.width(), depth.height());
    let mut labels = Image::filled(width, height, 0u16);
    for (row, v0) in (0..height).step_by(stride).enumerate() {
        let below = (row + 1).min(coarse.height() - 1);
        for (column, u0) in (0..width).step_by(stride).enumerate() {
            let right = (column + 1).min(coarse.width() - 1);
            let corners = [(column, row), (right, row), (column, below), (right, below)];
            let ids = corners.map(|at| coarse[at]);
            if ids == [0; 4] {
                continue;
            }
            for v in v0..(v0 + stride).min(height) {
                for u in u0..(u0 + stride).min(width) {
                    let p = depth.point(u, v);
                    if !is_reading(&p) {
                        continue;
                    }
                    if ids.iter().all(|id| *id == ids[0]) {
                        labels[(u, v)] = ids[0];
                        continue;
                    }
                    let mut nearest = (f32::INFINITY, 0);
                    for (at, id) in corners.into_iter().zip(ids) {
                        let distance = (in_camera[at] - p).norm_squared();
                        if distance < nearest.0 {
                            nearest = (distance, id);
                        }
                    }
                    labels[(u, v)] = nearest.1;
                }
            }
        }
    }
    labels
}

/// Gives gaps in the readings the label that lies on both sides of them, along the row or the column, at most `reach_px` apart.
pub fn fill_gaps(labels: &mut Image<u16>, depth_m: &Image<f32>, reach_px: usize) {
    let (width, height) = (labels.width(), labels.height());
    let before = labels.pixels().to_vec();
    let labels = labels.pixels_mut();
    // Row by row also for the columns: of each the last reading's row and label are kept.
    let mut above: Vec<(usize, u16)> = vec![(0, 0); width];
    for v in 0..height {
        let mut left = (0, 0);
        for u in 0..width {
            let i = v * width + u;
            if depth_m.pixels()[i].is_nan() {
                continue;
            }
            let id = before[i];
            let spans = |(at, other): (usize, u16), here: usize| id != 0 && other == id && here - at > 1 && here - at <= reach_px;
            if spans(left, u) {
                (left.0 + 1..u).for_each(|u| labels[v * width + u] = id);
            }
            if spans(above[u], v) {
                (above[u].0 + 1..v).for_each(|v| labels[v * width + u] = id);
            }
            left = (u, id);
            above[u] = (v, id);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gap_between_two_sides_of_a_mask_is_of_it_and_a_shadow_beside_it_is_not() {
        let (n, none) = (1.0, f32::NAN);
        let depth_m = Image::from_pixels(9, 1, vec![n, n, none, none, n, none, n, n, none]).unwrap();
        let mut labels = Image::from_pixels(9, 1, vec![0, 3, 0, 0, 3, 0, 0, 3, 0]).unwrap();
        fill_gaps(&mut labels, &depth_m, 4);
        assert_eq!(labels.pixels(), [0, 3, 3, 3, 3, 0, 0, 3, 0]);
        let mut labels = Image::from_pixels(9, 1, vec![0, 3, 0, 0, 3, 0, 0, 3, 0]).unwrap();
        fill_gaps(&mut labels, &depth_m, 2);
        assert_eq!(labels.pixels(), [0, 3, 0, 0, 3, 0, 0, 3, 0], "too wide");
    }
}
