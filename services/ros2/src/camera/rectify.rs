//! Pictures without what the lens bends: each pixel from where the lens shows it. Depth takes the nearest reading, color what lies between.

use repose_proto::CameraModel;

use super::calibration::Lens;
use super::pictures::{Color, Depth};

/// Where each pixel of the rectified picture comes from.
#[derive(Debug, Clone, PartialEq)]
pub struct Rectifier {
    width: usize,
    height: usize,
    /// Column and row, row by row; outside the picture where the lens shows nothing.
    sources: Vec<[f32; 2]>,
}

impl Rectifier {
    /// For pictures of a camera, which keep its intrinsics.
    pub fn new(camera: &CameraModel, lens: &Lens) -> Self {
        let source = |i: usize| {
            let (u, v) = ((i % camera.width) as f64, (i / camera.width) as f64);
            let (x, y) = lens.bent(((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy));
            [(camera.fx * x + camera.cx) as f32, (camera.fy * y + camera.cy) as f32]
        };
        let sources = (0..camera.width * camera.height).map(source).collect();
        Self { width: camera.width, height: camera.height, sources }
    }

    /// Depth, by the nearest reading: what lies between two is no place.
    pub fn depth(&self, depth: &Depth) -> Depth {
        let count = |at: &[f32; 2]| self.index(at[0].round(), at[1].round()).map_or(0, |i| depth.counts[i]);
        Depth { counts: self.sources.iter().map(count).collect(), ..*depth }
    }

    /// Color, between the four nearest pixels.
    pub fn color(&self, color: &Color) -> Color {
        let pixel = |at: &[f32; 2]| {
            let (u, v) = (at[0].floor(), at[1].floor());
            let corner = |du: f32, dv: f32| self.index(u + du, v + dv).map(|i| color.pixels[i]);
            let (Some(a), Some(b), Some(c), Some(d)) = (corner(0.0, 0.0), corner(1.0, 0.0), corner(0.0, 1.0), corner(1.0, 1.0)) else {
                return self.index(at[0].round(), at[1].round()).map_or([0; 3], |i| color.pixels[i]);
            };
            let (s, t) = (at[0] - u, at[1] - v);
            let mixed = |k: usize| {
                let [a, b, c, d] = [a, b, c, d].map(|p| f32::from(p[k]));
                ((a * (1.0 - s) + b * s) * (1.0 - t) + (c * (1.0 - s) + d * s) * t).round() as u8
            };
            [mixed(0), mixed(1), mixed(2)]
        };
        Color { pixels: self.sources.iter().map(pixel).collect(), ..*color }
    }

    fn index(&self, column: f32, row: f32) -> Option<usize> {
        let inside = column >= 0.0 && row >= 0.0 && column < self.width as f32 && row < self.height as f32;
        inside.then(|| row as usize * self.width + column as usize)
    }
}

#[cfg(test)]
mod tests {
    use repose_ros_messages::{CameraInfo, synthetic};

    use super::*;

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
