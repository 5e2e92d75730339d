//! Convex parts of a surface: ready ones by connected component, or V-HACD (Mamou 2016, as parry has it).

use nalgebra::{Point3, Vector3};
use parry3d::transformation::try_convex_hull;
use parry3d::transformation::vhacd::{VHACD, VHACDParameters};
use rapier3d::math::Vector;
use repose_geometry::TriMesh;

use super::clean::{cleaned, components, signed_volume};
use super::settings::DecompositionSettings;
use crate::convert;

/// A convex part of a mesh, as its corners, metres.
pub type ConvexPart = Vec<Point3<f32>>;

/// The parts of a surface in metres.
pub fn decomposed(mesh: &TriMesh, settings: &DecompositionSettings) -> Vec<ConvexPart> {
    if let Some(hull) = its_own_hull(mesh, settings.max_corners) {
        return vec![hull];
    }
    let parameters = VHACDParameters {
        concavity: settings.concavity,
        resolution: settings.resolution,
        max_convex_hulls: settings.max_parts,
        ..VHACDParameters::default()
    };
    // The library's tolerances are absolute: in decimetres they are small.
    let points: Vec<Vector> = mesh.vertices.iter().map(|v| convert::vector(v) * UNIT).collect();
    let cut = VHACD::decompose(&parameters, &points, &mesh.triangles, true);
    let parts = cut.compute_exact_convex_hulls(&points, &mesh.triangles).into_iter().map(|(corners, _)| corners);
    parts.filter_map(|corners| hull_corners(&corners, settings.max_corners)).collect()
}

/// The parts that someone cut already: each connected piece of `mesh` (metres) is one.
pub fn ready_parts(mesh: &TriMesh, weld: f32, max_corners: usize) -> Vec<ConvexPart> {
    let mesh = cleaned(mesh, weld).mesh;
    let part = |members: Vec<usize>| {
        let corners = members.iter().flat_map(|&t| mesh.corners(t)).map(|p| convert::vector(&p) * UNIT).collect::<Vec<_>>();
        hull_corners(&corners, max_corners)
    };
    components(&mesh).into_iter().filter_map(part).collect()
}

/// Flat feet under what stands: quadrilateral prisms over the lowest millimetres of the parts, no higher than the surface.
///
/// Scanned undersides are wavy by a few millimetres, and of a face with many corners the engine knows four in a row: without feet a
/// carton leans by three degrees.
pub fn feet(mesh: &TriMesh, parts: &[ConvexPart]) -> Vec<ConvexPart> {
    const SLAB_M: f32 = 0.003;
    const HEIGHT_M: f32 = 0.004;
    /// Less is no body to the engine. A part may stand out of the surface by as much.
    const LEAST_HEIGHT_M: f32 = 0.001;
    let points = || mesh.vertices.iter().chain(parts.iter().flatten());
    let low = points().map(|p| p.z).fold(f32::MAX, f32::min);
    let high = mesh.vertices.iter().map(|p| p.z).fold(f32::MIN, f32::max);
    let top = low + (high - low).clamp(LEAST_HEIGHT_M, HEIGHT_M);
    let near: Vec<&Point3<f32>> = points().filter(|p| p.z <= low + SLAB_M).collect();
    let farthest = |k: usize| {
        let turn = std::f32::consts::TAU * (k as f32 + 0.5) / 16.0;
        let along = |p: &Point3<f32>| p.x * turn.cos() + p.y * turn.sin();
        near.iter().copied().max_by(|a, b| along(a).total_cmp(&along(b)))
    };
    let quad = |first: usize| -> Option<ConvexPart> {
        let corners: Vec<&Point3<f32>> = (0..4).filter_map(|k| farthest(first + 4 * k)).collect();
        let twice_area: f32 =
            (0..corners.len()).map(|k| (corners[k], corners[(k + 1) % corners.len()])).map(|(a, b)| a.x * b.y - a.y * b.x).sum();
        // What touches the table in a line or a point (a ball, a roller) has no feet.
        (twice_area > 2e-4).then(|| corners.iter().flat_map(|p| [low, top].map(|z| Point3::new(p.x, p.y, z))).collect())
    };
    (0..4).filter_map(quad).collect()
}

/// The hull of the whole surface, where that has nearly the surface's volume.
fn its_own_hull(mesh: &TriMesh, max_corners: usize) -> Option<ConvexPart> {
    const ALIKE: f32 = 0.015;
    let points: Vec<Vector> = mesh.vertices.iter().map(|v| convert::vector(v) * UNIT).collect();
    let (corners, triangles) = try_convex_hull(&points).ok()?;
    let hull = TriMesh { vertices: corners.iter().map(|p| Point3::new(p.x, p.y, p.z) / UNIT).collect(), triangles };
    let (whole, own) = (signed_volume(&hull), signed_volume(mesh));
    ((whole - own).abs() <= ALIKE * whole).then(|| hull_corners(&points, max_corners)).flatten()
}

