//! From true depth to what the camera reports: lost readings, mixed readings, then noise and rounding of the disparity.

use repose_geometry::Pinhole;

use crate::SensorModel;
use crate::noise::{NoiseStream, bits, correlated, shares, triangular};
use crate::shadow::mark_row;
use crate::surface::PixelNeighbourhood;

/// Slant below which its noise is under a tenth of a millimetre and not worth an arc cosine: the squared cosine of 45°.
const SLANTED: f32 = 0.5;

impl SensorModel {
    /// Replaces true depth by what the camera reports of it.
    ///
    /// `depth_m` is `[camera.height, camera.width]`, row-major, metres along the optical axis, 0 = nothing, which stays nothing. The same `seed`
    /// gives the same noise at the same pixel, whatever else the picture shows.
    pub fn disturb(&self, depth_m: &mut [f32], camera: &Pinhole, seed: u64) {
        if *self == Self::ideal() || camera.width == 0 {
            return;
        }
        let picture = TruePicture::new(self, depth_m, camera, seed);
        let mut hidden = vec![false; camera.width];
        let mut lost_patches = vec![false; camera.width.div_ceil(picture.window)];
        for (v, row) in depth_m.chunks_exact_mut(camera.width).enumerate() {
            if self.shadows {
                let shift_px_m = camera.fx as f32 * self.baseline_m;
                mark_row(&picture.inverse_depth[v * camera.width..][..camera.width], shift_px_m, self.blind_band, &mut hidden);
            }
            if v % picture.window == 0 {
                for (k, lost) in lost_patches.iter_mut().enumerate() {
                    *lost = shares(bits(seed, NoiseStream::Patch, v * camera.width + k))[0] < self.dropout;
                }
            }
            for (u, depth) in row.iter_mut().enumerate().filter(|(_, depth)| **depth > 0.0) {
                let is_lost = hidden[u] || lost_patches[u / picture.window];
                *depth = if is_lost { 0.0 } else { picture.reading(u, v) };
            }
        }
    }
}

/// The true picture and what is computed of it once.
struct TruePicture<'a> {
    model: &'a SensorModel,
    camera: &'a Pinhole,
    seed: u64,
    /// 1/m, 0 = nothing; `[height, width]`.
    inverse_depth: Vec<f32>,
    /// Noise of variance 1; `[height, width]`.
    noise: Vec<f32>,
    /// Edge of the matched patch in pixels of this picture, odd.
    window: usize,
    /// Pixels of this picture per pixel of the imager.
    scale: f32,
}

impl<'a> TruePicture<'a> {
    fn new(model: &'a SensorModel, depth_m: &[f32], camera: &'a Pinhole, seed: u64) -> Self {
        let scale = camera.fx as f32 / model.focal_px;
        let window = 2 * ((model.window_px * scale - 1.0) / 2.0).round().max(0.0) as usize + 1;
        let inverse_depth = depth_m.iter().map(|z| if *z > 0.0 { 1.0 / z } else { 0.0 }).collect();
        let noise = correlated(camera.width, depth_m.len() / camera.width, window, seed);
        Self { model, camera, seed, inverse_depth, noise, window, scale }
    }

