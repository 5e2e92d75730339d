//! Tools and kitchen tools, each as it lies (or stands) when put down: what is thicker at one end touches the table at the other too.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

use super::super::bar::BarSection;
use super::super::body::Body;
use super::super::material::Material;
use super::super::outline::Outline;
use super::draw::Draw;
use super::made::Made;

/// One of them.
pub fn tool(draw: &mut Draw) -> Made {
    match draw.whole(0, 9) {
        0 => hammer(draw),
        1 => mallet(draw),
        2 => screwdriver(draw),
        3 => spatula(draw),
        4 => brush(draw),
        5 => wrench(draw),
        6 => mug_tree(draw),
        7 => torch(draw),
        8 => stapler(draw),
        _ => tongs(draw),
    }
}

/// The rotation that lays what was built along z down along x.
fn lying() -> UnitQuaternion<f32> {
    UnitQuaternion::from_axis_angle(&Vector3::y_axis(), std::f32::consts::FRAC_PI_2)
}

/// A handle from a head at height `from` down to the table at its far end.
fn leaning_handle(body: &mut Body, from: f32, length: f32, section: &BarSection, thickness: f32) {
    let path = [Point3::new(0.0, 0.0, from), Point3::new(length, 0.0, thickness * 1.02)];
    body.bar(&path, Vector3::y_axis(), section);
}

fn hammer(draw: &mut Draw) -> Made {
    let (length, half_head) = (draw.length(0.11, 0.22), draw.length(0.03, 0.055));
    let face = draw.length(0.009, 0.016);
    let mut body = Body::default();
    body.brick([-face, -half_head, 0.0], [face, half_head * 0.3, 2.0 * face]);
    // A claw that narrows, or a second face.
    let far = half_head * draw.between(0.7, 1.1);
    let thin = face * draw.between(0.3, 1.0);
    let claw = [[half_head * 0.3, face], [far, thin]]
        .map(|[y, half]| [[-face, -half], [face, -half], [face, half], [-face, half]].map(|[x, z]| Point3::new(x, y, face + z)));
    body.hull(claw.as_flattened());
    let grip = face * draw.between(0.45, 0.7);
    leaning_handle(&mut body, face, length, &BarSection::oval(grip * 1.3, grip), grip);
    Made::filled("hammer", body, Material::Steel, 0.0012, 700.0)
}

/// A round wooden head, lying on its side with its handle's end on the table.
fn mallet(draw: &mut Draw) -> Made {
    let (length, half) = (draw.length(0.1, 0.18), draw.length(0.025, 0.045));
    let radius = draw.length(0.016, 0.03);
    let sides = draw.pick(&[8, 10, 24]);
    let outline = if sides == 24 { Outline::circle() } else { Outline::regular(sides) };
    let mut head = Body::default();
    head.solid(&outline, &[[0.0, -half], [radius, -half], [radius, half], [0.0, half]]);
    let mut body = Body::default();
    // A facet, not an edge, is below.
    let facet = std::f32::consts::PI / outline.sides() as f32;
    let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f32::consts::FRAC_PI_2)
        * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f32::consts::FRAC_PI_2 + facet);
    let height = radius * facet.cos();
    body.add(&head, &Isometry3::from_parts(Translation3::new(0.0, 0.0, height), turn));
    let grip = draw.thickness(0.006, 0.01);
    leaning_handle(&mut body, height, length, &BarSection::round(grip), grip);
    Made::solid("mallet", body, Material::Wood)
}

