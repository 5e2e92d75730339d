//! Pictures without what the lens bends: each pixel from where the lens shows it. Depth takes the nearest reading, color what lies between.

use repose_proto::CameraModel;

use crate::calibration::Lens;
use crate::pictures::{Color, Depth};

/// Weights are of so many parts.
const PARTS: f32 = 256.0;
/// The source of pixels that the lens shows nowhere.
const NOWHERE: u32 = u32::MAX;

/// Where a pixel's color comes from: the upper left of four pixels, and how much of it is of those to the right and below.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Source {
    at: u32,
    right: u16,
    below: u16,
}

/// Where each pixel of the rectified picture comes from, row by row.
#[derive(Debug, Clone, PartialEq)]
pub struct Rectifier {
    width: usize,
    /// The nearest pixel.
    nearest: Vec<u32>,
    /// What lies between.
    between: Vec<Source>,
}

impl Rectifier {
    /// For pictures of a camera, which keep its intrinsics.
    pub fn new(camera: &CameraModel, lens: &Lens) -> Self {
        let (width, height) = (camera.width, camera.height);
        let index = |column: f32, row: f32| {
            let inside = column >= 0.0 && row >= 0.0 && column < width as f32 && row < height as f32;
            if inside { (row as usize * width + column as usize) as u32 } else { NOWHERE }
        };
        let (mut nearest, mut between) = (Vec::new(), Vec::new());
        for pixel in 0..width * height {
            let (column, row) = ((pixel % width) as f64, (pixel / width) as f64);
            let (x, y) = lens.bent(((column - camera.cx) / camera.fx, (row - camera.cy) / camera.fy));
            let (u, v) = ((camera.fx * x + camera.cx) as f32, (camera.fy * y + camera.cy) as f32);
            let at = index(u.round(), v.round());
            nearest.push(at);
            let (left, top) = (u.floor(), v.floor());
            let has_four = index(left, top) != NOWHERE && index(left + 1.0, top + 1.0) != NOWHERE;
            // Along the border there are no four: the nearest alone.
            between.push(match has_four {
                true => Source { at: index(left, top), right: ((u - left) * PARTS) as u16, below: ((v - top) * PARTS) as u16 },
                false => Source { at, right: 0, below: 0 },
            });
        }
        Self { width, nearest, between }
    }

    /// Depth, by the nearest reading: what lies between two is no place.
    pub fn depth(&self, depth: &Depth) -> Depth {
        let count = |at: &u32| depth.counts.get(*at as usize).copied().unwrap_or(0);
        Depth { counts: self.nearest.iter().map(count).collect(), ..*depth }
    }

    /// Color, between the four nearest pixels.
    pub fn color(&self, color: &Color) -> Color {
        let black = [0; 3];
        let pixel = |source: &Source| {
            let at = source.at as usize;
            let of = |i: usize| color.pixels.get(i).unwrap_or(&black);
            if source.right == 0 && source.below == 0 {
                return *of(at);
            }
            let corners = [of(at), of(at + 1), of(at + self.width), of(at + self.width + 1)];
            let parts = PARTS as u32;
            let (right, below) = (u32::from(source.right), u32::from(source.below));
            let (left, above) = (parts - right, parts - below);
            std::array::from_fn(|k| {
                let [a, b, c, d] = corners.map(|pixel| u32::from(pixel[k]));
                (((a * left + b * right) * above + (c * left + d * right) * below + parts * parts / 2) / (parts * parts)) as u8
            })
        };
        Color { pixels: self.between.iter().map(pixel).collect(), ..*color }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::CameraInfo;
    use crate::synthetic;

    /// A picture of straight bars as a lens shows it is straight again.
    #[test]
    fn straight_lines_are_straight_again() {
        let (width, height) = (160, 120);
        let camera = CameraModel { width, height, fx: 130.0, fy: 130.0, cx: 79.5, cy: 59.5, depth_unit_m: 0.001, world_from_camera: None };
        let info = CameraInfo::read(&synthetic::info("camera", 4)).expect("intrinsics");
        let info = CameraInfo { d: vec![-0.3, 0.08, 0.001, -0.002, 0.0], ..info };
        let lens = Lens::of(&info).expect("a model").expect("a lens");
        // What is left of a plane through the camera is near, what is right of it far: the border is a straight line of the rectified picture.
        let side = |u: f64, v: f64| if u > 30.0 + 0.1 * v { 2000 } else { 1000 };
        // The lens's picture: each of its pixels looked up by undoing the bending step by step.
        let unbent = |u: f64, v: f64| {
            let (x0, y0) = ((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy);
            let (mut x, mut y) = (x0, y0);
            for _ in 0..50 {
                let (bx, by) = lens.bent((x, y));
                (x, y) = (x + x0 - bx, y + y0 - by);
            }
            (camera.fx * x + camera.cx, camera.fy * y + camera.cy)
        };
        let pixels = || (0..width * height).map(|i| ((i % width) as f64, (i / width) as f64));
        let bent: Vec<u16> = pixels().map(|(u, v)| unbent(u, v)).map(|(u, v)| side(u, v)).collect();
        let straight: Vec<u16> = pixels().map(|(u, v)| side(u, v)).collect();
        let wrong = |got: &[u16]| got.iter().zip(&straight).filter(|(a, b)| **a != 0 && a != b).count();
        let rectified = Rectifier::new(&camera, &lens).depth(&Depth { width, height, unit_m: 0.001, counts: bent.clone() });
        assert!(wrong(&bent) > 200, "the lens bends: {}", wrong(&bent));
        // Rounding to pixels leaves a few on the line itself.
        assert!(wrong(&rectified.counts) < 70, "{} of {} pixels", wrong(&rectified.counts), width * height);
        let color = Color { width, height, pixels: bent.iter().map(|c| [(c / 10) as u8; 3]).collect() };
        let mixed = Rectifier::new(&camera, &lens).color(&color);
        assert!(mixed.pixels.iter().all(|p| p[0] == 0 || (100..=200).contains(&p[0])));
    }
}
