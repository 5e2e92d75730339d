//! One seed's draws: furnished, arranged, settled, watched, checked, until one is a scene.

use nalgebra::{Isometry3, Point3};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;

use super::measures::{displacement_m, measured};
use super::settings::KnockSettings;
use super::{NoScene, Rejected, SceneKind, SceneObject, SceneSettings, SimulatedScene};
use crate::arrange::arranged;
use crate::furniture::{Furniture, FurnitureSurface};
use crate::physics::{PhysicsSettings, Unrest};

/// How far below a surface the lowest point of what it carries may be, metres.
const SUNK_M: f64 = 0.004;

/// The scene of a seed, and the draws that were rejected before it. The kind is the seed's first draw; all attempts are of that kind.
///
/// # Errors
/// [`NoScene`] when `settings.max_attempts` draws were rejected.
pub fn scene_of_seed(seed: u64, settings: &SceneSettings) -> Result<(SimulatedScene, Vec<Rejected>), NoScene> {
    // A stream of its own for the kind: kinds that are hard to settle must not become rare by being drawn again.
    let kind = settings.kinds.draw(&mut stream(seed, u64::MAX));
    let mut rejections = Vec::new();
    for attempt in 0..settings.max_attempts.max(1) {
        match attempted(seed, kind, attempt, settings) {
            Ok(scene) => return Ok((scene, rejections)),
            Err(why) => rejections.push(why),
        }
    }
    Err(NoScene { seed, kind, rejections })
}

/// A stream of its own for each attempt: a rejected draw must not shift what the next one sees.
fn stream(seed: u64, attempt: u64) -> Pcg64 {
    Pcg64::seed_from_u64(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(attempt))
}

/// One draw: arranged, settled, checked.
fn attempted(seed: u64, kind: SceneKind, attempt: u32, settings: &SceneSettings) -> Result<SimulatedScene, Rejected> {
    let mut rng = stream(seed, u64::from(attempt));
    let furniture = Furniture::sample(kind, &settings.table, &mut rng);
    let objects = arranged(&furniture, &settings.arrange.for_kind(kind), &mut rng)?;
    let Furniture { fixtures, surfaces, outlook } = furniture;
    let mut scene = SimulatedScene { seed, kind, fixtures, surfaces, outlook, objects, gaps_m: Vec::new() };
    let poses = settled(&scene, settings)?;
    scene.put(&poses);
    let measures = measured(&scene);
    if measures.penetration_m > settings.max_penetration_m {
        return Err(Rejected::Penetrates { depth_m: measures.penetration_m, limit_m: settings.max_penetration_m });
    }
    scene.gaps_m = measures.gaps_m;
    if let Some(knock) = &settings.knock {
        knocked(&scene, settings.physics, knock, &mut rng)?;
    }
    Ok(scene)
}

/// Where everything comes to rest, watched for a further second.
fn settled(start: &SimulatedScene, settings: &SceneSettings) -> Result<Vec<Isometry3<f64>>, Rejected> {
    const PATIENCE: usize = 3;
    let moving = |index: usize, steps: usize| {
        let object = &start.objects[index];
        Rejected::Moving { id: object.id, name: object.shape.name.clone(), steps }
    };
    let lowest_m = start.surfaces.iter().map(FurnitureSurface::height_m).fold(f64::INFINITY, f64::min);
    let lost_below_m = lowest_m - 0.05;
    let mut scene = start.clone();
    let mut steps = 0;
    let mut creeping = 0;
    for _ in 0..PATIENCE {
        let mut world = scene.world(settings.physics);
        let taken = world.settle_above(&settings.rest, lost_below_m).map_err(|why| match why {
            Unrest::Lost { index } => Rejected::FellOff { id: start.objects[index].id },
            Unrest::Moving { index } => moving(index, steps + settings.rest.max_steps),
        })?;
        scene.put(&world.poses());
        if let Some(fallen) = scene.objects.iter().find(|o| !is_carried(&scene, o)) {
            return Err(Rejected::FellOff { id: fallen.id });
        }
        // Watched in a world of its own: what only stands thanks to the solver's memory of a moment ago would fall when loaded again.
        let mut watched = scene.world(settings.physics);
        for _ in 0..settings.watch_steps {
            watched.step();
        }
        steps += taken + settings.watch_steps;
        let after = watched.poses();
        let moves =
            |(o, pose): (&SceneObject, &Isometry3<f64>)| displacement_m(&o.shape, &o.world_from_object, pose) > settings.watch_limit_m;
        match scene.objects.iter().zip(&after).position(moves) {
            None => return Ok(scene.objects.iter().map(|o| o.world_from_object).collect()),
            Some(mover) => creeping = mover,
        }
        scene.put(&after);
    }
    Err(moving(creeping, steps))
}

/// Knocks at the table, and rejects a scene in which something topples.
fn knocked(scene: &SimulatedScene, physics: PhysicsSettings, knock: &KnockSettings, rng: &mut Pcg64) -> Result<(), Rejected> {
    let mut world = scene.world(physics);
    world.tilt_gravity(knock.tilt_rad, rng.random_range(-std::f32::consts::PI..std::f32::consts::PI));
    for _ in 0..knock.steps {
        world.step();
    }
    world.tilt_gravity(0.0, 0.0);
    for _ in 0..knock.wait_steps {
        world.step();
    }
    for (object, pose) in scene.objects.iter().zip(world.poses()) {
        let moved_m = displacement_m(&object.shape, &object.world_from_object, &pose);
        if moved_m > knock.limit_m {
            return Err(Rejected::Topples { id: object.id, moved_m });
        }
    }
    Ok(())
}

/// Whether the object's centre is over a surface, and no point of it below that surface.
fn is_carried(scene: &SimulatedScene, object: &SceneObject) -> bool {
    let at = object.world_from_object.translation.vector;
    let lowest = Point3::new(at.x, at.y, at.z - object.shape.depth_below_origin_m(&object.world_from_object));
    scene.surfaces.iter().any(|surface| surface.is_under(&lowest, SUNK_M))
}
