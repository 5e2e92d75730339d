//! Bottles, flasks of flat cross-section, and jars.

use nalgebra::{Isometry3, Vector3};

use super::super::body::Body;
use super::super::material::Material;
use super::super::outline::{Outline, ProfilePoint};
use super::draw::Draw;
use super::made::Made;

/// A round bottle.
pub fn bottle(draw: &mut Draw) -> Made {
    let (radius, height) = (draw.length(0.024, 0.043), draw.length(0.13, 0.28));
    let at = |r: f32, z: f32| [radius * r, height * z];
    let neck = draw.between(0.3, 0.42);
    let shoulder = draw.between(0.5, 0.68);
    let mut profile: Vec<ProfilePoint> = vec![[0.0, 0.0], at(0.93, 0.0), [radius, radius * 0.09]];
    match draw.whole(0, 4) {
        // Wine: straight, round shoulder, long neck, lip.
        0 => profile.extend([
            at(1.0, shoulder),
            at(0.85, shoulder + 0.06),
            at(0.5, shoulder + 0.12),
            at(neck, shoulder + 0.17),
            at(neck, 0.96),
            at(neck * 1.15, 0.965),
            at(neck * 1.15, 1.0),
        ]),
        // Soda: a waist to grip, a cap wider than the neck.
        1 => {
            let waist = draw.between(0.8, 0.92);
            profile.extend([
                at(1.0, 0.25),
                at(waist, 0.38),
                at(1.0, 0.52),
                at(0.97, 0.66),
                at(neck, 0.88),
                at(neck, 0.92),
                at(neck * 1.25, 0.92),
                at(neck * 1.25, 1.0),
            ]);
        }
        // Sauce: a taper all the way up.
        2 => profile.extend([at(1.0, 0.4), at(draw.between(0.7, 0.85), 0.62), at(neck, 0.82), at(neck * 1.1, 0.84), at(neck * 0.9, 1.0)]),
        // Medicine: square shoulder, wide cap.
        3 => {
            let cap = draw.between(0.55, 0.8);
            profile.extend([at(1.0, 0.7), at(0.8, 0.76), at(cap * 0.9, 0.78), at(cap * 0.9, 0.81), at(cap, 0.81), at(cap, 1.0)]);
        }
        // Anything: two or three conical stretches, then a cap.
        _ => {
            let stretches = draw.whole(2, 3);
            for k in 1..=stretches {
                profile.push(at(draw.between(0.68, 1.0), 0.68 * k as f32 / stretches as f32));
            }
            profile.extend([at(neck, 0.85), at(neck, 0.9), at(neck * 1.2, 0.9), at(neck * 1.1, 1.0)]);
        }
    }
    profile.push([0.0, height]);
    let mut body = Body::default();
    body.solid(&Outline::circle(), &profile);
    if draw.chance(0.4) {
        return Made::filled("bottle", body, Material::Glass, 0.0025, liquid(draw));
    }
    Made::filled("bottle", body, Material::Plastic, 0.0006, liquid(draw))
}

/// A flask: detergent, shampoo, spray cleaner.
pub fn flask(draw: &mut Draw) -> Made {
    let (radius, height) = (draw.length(0.03, 0.055), draw.length(0.11, 0.24));
    let aspect = draw.between(0.45, 0.75);
    let outline = match draw.whole(0, 2) {
        0 => Outline::superellipse(2.0, aspect),
        1 => Outline::superellipse(draw.between(2.6, 4.0), aspect),
        _ => Outline::rounded(aspect, draw.between(0.15, 0.35)),
    };
    let shoulder = height * draw.between(0.6, 0.8);
    let waist = draw.between(0.85, 1.0);
    let neck = draw.between(0.3, 0.45);
    let end = height * draw.between(0.84, 0.9);
    let profile = [
        [0.0, 0.0],
        [radius * 0.95, 0.0],
        [radius, radius * 0.08],
        [radius * waist, shoulder * 0.55],
        [radius * draw.between(0.85, 1.0), shoulder],
        [radius * neck, end],
        [0.0, end],
    ];
    let mut body = Body::default();
    body.solid(&outline, &profile);
    // The cap stands a little inside the shoulder's flat end.
    let cap = radius * neck * draw.between(0.75, 0.95) * aspect.max(0.6);
    let round = Outline::circle_of(16);
    let lift = Isometry3::translation(0.0, 0.0, end - 0.001);
    let mut head = Body::default();
    if draw.chance(0.3) {
        // A spray head: neck, trigger, nozzle.
        let rise = height - end + 0.02;
        head.solid(&round, &[[0.0, 0.0], [cap, 0.0], [cap * 0.8, rise], [0.0, rise]]);
        let half = Vector3::new(cap * 1.7, cap * 0.6, rise * 0.22);
        head.cuboid([cap * 0.7, 0.0, rise].into(), nalgebra::UnitQuaternion::identity(), half);
        head.brick([cap * 1.5, -cap * 0.25, rise * 0.25], [cap * 2.0, cap * 0.25, rise * 0.85]);
    } else {
        head.solid(&round, &[[0.0, 0.0], [cap, 0.0], [cap * draw.between(0.75, 1.0), height - end], [0.0, height - end]]);
    }
    body.add(&head, &lift);
    Made::filled("flask", body, Material::Plastic, 0.0008, liquid(draw))
}

/// A jar with its lid on.
pub fn jar(draw: &mut Draw) -> Made {
    let (radius, height) = (draw.length(0.028, 0.05), draw.length(0.05, 0.14));
    let outline = match draw.whole(0, 3) {
        0 => Outline::rounded(1.0, draw.between(0.3, 0.6)),
        1 => Outline::regular(draw.pick(&[6, 8])),
        _ => Outline::circle(),
    };
    let lid = draw.between(0.75, 1.02);
    let (shoulder, lid_start) = (height * draw.between(0.7, 0.78), height * draw.between(0.82, 0.88));
    let belly = draw.between(0.94, 1.0);
    let neck = (lid * 0.93).min(0.9);
    let profile = [
        [0.0, 0.0],
        [radius * 0.94, 0.0],
        [radius, radius * 0.1],
        [radius * belly, shoulder * 0.5],
        [radius, shoulder],
        [radius * neck, lid_start - height * 0.02],
        [radius * neck, lid_start],
        [radius * lid, lid_start],
        [radius * lid, height],
        [0.0, height],
    ];
    let mut body = Body::default();
    body.solid(&outline, &profile);
    let content = if draw.chance(0.3) { 0.0 } else { draw.between(300.0, 1100.0) };
    Made::filled("jar", body, Material::Glass, 0.0025, content).with_round_top(&outline, radius * lid, height)
}

/// What is left of the liquid, kg/m³ of the whole volume.
fn liquid(draw: &mut Draw) -> f32 {
    1000.0 * draw.between(0.05, 0.98)
}