    /// Depth reported at a pixel that has some, metres; 0 = none.
    #[inline]
    fn reading(&self, u: usize, v: usize) -> f32 {
        let (width, at) = (self.camera.width, v * self.camera.width + u);
        let here = self.inverse_depth[at];
        // Beyond the picture's edge the surface is taken to go on.
        let neighbour = |inside: bool, index: usize| if inside { self.inverse_depth[index] } else { here };
        let along_x = [neighbour(u > 0, at.wrapping_sub(1)), neighbour(u + 1 < width, at + 1)];
        let along_y = [neighbour(v > 0, at.wrapping_sub(width)), neighbour(at + width < self.inverse_depth.len(), at + width)];
        let lens = [self.camera.fx as f32, self.camera.fy as f32];
        let ray = [(u as f32 - self.camera.cx as f32) / lens[0], (v as f32 - self.camera.cy as f32) / lens[1]];
        let surface = PixelNeighbourhood::new(here, along_x, along_y, lens, ray);
        let inverse = if surface.is_edge { self.at_edge(u, v, &surface) } else { here };
        if inverse <= 0.0 {
            return 0.0;
        }
        let mut variance = self.model.noise_px * self.model.noise_px;
        if surface.cosine_squared < SLANTED {
            let angle = surface.cosine_squared.sqrt().acos();
            if self.is_grazing(angle, at) {
                return 0.0;
            }
            let share = angle / (std::f32::consts::FRAC_PI_2 - angle);
            // From depth to disparity: the derivative of `px_m / z`.
            let slant_px = self.model.slant_noise_m * share * share * inverse.sqrt() * self.model.px_m() * inverse * inverse;
            variance += slant_px * slant_px;
        }
        self.measured(inverse * self.model.px_m() + variance.sqrt() * self.noise[at])
    }

    /// The inverse depth seen at a jump: of a pixel beside, of something between the two surfaces, or none (0).
    #[cold]
    fn at_edge(&self, u: usize, v: usize, surface: &PixelNeighbourhood) -> f32 {
        let at = v * self.camera.width + u;
        let [lost, between, x, y] = shares(bits(self.seed, NoiseStream::Pixel, at));
        if lost < self.model.edge_lost {
            return 0.0;
        }
        // Nothing on one side: there is no second depth to mix with.
        if lost < self.model.edge_lost + self.model.edge_mixed && surface.least > 0.0 {
            return surface.least + between * (surface.greatest - surface.least);
        }
        // Two more numbers from the bits that chose nothing so far.
        let [x2, y2, ..] = shares(bits(self.seed, NoiseStream::Pixel, at + self.inverse_depth.len()));
        let wander = |a: f32, b: f32| (triangular(a, b) * self.model.wander_px * self.scale).round() as isize;
        let column = u.saturating_add_signed(wander(x, x2)).min(self.camera.width - 1);
        let row = v.saturating_add_signed(wander(y, y2)).min(self.inverse_depth.len() / self.camera.width - 1);
        self.inverse_depth[row * self.camera.width + column]
    }

    /// Whether a reading is lost to the surface's angle; more and more of them are between the two limits.
    fn is_grazing(&self, angle_rad: f32, at: usize) -> bool {
        let [from, to] = self.model.grazing_rad;
        if angle_rad <= from {
            return false;
        }
        let [.., share] = shares(bits(self.seed, NoiseStream::Pixel, at + 2 * self.inverse_depth.len()));
        angle_rad >= to || share < (angle_rad - from) / (to - from)
    }

    /// Depth of a disparity as the camera rounds it, metres; 0 outside its range.
    fn measured(&self, disparity_px: f32) -> f32 {
        let step = self.model.step_px;
        let rounded = if step > 0.0 { (disparity_px / step).round() * step } else { disparity_px };
        let depth = self.model.px_m() / rounded;
        if rounded > 0.0 && (self.model.range_m[0]..=self.model.range_m[1]).contains(&depth) { depth } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Vector3};
    use proptest::prelude::*;

    const CAMERA: Pinhole = Pinhole { width: 320, height: 240, fx: 290.0, fy: 290.0, cx: 159.5, cy: 119.5 };

    fn wall(z: f32) -> Vec<f32> {
        vec![z; CAMERA.width * CAMERA.height]
    }

    fn sensed(model: &SensorModel, mut depth_m: Vec<f32>, seed: u64) -> Vec<f32> {
        model.disturb(&mut depth_m, &CAMERA, seed);
        depth_m
    }

    /// Depth of the plane through (0, 0, z) turned by `turn` about y, metres.
    fn slanted(z: f32, turn: f32) -> Vec<f32> {
        let depth = |u: usize| z / (1.0 - turn.tan() * (u as f32 - 159.5) / 290.0);
        (0..CAMERA.width * CAMERA.height).map(|i| depth(i % CAMERA.width)).map(|z| if z > 0.0 { z } else { 0.0 }).collect()
    }

