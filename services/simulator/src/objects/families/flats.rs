//! What lies flat on a desk: books, notebooks, parcels, laptops, tablets, lids.

use nalgebra::{Point3, UnitQuaternion, Vector3};

use super::super::body::Body;
use super::super::material::Material;
use super::super::outline::Outline;
use super::draw::Draw;
use super::made::Made;

/// One of them, lying as it would be put down.
pub fn flat(draw: &mut Draw) -> Made {
    match draw.whole(0, 9) {
        0..=2 => book(draw),
        3 => notebook(draw),
        4..=6 => parcel(draw),
        7 => laptop(draw),
        8 => tablet(draw),
        _ => lid(draw),
    }
}

/// A cuboid of these edge lengths, and the half extents of its top.
fn slab([x, y, z]: [f32; 3]) -> (Body, [f32; 2]) {
    let mut body = Body::default();
    body.brick([-x / 2.0, -y / 2.0, 0.0], [x / 2.0, y / 2.0, z]);
    (body, [x / 2.0, y / 2.0])
}

/// A5 to a little over A4, from a paperback to a dictionary.
fn book(draw: &mut Draw) -> Made {
    let long = draw.length(0.17, 0.3);
    let size = [long, long * draw.between(0.62, 0.8), draw.length(0.012, 0.045)];
    let (body, top) = slab(size);
    Made::solid("book", body, Material::Cardboard).with_top([0.0, 0.0], size[2], top)
}

/// A notebook, a magazine, a thin stack of paper.
fn notebook(draw: &mut Draw) -> Made {
    let long = draw.length(0.14, 0.29);
    let size = [long, long * draw.between(0.65, 0.75), draw.thickness(0.006, 0.012)];
    let (body, top) = slab(size);
    Made::solid("notebook", body, Material::Cardboard).with_top([0.0, 0.0], size[2], top)
}

/// A flat package: a mailing box, chocolates, a game.
fn parcel(draw: &mut Draw) -> Made {
    let long = draw.length(0.14, 0.36);
    let size = [long, long * draw.between(0.45, 1.0), draw.length(0.018, 0.06)];
    let (body, top) = slab(size);
    Made::filled("parcel", body, Material::Cardboard, 0.001, draw.between(20.0, 300.0)).with_top([0.0, 0.0], size[2], top)
}

/// A laptop, closed or with its screen up.
fn laptop(draw: &mut Draw) -> Made {
    let wide = draw.length(0.28, 0.36);
    let (deep, thick) = (wide * draw.between(0.66, 0.72), draw.thickness(0.014, 0.02));
    let (mut body, top) = slab([wide, deep, thick]);
    if draw.chance(0.4) {
        return Made::filled("laptop", body, Material::Aluminium, 0.0008, 1200.0).with_top([0.0, 0.0], thick, top);
    }
    // Leaning back from the hinge at the far edge by 10° to 35°.
    let lean = draw.between(0.17, 0.6);
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -lean);
    let half = Vector3::new(wide / 2.0, 0.004, deep / 2.0);
    let hinge = Point3::new(0.0, deep / 2.0 - 0.006, thick - 0.006);
    body.cuboid(hinge + rotation * Vector3::new(0.0, 0.0, half.z), rotation, half);
    Made::filled("open laptop", body, Material::Aluminium, 0.0008, 1200.0)
}

/// A tablet or a telephone.
fn tablet(draw: &mut Draw) -> Made {
    let radius = draw.length(0.075, 0.135);
    let outline = Outline::rounded(draw.between(0.5, 0.75), 0.08);
    let thick = draw.thickness(0.0075, 0.011);
    let mut body = Body::default();
    body.solid(&outline, &[[0.0, 0.0], [radius, 0.0], [radius, thick], [0.0, thick]]);
    Made::solid("tablet", body, Material::Glass).with_round_top(&outline, radius, thick)
}

/// The lid of a pot or a box, a coaster, a board to cut on.
fn lid(draw: &mut Draw) -> Made {
    let radius = draw.length(0.05, 0.14);
    let outline = if draw.chance(0.5) { Outline::circle() } else { Outline::rounded(draw.between(0.55, 1.0), draw.between(0.1, 0.4)) };
    let thick = draw.thickness(0.008, 0.018);
    let mut body = Body::default();
    body.solid(&outline, &[[0.0, 0.0], [radius, 0.0], [radius * 0.97, thick], [0.0, thick]]);
    let material = draw.pick(&[Material::Plastic, Material::Wood]);
    if draw.chance(0.5) {
        let knob = draw.between(0.009, 0.016);
        let mut grip = Body::default();
        grip.solid(&Outline::circle_of(16), &[[0.0, 0.0], [knob, 0.0], [knob, knob * 1.5], [0.0, knob * 1.5]]);
        body.add(&grip, &nalgebra::Isometry3::translation(0.0, 0.0, thick - 0.0005));
        return Made::solid("lid", body, material);
    }
    Made::solid("board", body, material).with_round_top(&outline, radius * 0.97, thick)
}
