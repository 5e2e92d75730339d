//! The default cell: a Panda at a table, a camera on a tripod across from it, and a scene made from a seed.
//!
//! The robot's base is the world's frame; the table's top is z = 0. Most objects fit the gripper in at least one direction.

use nalgebra::{Isometry3, Point2, Point3, Vector3};
use repose_geometry::Pinhole;
use repose_geometry::transform::look_at;

use crate::arrange::{ArrangeSettings, Ways};
use crate::furniture::{KindWeights, SceneKind, Table};
use crate::objects::{Family, ObjectSource};
use crate::physics::PhysicsSettings;
use crate::scene::{NoScene, SceneSettings, SimulatedScene, scene_of_seed};

/// What the cell is made of.
#[derive(Debug, Clone, PartialEq)]
pub struct CellSettings {
    /// How scenes are made.
    pub scene: SceneSettings,
    /// Where the camera is.
    pub camera_at_m: Point3<f64>,
    /// What it looks at.
    pub camera_target_m: Point3<f64>,
    /// Its intrinsics.
    pub camera: Pinhole,
}

impl Default for CellSettings {
    fn default() -> Self {
        use Family::{Bottle, Bowl, Box, Can, Compound, Cup, Cylinder, Mug};
        let arrange = ArrangeSettings {
            objects: [3, 6],
            source: ObjectSource::procedural([
                (Box, 4.0),
                (Cylinder, 2.0),
                (Can, 2.0),
                (Mug, 2.0),
                (Bottle, 1.0),
                (Cup, 1.0),
                (Bowl, 1.0),
                (Compound, 1.0),
            ]),
            scale: [0.6, 0.95],
            spread_m: [0.2, 0.24],
            highest_stack_m: 0.15,
            friction: [0.7, 0.9],
            gather_at: Some(Point2::new(0.52, 0.0)),
            ways: Ways { surface: 0.74, beside: 0.13, on_top: 0.13, into: 0.0, falling: 0.0 },
            ..ArrangeSettings::default()
        };
        Self {
            scene: SceneSettings {
                kinds: KindWeights::only(SceneKind::OpenTable),
                table: Table::Fixed { low: Point2::new(0.25, -0.45), high: Point2::new(0.85, 0.45) },
                arrange,
                physics: PhysicsSettings::grasping(),
                ..SceneSettings::default()
            },
            camera_at_m: Point3::new(1.3, 0.25, 0.72),
            camera_target_m: Point3::new(0.53, 0.0, 0.03),
            camera: Pinhole { width: 640, height: 480, fx: 525.0, fy: 525.0, cx: 319.5, cy: 239.5 },
        }
    }
}

impl CellSettings {
    /// Pose of the camera.
    pub fn world_from_camera(&self) -> Isometry3<f64> {
        look_at(&self.camera_at_m, &self.camera_target_m, &Vector3::z())
    }
}

/// The settled scene of a seed in the cell.
///
/// # Errors
/// [`NoScene`] when the seed gives none.
pub fn cell_of_seed(seed: u64, settings: &CellSettings) -> Result<SimulatedScene, NoScene> {
    scene_of_seed(seed, &settings.scene).map(|(scene, _)| scene)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_camera_sees_the_whole_table() {
        let settings = CellSettings::default();
        let camera_from_world = settings.world_from_camera().inverse();
        for (x, y) in [(0.25, -0.45), (0.25, 0.45), (0.85, -0.45), (0.85, 0.45)] {
            let corner = camera_from_world * Point3::new(x, y, 0.0);
            assert!(settings.camera.pixel_of(&corner).is_some(), "corner {x}, {y} at {:?}", settings.camera.project(&corner));
        }
    }

    #[test]
    fn seeds_give_scenes_on_the_table_that_mostly_fit_the_gripper() {
        let settings = CellSettings::default();
        let (mut fit, mut all) = (0, 0);
        for seed in 0..10 {
            let scene = cell_of_seed(seed, &settings).expect("a scene");
            assert!((3..=6).contains(&scene.objects.len()));
            for object in &scene.objects {
                all += 1;
                fit += usize::from(object.shape.half_extents_m.xy().min() * 2.0 < 0.07 || object.shape.opening.is_some());
                let at = object.world_from_object.translation.vector;
                assert!(at.x > 0.25 && at.x < 0.85 && at.y.abs() < 0.45);
            }
        }
        assert!(fit * 10 >= all * 8, "{fit} of {all}");
    }
}
