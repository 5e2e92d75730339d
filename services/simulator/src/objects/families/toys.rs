//! Toys.

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};

use super::super::body::Body;
use super::super::material::Material;
use super::super::outline::{Outline, ProfilePoint};
use super::draw::Draw;
use super::made::Made;

/// One of them.
pub fn toy(draw: &mut Draw) -> Made {
    match draw.whole(0, 6) {
        0 => car(draw),
        1 => wagon(draw),
        2 => animal(draw),
        3 => studded_brick(draw),
        4 => ring_tower(draw),
        5 => chess_piece(draw),
        _ => robot(draw),
    }
}

/// Four wheels, standing on a facet each.
fn wheels(body: &mut Body, x: f32, y: f32, radius: f32, half_width: f32) {
    let outline = Outline::regular(12);
    let mut wheel = Body::default();
    wheel.solid(&outline, &[[0.0, -half_width], [radius, -half_width], [radius, half_width], [0.0, half_width]]);
    let facet = std::f32::consts::PI / 12.0;
    let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f32::consts::FRAC_PI_2)
        * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f32::consts::FRAC_PI_2 + facet);
    for [sx, sy] in [[-1.0f32, -1.0f32], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]] {
        let at = Translation3::new(sx * x, sy * y, radius * facet.cos());
        body.add(&wheel, &Isometry3::from_parts(at, turn));
    }
}

fn car(draw: &mut Draw) -> Made {
    let (half, width) = (draw.length(0.03, 0.06), draw.length(0.016, 0.028));
    let (wheel, height) = (draw.length(0.009, 0.015), draw.length(0.014, 0.024));
    let mut body = Body::default();
    let low = wheel * 0.7;
    body.brick([-half, -width, low], [half, width, low + height]);
    // A cabin with slanted ends.
    let (from, to, slant) = (-half * draw.between(0.5, 0.95), half * draw.between(0.1, 0.6), half * draw.between(0.05, 0.25));
    let roof = low + height + height * draw.between(0.6, 1.1);
    let points: Vec<Point3<f32>> = [[from, low + height], [to, low + height], [to - slant, roof], [from + slant * 0.5, roof]]
        .iter()
        .flat_map(|&[x, z]| [Point3::new(x, -width * 0.88, z), Point3::new(x, width * 0.88, z)])
        .collect();
    body.hull(&points);
    wheels(&mut body, half * 0.62, width * 0.98, wheel, width * 0.22);
    Made::filled("toy car", body, Material::Plastic, 0.002, draw.between(50.0, 500.0))
}

/// An open wagon with something to load.
fn wagon(draw: &mut Draw) -> Made {
    let (half, width, wheel) = (draw.length(0.035, 0.06), draw.length(0.022, 0.035), draw.length(0.009, 0.014));
    let (floor, side) = (wheel * 0.8 + 0.006, draw.length(0.012, 0.03));
    let wall = draw.thickness(0.003, 0.004);
    let mut tub = Body::default();
    let outline = Outline::rectangle(width / half);
    let opening = tub.vessel(&outline, &[[half, floor - 0.006], [half, floor + side]], wall * half / width, 0.006);
    let mut body = Body::default();
    body.add(&tub, &Isometry3::identity());
    // Beside the tub: through its side they would be in what it holds.
    wheels(&mut body, half * 0.65, width * 1.12, wheel, width * 0.15);
    Made::solid("toy wagon", body, draw.pick(&[Material::Wood, Material::Plastic])).with_opening(opening)
}

/// Four legs, a trunk, a head.
fn animal(draw: &mut Draw) -> Made {
    let (half, width) = (draw.length(0.025, 0.05), draw.length(0.012, 0.022));
    let (legs, trunk, leg) = (draw.length(0.015, 0.04), draw.length(0.02, 0.035), draw.length(0.005, 0.009));
    let mut body = Body::default();
    for [x, y] in [[-1.0f32, -1.0f32], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]] {
        let (x, y) = (x * (half - leg), y * (width - leg));
        body.brick([x - leg, y - leg, 0.0], [x + leg, y + leg, legs]);
    }
    body.brick([-half, -width, legs], [half, width, legs + trunk]);
    let (neck, head) = (draw.length(0.006, 0.03), draw.length(0.009, 0.014));
    let top = legs + trunk + neck;
    body.brick([half - 2.0 * leg, -leg, legs + trunk], [half, leg, top]);
    body.brick([half - 2.2 * leg, -head, top], [half + head, head, top + head * 1.4]);
    Made::solid("toy animal", body, draw.pick(&[Material::Wood, Material::Plastic]))
}

