//! Odd shapes of bricks and wedges: what stands in for everything that has no family.

use nalgebra::Point3;

use super::super::body::Body;
use super::super::material::Material;
use super::draw::Draw;
use super::made::Made;

/// One of them.
pub fn compound(draw: &mut Draw) -> Made {
    match draw.whole(0, 9) {
        0 => letter_l(draw),
        1 => letter_t(draw),
        2 => steps(draw),
        3 => arch(draw),
        4 => table(draw),
        5 => cross(draw),
        6 => wedge(draw),
        7 => channel(draw),
        8 => roofed(draw),
        _ => pile(draw),
    }
}

fn made(name: &'static str, body: Body, draw: &mut Draw) -> Made {
    if draw.chance(0.5) {
        Made::solid(name, body, Material::Wood)
    } else {
        Made::filled(name, body, Material::Plastic, 0.0015, draw.between(100.0, 600.0))
    }
}

/// A foot with a post at one end.
fn letter_l(draw: &mut Draw) -> Made {
    let (x, y, z) = (draw.length(0.06, 0.13), draw.length(0.03, 0.08), draw.length(0.018, 0.045));
    let (post, rise) = (x * draw.between(0.22, 0.42), draw.length(0.03, 0.09));
    let mut body = Body::default();
    body.brick([0.0, -y / 2.0, 0.0], [x, y / 2.0, z]);
    body.brick([0.0, -y / 2.0, z], [post, y / 2.0, z + rise]);
    made("letter L", body, draw).with_top([post / 2.0, 0.0], z + rise, [post / 2.0, y / 2.0])
}

/// Upright or upside down.
fn letter_t(draw: &mut Draw) -> Made {
    let (x, y) = (draw.length(0.06, 0.13), draw.length(0.035, 0.07));
    let (bar, rise) = (draw.length(0.018, 0.035), draw.length(0.035, 0.08));
    let post = x * draw.between(0.28, 0.45);
    let mut body = Body::default();
    if draw.chance(0.5) {
        body.brick([-x / 2.0, -y / 2.0, 0.0], [x / 2.0, y / 2.0, bar]);
        body.brick([-post / 2.0, -y / 2.0, bar], [post / 2.0, y / 2.0, bar + rise]);
        made("letter T", body, draw).with_top([0.0, 0.0], bar + rise, [post / 2.0, y / 2.0])
    } else {
        body.brick([-post / 2.0, -y / 2.0, 0.0], [post / 2.0, y / 2.0, rise]);
        body.brick([-x / 2.0, -y / 2.0, rise], [x / 2.0, y / 2.0, rise + bar]);
        // Only over the post does it bear a load.
        made("letter T", body, draw).with_top([0.0, 0.0], rise + bar, [post / 2.0, y / 2.0])
    }
}

fn steps(draw: &mut Draw) -> Made {
    let count = draw.whole(2, 4);
    let (x, y, z) = (draw.length(0.02, 0.035), draw.length(0.03, 0.09), draw.length(0.012, 0.03));
    let mut body = Body::default();
    for k in 0..count {
        body.brick([x * k as f32, -y / 2.0, 0.0], [x * (k + 1) as f32, y / 2.0, z * (k + 1) as f32]);
    }
    let last = count as f32;
    made("steps", body, draw).with_top([x * (last - 0.5), 0.0], z * last, [x / 2.0, y / 2.0])
}

/// Two pillars and a bridge, round or square inside.
fn arch(draw: &mut Draw) -> Made {
    let (half, depth) = (draw.length(0.035, 0.07), draw.length(0.03, 0.07));
    let thick = half * draw.between(0.3, 0.5);
    let hole = half - thick;
    let legs = draw.length(0.012, 0.05);
    let mut body = Body::default();
    for side in [-1.0f32, 1.0] {
        body.brick([(side * half).min(side * hole), -depth / 2.0, 0.0], [(side * half).max(side * hole), depth / 2.0, legs]);
    }
    let top = if draw.chance(0.6) {
        const STONES: usize = 6;
        let top = legs + hole + thick * 0.8;
        // Each stone spans from the round hole up to the level top.
        let at = |k: usize| {
            let turn = std::f32::consts::PI * k as f32 / STONES as f32;
            [hole * turn.cos(), legs + hole * turn.sin()]
        };
        for k in 0..STONES {
            let (a, b) = (at(k), at(k + 1));
            body.hull(&slab(&[a, [a[0], top], [b[0], top], b], depth));
        }
        for side in [-1.0f32, 1.0] {
            body.brick([(side * half).min(side * hole), -depth / 2.0, legs], [(side * half).max(side * hole), depth / 2.0, top]);
        }
        top
    } else {
        let top = legs + thick;
        body.brick([-half, -depth / 2.0, legs], [half, depth / 2.0, top]);
        top
    };
    made("arch", body, draw).with_top([0.0, 0.0], top, [half, depth / 2.0])
}

