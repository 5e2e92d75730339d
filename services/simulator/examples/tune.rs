use nalgebra::Isometry3;
use parry3d::shape::SharedShape;
use rand::SeedableRng;
use rand_pcg::Pcg64;
use repose_simulator::objects::Family;
use repose_simulator::physics::*;
fn main() {
    let mut rng = Pcg64::seed_from_u64(4);
    let bases = [Family::Box, Family::Cylinder, Family::Can, Family::Plate];
    let mut total = [0usize; 2];
    for family in Family::ALL {
        let mut line = String::new();
        for k in 0..12 {
            let shape = family.sample(1.0, &mut rng);
            let base = bases[k % 4].sample(1.0, &mut rng);
            let mut world = World::new(PhysicsSettings::default());
            world.add_fixture(SharedShape::cuboid(1.0, 1.0, 0.05), &Isometry3::translation(0.0, 0.0, -0.05), 0.6);
            world.add_object(&base, &Isometry3::translation(0.0, 0.0, base.half_extents_m.z+0.0001));
            let top = base.half_extents_m.z + base.top.unwrap().height_m as f64;
            world.add_object(&shape, &Isometry3::translation(0.0, 0.0, top + shape.half_extents_m.z + 0.0003));
            let s = world.settle(&RestSettings::default());
            let (l, a) = world.fastest();
            total[usize::from(s.is_none())] += 1;
            let z = world.world_from_object(1).translation.vector.xy().norm() * 1e3;
            line += &match s { Some(s) => format!("{s}({z:.1}) "), None => format!("[{} {:.1}mm/s {:.2} ({z:.1})] ", base.family.name(), l * 1e3, a) };
        }
        println!("{:10} {line}", family.name());
    }
    println!("rest, moving: {total:?}");
}
