//! What must hold for every object, whatever its family: checked here for many of each.

use nalgebra::{Isometry3, Point3, Vector3};
use parry3d::query::{PointQuery, Ray};
use parry3d::shape::{Shape as EngineShape, SharedShape, TriMesh as Surface};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use rapier3d::math::{Pose, Vector};
use repose_geometry::TriMesh;

use super::material::Mass;
use super::{Family, ObjectShape};
use crate::convert;
use crate::physics::{PhysicsSettings, RestSettings, World};

/// Many objects of a family at the scales that scenes use.
fn samples(family: Family, count: usize, seed: u64) -> impl Iterator<Item = ObjectShape> {
    let mut rng = Pcg64::seed_from_u64(seed);
    (0..count).map(move |_| {
        let scale = rng.random_range(0.75..1.25);
        family.sample(scale, &mut rng)
    })
}

fn surface(mesh: &TriMesh) -> Surface {
    Surface::new(mesh.vertices.iter().map(convert::vector).collect(), mesh.triangles.clone()).expect("triangles")
}

/// How many surfaces enclose a point: signed crossings of a ray.
fn winding(mesh: &TriMesh, p: &Point3<f32>) -> i32 {
    // A direction that no family's faces or edges run along.
    let direction = Vector3::new(0.5571, 0.3127, 0.7694).normalize();
    (0..mesh.triangles.len())
        .map(|i| mesh.corners(i))
        .filter_map(|[a, b, c]| {
            let normal = (b - a).cross(&(c - a));
            let slope = normal.dot(&direction);
            let t = normal.dot(&(a - p)) / slope;
            let hit = p + direction * t;
            let inside = [(a, b), (b, c), (c, a)].iter().all(|(from, to)| (to - from).cross(&(hit - from)).dot(&normal) >= 0.0);
            (slope != 0.0 && t > 0.0 && inside).then_some(if slope > 0.0 { 1 } else { -1 })
        })
        .sum()
}

/// The faces of a convex polyhedron: normal and offset along it. (The engine's own point and ray queries are iterative, with absolute
/// tolerances that are too coarse for centimetres; the normals it keeps are those of one triangle of a face, perhaps a sliver.)
fn planes(shape: &dyn EngineShape) -> Option<Vec<(Vector, f32)>> {
    let hull = shape.as_convex_polyhedron()?;
    let plane = |corners: &[u32]| {
        let corner = |k: usize| hull.points()[corners[k % corners.len()] as usize];
        let normal = (0..corners.len()).map(|k| (corner(k) - corner(0)).cross(corner(k + 1) - corner(0))).sum::<Vector>().normalize();
        (normal, hull.points().iter().map(|p| p.dot(normal)).fold(f32::MIN, f32::max))
    };
    let corners = |first: u32, count: u32| &hull.vertices_adj_to_face()[first as usize..(first + count) as usize];
    Some(hull.faces().iter().map(|face| plane(corners(face.first_vertex_or_edge, face.num_vertices_or_edges))).collect())
}

/// How far a point is outside of all parts, metres (0: inside one); a little less at a hull's corners.
fn distance_to_parts_m(shape: &ObjectShape, p: &Point3<f32>) -> f32 {
    let p = convert::vector(p);
    let distance = |(pose, part): &(Pose, SharedShape)| match planes(part.0.as_ref()) {
        Some(planes) => {
            let local = pose.inverse_transform_point(p);
            planes.iter().map(|(normal, offset)| normal.dot(local) - offset).fold(0.0, f32::max)
        }
        None => part.distance_to_point(pose, p, true),
    };
    shape.parts.iter().map(distance).fold(f32::MAX, f32::min)
}

