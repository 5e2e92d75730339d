//! What rises above the furniture.
//!
//! Every reading is compared with the plane of the furniture under it, covered or not. Near that plane heights are averaged with their like
//! around them, and what is left of the noise is measured on the furniture itself: a reading that rises by several times that is a seed,
//! and what rises by a little less beside a seed belongs to it. So a thin book is found where the camera is near, and the noise of a
//! far table is not.

use repose_geometry::{Image, Point3};

use crate::readings::noise::DepthNoise;
use crate::readings::point_map::{PointMap, is_reading};
use crate::settings::{ForegroundSettings, LevelSettings};
use crate::supports::extent::Extent;
use crate::supports::levels::{Level, LevelKind, Levels};

/// The rise of a picture's readings above the furniture.
#[derive(Debug, Clone)]
pub struct Foreground {
    /// Which readings rise above it.
    pub rises: Image<bool>,
    /// How far, metres, averaged over their like; NaN where there is none below.
    pub rise_m: Image<f32>,
    /// The readings in the world, their heights averaged.
    pub in_world: PointMap,
    /// Which readings lie over the outline of what they rise above, or very near to it.
    pub inside: Image<bool>,
    /// Noise of the averaged heights.
    pub noise: DepthNoise,
}

/// A level with its extent looked up.
struct Support<'a> {
    level: &'a Level,
    extent: Extent,
}

/// The foreground of a picture; `in_camera` and `in_world` are the same points, `camera_m` the camera's height in the world.
pub fn find(
    in_camera: &PointMap,
    in_world: &PointMap,
    levels: &Levels,
    camera_m: f32,
    settings: &ForegroundSettings,
    level_settings: &LevelSettings,
) -> Foreground {
    let (width, height) = (in_world.width(), in_world.height());
    let mut supports: Vec<Support<'_>> =
        levels.furniture().map(|level| Support { level, extent: Extent::new(&level.extent, settings.beyond_m) }).collect();
    // The highest furniture under a reading is what it stands on.
    supports.reverse();
    let mut rise_m = Image::filled(width, height, f32::NAN);
    let mut inside = Image::filled(width, height, false);
    let pixels = in_world.pixels().iter().zip(in_camera.pixels()).enumerate().filter(|(_, (p, _))| is_reading(p));
    for (i, (p, seen)) in pixels {
        let band_m = level_settings.least_clearance_m + level_settings.clearance_deviations * levels.noise.height_m(seen.z, camera_m - p.z);
        let Some((rise, over)) = rise_of(p, band_m, &supports, settings) else { continue };
        rise_m.pixels_mut()[i] = rise;
        inside.pixels_mut()[i] = over;
    }
    let (averaged, noise) = averaged(&rise_m, in_camera, in_world, camera_m, levels.noise, settings);
    let rises = grown(&averaged, in_camera, in_world, camera_m, noise, settings);
    let mut points = in_world.clone();
    for (p, (averaged, rise)) in points.pixels_mut().iter_mut().zip(averaged.pixels().iter().zip(rise_m.pixels())) {
        p.z += if averaged.is_nan() { 0.0 } else { averaged - rise };
    }
    Foreground { rises, rise_m: averaged, in_world: points, inside, noise }
}