fn studded_brick(draw: &mut Draw) -> Made {
    let unit = draw.length(0.011, 0.016);
    let (columns, rows) = (draw.whole(1, 4), draw.whole(1, 2));
    let height = unit * draw.between(0.6, 2.4);
    let (x, y) = (unit * columns as f32, unit * rows as f32);
    let mut body = Body::default();
    body.brick([-x, -y, 0.0], [x, y, height]);
    let rise = unit * 0.35;
    let mut stud = Body::default();
    stud.solid(&Outline::regular(8), &[[0.0, 0.0], [unit * 0.6, 0.0], [unit * 0.6, rise], [0.0, rise]]);
    for column in 0..columns {
        for row in 0..rows {
            let at = |k: usize, n: usize| unit * (2.0 * k as f32 + 1.0 - n as f32);
            body.add(&stud, &Isometry3::translation(at(column, columns), at(row, rows), height));
        }
    }
    // The studs bear what stands on them.
    Made::filled("toy brick", body, Material::Plastic, 0.0015, 200.0).with_top([0.0, 0.0], height + rise, [x - unit * 0.5, y - unit * 0.5])
}

/// Rings of falling size on a cone.
fn ring_tower(draw: &mut Draw) -> Made {
    let rings = draw.whole(3, 5);
    let (radius, rise) = (draw.length(0.03, 0.05), draw.length(0.012, 0.02));
    let mut profile: Vec<ProfilePoint> = vec![[0.0, 0.0]];
    for k in 0..rings {
        let (r, z) = (radius * (1.0 - 0.7 * k as f32 / rings as f32), rise * k as f32);
        profile.extend([[r * 0.93, z], [r, z + rise * 0.25], [r, z + rise * 0.75], [r * 0.93, z + rise * 0.98]]);
    }
    let top = rise * rings as f32;
    profile.extend([[radius * 0.22, top], [radius * 0.14, top + rise * 0.7], [0.0, top + rise * 0.9]]);
    let mut body = Body::default();
    body.solid(&Outline::circle(), &profile);
    Made::solid("ring tower", body, draw.pick(&[Material::Wood, Material::Plastic]))
}

fn chess_piece(draw: &mut Draw) -> Made {
    let (foot, height) = (draw.length(0.015, 0.026), draw.length(0.05, 0.11));
    let (waist, head) = (foot * draw.between(0.35, 0.55), foot * draw.between(0.6, 0.85));
    let at = |r: f32, z: f32| [r, height * z];
    let mut body = Body::default();
    body.solid(
        &Outline::circle(),
        &[
            [0.0, 0.0],
            at(foot, 0.0),
            at(foot, 0.08),
            at(foot * 0.75, 0.16),
            at(waist, 0.4),
            at(waist * 0.9, 0.62),
            at(head, 0.66),
            at(head, 0.7),
            at(head * 0.7, 0.73),
            at(head * 0.95, 0.84),
            at(head * 0.7, 0.95),
            [0.0, height],
        ],
    );
    Made::solid("chess piece", body, Material::Wood)
}

/// Two feet, a trunk, arms, a head.
fn robot(draw: &mut Draw) -> Made {
    let (half, depth) = (draw.length(0.018, 0.032), draw.length(0.014, 0.022));
    let (legs, trunk, head) = (draw.length(0.015, 0.03), draw.length(0.03, 0.05), draw.length(0.01, 0.016));
    let mut body = Body::default();
    for side in [-1.0f32, 1.0] {
        let (near, far) = (side * half * 0.15, side * half);
        body.brick([near.min(far), -depth, 0.0], [near.max(far), depth * 1.2, legs]);
        let (inner, outer) = (side * half, side * half * 1.4);
        let drop = trunk * draw.between(0.2, 0.7);
        body.brick([inner.min(outer), -depth * 0.5, legs + drop], [inner.max(outer), depth * draw.between(0.5, 1.3), legs + trunk * 0.95]);
    }
    body.brick([-half, -depth, legs], [half, depth, legs + trunk]);
    body.brick([-head, -head, legs + trunk], [head, head, legs + trunk + 2.0 * head]);
    Made::solid("toy robot", body, draw.pick(&[Material::Wood, Material::Plastic])).with_top(
        [0.0, 0.0],
        legs + trunk + 2.0 * head,
        [head, head],
    )
}
