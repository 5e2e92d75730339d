//! Small household things, all of which can rest: fruit has a flat side.

use super::super::body::Body;
use super::super::material::Material;
use super::super::outline::{Outline, ProfilePoint};
use super::draw::Draw;
use super::made::Made;

/// One of them.
pub fn small(draw: &mut Draw) -> Made {
    match draw.whole(0, 8) {
        0 => half_ball(draw),
        1 => fruit(draw),
        2 => ring(draw),
        3 => die(draw),
        4 => soap(draw),
        5 => disc(draw),
        6 => candle(draw),
        7 => shaker(draw),
        _ => sponge(draw),
    }
}

/// The profile of a ball's part above the height `from` (share of its radius, −1 to 1), flattened by `squash`.
fn dome(radius: f32, from: f32, squash: f32) -> Vec<ProfilePoint> {
    const RINGS: usize = 8;
    let start = from.acos();
    let mut profile: Vec<ProfilePoint> = (0..=RINGS)
        .map(|k| {
            let turn = start * (1.0 - k as f32 / RINGS as f32);
            [radius * turn.sin(), radius * squash * (turn.cos() - from)]
        })
        .collect();
    profile[RINGS][0] = 0.0;
    profile.insert(0, [0.0, 0.0]);
    profile
}

fn half_ball(draw: &mut Draw) -> Made {
    let radius = draw.length(0.02, 0.06);
    let mut body = Body::default();
    body.solid(&Outline::circle(), &dome(radius, draw.between(0.0, 0.3), draw.between(0.6, 1.3)));
    Made::filled("half ball", body, Material::Plastic, 0.002, draw.between(0.0, 900.0))
}

fn fruit(draw: &mut Draw) -> Made {
    let radius = draw.length(0.022, 0.045);
    let mut body = Body::default();
    body.solid(&Outline::circle(), &dome(radius, -draw.between(0.8, 0.93), draw.between(0.8, 1.15)));
    // Fruit floats or nearly sinks: its density is close to water's.
    Made::filled("fruit", body, Material::Rubber, 0.0005, draw.between(700.0, 1000.0))
}

/// Tape, napkin rings, pipe.
fn ring(draw: &mut Draw) -> Made {
    let (radius, height) = (draw.length(0.024, 0.055), draw.length(0.012, 0.05));
    let hole = radius * draw.between(0.5, 0.85);
    let (round, bevel) = (draw.chance(0.4), radius - hole);
    let mut body = Body::default();
    let outline = Outline::circle_of(20);
    if round {
        let (b, h) = (bevel * 0.25, height * 0.2);
        body.ring(
            &outline,
            &[[radius - b, 0.0], [radius, h], [radius, height - h], [radius - b, height]],
            &[[hole + b, 0.0], [hole, h], [hole, height - h], [hole + b, height]],
        );
    } else {
        body.ring(&outline, &[[radius, 0.0], [radius, height]], &[[hole, 0.0], [hole, height]]);
    }
    let material = draw.pick(&[Material::Plastic, Material::Cardboard, Material::Wood]);
    Made::solid("ring", body, material)
}

fn die(draw: &mut Draw) -> Made {
    let half = draw.length(0.009, 0.03);
    let mut body = Body::default();
    body.brick([-half, -half, 0.0], [half, half, 2.0 * half]);
    let material = draw.pick(&[Material::Plastic, Material::Wood, Material::Rubber]);
    Made::solid("cube", body, material).with_top([0.0, 0.0], 2.0 * half, [half, half])
}

/// A pillow: bevelled above and below.
fn soap(draw: &mut Draw) -> Made {
    let (radius, height) = (draw.length(0.025, 0.045), draw.length(0.018, 0.035));
    let bevel = draw.between(0.7, 0.9);
    let outline = if draw.chance(0.5) {
        Outline::superellipse(draw.between(2.0, 4.0), draw.between(0.5, 0.8))
    } else {
        Outline::rounded(draw.between(0.5, 0.8), 0.3)
    };
    let mut body = Body::default();
    body.solid(
        &outline,
        &[[0.0, 0.0], [radius * bevel, 0.0], [radius, height * 0.35], [radius, height * 0.65], [radius * bevel, height], [0.0, height]],
    );
    Made::filled("soap", body, Material::Plastic, 0.001, 950.0).with_round_top(&outline, radius * bevel, height)
}

/// Coasters, lids, tins of cream.
fn disc(draw: &mut Draw) -> Made {
    let (radius, height) = (draw.length(0.025, 0.06), draw.length(0.007, 0.022));
    let mut body = Body::default();
    body.solid(&Outline::circle(), &[[0.0, 0.0], [radius, 0.0], [radius, height], [0.0, height]]);
    let material = draw.pick(&[Material::Wood, Material::Plastic, Material::Rubber]);
    Made::solid("disc", body, material).with_round_top(&Outline::circle(), radius, height)
}

/// A candle in its holder.
fn candle(draw: &mut Draw) -> Made {
    let (foot, radius) = (draw.length(0.028, 0.045), draw.length(0.009, 0.016));
    let (base, height) = (draw.length(0.008, 0.02), draw.length(0.06, 0.14));
    let mut body = Body::default();
    body.solid(
        &Outline::circle(),
        &[[0.0, 0.0], [foot, 0.0], [foot * 0.9, base * 0.5], [radius * 1.4, base], [radius, base], [radius, height], [0.0, height]],
    );
    Made::filled("candle", body, Material::Ceramic, 0.001, 850.0)
}

/// Salt, pepper, spice: a tapered prism under a dome.
fn shaker(draw: &mut Draw) -> Made {
    let (radius, height) = (draw.length(0.016, 0.026), draw.length(0.055, 0.1));
    let outline = if draw.chance(0.5) { Outline::circle() } else { Outline::regular(8) };
    let head = radius * draw.between(0.7, 1.0);
    let cap = height * draw.between(0.7, 0.8);
    let mut body = Body::default();
    body.solid(
        &outline,
        &[[0.0, 0.0], [radius, 0.0], [head, cap], [head * 0.9, height * 0.92], [head * 0.5, height * 0.99], [0.0, height]],
    );
    Made::filled("shaker", body, Material::Glass, 0.002, draw.between(200.0, 900.0))
}

fn sponge(draw: &mut Draw) -> Made {
    let half = [draw.length(0.04, 0.06), draw.length(0.025, 0.04)];
    let height = draw.length(0.02, 0.035);
    let pad = height * draw.between(0.6, 0.85);
    let mut body = Body::default();
    body.brick([-half[0], -half[1], 0.0], [half[0], half[1], pad]);
    let inset = draw.between(0.9, 1.0);
    body.brick([-half[0] * inset, -half[1] * inset, pad], [half[0] * inset, half[1] * inset, height]);
    Made::solid("sponge", body, Material::Rubber).with_top([0.0, 0.0], height, half.map(|h| h * inset))
}