/// The highest point of all parts over (x, y), metres.
fn height_at_m(shape: &ObjectShape, x: f32, y: f32) -> f32 {
    let reach = 1.0;
    let from = Vector::new(x, y, reach);
    let height = |(pose, part): &(Pose, SharedShape)| match planes(part.0.as_ref()) {
        Some(planes) => {
            let (from, down) = (pose.inverse_transform_point(from), pose.rotation.inverse() * Vector::new(0.0, 0.0, -1.0));
            let (mut enters, mut leaves) = (0.0f32, 2.0 * reach);
            for (normal, offset) in planes {
                let (slope, height) = (normal.dot(down), normal.dot(from) - offset);
                match slope {
                    s if s < 0.0 => enters = enters.max(-height / s),
                    s if s > 0.0 => leaves = leaves.min(-height / s),
                    _ if height > 0.0 => leaves = f32::MIN,
                    _ => {}
                }
            }
            if enters <= leaves { reach - enters } else { f32::MIN }
        }
        None => {
            let ray = Ray::new(from, Vector::new(0.0, 0.0, -1.0));
            part.cast_ray(pose, &ray, 2.0 * reach, true).map_or(f32::MIN, |t| reach - t)
        }
    };
    shape.parts.iter().map(height).fold(f32::MIN, f32::max)
}

#[test]
fn surfaces_are_closed_centered_and_outward() {
    for family in Family::ALL {
        for shape in samples(family, 30, 1) {
            let mesh = &shape.mesh;
            let bounds = mesh.aabb().expect("vertices");
            assert!((bounds.min.coords + bounds.max.coords).norm() < 1e-5, "{} is centered", shape.name);
            let mut edges: Vec<(u32, u32)> = mesh.triangles.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]).collect();
            let mut mirrored: Vec<(u32, u32)> = edges.iter().map(|&(a, b)| (b, a)).collect();
            edges.sort_unstable();
            mirrored.sort_unstable();
            assert_eq!(edges, mirrored, "{} is closed", shape.name);
            let volume: f32 =
                (0..mesh.triangles.len()).map(|i| mesh.corners(i)).map(|[a, b, c]| a.coords.dot(&b.coords.cross(&c.coords)) / 6.0).sum();
            assert!(volume > 0.0, "{} faces outwards", shape.name);
        }
    }
}

#[test]
fn what_is_seen_is_what_is_touched_to_a_millimetre() {
    let mut rng = Pcg64::seed_from_u64(2);
    for family in Family::ALL {
        for shape in samples(family, 8, 3) {
            let seen = surface(&shape.mesh);
            let half = shape.half_extents_m.cast::<f32>();
            for _ in 0..120 {
                let p = Point3::from(half.map(|h| rng.random_range(-1.03..1.03) * h));
                let to_surface = seen.distance_to_local_point(convert::vector(&p), false);
                if to_surface < 0.0012 {
                    continue;
                }
                let (inside, touched) = (winding(&shape.mesh, &p) > 0, distance_to_parts_m(&shape, &p) == 0.0);
                assert_eq!(inside, touched, "{} at {p}, {to_surface} m from its surface", shape.name);
            }
            for _ in 0..60 {
                let triangle = shape.mesh.corners(rng.random_range(0..shape.mesh.triangles.len()));
                let (a, b): (f32, f32) = (rng.random_range(0.0..1.0), rng.random_range(0.0..1.0));
                let (a, b) = if a + b > 1.0 { (1.0 - a, 1.0 - b) } else { (a, b) };
                let p = triangle[0] + (triangle[1] - triangle[0]) * a + (triangle[2] - triangle[0]) * b;
                let gap = distance_to_parts_m(&shape, &p);
                assert!(gap < 0.0013, "{} has {gap} m between its surface at {p} and its parts", shape.name);
            }
        }
    }
}

#[test]
fn vessels_are_clear_down_to_their_floor() {
    let mut vessels = 0;
    for family in Family::ALL {
        for shape in samples(family, 20, 4) {
            let Some(opening) = shape.opening else { continue };
            vessels += 1;
            let [cx, cy] = opening.center_m;
            let spots = (0..12).map(|k| {
                let turn = std::f32::consts::TAU * k as f32 / 12.0;
                [cx + opening.radius_m * 0.98 * turn.cos(), cy + opening.radius_m * 0.98 * turn.sin()]
            });
            let [hx, hy] = opening.half_extents_m.map(|h| h * 0.98);
            let corners = [[hx, hy], [-hx, hy], [-hx, -hy], [hx, -hy], [0.0, 0.0]].map(|[x, y]| [cx + x, cy + y]);
            for [x, y] in spots.chain(corners) {
                let reached = height_at_m(&shape, x, y);
                assert!((reached - opening.floor_m).abs() < 0.001, "{}: {reached} where the floor is {opening:?}", shape.name);
            }
            assert!(opening.rim_m > opening.floor_m && opening.mouth_radius_m >= opening.radius_m * 0.999, "{}: {opening:?}", shape.name);
        }
    }
    assert!(vessels > 150, "{vessels}");
}