/// A faceted grip, which it lies on, and a shaft in the air.
fn screwdriver(draw: &mut Draw) -> Made {
    let (grip, shaft) = (draw.length(0.07, 0.11), draw.length(0.05, 0.1));
    let radius = draw.length(0.011, 0.018);
    let sides = draw.pick(&[6, 8]);
    let mut tool = Body::default();
    tool.solid(&Outline::regular(sides), &[[0.0, 0.0], [radius, 0.0], [radius, grip], [0.0, grip]]);
    let thin = draw.thickness(0.0028, 0.004);
    tool.bar(&[Point3::new(0.0, 0.0, grip - 0.003), Point3::new(0.0, 0.0, grip + shaft)], Vector3::y_axis(), &BarSection::round(thin));
    let mut body = Body::default();
    let facet = std::f32::consts::PI / sides as f32;
    body.add(&tool, &Isometry3::from_parts(Translation3::identity(), lying() * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), facet)));
    Made::filled("screwdriver", body, Material::Plastic, 0.003, 1300.0)
}

fn spatula(draw: &mut Draw) -> Made {
    let (blade, half_width) = (draw.length(0.06, 0.1), draw.length(0.025, 0.045));
    let thick = draw.thickness(0.004, 0.007);
    let narrow = half_width * draw.between(0.5, 1.0);
    let mut body = Body::default();
    let outline = [[-blade, -half_width], [-blade, half_width], [0.0, narrow], [0.0, -narrow]];
    let points: Vec<Point3<f32>> = outline.iter().flat_map(|&[x, y]| [Point3::new(x, y, 0.0), Point3::new(x, y, thick)]).collect();
    body.hull(&points);
    let (length, half) = (draw.length(0.09, 0.16), draw.thickness(0.004, 0.007).min(thick));
    // The handle rises, and comes down to the table at its end.
    let peak = half + draw.length(0.0, 0.02);
    let path = [[-0.006, thick / 2.0], [length * 0.25, peak], [length, half * 1.02]].map(|[x, z]| Point3::new(x, 0.0, z));
    body.bar(&path, Vector3::y_axis(), &BarSection::oval(half * 1.4, half));
    let material = draw.pick(&[Material::Wood, Material::Plastic]);
    Made::solid("spatula", body, material)
}

/// A scrubbing brush: bristles below, a back, and often a handle in the air.
fn brush(draw: &mut Draw) -> Made {
    let (half, depth) = (draw.length(0.03, 0.06), draw.length(0.018, 0.03));
    let (bristles, back) = (draw.length(0.015, 0.03), draw.length(0.01, 0.018));
    let mut body = Body::default();
    body.brick([-half * 0.93, -depth * 0.9, 0.0], [half * 0.93, depth * 0.9, bristles]);
    body.brick([-half, -depth, bristles], [half, depth, bristles + back]);
    let top = bristles + back;
    if draw.chance(0.6) {
        let length = half * draw.between(1.2, 2.2);
        let grip = back * 0.45;
        let path = [
            Point3::new(half - 0.004, 0.0, top - back / 2.0),
            Point3::new(half + length, 0.0, top - back / 2.0 + length * draw.between(0.0, 0.3)),
        ];
        body.bar(&path, Vector3::y_axis(), &BarSection::oval(grip * 1.6, grip));
        Made::filled("brush", body, Material::Wood, 0.004, 300.0)
    } else {
        Made::filled("brush", body, Material::Wood, 0.004, 300.0).with_top([0.0, 0.0], top, [half, depth])
    }
}

/// A flat spanner.
fn wrench(draw: &mut Draw) -> Made {
    let (length, thick) = (draw.length(0.1, 0.18), draw.thickness(0.007, 0.011));
    let (half, jaw) = (draw.length(0.006, 0.01), draw.length(0.013, 0.022));
    let mut body = Body::default();
    body.brick([0.0, -half, 0.0], [length, half, thick]);
    let mut head = |at: f32, out: f32| {
        body.brick([at.min(at - out * jaw), -jaw, 0.0], [at.max(at - out * jaw), jaw, thick]);
        for side in [-1.0f32, 1.0] {
            let (near, far) = (side * jaw * 0.45, side * jaw);
            let (from, to) = (at - out * jaw, at - out * jaw * 2.1);
            body.brick([from.min(to), near.min(far), 0.0], [from.max(to), near.max(far), thick]);
        }
    };
    head(0.0, 1.0);
    if draw.chance(0.5) {
        head(length, -1.0);
    }
    Made::solid("wrench", body, Material::Steel)
}