    /// Deviation of depth from the plane fitted to the readings, metres, root mean square.
    fn plane_rms_m(depth_m: &[f32]) -> f64 {
        let rows = || {
            depth_m
                .iter()
                .enumerate()
                .filter(|(_, z)| **z > 0.0)
                .map(|(i, z)| (Vector3::new((i % CAMERA.width) as f64 / 100.0, (i / CAMERA.width) as f64 / 100.0, 1.0), f64::from(*z)))
        };
        let normal: Matrix3<f64> = rows().map(|(a, _)| a * a.transpose()).sum();
        let plane = normal.try_inverse().unwrap() * rows().map(|(a, z)| a * z).sum::<Vector3<f64>>();
        (rows().map(|(a, z)| (z - a.dot(&plane)).powi(2)).sum::<f64>() / rows().count() as f64).sqrt()
    }

    #[test]
    fn the_structured_light_camera_is_as_noisy_as_the_published_curves_say() {
        for z in [0.6f64, 1.0, 1.5, 2.0] {
            let rms = plane_rms_m(&sensed(&SensorModel::structured_light(), wall(z as f32), 3));
            let (khoshelham, nguyen) = (1.42e-3 * z * z, 1.2e-3 + 1.9e-3 * (z - 0.4).powi(2));
            assert!(rms > 0.9 * khoshelham && rms < 1.1 * nguyen.max(khoshelham), "{rms} at {z}, published {khoshelham} and {nguyen}");
        }
    }

    #[test]
    fn the_active_stereo_camera_is_as_noisy_as_its_makers_formula_says() {
        let model = SensorModel::active_stereo();
        for z in [0.6f64, 1.0, 1.5, 2.0] {
            let rms = plane_rms_m(&sensed(&model, wall(z as f32), 3));
            let formula = |subpixel: f64| z * z * subpixel / f64::from(model.focal_px * model.baseline_m);
            assert!(rms > formula(0.06) && rms < formula(0.08), "{rms} at {z}, formula {} to {}", formula(0.06), formula(0.08));
        }
    }

    #[test]
    fn readings_lie_on_the_steps_of_the_disparity() {
        for model in [SensorModel::structured_light(), SensorModel::active_stereo()] {
            let readings = sensed(&model, wall(1.2), 5);
            let mut steps: Vec<i64> = Vec::new();
            for z in readings.iter().filter(|z| **z > 0.0) {
                let step = f64::from(model.px_m()) / f64::from(*z) / f64::from(model.step_px);
                assert!((step - step.round()).abs() < 1e-3, "{z} is between steps");
                steps.push(step.round() as i64);
            }
            steps.sort_unstable();
            steps.dedup();
            assert!(steps.len() >= 3, "{steps:?}");
        }
        // Khoshelham & Elberink: 2.85 mm at a metre.
        let model = SensorModel::structured_light();
        let step_m = model.step_px / model.px_m();
        assert!((step_m - 2.85e-3).abs() < 0.02e-3, "{step_m}");
    }

    #[test]
    fn slant_adds_noise_and_grazing_surfaces_have_no_reading() {
        let model = SensorModel { dropout: 0.0, ..SensorModel::structured_light() };
        let lost = |turn: f32| {
            let truth = slanted(1.0, turn);
            let near_axis = |i: &usize| (i % 320).abs_diff(160) < 20;
            let readings = sensed(&model, truth, 2);
            (0..readings.len()).filter(near_axis).filter(|i| readings[*i] == 0.0).count() as f64 / (39.0 * 240.0)
        };
        assert_eq!(lost(0.0), 0.0);
        assert_eq!(lost(1.0), 0.0);
        assert!((0.2..0.8).contains(&lost(-1.3)), "{}", lost(-1.3));
        assert!(lost(-1.45) > 0.99);
        let deviation = |turn: f32| {
            let truth = slanted(0.7, turn);
            let readings = sensed(&model, truth.clone(), 2);
            let errors: Vec<f32> =
                (0..truth.len()).filter(|i| (i % 320).abs_diff(160) < 10 && readings[*i] > 0.0).map(|i| readings[i] - truth[i]).collect();
            (errors.iter().map(|e| e * e).sum::<f32>() / errors.len() as f32).sqrt()
        };
        assert!(deviation(-1.15) > 1.3 * deviation(0.0), "{} {}", deviation(-1.15), deviation(0.0));
    }

