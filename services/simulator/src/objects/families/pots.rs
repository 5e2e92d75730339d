//! Pots with two grips and pans with one long handle, open or under a lid.

use nalgebra::{Point3, Vector3};

use super::super::VesselInterior;
use super::super::bar::BarSection;
use super::super::body::Body;
use super::super::material::Material;
use super::super::outline::{Outline, ProfilePoint, radius_at};
use super::draw::Draw;
use super::made::Made;

/// A pot with two grips.
pub fn pot(draw: &mut Draw) -> Made {
    let (radius, height) = (draw.length(0.05, 0.1), draw.length(0.045, 0.11));
    let outer = if draw.chance(0.6) {
        vec![[radius * 0.95, 0.0], [radius, radius * 0.05], [radius, height]]
    } else {
        vec![[radius * 0.7, 0.0], [radius * 0.93, height * 0.22], [radius, height * 0.5], [radius, height]]
    };
    let mut pot = Cookware::new("pot", outer, 0.35, draw);
    let (at, z) = (radius_at(&pot.outer, height * 0.8), height * draw.between(0.72, 0.85));
    let reach = radius * draw.between(0.25, 0.4);
    let half_width = radius * draw.between(0.25, 0.4);
    let loops = draw.chance(0.5);
    for side in [-1.0f32, 1.0] {
        if loops {
            let inside = at - pot.wall * 0.5;
            // The wall curves away under a wide grip; its ends start where the wall is.
            let start = (inside * inside - half_width * half_width).max(0.0).sqrt();
            let path = [[start, -half_width], [at + reach, -half_width * 0.85], [at + reach, half_width * 0.85], [start, half_width]]
                .map(|[x, y]| Point3::new(side * x, y, z));
            pot.body.bar(&path, Vector3::z_axis(), &BarSection::round(draw.thickness(0.0032, 0.0045)));
        } else {
            let edge = ((at - pot.wall * 0.5).powi(2) - half_width * half_width).max(0.0).sqrt();
            let half = Vector3::new((at + reach - edge) / 2.0, half_width, draw.thickness(0.004, 0.006));
            // A block between two level faces; inside, it ends within the wall at its middle too.
            block_on_wall(&mut pot.body, side, [at - pot.wall * 0.6, edge, at + reach], half.y, half.z, z);
        }
    }
    pot.made(draw)
}

/// A pan, or with higher walls a saucepan.
pub fn pan(draw: &mut Draw) -> Made {
    let deep = draw.chance(0.4);
    let radius = if deep { draw.length(0.06, 0.09) } else { draw.length(0.08, 0.125) };
    let height = if deep { draw.length(0.06, 0.1) } else { draw.length(0.03, 0.05) };
    let base = radius * draw.between(0.78, 0.96);
    let outer = vec![[base, 0.0], [base + (radius - base) * 0.7, height * 0.4], [radius, height]];
    let mut pan = Cookware::new(if deep { "saucepan" } else { "pan" }, outer, if deep { 0.3 } else { 0.08 }, draw);
    let z = height * draw.between(0.7, 0.82);
    let inside = radius_at(&pan.outer, z) - pan.wall * 0.5;
    let length = radius * draw.between(1.1, 1.7);
    let (half_width, half_height) = (draw.thickness(0.007, 0.011), draw.thickness(0.0035, 0.006));
    let rise = length * draw.between(0.0, 0.25);
    let path = [[0.0, 0.0], [0.25, 0.0], [0.6, 0.5], [1.0, 1.0]].map(|[t, up]| Point3::new(inside + length * t, 0.0, z + rise * up));
    pan.body.bar(&path, Vector3::y_axis(), &BarSection::oval(half_width, half_height));
    pan.made(draw)
}

struct Cookware {
    name: &'static str,
    body: Body,
    outer: Vec<ProfilePoint>,
    wall: f32,
    opening: Option<VesselInterior>,
}

impl Cookware {
    /// The vessel, or with the given probability a closed one under a lid with a knob.
    fn new(name: &'static str, outer: Vec<ProfilePoint>, lid: f64, draw: &mut Draw) -> Self {
        let wall = draw.thickness(0.0026, 0.0036);
        let mut body = Body::default();
        let [radius, height] = outer[outer.len() - 1];
        let opening = if draw.chance(lid) {
            let (rise, brim, knob) = (draw.length(0.006, 0.018), draw.thickness(0.003, 0.005), draw.length(0.008, 0.014));
            let top = height + brim + rise;
            let mut profile = vec![[0.0, 0.0]];
            profile.extend_from_slice(&outer);
            profile.extend([
                [radius * 1.03, height],
                [radius * 1.03, height + brim],
                [knob, top],
                [knob * 0.6, top + knob * 0.4],
                [knob, top + knob * 0.8],
                [knob * 0.9, top + knob * 1.3],
                [0.0, top + knob * 1.3],
            ]);
            body.solid(&Outline::circle(), &profile);
            None
        } else {
            Some(body.vessel(&Outline::circle(), &outer, wall, draw.thickness(0.0035, 0.005)))
        };
        Self { name, body, outer, wall, opening }
    }

    fn made(self, draw: &mut Draw) -> Made {
        match self.opening {
            Some(opening) => {
                let material = draw.pick(&[Material::Steel, Material::Aluminium, Material::Aluminium]);
                Made::solid(self.name, self.body, material).with_opening(opening)
            }
            // With a lid on nobody sees what is inside; it may be half full.
            None => Made::filled(self.name, self.body, Material::Aluminium, 0.002, draw.between(0.0, 500.0)),
        }
    }
}

/// A grip across a round wall: `x` are its distances from the axis in the middle of the wall, at its sides, and outside.
fn block_on_wall(body: &mut Body, side: f32, x: [f32; 3], half_width: f32, half_height: f32, z: f32) {
    let [middle, edge, out] = x;
    let mut half = |y0: f32, y1: f32| {
        let points: Vec<Point3<f32>> = [-1.0f32, 1.0]
            .into_iter()
            .flat_map(|up| {
                let inner = |y: f32| if y == 0.0 { middle } else { edge };
                [[inner(y0), y0], [out, y0], [inner(y1), y1], [out, y1]].map(|[x, y]| Point3::new(side * x, y, z + up * half_height))
            })
            .collect();
        body.hull(&points);
    };
    half(-half_width, 0.0);
    half(0.0, half_width);
}
