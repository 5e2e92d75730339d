//! Cuboids and packaging.

use nalgebra::Point3;

use super::super::body::Body;
use super::super::material::Material;
use super::super::outline::Outline;
use super::draw::Draw;
use super::made::Made;

/// A cuboid, standing on any of its faces.
pub fn cuboid(draw: &mut Draw) -> Made {
    let [x, y, z] = if draw.chance(0.12) {
        [draw.length(0.16, 0.3), draw.length(0.1, 0.2), draw.length(0.06, 0.13)]
    } else {
        [0; 3].map(|_| draw.log_length(0.022, 0.17))
    };
    // Slender ones would fall at a breath.
    let (x, y) = (x.max(z * 0.22), y.max(z * 0.22));
    let mut body = Body::default();
    body.brick([-x / 2.0, -y / 2.0, 0.0], [x / 2.0, y / 2.0, z]);
    let top = [x / 2.0, y / 2.0];
    let made = if draw.chance(0.2) {
        Made::solid("block", body, Material::Wood)
    } else {
        Made::filled("box", body, Material::Cardboard, 0.0005, draw.between(60.0, 700.0))
    };
    made.with_top([0.0, 0.0], z, top)
}

/// Packaging that is not, or not just, a cuboid.
pub fn carton(draw: &mut Draw) -> Made {
    match draw.whole(0, 4) {
        0 | 1 => thin_box(draw),
        2 => gable_top(draw),
        3 => capped_carton(draw),
        _ => wrapped(draw),
    }
}

/// Cereals, books, tablets: two long edges and a short one.
fn thin_box(draw: &mut Draw) -> Made {
    let (long, middle, short) = (draw.length(0.11, 0.25), draw.length(0.07, 0.17), draw.length(0.022, 0.06));
    // Lying, on the long edge, or standing, where it is thick enough to.
    let [x, y, z] = match draw.whole(0, 3) {
        0 | 1 => [long, middle, short],
        2 => [long, short.max(middle * 0.25), middle],
        _ => [middle, short.max(long * 0.25), long],
    };
    let mut body = Body::default();
    body.brick([-x / 2.0, -y / 2.0, 0.0], [x / 2.0, y / 2.0, z]);
    Made::filled("carton", body, Material::Cardboard, 0.0005, draw.between(80.0, 650.0)).with_top([0.0, 0.0], z, [x / 2.0, y / 2.0])
}

/// A milk carton: a roof and a fin over a square block.
fn gable_top(draw: &mut Draw) -> Made {
    let (half, height) = (draw.length(0.024, 0.046), draw.length(0.08, 0.19));
    let depth = half * draw.between(0.75, 1.0);
    let rise = half * draw.between(0.5, 0.9);
    let fin = draw.length(0.008, 0.016);
    let mut body = Body::default();
    body.brick([-half, -depth, 0.0], [half, depth, height]);
    let corner = |x: f32, y: f32, z: f32| Point3::new(x, y, height - 0.0005 + z);
    let thin = 0.0015;
    body.hull(&[
        corner(-half, -depth, 0.0),
        corner(half, -depth, 0.0),
        corner(half, depth, 0.0),
        corner(-half, depth, 0.0),
        corner(-half, -thin, rise),
        corner(half, -thin, rise),
        corner(half, thin, rise),
        corner(-half, thin, rise),
    ]);
    body.brick([-half, -thin, height + rise - 0.001], [half, thin, height + rise + fin]);
    Made::filled("milk carton", body, Material::Cardboard, 0.0006, draw.between(30.0, 1000.0))
}

/// A drink carton: a block with a screw cap, its top level or slanted.
fn capped_carton(draw: &mut Draw) -> Made {
    let (half, height) = (draw.length(0.024, 0.045), draw.length(0.09, 0.2));
    let depth = half * draw.between(0.6, 1.0);
    let drop = if draw.chance(0.5) { half * draw.between(0.3, 0.7) } else { 0.0 };
    let mut body = Body::default();
    let bottom = [[-half, -depth], [half, -depth], [half, depth], [-half, depth]];
    let mut points: Vec<Point3<f32>> = bottom.iter().map(|&[x, y]| Point3::new(x, y, 0.0)).collect();
    points.extend(bottom.iter().map(|&[x, y]| Point3::new(x, y, if x > 0.0 { height - drop } else { height })));
    body.hull(&points);
    let cap = draw.length(0.009, 0.013).min(depth * 0.8);
    let rise = draw.length(0.009, 0.015);
    let mut screw = Body::default();
    screw.solid(&Outline::circle_of(16), &[[0.0, 0.0], [cap, 0.0], [cap, rise], [0.0, rise]]);
    let slope = (drop / (2.0 * half)).atan();
    let tilt = nalgebra::UnitQuaternion::from_axis_angle(&nalgebra::Vector3::y_axis(), slope);
    let at = nalgebra::Translation3::new(half * 0.3, 0.0, height - drop * 0.65 - 0.0005);
    body.add(&screw, &nalgebra::Isometry3::from_parts(at, tilt));
    Made::filled("drink carton", body, Material::Cardboard, 0.0006, draw.between(30.0, 1000.0))
}

/// Boxes whose cross-section is a polygon or rounded: tea, sweets, soap.
fn wrapped(draw: &mut Draw) -> Made {
    let (radius, height) = (draw.length(0.025, 0.075), draw.length(0.025, 0.12));
    let outline = match draw.whole(0, 2) {
        0 => Outline::regular(draw.pick(&[5, 6, 8])),
        1 => Outline::rounded(draw.between(0.5, 1.0), draw.between(0.1, 0.4)),
        _ => Outline::rectangle(draw.between(0.5, 1.0)),
    };
    // A lid a little wider than the box, or sides that taper.
    let (profile, head) = if draw.chance(0.5) {
        let edge = height * draw.between(0.6, 0.8);
        let wide = radius * 1.04;
        (vec![[0.0, 0.0], [radius, 0.0], [radius, edge], [wide, edge], [wide, height], [0.0, height]], wide)
    } else {
        let head = radius * draw.between(0.7, 1.0);
        (vec![[0.0, 0.0], [radius, 0.0], [head, height], [0.0, height]], head)
    };
    let mut body = Body::default();
    body.solid(&outline, &profile);
    Made::filled("gift box", body, Material::Cardboard, 0.0008, draw.between(50.0, 600.0)).with_round_top(&outline, head, height)
}
