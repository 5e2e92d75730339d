//! Tins and drink cans.

use super::super::body::Body;
use super::super::material::Material;
use super::super::outline::{Outline, ProfilePoint};
use super::draw::Draw;
use super::made::Made;

/// A can.
pub fn can(draw: &mut Draw) -> Made {
    let radius = draw.length(0.024, 0.052);
    let content = if draw.chance(0.2) { draw.between(0.0, 50.0) } else { draw.between(350.0, 1050.0) };
    let (outline, profile): (Outline, Vec<ProfilePoint>) = match draw.whole(0, 4) {
        // A drink can: necked at both ends.
        0 => {
            let (radius, height) = (draw.length(0.026, 0.034), draw.length(0.09, 0.17));
            let (foot, neck) = (radius * 0.78, radius * 0.82);
            let profile = vec![
                [0.0, 0.0],
                [foot, 0.0],
                [radius, radius * 0.25],
                [radius, height - radius * 0.35],
                [neck, height - radius * 0.05],
                [neck, height],
                [0.0, height],
            ];
            (Outline::circle(), profile)
        }
        // A flat tin of fish, oval or rounded.
        1 => {
            let (radius, height) = (draw.length(0.04, 0.06), draw.length(0.02, 0.04));
            let outline = if draw.chance(0.5) {
                Outline::rounded(draw.between(0.55, 0.8), draw.between(0.25, 0.45))
            } else {
                Outline::superellipse(2.0, draw.between(0.6, 0.85))
            };
            (outline, vec![[0.0, 0.0], [radius, 0.0], [radius, height], [0.0, height]])
        }
        // A rounded meat tin with tapering sides.
        2 => {
            let (radius, height) = (draw.length(0.04, 0.055), draw.length(0.06, 0.1));
            let head = radius * draw.between(0.88, 0.97);
            (Outline::rounded(draw.between(0.5, 0.75), 0.3), vec![[0.0, 0.0], [radius, 0.0], [head, height], [0.0, height]])
        }
        // A food tin, with bevelled rims.
        _ => {
            let height = radius * draw.between(1.2, 3.2);
            let bevel = radius * draw.between(0.04, 0.1);
            let inset = radius - bevel;
            let profile = vec![[0.0, 0.0], [inset, 0.0], [radius, bevel], [radius, height - bevel], [inset, height], [0.0, height]];
            (Outline::circle(), profile)
        }
    };
    let [head, height] = profile[profile.len() - 2];
    let mut body = Body::default();
    body.solid(&outline, &profile);
    Made::filled("can", body, Material::Aluminium, 0.0003, content).with_round_top(&outline, head, height)
}