/// How far a point is above the furniture that it stands on, and whether it lies over that furniture's outline; `None` where there is none, and
/// for what is the furniture's own underneath.
fn rise_of(p: &Point3<f32>, band_m: f32, supports: &[Support<'_>], settings: &ForegroundSettings) -> Option<(f32, bool)> {
    let mut roofed = false;
    let mut beyond: Option<f32> = None;
    for support in supports {
        let margin_m = support.extent.margin_m(p);
        let rise = support.level.plane.rise_m(p);
        if rise < -band_m {
            roofed |= margin_m > -settings.slack_m;
            continue;
        }
        // A table's legs and sides are no objects on the floor.
        if roofed && support.level.kind == LevelKind::Floor {
            return None;
        }
        if margin_m > -settings.slack_m {
            return Some((rise, true));
        }
        if margin_m > -settings.beyond_m && support.level.kind != LevelKind::Floor {
            beyond = beyond.or(Some(rise));
        }
    }
    beyond.map(|rise| (rise, false))
}

/// Heights averaged over their like around them, and the noise that is left.
fn averaged(
    rise_m: &Image<f32>,
    in_camera: &PointMap,
    in_world: &PointMap,
    camera_m: f32,
    noise: DepthNoise,
    settings: &ForegroundSettings,
) -> (Image<f32>, DepthNoise) {
    /// Every other pixel: readings of one matched patch err together, so that their neighbours add nothing.
    const STEPS: [isize; 3] = [-2, 0, 2];
    /// Of so many readings one tells the noise.
    const TOLD: usize = 5;
    let (width, height) = (rise_m.width() as isize, rise_m.height() as isize);
    let (rises, one) = (rise_m.pixels(), DepthNoise { per_m2: 1.0 });
    let mut averaged = rise_m.clone();
    let mut shares = Vec::new();
    for (i, out) in averaged.pixels_mut().iter_mut().enumerate() {
        let rise = rises[i];
        if rise.is_nan() {
            continue;
        }
        let unit_m = one.height_m(in_camera.pixels()[i].z, camera_m - in_world.pixels()[i].z).max(0.01);
        let like_m = settings.like_deviations * noise.per_m2 * unit_m;
        let (u, v) = (i as isize % width, i as isize / width);
        let inside = u >= 2 && v >= 2 && u + 2 < width && v + 2 < height;
        let (mut sum, mut count) = (0.0f32, 0.0f32);
        for dv in STEPS {
            for du in STEPS {
                if inside || (0..width).contains(&(u + du)) && (0..height).contains(&(v + dv)) {
                    let other = rises[((v + dv) * width + u + du) as usize];
                    let like = (other - rise).abs() <= like_m;
                    sum += if like { other } else { 0.0 };
                    count += if like { 1.0 } else { 0.0 };
                }
            }
        }
        *out = sum / count;
        if i % TOLD == 0 && rise.abs() <= like_m {
            shares.push(*out / unit_m);
        }
    }
    let left = DepthNoise::explaining(shares).map_or(noise.per_m2, |left| left.per_m2);
    (averaged, DepthNoise { per_m2: left.clamp(0.25 * noise.per_m2, noise.per_m2) })
}

/// What rises clearly, and what beside it rises a little less.
fn grown(
    rise_m: &Image<f32>,
    in_camera: &PointMap,
    in_world: &PointMap,
    camera_m: f32,
    noise: DepthNoise,
    settings: &ForegroundSettings,
) -> Image<bool> {
    let (width, height) = (rise_m.width(), rise_m.height());
    let mut grown = Image::filled(width, height, false);
    let mut open = Vec::new();
    let mut may = vec![false; width * height];
    for (i, rise) in rise_m.pixels().iter().enumerate() {
        let sigma_m = noise.height_m(in_camera.pixels()[i].z, camera_m - in_world.pixels()[i].z);
        // False without furniture below.
        may[i] = *rise > settings.least_m + settings.belongs_deviations * sigma_m;
        if *rise > settings.least_m + settings.seed_deviations * sigma_m {
            grown.pixels_mut()[i] = true;
            open.push(i);
        }
    }
    while let Some(i) = open.pop() {
        let (u, v) = (i % width, i / width);
        let beside =
            [(u > 0).then(|| i - 1), (u + 1 < width).then(|| i + 1), (v > 0).then(|| i - width), (v + 1 < height).then(|| i + width)];
        for j in beside.into_iter().flatten() {
            if may[j] && !grown.pixels()[j] {
                grown.pixels_mut()[j] = true;
                open.push(j);
            }
        }
    }
    grown
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::readings::point_map::transformed;
    use crate::settings::Settings;
    use crate::supports::levels::{self, Viewpoint};
    use crate::supports::surfaces;
    use crate::synthetic::{Solid, cast};
    use rand::{RngExt, SeedableRng};
    use repose_geometry::transform::look_at;
    use repose_geometry::{Pinhole, Vector3};

    const CAMERA: Pinhole = Pinhole { width: 320, height: 240, fx: 262.0, fy: 262.0, cx: 159.5, cy: 119.5 };

    /// Of each solid, the share of its pixels that rises, seen from `distance_m` with noise of `per_m2`.
    fn rising(solids: &[Solid], distance_m: f64, per_m2: f64) -> Vec<f64> {
        let world_from_camera = look_at(&Point3::new(0.0, -0.6 * distance_m, 0.8 * distance_m), &Point3::origin(), &Vector3::z());
        let seen = cast(solids, &CAMERA, &world_from_camera);
        let mut rng = rand_pcg::Pcg64::seed_from_u64(7);
        let mut in_camera = PointMap::filled(320, 240, crate::readings::point_map::MISSING);
        for (i, p) in in_camera.pixels_mut().iter_mut().enumerate() {
            let noise = (0..12).map(|_| rng.random_range(-0.5..0.5)).sum::<f64>();
            let Some((depth, _)) = seen.pixels()[i] else { continue };
            *p = CAMERA.unproject((i % 320) as f64, (i / 320) as f64, depth + per_m2 * noise * depth * depth).cast();
        }
        let in_world = transformed(&in_camera, &world_from_camera);
        let settings = Settings::default();
        let everything = in_world.pixels().iter().filter(|p| is_reading(p)).map(|p| (*p, 0));
        let viewpoint = Viewpoint::new(&CAMERA, &world_from_camera);
        let pieces = surfaces::find(everything, &settings.surfaces, settings.levels.max_slope);
        let levels = levels::find(&pieces, &in_camera, &in_world, &viewpoint, &settings.levels);
        let found = find(&in_camera, &in_world, &levels, viewpoint.camera.z, &settings.components.foreground, &settings.levels);
        let share = |solid: usize| {
            let own: Vec<usize> = (0..320 * 240).filter(|i| seen.pixels()[*i].is_some_and(|(_, k)| k == solid)).collect();
            own.iter().filter(|i| found.rises.pixels()[**i]).count() as f64 / own.len().max(1) as f64
        };
        (0..solids.len()).map(share).collect()
    }

    #[test]
    fn a_notebook_rises_where_the_camera_is_near_and_the_noise_of_a_table_does_not() {
        let solids = [Solid::table(0.0), Solid::cuboid([0.0, 0.0, 0.004], [0.08, 0.1, 0.004])];
        for (distance_m, per_m2) in [(0.5, 0.0015), (0.8, 0.0015), (1.2, 0.001)] {
            let shares = rising(&solids, distance_m, per_m2);
            assert!(shares[1] > 0.85 && shares[0] < 0.01, "{distance_m} m: {shares:?}");
        }
        let far = rising(&solids[..1], 1.6, 0.004);
        assert!(far[0] < 0.01, "{far:?}");
    }
}
