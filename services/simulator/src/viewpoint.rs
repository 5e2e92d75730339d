//! Cameras as a tripod, a robot's head or its wrist would hold them: near what they look at, outside of things, with something in view.

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use rand::{Rng, RngExt};
use repose_geometry::Pinhole;
use repose_geometry::transform::look_at;
use serde::Serialize;

use crate::furniture::{Fixture, Focus};
use crate::scene::SimulatedScene;

/// A way to hold a camera.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Mount {
    /// What holds it, as the data set names it.
    pub name: &'static str,
    /// How often, relative to the other mounts.
    pub share: f64,
    /// Distance from what is looked at, metres, nearest and farthest.
    pub distance_m: [f64; 2],
    /// Elevation over the horizontal, radians, lowest and highest; below π/2, where world z is no up for a picture.
    pub elevation_rad: [f64; 2],
    /// How far the line of sight may pass what is looked at, metres along each axis.
    pub aim_error_m: f64,
    /// How far the camera may be turned about its line of sight, radians.
    pub roll_rad: f64,
}

/// The range of random viewpoints.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ViewpointSettings {
    /// Columns of the picture.
    pub width: usize,
    /// Rows of the picture.
    pub height: usize,
    /// Focal length in picture widths, lowest and highest: 0.78 is a D415 as wide as it sees, 0.92 a Kinect, 0.97 a D415 behind its color camera.
    pub focal_widths: [f64; 2],
    /// How far the principal point may be from the picture's middle, as a share of the width. Raising it makes cameras less alike.
    pub principal_shift: f64,
    /// Who holds the camera.
    pub mounts: Vec<Mount>,
    /// How near to furniture or an object the camera may be, metres.
    pub clearance_m: f64,
    /// How many objects must be seen.
    pub seen_least: usize,
    /// How much of all that the camera would see of the objects one by one it must see with everything there. Raising it avoids crowded views.
    pub visible_share_least: f64,
    /// Draws per view before it is given up.
    pub tries: usize,
}

impl Default for ViewpointSettings {
    fn default() -> Self {
        let degrees = |low: f64, high: f64| [low.to_radians(), high.to_radians()];
        let tripod = Mount {
            name: "tripod",
            share: 0.4,
            distance_m: [0.8, 1.4],
            elevation_rad: degrees(20.0, 60.0),
            aim_error_m: 0.08,
            roll_rad: 0.05,
        };
        let head = Mount {
            name: "head",
            share: 0.35,
            distance_m: [0.6, 1.1],
            elevation_rad: degrees(30.0, 65.0),
            aim_error_m: 0.08,
            roll_rad: 0.03,
        };
        let wrist = Mount {
            name: "wrist",
            share: 0.25,
            distance_m: [0.35, 0.6],
            elevation_rad: degrees(45.0, 84.0),
            aim_error_m: 0.05,
            roll_rad: 0.15,
        };
        Self {
            width: 320,
            height: 240,
            focal_widths: [0.80, 0.97],
            principal_shift: 0.02,
            mounts: vec![tripod, head, wrist],
            clearance_m: 0.1,
            seen_least: 2,
            visible_share_least: 0.4,
            tries: 40,
        }
    }
}

/// A camera with its pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Viewpoint {
    /// Intrinsics.
    pub camera: Pinhole,
    /// Pose.
    pub world_from_camera: Isometry3<f64>,
    /// Who holds it.
    pub mount: &'static str,
}

impl Viewpoint {
    /// A random camera that looks at `focus` from where it can be seen.
    pub fn random(focus: &Focus, settings: &ViewpointSettings, rng: &mut impl Rng) -> Self {
        let all: f64 = settings.mounts.iter().map(|m| m.share).sum();
        let mut rest = rng.random_range(0.0..1.0) * all;
        let chosen = settings.mounts.iter().find(|m| {
            rest -= m.share;
            rest < 0.0
        });
        let fallback = Mount { name: "none", share: 1.0, distance_m: [1.0; 2], elevation_rad: [0.8; 2], aim_error_m: 0.0, roll_rad: 0.0 };
        let mount = chosen.or(settings.mounts.last()).unwrap_or(&fallback);
        let mut between = |[low, high]: [f64; 2]| rng.random_range(low..=high);
        let focal = between(settings.focal_widths) * settings.width as f64;
        let distance = between(within(mount.distance_m, focus.distance_m));
        let elevation = between(within(mount.elevation_rad, focus.elevation_rad));
        let azimuth = between(focus.azimuth_rad);
        let roll = between([-mount.roll_rad, mount.roll_rad]);
        let aimed = focus.target + Vector3::from_fn(|_, _| between([-mount.aim_error_m, mount.aim_error_m]));
        let shift = settings.principal_shift * settings.width as f64;
        let [cx, cy] = [settings.width, settings.height].map(|size| (size as f64 - 1.0) / 2.0 + between([-shift, shift]));
        let outward = Vector3::new(azimuth.cos() * elevation.cos(), azimuth.sin() * elevation.cos(), elevation.sin());
        let level = look_at(&(aimed + outward * distance), &aimed, &Vector3::z());
        let camera = Pinhole { width: settings.width, height: settings.height, fx: focal, fy: focal, cx, cy };
        Self { camera, world_from_camera: level * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll), mount: mount.name }
    }

    /// Whether the camera is clear of everything, and furniture leaves it at least `settings.seen_least` objects' middles in sight and in the
    /// picture. Cheap: nothing is drawn.
    pub fn is_plausible(&self, scene: &SimulatedScene, settings: &ViewpointSettings) -> bool {
        let eye = Point3::from(self.world_from_camera.translation.vector);
        let grown = |half: &Vector3<f64>| half.add_scalar(settings.clearance_m);
        let inside = |world_from_box: &Isometry3<f64>, half: &Vector3<f64>| {
            let local = world_from_box.inverse_transform_point(&eye);
            local.coords.abs().zip_map(&grown(half), |p, h| p < h).fold(true, |all, axis| all && axis)
        };
        let objects = || scene.objects.iter().map(|o| o.shape.bounds(&o.world_from_object));
        let is_clear = !scene.fixtures.iter().any(|f| inside(&f.world_from_fixture, &f.half_extents_m))
            && !objects().any(|b| inside(&b.world_from_box, &b.half_extents));
        let camera_from_world = self.world_from_camera.inverse();
        let in_sight = objects().map(|b| b.center()).filter(|middle| {
            self.camera.pixel_of(&(camera_from_world * middle)).is_some() && !scene.fixtures.iter().any(|f| is_between(f, &eye, middle))
        });
        is_clear && in_sight.count() >= settings.seen_least
    }
}