#[test]
fn tops_bear_what_stands_on_them() {
    for family in Family::ALL {
        for shape in samples(family, 15, 5) {
            let Some(top) = shape.top else { continue };
            let [hx, hy] = top.half_extents_m;
            assert!(hx > 0.003 && hy > 0.003, "{}: {top:?}", shape.name);
            for [sx, sy] in [[0.9, 0.9], [-0.9, 0.9], [-0.9, -0.9], [0.9, -0.9]] {
                let height = height_at_m(&shape, top.center_m[0] + sx * hx, top.center_m[1] + sy * hy);
                // Studs leave gaps; nothing may stand out.
                let studded = &*shape.name == "toy brick";
                assert!(height - top.height_m < 0.001 && (studded || top.height_m - height < 0.001), "{}: {height}, {top:?}", shape.name);
            }
        }
    }
}

#[test]
fn whatever_stands_upright_stays_where_it_is() {
    for family in Family::ALL {
        for shape in samples(family, 12, 6) {
            let mut world = World::new(PhysicsSettings::default());
            world.add_fixture(SharedShape::cuboid(1.0, 1.0, 0.05), &Isometry3::translation(0.0, 0.0, -0.05), 0.6);
            let start = Isometry3::translation(0.0, 0.0, shape.half_extents_m.z);
            world.add_object(&shape, &start);
            let steps = world.settle(&RestSettings::default());
            let end = world.world_from_object(0);
            let moved = (end.translation.vector - start.translation.vector).norm();
            let tilt = end.transform_vector(&Vector3::z()).angle(&Vector3::z());
            assert!(steps.is_some(), "{} comes to rest", shape.name);
            assert!(moved < 0.003 && tilt < 0.03, "{} moved {moved} m and tilted {tilt} rad", shape.name);
        }
    }
}

#[test]
fn masses_and_sizes_are_those_of_things_on_tables() {
    for family in Family::ALL {
        let mut masses: Vec<f32> = samples(family, 60, 7)
            .map(|shape| {
                let size = shape.half_extents_m * 2.0;
                assert!(size.min() > 0.005 && size.max() < 0.48, "{}: {size:?}", shape.name);
                assert!((0.2..=1.2).contains(&shape.friction), "{}: {}", shape.name, shape.friction);
                assert!((Mass::LIMITS_KG[0]..=Mass::LIMITS_KG[1]).contains(&shape.mass_kg), "{}: {} kg", shape.name, shape.mass_kg);
                // Nothing is denser than steel, nor lighter than foam for its size.
                let box_m3 = size.product() as f32;
                assert!(shape.mass_kg / box_m3 < 8000.0 || shape.mass_kg == Mass::LIMITS_KG[0], "{}", shape.name);
                shape.mass_kg
            })
            .collect();
        masses.sort_by(f32::total_cmp);
        let median = masses[30];
        assert!((0.03..0.9).contains(&median), "half of all {} weigh {median} kg", family.name());
        let clamped = masses.iter().filter(|m| Mass::LIMITS_KG.contains(m)).count();
        println!("{:>10}: {:.3} {:.3} {:.3} kg, {clamped} of 60 at a limit", family.name(), masses[3], median, masses[56]);
    }
}

#[test]
fn the_same_seed_gives_the_same_object_and_another_another() {
    for family in Family::ALL {
        let shape = |seed: u64| family.sample(1.0, &mut Pcg64::seed_from_u64(seed));
        let (a, b, c) = (shape(8), shape(8), shape(9));
        assert_eq!((&a.mesh, a.mass_kg.to_bits(), &a.name), (&b.mesh, b.mass_kg.to_bits(), &b.name));
        assert_ne!(a.mesh, c.mesh, "{}", family.name());
    }
}
