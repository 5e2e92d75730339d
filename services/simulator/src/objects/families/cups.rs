//! Mugs, cups and glasses.

use super::super::body::Body;
use super::super::material::Material;
use super::super::outline::{Outline, ProfilePoint, smooth};
use super::draw::Draw;
use super::handles::add_handles;
use super::made::Made;

/// A cup with one handle, or with two.
pub fn mug(draw: &mut Draw) -> Made {
    let (radius, height) = (draw.length(0.033, 0.05), draw.length(0.065, 0.12));
    let outer = walls(radius, height, draw);
    let wall = draw.thickness(0.0032, 0.0052);
    let mut body = Body::default();
    let opening = body.vessel(&cup_outline(radius), &outer, wall, wall * draw.between(1.1, 1.7));
    add_handles(&mut body, &outer, wall, if draw.chance(0.12) { 2 } else { 1 }, draw);
    let material = draw.pick(&[Material::Ceramic, Material::Ceramic, Material::Ceramic, Material::Glass, Material::Plastic]);
    Made::solid("mug", body, material).with_opening(opening)
}

/// A cup without a handle, round or not: beakers, tumblers, flower pots.
pub fn cup(draw: &mut Draw) -> Made {
    let (radius, height) = (draw.length(0.028, 0.05), draw.length(0.05, 0.13));
    let outer = walls(radius, height, draw);
    let wall = draw.thickness(0.0028, 0.0048);
    let outline = match draw.whole(0, 5) {
        0 => Outline::rounded(1.0, draw.between(0.3, 0.6)),
        1 => Outline::regular(draw.pick(&[6, 8])),
        _ => cup_outline(radius),
    };
    let mut body = Body::default();
    let opening = body.vessel(&outline, &outer, wall, wall * draw.between(1.1, 1.7));
    let material = draw.pick(&[Material::Ceramic, Material::Plastic, Material::Plastic, Material::Wood]);
    Made::solid("cup", body, material).with_opening(opening)
}

/// A drinking glass: a tumbler, or a bowl on a stem.
pub fn glass(draw: &mut Draw) -> Made {
    let wall = draw.thickness(0.0024, 0.0034);
    let mut body = Body::default();
    if draw.chance(0.6) {
        let (radius, height) = (draw.length(0.028, 0.042), draw.length(0.08, 0.16));
        let base = radius * draw.between(0.7, 1.0);
        let outline = if draw.chance(0.25) { Outline::regular(draw.pick(&[8, 10])) } else { cup_outline(radius) };
        let outer = if draw.chance(0.3) {
            smooth(&[[base, 0.0], [radius * 0.94, height * 0.4], [radius, height * 0.7], [radius * 0.92, height]], 2)
        } else {
            vec![[base, 0.0], [radius, height]]
        };
        let opening = body.vessel(&outline, &outer, wall, draw.length(0.004, 0.012));
        return Made::solid("glass", body, Material::Glass).with_opening(opening);
    }
    // The foot is wide enough for the bowl's weight above it; the floor is where the bowl begins.
    let (radius, height) = (draw.length(0.03, 0.043), draw.length(0.12, 0.2));
    let foot = radius * draw.between(0.85, 1.0);
    let (stem, start) = (draw.length(0.004, 0.006), height * draw.between(0.3, 0.5));
    let mouth = draw.between(0.75, 1.0);
    let outer = [
        [foot, 0.0],
        [foot, 0.003],
        [stem * 1.5, 0.009],
        [stem, start * 0.6],
        [stem * 1.3, start],
        [radius * 0.78, start + (height - start) * 0.2],
        [radius, start + (height - start) * 0.5],
        [radius * mouth, height],
    ];
    let floor = start + (height - start) * 0.1;
    let opening = body.vessel(&cup_outline(radius), &outer, wall, floor);
    Made::solid("wine glass", body, Material::Glass).with_opening(opening)
}

/// Fewer facets for thin cups: they are 0.6 mm deep at most.
fn cup_outline(radius: f32) -> Outline {
    Outline::circle_of(if radius < 0.032 { 18 } else { 22 })
}

/// The outer profile of a cup: straight, conical, barrel, waisted, tulip, or with a rounded bottom.
fn walls(radius: f32, height: f32, draw: &mut Draw) -> Vec<ProfilePoint> {
    let at = |r: f32, z: f32| [radius * r, height * z];
    match draw.whole(0, 6) {
        0 | 1 => vec![at(0.97, 0.0), at(1.0, 0.03), at(1.0, 1.0)],
        2 => vec![at(draw.between(0.6, 0.85), 0.0), at(1.0, 1.0)],
        3 => {
            let ends = draw.between(0.78, 0.92);
            smooth(&[at(ends, 0.0), at(1.0, 0.45), at(ends * draw.between(0.95, 1.05), 1.0)], 3)
        }
        4 => {
            let waist = draw.between(0.76, 0.9);
            smooth(&[at(0.95, 0.0), at(waist, 0.55), at(1.0, 1.0)], 3)
        }
        5 => smooth(&[at(0.62, 0.0), at(0.95, 0.3), at(0.93, 0.65), at(1.0, 1.0)], 2),
        _ => {
            let bend = draw.between(0.12, 0.3);
            vec![at(0.62, 0.0), at(0.84, bend * 0.3), at(1.0, bend), at(1.0, 1.0)]
        }
    }
}