/// A random camera that looks at `focus`: intrinsics and `world_from_camera`, wherever that is.
pub fn random_viewpoint(focus: &Focus, settings: &ViewpointSettings, rng: &mut impl Rng) -> (Pinhole, Isometry3<f64>) {
    let viewpoint = Viewpoint::random(focus, settings, rng);
    (viewpoint.camera, viewpoint.world_from_camera)
}

/// What a mount can do of what the furniture allows; where it can do nothing of that, what it can come nearest to.
fn within(mount: [f64; 2], allowed: [f64; 2]) -> [f64; 2] {
    mount.map(|end| end.clamp(allowed[0], allowed[1]))
}

/// Whether a piece of furniture cuts the segment between two points.
fn is_between(fixture: &Fixture, from: &Point3<f64>, to: &Point3<f64>) -> bool {
    let fixture_from_world = fixture.world_from_fixture.inverse();
    let (start, along) = (fixture_from_world * from, fixture_from_world * (to - from));
    let (mut enters, mut leaves) = (0.0f64, 1.0f64);
    for axis in 0..3 {
        let half = fixture.half_extents_m[axis];
        if along[axis].abs() < 1e-12 {
            if start[axis].abs() > half {
                return false;
            }
            continue;
        }
        let (a, b) = ((-half - start[axis]) / along[axis], (half - start[axis]) / along[axis]);
        enters = enters.max(a.min(b));
        leaves = leaves.min(a.max(b));
    }
    enters < leaves
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    use super::*;
    use crate::furniture::{FurnitureRole, Outlook};

    #[test]
    fn every_mount_is_used_and_keeps_its_range() {
        let (settings, target) = (ViewpointSettings::default(), Point3::new(0.1, -0.2, 0.3));
        let focus = Outlook::AROUND.at(target);
        let mut rng = Pcg64::seed_from_u64(5);
        let mut counts = [0usize; 3];
        for _ in 0..600 {
            let viewpoint = Viewpoint::random(&focus, &settings, &mut rng);
            let k = settings.mounts.iter().position(|m| m.name == viewpoint.mount).expect("a known mount");
            counts[k] += 1;
            let (mount, from_target) = (&settings.mounts[k], viewpoint.world_from_camera.translation.vector - target.coords);
            let slack = mount.aim_error_m * 3f64.sqrt();
            assert!(from_target.norm() > mount.distance_m[0] - slack && from_target.norm() < mount.distance_m[1] + slack);
            // The target is in the picture, and up in the world is up in it.
            let in_camera = viewpoint.world_from_camera.inverse() * target;
            assert!(viewpoint.camera.pixel_of(&in_camera).is_some(), "{viewpoint:?}");
            assert!((viewpoint.world_from_camera.inverse_transform_vector(&Vector3::z())).y < 0.0);
        }
        assert!(counts.iter().all(|n| *n > 100), "{counts:?}");
    }

    #[test]
    fn furniture_between_two_points_is_noticed() {
        let wall = Fixture::between(FurnitureRole::Wall, Point3::new(-1.0, 0.4, 0.0), Point3::new(1.0, 0.5, 1.0), [0; 3]);
        let at = |y: f64, z: f64| Point3::new(0.0, y, z);
        assert!(is_between(&wall, &at(0.0, 0.5), &at(1.0, 0.5)));
        assert!(!is_between(&wall, &at(0.0, 0.5), &at(0.39, 0.5)), "before it");
        assert!(!is_between(&wall, &at(0.0, 1.2), &at(1.0, 1.2)), "above it");
        assert!(!is_between(&wall, &at(0.6, 0.5), &at(1.0, 0.5)), "behind it");
    }
}
