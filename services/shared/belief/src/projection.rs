//! Many points in a camera's picture at once: a search looks at hundreds of them for every candidate.
//!
//! A plain loop over a block of points, which the compiler turns into vectors; every instruction set finds the same pixels.

use nalgebra::{Isometry3, Matrix3, Point3, Vector3};
use repose_geometry::Pinhole;
use repose_simd::{Lanes, Work};

/// Points projected at once.
pub(crate) const BLOCK: usize = 32;
/// The pixel of points outside the picture.
pub(crate) const NOWHERE: u32 = u32::MAX;

/// A rigid motion into a camera's axes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct IntoCamera {
    turn: Matrix3<f64>,
    shift: Vector3<f64>,
}

impl IntoCamera {
    pub fn new(motion: &Isometry3<f64>) -> Self {
        Self { turn: motion.rotation.to_rotation_matrix().into_inner(), shift: motion.translation.vector }
    }
}

/// Coordinates of a block of points, x, y and z.
pub(crate) type Columns = [[f64; BLOCK]; 3];

/// Puts points into columns; what is missing to a block is left as it was.
pub(crate) fn fill(columns: &mut Columns, points: &[Point3<f64>]) {
    for (i, p) in points.iter().enumerate().take(BLOCK) {
        for (column, coordinate) in columns.iter_mut().zip(p.iter()) {
            column[i] = *coordinate;
        }
    }
}

/// Projects a block of points.
pub(crate) struct Projecting<'a> {
    pub points: &'a Columns,
    pub motion: &'a IntoCamera,
    pub camera: &'a Pinhole,
}

/// Where a block of points falls.
pub(crate) struct Projected {
    /// Pixels, row by row, or [`NOWHERE`].
    pub pixels: [u32; BLOCK],
    /// Along the optical axis, metres.
    pub depths_m: [f64; BLOCK],
}

impl Work for Projecting<'_> {
    type Output = Projected;

    #[inline(always)]
    unsafe fn run<L: Lanes>(self) -> Projected {
        let Self { points: [xs, ys, zs], motion: IntoCamera { turn, shift }, camera } = self;
        let mut projected = Projected { pixels: [NOWHERE; BLOCK], depths_m: [0.0; BLOCK] };
        for i in 0..BLOCK {
            let (x, y, z) = (xs[i], ys[i], zs[i]);
            let along = |row: usize| turn[(row, 0)] * x + turn[(row, 1)] * y + turn[(row, 2)] * z + shift[row];
            let (right, down, ahead) = (along(0), along(1), along(2));
            let (u, in_row) = nearest(camera.fx * right / ahead + camera.cx, camera.width);
            let (v, in_column) = nearest(camera.fy * down / ahead + camera.cy, camera.height);
            let is_seen = (ahead > 1e-9) & in_row & in_column;
            let pixel = v.wrapping_mul(camera.width as u32).wrapping_add(u);
            projected.pixels[i] = if is_seen { pixel } else { NOWHERE };
            projected.depths_m[i] = ahead;
        }
        projected
    }
}

/// The nearest of `count` pixels, halves upwards, and whether there is one: [`Pinhole::pixel_of`] without a branch.
#[inline(always)]
fn nearest(at: f64, count: usize) -> (u32, bool) {
    let is_near = (at > -0.5) & (at < count as f64);
    // SAFETY: from −0.5 to the number of a picture's rows or columns.
    let whole: i32 = unsafe { (if is_near { at } else { 0.0 }).to_int_unchecked() };
    let pixel = (whole + i32::from(at - f64::from(whole) >= 0.5)) as u32;
    (pixel, is_near & (pixel < count as u32))
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;
    use repose_simd::InstructionSet;

    use super::*;

    #[test]
    fn every_instruction_set_finds_the_pixels_of_points_one_by_one() {
        let camera = Pinhole { width: 160, height: 120, fx: 131.0, fy: 130.0, cx: 79.6, cy: 59.5 };
        let motion = Isometry3::new(Vector3::new(0.02, -0.1, 0.7), Vector3::new(2.0, 0.1, -0.2));
        let mut rng = Pcg64::seed_from_u64(5);
        let turn = motion.rotation.to_rotation_matrix();
        let mut seen = 0;
        for _ in 0..40 {
            let points: Vec<Point3<f64>> = (0..BLOCK).map(|_| Point3::from([(); 3].map(|()| rng.random_range(-1.2..1.2)))).collect();
            let mut columns = [[0.0; BLOCK]; 3];
            fill(&mut columns, &points);
            for set in InstructionSet::available() {
                let projected = set.run(Projecting { points: &columns, motion: &IntoCamera::new(&motion), camera: &camera });
                for (i, p) in points.iter().enumerate() {
                    let in_camera = turn * p + motion.translation.vector;
                    let pixel = camera.pixel_of(&in_camera).map_or(NOWHERE, |(u, v)| (v * camera.width + u) as u32);
                    assert_eq!((projected.pixels[i], projected.depths_m[i]), (pixel, in_camera.z), "{set:?}");
                    seen += usize::from(pixel != NOWHERE);
                }
            }
        }
        assert!(seen > 100, "{seen}");
    }
}
