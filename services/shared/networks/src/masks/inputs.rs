//! What the network reads of a depth picture: twelve numbers a pixel, the same as `inputs` in `scripts/train_masks.py`.

use nalgebra::Vector3;
use repose_geometry::Pinhole;
use repose_geometry::viewer::away_in_camera;

/// Features of a pixel.
pub(super) const CHANNELS: usize = 12;
/// Half the length over which normals are taken, pixels.
const NORMAL_ARM: isize = 2;
/// Lengths over which a surface's bend is taken to either side, pixels.
const BEND_ARMS: [isize; 2] = [1, 4];
/// Least upward part of the normal of what may be the main support.
const FACES_UP: f32 = 0.9;
/// Bins of the height histogram: their height in metres, their number, and how far below the camera they begin.
const BIN_M: f32 = 0.01;
const BINS: usize = 600;
const LOWEST_M: f32 = -4.0;

/// The mask network's input: features of each pixel, row by row.
///
/// Whether there is a reading; the height over the main support in halves of a metre and in twentieths, both cut off; depth less 0.9 m; the
/// normal's parts to the right, away and up, as the camera's viewer has them; the bends along x and y over a short and a long arm, as slopes;
/// how much the line of sight points up.
#[derive(Debug, Clone, PartialEq)]
pub struct MaskInputs {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `[height · width]`.
    pub pixels: Vec<[f32; CHANNELS]>,
}

impl MaskInputs {
    /// Of a picture `depth_m` `[camera.height · camera.width]`, metres along the optical axis, where anything but a positive number is no
    /// reading. `up` is the unit vector against gravity in the camera's frame.
    pub fn new(depth_m: &[f32], camera: &Pinhole, up: &Vector3<f64>) -> Self {
        let picture = Picture::new(depth_m, camera, up);
        let normals: Vec<Vector3<f32>> = (0..depth_m.len()).map(|i| picture.normal(i)).collect();
        let heights: Vec<f32> = picture.points.iter().map(|p| picture.up.dot(p)).collect();
        let level = level(&heights, &picture.depth_m, |i| picture.up.dot(&normals[i]) > FACES_UP);
        let pixels = (0..depth_m.len()).map(|i| picture.features(i, &normals[i], heights[i] - level)).collect();
        Self { width: camera.width, height: camera.height, pixels }
    }
}

/// The picture with its points and directions, in the camera's frame.
struct Picture<'a> {
    camera: &'a Pinhole,
    /// Metres, 0 without a reading.
    depth_m: Vec<f32>,
    points: Vec<Vector3<f32>>,
    right: Vector3<f32>,
    away: Vector3<f32>,
    up: Vector3<f32>,
}

impl<'a> Picture<'a> {
    fn new(depth_m: &[f32], camera: &'a Pinhole, up: &Vector3<f64>) -> Self {
        let ahead: Vector3<f32> = away_in_camera(&up.normalize()).cast();
        let up = up.cast::<f32>().normalize();
        let away = (ahead - up * ahead.dot(&up)).normalize();
        let depth_m: Vec<f32> = depth_m.iter().map(|z| if *z > 0.0 { *z } else { 0.0 }).collect();
        let mut picture = Self { camera, depth_m, points: Vec::new(), right: away.cross(&up), away, up };
        picture.points = (0..picture.depth_m.len()).map(|i| picture.ray(i) * picture.depth_m[i]).collect();
        picture
    }

    /// Through a pixel, with a depth of 1.
    fn ray(&self, i: usize) -> Vector3<f32> {
        let (u, v) = ((i % self.camera.width) as f64, (i / self.camera.width) as f64);
        Vector3::new(((u - self.camera.cx) / self.camera.fx) as f32, ((v - self.camera.cy) / self.camera.fy) as f32, 1.0)
    }

    /// The pixel so many columns to the right and rows down, when it is in the picture and has a reading.
    fn reading_at(&self, i: usize, du: isize, dv: isize) -> Option<usize> {
        let u = (i % self.camera.width).checked_add_signed(du).filter(|u| *u < self.camera.width)?;
        let v = (i / self.camera.width).checked_add_signed(dv).filter(|v| *v < self.camera.height)?;
        Some(v * self.camera.width + u).filter(|j| self.depth_m[*j] > 0.0)
    }

    /// The unit normal that faces the camera, zero where a reading that it needs is missing.
    fn normal(&self, i: usize) -> Vector3<f32> {
        let across = |du: isize, dv: isize| {
            let [from, to] = [self.reading_at(i, -du, -dv)?, self.reading_at(i, du, dv)?];
            Some(self.points[to] - self.points[from])
        };
        let both = (self.depth_m[i] > 0.0).then(|| Some((across(NORMAL_ARM, 0)?, across(0, NORMAL_ARM)?))).flatten();
        both.and_then(|(along_x, along_y)| along_y.cross(&along_x).try_normalize(1e-12)).unwrap_or_default()
    }

    /// How far the pixel lies before the middle of the readings on both sides, over the arm's length; at most 1 either way.
    fn bend(&self, i: usize, du: isize, dv: isize) -> f32 {
        let Some((before, after)) = self.reading_at(i, -du, -dv).zip(self.reading_at(i, du, dv)) else { return 0.0 };
        let here = self.depth_m[i];
        if here == 0.0 {
            return 0.0;
        }
        let relief = (self.depth_m[before] + self.depth_m[after]) / 2.0 - here;
        let arm_m = (du + dv) as f32 * here.max(0.05) / self.camera.fx as f32;
        (relief / arm_m).clamp(-1.0, 1.0)
    }