/// A board on four legs, a bench, a stool.
fn table(draw: &mut Draw) -> Made {
    let half = [draw.length(0.03, 0.08), draw.length(0.03, 0.06)];
    let (leg, rise, board) = (draw.length(0.006, 0.012), draw.length(0.025, 0.08), draw.length(0.008, 0.016));
    let mut body = Body::default();
    if draw.chance(0.6) {
        for [x, y] in [[-1.0f32, -1.0f32], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]] {
            let (x, y) = (x * (half[0] - leg), y * (half[1] - leg));
            body.brick([x - leg, y - leg, 0.0], [x + leg, y + leg, rise]);
        }
    } else {
        for side in [-1.0f32, 1.0] {
            let x = side * (half[0] - leg);
            body.brick([x - leg, -half[1], 0.0], [x + leg, half[1], rise]);
        }
    }
    body.brick([-half[0], -half[1], rise], [half[0], half[1], rise + board]);
    made("small table", body, draw).with_top([0.0, 0.0], rise + board, half)
}

/// A plus, lying.
fn cross(draw: &mut Draw) -> Made {
    let (x, y, z) = (draw.length(0.035, 0.07), draw.length(0.035, 0.07), draw.length(0.018, 0.05));
    let (a, b) = (y * draw.between(0.25, 0.5), x * draw.between(0.25, 0.5));
    let mut body = Body::default();
    body.brick([-x, -a, 0.0], [x, a, z]);
    for side in [-1.0f32, 1.0] {
        body.brick([-b, (side * a).min(side * y), 0.0], [b, (side * a).max(side * y), z]);
    }
    made("cross", body, draw).with_top([0.0, 0.0], z, [x, a])
}

/// A ramp or a roof.
fn wedge(draw: &mut Draw) -> Made {
    let (x, y, z) = (draw.length(0.05, 0.13), draw.length(0.04, 0.09), draw.length(0.025, 0.07));
    let blunt = draw.length(0.004, 0.02);
    let mut body = Body::default();
    let ridge = x * draw.pick(&[0.0, 0.5]);
    let from = if ridge > 0.0 { ridge - blunt / 2.0 } else { 0.0 };
    body.hull(&slab(&[[0.0, 0.0], [x, 0.0], [from + blunt, z], [from, z]], y));
    made("wedge", body, draw)
}

/// A U lying with its opening up.
fn channel(draw: &mut Draw) -> Made {
    let (x, y, z) = (draw.length(0.03, 0.06), draw.length(0.03, 0.08), draw.length(0.025, 0.06));
    let (wall, floor) = (x * draw.between(0.15, 0.3), draw.length(0.008, 0.018));
    let mut body = Body::default();
    body.brick([-x, -y, 0.0], [x, y, floor]);
    body.brick([-x, -y, floor], [-x + wall, y, z]);
    body.brick([x - wall, -y, floor], [x, y, z]);
    made("channel", body, draw)
}

/// A block with a pitched roof that overhangs.
fn roofed(draw: &mut Draw) -> Made {
    let (x, y, z) = (draw.length(0.025, 0.05), draw.length(0.025, 0.06), draw.length(0.03, 0.07));
    let (over, rise) = (draw.between(1.0, 1.25), draw.length(0.015, 0.035));
    let mut body = Body::default();
    body.brick([-x, -y, 0.0], [x, y, z]);
    body.hull(&slab(&[[-x * over, z], [x * over, z], [0.003, z + rise], [-0.003, z + rise]], 2.0 * y));
    made("house", body, draw)
}

/// Bricks that grow on one another, each over its parent's middle.
fn pile(draw: &mut Draw) -> Made {
    let count = draw.whole(2, 4);
    let (mut x, mut y) = (draw.length(0.03, 0.06), draw.length(0.025, 0.05));
    let (mut at, mut z) = ([0.0f32, 0.0f32], 0.0f32);
    let mut body = Body::default();
    for _ in 0..count {
        let rise = draw.length(0.012, 0.045);
        body.brick([at[0] - x, at[1] - y, z], [at[0] + x, at[1] + y, z + rise]);
        z += rise;
        let (next_x, next_y) = (x * draw.between(0.45, 1.05), y * draw.between(0.45, 1.05));
        at[0] += (x - next_x).abs() * draw.between(-1.0, 1.0) * 0.6;
        at[1] += (y - next_y).abs() * draw.between(-1.0, 1.0) * 0.6;
        (x, y) = (next_x, next_y);
    }
    made("stepped block", body, draw)
}

/// A polygon in the xz plane, drawn out along y.
fn slab(polygon: &[[f32; 2]], depth: f32) -> Vec<Point3<f32>> {
    polygon.iter().flat_map(|&[x, z]| [Point3::new(x, -depth / 2.0, z), Point3::new(x, depth / 2.0, z)]).collect()
}