    #[test]
    fn the_shadow_of_a_thing_is_left_of_it_and_as_wide_as_the_baseline_makes_it() {
        let (near, far) = (0.8, 1.2);
        let mut truth = wall(far);
        for v in 60..180 {
            truth[v * 320 + 120..v * 320 + 200].fill(near);
        }
        let model = SensorModel { dropout: 0.0, edge_lost: 0.0, edge_mixed: 0.0, wander_px: 0.0, ..SensorModel::structured_light() };
        let readings = sensed(&model, truth, 1);
        let expected = 290.0 * 0.075 * (1.0 / near - 1.0 / far);
        for v in 62..178 {
            let lost: Vec<usize> = (0..320).filter(|u| readings[v * 320 + u] == 0.0).collect();
            assert!((lost.len() as f32 - expected).abs() <= 1.0, "{} columns, expected {expected}", lost.len());
            assert_eq!(lost.last(), Some(&119));
        }
    }

    #[test]
    fn silhouettes_lose_readings_and_mix_depths_but_never_beyond_the_two() {
        let mut truth = wall(1.2);
        truth.iter_mut().enumerate().filter(|(i, _)| i % 320 >= 150).for_each(|(_, z)| *z = 0.9);
        let model =
            SensorModel { noise_px: 0.0, step_px: 0.0, dropout: 0.0, shadows: false, edge_mixed: 0.3, ..SensorModel::active_stereo() };
        let readings = sensed(&SensorModel { blind_band: false, ..model }, truth, 9);
        let seam: Vec<f32> = (0..240).flat_map(|v| [readings[v * 320 + 149], readings[v * 320 + 150]]).collect();
        let share = |keep: &dyn Fn(f32) -> bool| seam.iter().filter(|z| keep(**z)).count() as f64 / seam.len() as f64;
        assert!(seam.iter().all(|z| *z == 0.0 || (0.899..1.201).contains(z)));
        assert!((share(&|z| z == 0.0) - 0.1).abs() < 0.06, "{}", share(&|z| z == 0.0));
        assert!((share(&|z| (0.905..1.195).contains(&z)) - 0.3).abs() < 0.08);
    }

    #[test]
    fn the_ideal_camera_reports_true_depth() {
        let truth = slanted(1.0, 0.4);
        assert_eq!(sensed(&SensorModel::ideal(), truth.clone(), 1), truth);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn nothing_stays_nothing_and_readings_are_in_range(seed: u64, z in 0.05f32..8.0, stereo: bool) {
            let model = if stereo { SensorModel::active_stereo() } else { SensorModel::structured_light() };
            let mut truth = wall(z);
            truth.iter_mut().step_by(7).for_each(|z| *z = 0.0);
            let readings = sensed(&model, truth.clone(), seed);
            for (reading, truth) in readings.iter().zip(&truth) {
                prop_assert!(*reading == 0.0 || (*truth > 0.0 && (model.range_m[0]..=model.range_m[1]).contains(reading)));
            }
        }

        #[test]
        fn a_pixels_noise_does_not_depend_on_what_others_show(seed: u64) {
            let model = SensorModel { shadows: false, blind_band: false, ..SensorModel::structured_light() };
            let whole = sensed(&model, wall(1.0), seed);
            let mut half = wall(1.0);
            half[160 * 320..].fill(2.0);
            let half = sensed(&model, half, seed);
            prop_assert_eq!(&whole[..158 * 320], &half[..158 * 320]);
        }
    }
}
