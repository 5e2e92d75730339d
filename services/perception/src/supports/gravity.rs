//! Which way is up when nobody says: the main support plane, found by RANSAC in the camera frame.
//!
//! The plane is the largest one that the camera is above, that has little beneath it, and whose normal is where up can be for a
//! camera that is held upright (a wall is as large, but faces a camera that looks down from the wrong side). A camera that
//! looks straight down sees the table where a level one sees a wall: what could lie below a level one goes first. The world is then
//! levelled on it: z = 0 on the plane, the origin below the camera, the camera's viewer looking along +y.

use rand::RngExt;
use rand_pcg::Pcg64;
use repose_geometry::viewer::away_in_camera;
use repose_geometry::{Isometry3, Plane, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

use crate::readings::point_map::{PointMap, is_reading};
use crate::settings::GravitySettings;

/// Rounds of least squares on the winner's readings; the third changes the normal by less than a hundredth of a degree.
const REFINEMENTS: usize = 3;

/// A plane with a normal whose z is below this is faced squarely: the table of a camera that looks down, or the wall before a level one.
const FACING: f64 = -0.9;
/// A plane with a normal whose y is below this would lie below a level camera.
const BELOW: f64 = -0.7;

/// The main support plane in the camera frame, normal towards the camera; `None` when no plane qualifies.
pub fn support_plane(in_camera: &PointMap, settings: &GravitySettings, rng: &mut Pcg64) -> Option<Plane> {
    let sample = sample_readings(in_camera, settings.sample_points);
    if sample.len() < 3 {
        return None;
    }
    let least = (settings.min_share * sample.len() as f64).ceil() as usize;
    let columns = Columns::of(&sample, settings);
    let (mut best, mut best_below) = (None, None);
    for _ in 0..settings.iterations {
        let [a, b, c] = std::array::from_fn(|_| sample[rng.random_range(0..sample.len())].cast::<f64>());
        let Some(plane) = Plane::through(&a, &b, &c).map(towards_camera).filter(|p| can_be_up(&p.normal, settings)) else { continue };
        let (on, below) = columns.count(&plane);
        let qualifies = on as usize >= least.max(settings.min_readings) && f64::from(below) <= settings.max_below_ratio * f64::from(on);
        if qualifies {
            best = fuller(best, (on, plane));
            if plane.normal.y < BELOW {
                best_below = fuller(best_below, (on, plane));
            }
        }
    }
    let (_, fullest) = best?;
    let mut plane = match best_below {
        Some((_, below)) if fullest.normal.z < FACING => below,
        _ => fullest,
    };
    for _ in 0..REFINEMENTS {
        let on: Vec<Point3<f32>> = sample.iter().filter(|p| is_on(&plane, p, settings)).copied().collect();
        plane = towards_camera(Plane::fit(on.iter())?);
    }
    can_be_up(&plane.normal, settings).then_some(plane)
}

/// Of two planes the one that holds more readings, the first of equal ones.
fn fuller(best: Option<(u32, Plane)>, other: (u32, Plane)) -> Option<(u32, Plane)> {
    best.filter(|(most, _)| *most >= other.0).or(Some(other))
}

/// The camera's pose in the world that a support plane defines; the plane's normal points towards the camera.
pub fn level(plane_in_camera: &Plane) -> Isometry3<f64> {
    let up = plane_in_camera.normal.into_inner();
    let level = |v: Vector3<f64>| v - up * up.dot(&v);
    let away = level(away_in_camera(&up)).normalize();
    let right = away.cross(&up);
    let world_from_camera = Rotation3::from_matrix_unchecked(nalgebra::Matrix3::from_columns(&[right, away, up]).transpose());
    let height_m = -plane_in_camera.offset_m;
    Isometry3::from_parts(Translation3::new(0.0, 0.0, height_m), UnitQuaternion::from_rotation_matrix(&world_from_camera))
}

/// Up to `count` readings, spread evenly over the picture's readings.
fn sample_readings(points: &PointMap, count: usize) -> Vec<Point3<f32>> {
    let readings: Vec<Point3<f32>> = points.pixels().iter().filter(|p| is_reading(p)).copied().collect();
    let stride = readings.len().div_ceil(count.max(1)).max(1);
    readings.into_iter().step_by(stride).collect()
}

fn towards_camera(plane: Plane) -> Plane {
    // The camera is the origin: it is above when its signed distance, minus the offset, is positive.
    if plane.offset_m > 0.0 { plane.flipped() } else { plane }
}

/// Whether a normal can be up for an upright camera: the picture's up is -y, and straight down turns it into -z.
fn can_be_up(normal: &Vector3<f64>, settings: &GravitySettings) -> bool {
    normal.x.abs() <= settings.max_roll_rad.sin() && normal.y <= settings.max_past_vertical_rad.sin()
}

fn is_on(plane: &Plane, p: &Point3<f32>, settings: &GravitySettings) -> bool {
    plane.signed_distance(&p.cast::<f64>()).abs() <= f64::from(tolerance_m(p, settings))
}

fn tolerance_m(p: &Point3<f32>, settings: &GravitySettings) -> f32 {
    settings.tolerance_m + settings.tolerance_per_m2 * p.z * p.z
}

/// Readings coordinate by coordinate, each with its tolerance: hundreds of planes are counted on them, many readings at once.
struct Columns {
    x: Vec<f32>,
    y: Vec<f32>,
    z: Vec<f32>,
    tolerance_m: Vec<f32>,
}

impl Columns {
    fn of(sample: &[Point3<f32>], settings: &GravitySettings) -> Self {
        let column = |of: &dyn Fn(&Point3<f32>) -> f32| sample.iter().map(of).collect();
        Self { x: column(&|p| p.x), y: column(&|p| p.y), z: column(&|p| p.z), tolerance_m: column(&|p| tolerance_m(p, settings)) }
    }

    /// How many readings lie on the plane, and how many clearly below it.
    fn count(&self, plane: &Plane) -> (u32, u32) {
        let normal: Vector3<f32> = plane.normal.into_inner().cast();
        let offset_m = plane.offset_m as f32;
        let (mut on, mut below) = (0, 0);
        for (((x, y), z), tolerance_m) in self.x.iter().zip(&self.y).zip(&self.z).zip(&self.tolerance_m) {
            let distance_m = normal.x * x + normal.y * y + normal.z * z - offset_m;
            on += u32::from(distance_m.abs() <= *tolerance_m);
            below += u32::from(distance_m < -3.0 * tolerance_m);
        }
        (on, below)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rand::SeedableRng;
    use repose_geometry::transform::look_at;
    use repose_geometry::{Pinhole, ViewerFrame};

    use crate::synthetic::{Solid, render};

    const CAMERA: Pinhole = Pinhole { width: 160, height: 120, fx: 130.0, fy: 130.0, cx: 79.5, cy: 59.5 };

    fn find(in_camera: &PointMap) -> Option<Isometry3<f64>> {
        let plane = support_plane(in_camera, &GravitySettings::default(), &mut Pcg64::seed_from_u64(1))?;
        Some(level(&plane))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn the_levelled_world_agrees_with_the_true_one(x in -0.6..0.6f64, y in -1.0..-0.4f64, z in 0.4..1.2f64, roll in -0.2..0.2f64) {
            let up = Vector3::new(roll, 0.0, 1.0);
            let truth = look_at(&Point3::new(x, y, z), &Point3::origin(), &up);
            let solids = [Solid::table(0.0), Solid::cuboid([0.1, 0.05, 0.1], [0.06, 0.08, 0.1])];
            let estimated = find(&render(&solids, &CAMERA, &truth)).unwrap();
            let up_in_camera = |world_from_camera: &Isometry3<f64>| world_from_camera.inverse() * Vector3::z();
            prop_assert!(up_in_camera(&truth).angle(&up_in_camera(&estimated)) < 0.01);
            prop_assert!((estimated.translation.z - z).abs() < 0.01);
            prop_assert!(estimated.translation.x.abs() < 1e-12 && estimated.translation.y.abs() < 1e-12);
            prop_assert!(ViewerFrame::from_camera(&estimated).yaw_rad().abs() < 1e-9);
        }
    }

    #[test]
    fn a_wall_behind_a_smaller_table_is_not_taken_for_it() {
        let solids = [Solid::cuboid([0.0, 0.0, -0.02], [0.5, 0.4, 0.02]), Solid::cuboid([0.0, 1.0, 0.5], [5.0, 0.1, 5.0])];
        let truth = look_at(&Point3::new(0.0, -1.0, 0.6), &Point3::new(0.0, 0.2, 0.1), &Vector3::z());
        let estimated = find(&render(&solids, &CAMERA, &truth)).unwrap();
        assert!((estimated.translation.z - 0.6).abs() < 0.01, "height over the table, got {}", estimated.translation.z);
    }

    #[test]
    fn the_wall_before_a_level_camera_is_not_taken_for_the_table_and_the_table_straight_below_one_is() {
        let wall = Solid::cuboid([0.0, 1.1, 1.0], [5.0, 0.1, 5.0]);
        let level = look_at(&Point3::new(0.0, -1.0, 0.35), &Point3::new(0.0, 0.0, 0.35 - 4f64.to_radians().tan()), &Vector3::z());
        let estimated = find(&render(&[Solid::table(0.0), wall], &CAMERA, &level)).unwrap();
        assert!((estimated.translation.z - 0.35).abs() < 0.01, "height over the table, got {}", estimated.translation.z);
        let above = look_at(&Point3::new(0.0, 0.0, 0.9), &Point3::origin(), &Vector3::y());
        let thing = Solid::cuboid([0.1, 0.1, 0.1], [0.1, 0.1, 0.1]);
        let estimated = find(&render(&[Solid::table(0.0), thing], &CAMERA, &above)).unwrap();
        assert!((estimated.translation.z - 0.9).abs() < 0.01, "height over the table, got {}", estimated.translation.z);
    }

    #[test]
    fn a_camera_that_looks_straight_down_sees_its_pictures_up_as_away() {
        let plane = Plane { normal: nalgebra::Unit::new_normalize(-Vector3::z()), offset_m: -0.8 };
        let world_from_camera = level(&plane);
        assert!((world_from_camera * -Vector3::y() - Vector3::y()).norm() < 1e-12);
        assert!((world_from_camera * Point3::new(0.0, 0.0, 0.8)).coords.norm() < 1e-12);
    }

    #[test]
    fn a_camera_above_that_is_tilted_sideways_sees_its_pictures_up_as_away() {
        for tilt_deg in [-25f64, -10.0, 10.0, 25.0] {
            let (x, z) = tilt_deg.to_radians().sin_cos();
            let world_from_camera = level(&Plane { normal: nalgebra::Unit::new_normalize(Vector3::new(x, 0.0, -z)), offset_m: -0.8 });
            assert!((world_from_camera * -Vector3::y() - Vector3::y()).norm() < 1e-9, "{tilt_deg}");
            assert!(ViewerFrame::from_camera(&world_from_camera).yaw_rad().abs() < 1e-9, "{tilt_deg}");
        }
    }

    #[test]
    fn nothing_is_found_in_an_empty_picture() {
        assert_eq!(find(&PointMap::filled(40, 30, crate::readings::point_map::MISSING)), None);
    }
}