/// Decimetres in a metre.
const UNIT: f32 = 10.0;

/// The hull's corners, thinned to those that are farthest in evenly spread directions; `None` for points without volume.
fn hull_corners(points: &[Vector], max_corners: usize) -> Option<ConvexPart> {
    let (corners, _) = try_convex_hull(points).ok()?;
    let metres = |p: &Vector| Point3::new(p.x, p.y, p.z) / UNIT;
    if corners.len() <= max_corners {
        return Some(corners.iter().map(metres).collect());
    }
    let farthest = |direction: Vector3<f32>| {
        let along = |p: &Vector| p.dot(Vector::new(direction.x, direction.y, direction.z));
        (0..corners.len()).max_by(|&a, &b| along(&corners[a]).total_cmp(&along(&corners[b]))).unwrap_or(0)
    };
    // The axes first, so that the part keeps its box.
    let axes = (0..6).map(|k| Vector3::ith(k / 2, if k % 2 == 0 { 1.0 } else { -1.0 }));
    let mut kept: Vec<usize> = Vec::new();
    for direction in axes.chain(spread_directions(4 * max_corners)) {
        let corner = farthest(direction);
        if !kept.contains(&corner) {
            kept.push(corner);
        }
        if kept.len() == max_corners {
            break;
        }
    }
    kept.sort_unstable();
    Some(kept.into_iter().map(|i| metres(&corners[i])).collect())
}

/// Directions that cover the sphere evenly however many are taken (the R2 sequence of Roberts 2018, mapped by equal areas).
fn spread_directions(count: usize) -> impl Iterator<Item = Vector3<f32>> {
    (0..count).map(|k| {
        let share = |step: f64| ((0.5 + step * k as f64) % 1.0) as f32;
        let (z, turn) = (1.0 - 2.0 * share(0.754_877_666_246_693), std::f32::consts::TAU * share(0.569_840_290_998_053));
        let r = (1.0 - z * z).sqrt();
        Vector3::new(r * turn.cos(), r * turn.sin(), z)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::objects::body::cuboid_mesh;
    use crate::objects::loft::swept;
    use crate::objects::outline::Outline;

    #[test]
    fn a_box_is_one_part_and_two_boxes_are_two_ready_ones() {
        let cube = cuboid_mesh(Vector3::new(0.02, 0.03, 0.04));
        let parts = decomposed(&cube, &DecompositionSettings::default());
        assert_eq!(parts.len(), 1);
        let high = parts[0].iter().map(|p| p.z).fold(0.0, f32::max);
        assert!((high - 0.04).abs() < 1e-4, "{high}");
        let mut two = cube.clone();
        two.append(&cube.transformed(&nalgebra::Isometry3::translation(0.2, 0.0, 0.0)));
        assert_eq!(ready_parts(&two, 1e-6, 48).len(), 2);
    }

    #[test]
    fn the_feet_of_something_flat_end_with_it() {
        // A card of 2 mm, a box, and a sheet without a thickness.
        for (height, expected) in [(0.002, 0.002), (0.08, 0.004), (0.0, 0.001)] {
            let mesh = cuboid_mesh(Vector3::new(0.043, 0.027, height / 2.0));
            let feet = feet(&mesh, &[]);
            let top = feet.iter().flatten().map(|p| p.z + height / 2.0).fold(0.0, f32::max);
            assert!(!feet.is_empty() && (top - expected).abs() < 1e-6, "{height} m: feet of {top} m");
        }
    }

    #[test]
    fn a_cup_stays_hollow() {
        let profile = [[0.0, 0.0], [0.04, 0.0], [0.04, 0.09], [0.034, 0.09], [0.034, 0.006], [0.0, 0.006]];
        let cup = swept(&Outline::circle(), &profile);
        let parts = decomposed(&cup, &DecompositionSettings::default());
        assert!(parts.len() > 6, "{}", parts.len());
        // No part reaches the axis above the floor.
        let volume: f32 = parts
            .iter()
            .map(|p| {
                let points: Vec<Vector> = p.iter().map(convert::vector).collect();
                parry3d::shape::SharedShape::convex_hull(&points).map_or(0.0, |s| s.mass_properties(1.0).mass())
            })
            .sum();
        let wall = signed_volume(&cup);
        assert!(volume < 1.6 * wall, "{volume} m³ of parts for {wall} m³ of wall");
    }

    #[test]
    fn thinned_hulls_keep_their_box() {
        let many: Vec<Vector> = spread_directions(800).map(|d| Vector::new(d.x, 0.5 * d.y, 0.8 * d.z)).collect();
        let part = hull_corners(&many, 40).expect("a volume");
        assert!(part.len() <= 40);
        let reach = part.iter().map(|p| p.x).fold(0.0, f32::max) * UNIT;
        assert!(reach > 0.995, "{reach}");
    }
}
