//! Plates (flat, deep, with rims) and open boxes (trays, baskets, storage boxes).

use super::super::body::Body;
use super::super::material::Material;
use super::super::outline::{Outline, ProfilePoint};
use super::draw::Draw;
use super::made::Made;

/// A plate.
pub fn plate(draw: &mut Draw) -> Made {
    let radius = draw.length(0.07, 0.135);
    let wall = draw.thickness(0.0035, 0.005);
    let outline = match draw.whole(0, 7) {
        0 => Outline::rounded(1.0, draw.between(0.2, 0.5)),
        1 => Outline::rounded(draw.between(0.6, 0.85), draw.between(0.2, 0.4)),
        2 => Outline::superellipse(2.0, draw.between(0.65, 0.9)),
        _ => Outline::circle(),
    };
    let (base, height) = (radius * draw.between(0.55, 0.72), draw.length(0.013, 0.022));
    let outer: Vec<ProfilePoint> = match draw.whole(0, 3) {
        // Coupe: one slope from the foot to the edge.
        0 => vec![[base, 0.0], [radius, height]],
        // A rim: steep wall, then a nearly level brim.
        1 => vec![[base, 0.0], [base * 1.12, height * 0.72], [radius, height]],
        // Deep: a soup plate.
        2 => vec![[base, 0.0], [base * 1.18, height * 1.3], [radius, height * 1.6]],
        // Nearly a board with a raised edge.
        _ => vec![[radius * 0.9, 0.0], [radius, wall * 2.2]],
    };
    let mut body = Body::default();
    let opening = body.vessel(&outline, &outer, wall, wall * 1.1);
    let material = draw.pick(&[Material::Ceramic, Material::Ceramic, Material::Ceramic, Material::Plastic, Material::Wood]);
    // What stands on a plate stands inside its wall.
    let [x, y] = opening.half_extents_m;
    Made::solid("plate", body, material).with_top([0.0, 0.0], opening.floor_m, [x * 0.97, y * 0.97]).with_opening(opening)
}

/// An open box.
pub fn tray(draw: &mut Draw) -> Made {
    let radius = draw.length(0.05, 0.15);
    let aspect = draw.between(0.5, 1.0);
    let outline = match draw.whole(0, 2) {
        0 => Outline::rounded(aspect, draw.between(0.12, 0.4)),
        1 => Outline::superellipse(draw.between(2.5, 5.0), aspect),
        _ => Outline::rectangle(aspect),
    };
    let tall = draw.chance(0.35);
    let height = if tall { draw.length(0.05, 0.11) } else { draw.length(0.018, 0.045) };
    let wall = draw.thickness(0.003, 0.005) / aspect;
    let base = radius * draw.between(0.82, 1.0);
    let mut body = Body::default();
    let opening = body.vessel(&outline, &[[base, 0.0], [radius, height]], wall, draw.thickness(0.003, 0.005));
    let material = draw.pick(&[Material::Plastic, Material::Wood, Material::Cardboard]);
    Made::solid(if tall { "open box" } else { "tray" }, body, material).with_opening(opening)
}
