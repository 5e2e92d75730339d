//! Bowls: several profiles, with and without a foot ring, also oval and square.

use super::super::body::Body;
use super::super::material::Material;
use super::super::outline::{Outline, ProfilePoint};
use super::draw::Draw;
use super::made::Made;

/// A bowl.
pub fn bowl(draw: &mut Draw) -> Made {
    let (radius, height) = (draw.length(0.05, 0.11), draw.length(0.032, 0.085));
    let wall = draw.thickness(0.003, 0.0045);
    let foot_height = if draw.chance(0.4) { draw.length(0.003, 0.008) } else { 0.0 };
    let base = radius * draw.between(0.38, 0.6);
    let mut outer: Vec<ProfilePoint> = if foot_height > 0.0 { vec![[base, 0.0], [base, foot_height]] } else { Vec::new() };
    let start = if foot_height > 0.0 { base * 1.1 } else { base };
    // Wall forms from a shallow cone to a deep, steep-walled bowl, some flared at the rim.
    let rise = height - foot_height;
    let form = draw.whole(0, 3);
    let roundness = draw.between(0.7, 1.1);
    let points = 5;
    for k in 0..=points {
        let t = k as f32 / points as f32;
        let turn = std::f32::consts::FRAC_PI_2 * t;
        let (out, up) = match form {
            0 => (t, t),
            1 => (turn.sin(), 1.0 - turn.cos()),
            2 => (turn.sin().powf(roundness), t.powf(1.6)),
            _ => (0.82 * turn.sin().powf(0.8) + 0.18 * t.powi(3), t.powf(1.4)),
        };
        outer.push([start + (radius - start) * out, foot_height + rise * up]);
    }
    // A wall's slope right at the table would be a knife's edge.
    outer.dedup_by(|b, a| b[1] - a[1] < 1e-4);
    let outline = match draw.whole(0, 9) {
        0 => Outline::superellipse(2.0, draw.between(0.65, 0.9)),
        1 => Outline::rounded(draw.between(0.75, 1.0), draw.between(0.25, 0.6)),
        2 => Outline::regular(8),
        _ => Outline::circle_of(if radius < 0.07 { 20 } else { 24 }),
    };
    let mut body = Body::default();
    let opening = body.vessel(&outline, &outer, wall, foot_height + wall * 1.15);
    let material = draw.pick(&[Material::Ceramic, Material::Ceramic, Material::Plastic, Material::Wood, Material::Glass, Material::Steel]);
    Made::solid("bowl", body, material).with_opening(opening)
}