    fn features(&self, i: usize, normal: &Vector3<f32>, height_m: f32) -> [f32; CHANNELS] {
        let ray = self.ray(i);
        let slope = self.up.dot(&ray) / ray.norm();
        let here = self.depth_m[i];
        if here == 0.0 {
            return [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, slope];
        }
        let [near, far] = BEND_ARMS.map(|arm| [self.bend(i, arm, 0), self.bend(i, 0, arm)]);
        let [coarse, fine] = [(2.0 * height_m).clamp(-1.5, 1.5), (20.0 * height_m).clamp(-1.0, 1.0)];
        let [right, away, up] = [self.right, self.away, self.up].map(|axis| axis.dot(normal));
        [1.0, coarse, fine, (here - 0.9).clamp(-1.0, 1.5), right, away, up, near[0], near[1], far[0], far[1], slope]
    }
}

/// The height of the main support: of what faces up, the fullest three bins of the histogram, and the mean within them.
///
/// What is near counts more, by the square of its depth, or the floor would win over a small table. Without anything that faces up all
/// readings count.
fn level(heights: &[f32], depth_m: &[f32], faces_up: impl Fn(usize) -> bool) -> f32 {
    let mut counted: Vec<usize> = (0..heights.len()).filter(|i| depth_m[*i] > 0.0 && faces_up(*i)).collect();
    if counted.is_empty() {
        counted = (0..heights.len()).filter(|i| depth_m[*i] > 0.0).collect();
    }
    let bin = |i: usize| (((heights[i] - LOWEST_M) / BIN_M) as usize).clamp(1, BINS - 2);
    let mut sums = [0f32; BINS];
    for &i in &counted {
        sums[bin(i)] += depth_m[i].max(0.05).powi(-2);
    }
    let triples = sums.windows(3).map(|w| w[0] + w[1] + w[2]).enumerate();
    let middle = 1 + triples.fold((0, f32::MIN), |best, (k, sum)| if sum > best.1 { (k, sum) } else { best }).0;
    let within: Vec<f32> = counted.into_iter().filter(|i| bin(*i).abs_diff(middle) <= 1).map(|i| heights[i]).collect();
    within.iter().sum::<f32>() / within.len().max(1) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    const CAMERA: Pinhole = Pinhole { width: 64, height: 48, fx: 60.0, fy: 60.0, cx: 31.5, cy: 23.5 };

    /// A table 0.7 m below a camera that looks down at 37°, a box of 8 cm of depth on it.
    fn table() -> (Vec<f32>, Vector3<f64>) {
        let depth = |i: usize| {
            let (u, v) = (i % 64, i / 64);
            let table = 0.7 / (0.6 + 0.8 * (v as f32 - 23.5) / 60.0);
            if (20..40).contains(&u) && (16..30).contains(&v) { table - 0.08 } else { table }
        };
        ((0..64 * 48).map(depth).collect(), Vector3::new(0.0, -0.8, -0.6))
    }

    #[test]
    fn a_table_is_at_no_height_faces_up_and_is_flat() {
        let (depth, up) = table();
        let inputs = MaskInputs::new(&depth, &CAMERA, &up);
        let [reading, coarse, fine, _, right, away, up, bends @ .., _] = inputs.pixels[40 * 64 + 10];
        assert_eq!(reading, 1.0);
        assert!(coarse.abs() < 0.01 && fine.abs() < 0.1 && right.abs() < 0.01 && away.abs() < 0.01 && up > 0.99);
        assert!(bends.iter().all(|b| b.abs() < 0.3), "{bends:?}");
        let on_box = inputs.pixels[22 * 64 + 30];
        assert!(on_box[2] > 0.9, "{on_box:?}");
    }

    #[test]
    fn the_pictures_up_is_away_for_a_camera_above_that_is_tilted_sideways() {
        for tilt_deg in [-25f64, -10.0, 0.0, 10.0, 25.0] {
            let (x, z) = tilt_deg.to_radians().sin_cos();
            let picture = Picture::new(&[0.0; 64 * 48], &CAMERA, &Vector3::new(x, 0.0, -z));
            assert!((picture.away + Vector3::y()).norm() < 1e-6 && picture.right.x > 0.9, "{tilt_deg}");
        }
    }

    #[test]
    fn what_has_no_reading_has_no_features_and_nothing_is_no_number() {
        let (mut depth, up) = table();
        (depth[5], depth[6], depth[7]) = (f32::NAN, 0.0, -1.0);
        let inputs = MaskInputs::new(&depth, &CAMERA, &up);
        assert!(inputs.pixels[5..8].iter().all(|p| p[..11] == [0.0; 11]));
        assert!(inputs.pixels.as_flattened().iter().all(|x| x.is_finite()));
        let nothing = MaskInputs::new(&[f32::NAN; 64 * 48], &CAMERA, &up);
        assert!(nothing.pixels.as_flattened().iter().all(|x| x.is_finite()));
    }
}
