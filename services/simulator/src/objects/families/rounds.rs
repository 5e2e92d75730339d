//! Plain cylinders, cones and discs, and prisms over other outlines.

use super::super::body::Body;
use super::super::material::Material;
use super::super::outline::Outline;
use super::draw::Draw;
use super::made::Made;

/// A cylinder, or a blunt cone.
pub fn cylinder(draw: &mut Draw) -> Made {
    let radius = draw.length(0.016, 0.06);
    let height = if draw.chance(0.2) { draw.length(0.01, 0.025) } else { draw.length(0.03, 0.2).min(radius * 7.0) };
    let head = if draw.chance(0.25) { radius * draw.between(0.4, 0.95) } else { radius };
    let outline = Outline::circle();
    let mut body = Body::default();
    body.solid(&outline, &[[0.0, 0.0], [radius, 0.0], [head, height], [0.0, height]]);
    filled_or_solid(if head < radius { "cone" } else { "cylinder" }, body, draw).with_round_top(&outline, head, height)
}

/// A prism, straight or tapering.
pub fn prism(draw: &mut Draw) -> Made {
    let radius = draw.length(0.022, 0.065);
    let height = draw.length(0.02, 0.16).min(radius * 4.0);
    let outline = match draw.whole(0, 4) {
        0 => Outline::regular(3),
        1 => Outline::regular(draw.whole(5, 8)),
        2 => Outline::superellipse(draw.between(1.3, 1.8), draw.between(0.6, 1.0)),
        3 => Outline::superellipse(draw.between(2.0, 6.0), draw.between(0.45, 1.0)),
        _ => Outline::rounded(draw.between(0.4, 1.0), draw.between(0.15, 0.4)),
    };
    let head = if draw.chance(0.4) { radius * draw.between(0.35, 0.95) } else { radius };
    let mut body = Body::default();
    body.solid(&outline, &[[0.0, 0.0], [radius, 0.0], [head, height], [0.0, height]]);
    filled_or_solid("prism", body, draw).with_round_top(&outline, head, height)
}

fn filled_or_solid(name: &'static str, body: Body, draw: &mut Draw) -> Made {
    match draw.whole(0, 2) {
        0 => Made::solid(name, body, Material::Wood),
        1 => Made::filled(name, body, Material::Plastic, 0.0015, draw.between(0.0, 700.0)),
        _ => Made::filled(name, body, Material::Cardboard, 0.001, draw.between(50.0, 700.0)),
    }
}