/// A post on a foot with pegs: for mugs, rolls, jewellery.
fn mug_tree(draw: &mut Draw) -> Made {
    let (foot, base) = (draw.length(0.04, 0.065), draw.length(0.01, 0.018));
    let (post, height) = (draw.length(0.006, 0.01), draw.length(0.12, 0.24));
    let mut body = Body::default();
    body.solid(
        &Outline::circle(),
        &[[0.0, 0.0], [foot, 0.0], [foot, base], [post, base], [post, height], [post * 0.6, height + post], [0.0, height + post]],
    );
    for level in 0..draw.whole(0, 2) {
        let z = height * (0.85 - 0.3 * level as f32);
        let (reach, rise) = (draw.length(0.03, 0.05), draw.length(0.012, 0.03));
        for side in [-1.0f32, 1.0] {
            let direction = if level == 0 { Vector3::x() } else { Vector3::y() } * side;
            let across = if level == 0 { Vector3::y_axis() } else { Vector3::x_axis() };
            let path = [Point3::new(0.0, 0.0, z), Point3::from(direction * reach) + Vector3::z() * (z + rise)];
            body.bar(&path, across, &BarSection::round(draw.thickness(0.0035, 0.005)));
        }
    }
    Made::solid("mug tree", body, Material::Wood)
}

/// A torch or a flask on its side, on the facets of its wider head.
fn torch(draw: &mut Draw) -> Made {
    let (length, radius) = (draw.length(0.1, 0.18), draw.length(0.014, 0.024));
    let head = radius * draw.between(1.0, 1.02);
    let sides = draw.pick(&[6, 8]);
    let split = length * draw.between(0.6, 0.8);
    let mut tool = Body::default();
    let slim = radius * draw.between(0.75, 0.95);
    let profile = [[0.0, 0.0], [head, 0.0], [head, split], [slim, split], [slim, length], [0.0, length]];
    tool.solid(&Outline::regular(sides), &profile);
    let mut body = Body::default();
    let facet = std::f32::consts::PI / sides as f32;
    body.add(&tool, &Isometry3::from_parts(Translation3::identity(), lying() * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), facet)));
    Made::filled("torch", body, Material::Aluminium, 0.0015, draw.between(500.0, 1500.0))
}

/// A flat base and an arm that rises from its back end.
fn stapler(draw: &mut Draw) -> Made {
    let (length, half) = (draw.length(0.09, 0.15), draw.length(0.014, 0.022));
    let (base, arm) = (draw.length(0.007, 0.012), draw.length(0.014, 0.024));
    let rise = length * draw.between(0.08, 0.25);
    let mut body = Body::default();
    body.brick([0.0, -half, 0.0], [length, half, base]);
    let profile = [[0.0, base], [length * 0.2, base], [length, base + rise], [length, base + rise + arm], [0.0, base + arm]];
    let points: Vec<Point3<f32>> =
        profile.iter().flat_map(|&[x, z]| [Point3::new(x, -half * 0.8, z), Point3::new(x, half * 0.8, z)]).collect();
    body.hull(&points);
    Made::filled("stapler", body, Material::Steel, 0.001, 300.0)
}

/// Two arms that spread from a joint.
fn tongs(draw: &mut Draw) -> Made {
    let (length, thick) = (draw.length(0.1, 0.2), draw.thickness(0.008, 0.014));
    let half = draw.thickness(0.004, 0.007);
    let spread = length * draw.between(0.12, 0.3);
    let mut body = Body::default();
    for side in [-1.0f32, 1.0] {
        let path = [[0.0, 0.0], [length * 0.5, spread * side], [length, spread * 0.55 * side]].map(|[x, y]| Point3::new(x, y, thick / 2.0));
        body.bar(&path, Vector3::z_axis(), &BarSection::flat(thick / 2.0, half));
    }
    Made::solid("tongs", body, draw.pick(&[Material::Plastic, Material::Wood, Material::Aluminium]))
}
