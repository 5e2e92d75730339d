//! A camera's parameters, the two cameras that are known by name, and a random one near them.

use rand::{Rng, RngExt};

/// A depth camera that measures disparity. Pixels are those of its own imager (`focal_px` wide per unit of tangent), whatever size the
/// picture has that it is applied to: a picture of half the size is one that was halved after measuring.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorModel {
    /// Focal length of the imager, pixels. Higher: finer depth.
    pub focal_px: f32,
    /// Where the projector or second imager is along the picture's x axis, metres; positive is right, which puts shadows to the left of things.
    pub baseline_m: f32,
    /// Standard deviation of the disparity on a surface that faces the camera, pixels, before rounding.
    pub noise_px: f32,
    /// Edge of the square patch that is matched, pixels: noise is correlated as far as patches overlap.
    pub window_px: f32,
    /// Step of the disparity, pixels; 0 = none.
    pub step_px: f32,
    /// Noise added by slant, metres at 1 m and 45°; grows with (θ / (90° − θ))².
    pub slant_noise_m: f32,
    /// Angle between a surface's normal and the line of sight from which on readings are lost, and from which on all are, radians.
    pub grazing_rad: [f32; 2],
    /// Standard deviation of a silhouette's place in the picture, pixels.
    pub wander_px: f32,
    /// Share of readings that are lost at jumps in depth.
    pub edge_lost: f32,
    /// Share of readings at jumps in depth that lie somewhere between the two depths.
    pub edge_mixed: f32,
    /// Share of patches without a reading for no reason that geometry shows (reflection, dark color, dust).
    pub dropout: f32,
    /// Nearest and farthest depth, metres.
    pub range_m: [f32; 2],
    /// Whether what the projector or second imager does not see is lost.
    pub shadows: bool,
    /// Whether what lies outside the second imager's picture is lost too: true for two imagers, false for a projector that reaches wider.
    pub blind_band: bool,
}

impl SensorModel {
    /// The names that [`SensorModel::named`] knows.
    pub const NAMES: [&str; 3] = ["structured_light", "active_stereo", "ideal"];

    /// A camera that projects a pattern and finds it again: Kinect v1, ASUS Xtion, PrimeSense Carmine.
    pub const fn structured_light() -> Self {
        Self {
            focal_px: 586.0,
            baseline_m: 0.075,
            noise_px: 0.055,
            window_px: 9.0,
            step_px: 0.125,
            slant_noise_m: 1e-4,
            grazing_rad: [1.20, 1.40],
            wander_px: 0.8,
            edge_lost: 0.25,
            edge_mixed: 0.05,
            dropout: 0.004,
            range_m: [0.4, 5.0],
            shadows: true,
            blind_band: false,
        }
    }

    /// A camera that compares two infrared pictures of a projected pattern: Intel RealSense D415 at 848 × 480, 65° wide.
    pub const fn active_stereo() -> Self {
        Self {
            focal_px: 665.0,
            baseline_m: 0.055,
            noise_px: 0.07,
            window_px: 7.0,
            step_px: 1.0 / 32.0,
            slant_noise_m: 1e-4,
            grazing_rad: [1.25, 1.45],
            wander_px: 1.0,
            edge_lost: 0.10,
            edge_mixed: 0.20,
            dropout: 0.006,
            range_m: [0.31, 6.0],
            shadows: true,
            blind_band: true,
        }
    }

    /// A camera without faults: reports true depth as it is.
    pub const fn ideal() -> Self {
        Self {
            noise_px: 0.0,
            step_px: 0.0,
            slant_noise_m: 0.0,
            grazing_rad: [f32::MAX; 2],
            wander_px: 0.0,
            edge_lost: 0.0,
            edge_mixed: 0.0,
            dropout: 0.0,
            range_m: [0.0, f32::MAX],
            shadows: false,
            blind_band: false,
            ..Self::structured_light()
        }
    }

    /// The camera of that name, one of [`SensorModel::NAMES`].
    pub fn named(name: &str) -> Option<Self> {
        match name {
            "structured_light" => Some(Self::structured_light()),
            "active_stereo" => Some(Self::active_stereo()),
            "ideal" => Some(Self::ideal()),
            _ => None,
        }
    }

    /// A random camera for training: either kind, better and worse than the named one, now and then mounted upside down.
    ///
    /// Its near limit is lower than the named ones': how near a camera is put is a matter of where it is mounted, and the views say that.
    pub fn jittered(rng: &mut impl Rng) -> Self {
        let mut model = if rng.random_bool(0.5) { Self::structured_light() } else { Self::active_stereo() };
        let mut scaled = |value: &mut f32, low: f32, high: f32| *value *= rng.random_range(low..=high);
        scaled(&mut model.focal_px, 0.9, 1.15);
        scaled(&mut model.baseline_m, 0.8, 1.2);
        scaled(&mut model.noise_px, 0.5, 1.6);
        scaled(&mut model.window_px, 0.6, 1.4);
        scaled(&mut model.step_px, 0.3, 1.0);
        scaled(&mut model.slant_noise_m, 0.3, 2.0);
        scaled(&mut model.grazing_rad[0], 0.85, 1.1);
        scaled(&mut model.grazing_rad[1], 0.95, 1.05);
        scaled(&mut model.wander_px, 0.3, 1.3);
        scaled(&mut model.edge_lost, 0.2, 2.0);
        scaled(&mut model.edge_mixed, 0.2, 2.0);
        scaled(&mut model.dropout, 0.0, 4.0);
        model.grazing_rad[0] = model.grazing_rad[0].min(model.grazing_rad[1]);
        model.range_m[0] = 0.25;
        if rng.random_bool(0.2) {
            model.baseline_m = -model.baseline_m;
        }
        model
    }

    /// Disparity times depth, pixels · metres.
    pub(crate) fn px_m(&self) -> f32 {
        self.focal_px * self.baseline_m.abs()
    }
}

impl Default for SensorModel {
    fn default() -> Self {
        Self::structured_light()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    #[test]
    fn every_name_is_known_and_no_other() {
        assert!(SensorModel::NAMES.iter().all(|name| SensorModel::named(name).is_some()));
        assert_eq!(SensorModel::named("lidar"), None);
    }

    #[test]
    fn jittered_cameras_differ_and_stay_in_range() {
        let mut rng = Pcg64::seed_from_u64(1);
        let models: Vec<SensorModel> = (0..200).map(|_| SensorModel::jittered(&mut rng)).collect();
        for model in &models {
            assert!(model.edge_lost + model.edge_mixed < 1.0 && model.dropout < 0.05, "{model:?}");
            assert!(model.grazing_rad[0] <= model.grazing_rad[1] && model.grazing_rad[1] < 1.56, "{model:?}");
        }
        assert!(models.iter().any(|m| m.baseline_m < 0.0) && models.iter().any(|m| m.blind_band) && models.iter().any(|m| !m.blind_band));
    }
}
