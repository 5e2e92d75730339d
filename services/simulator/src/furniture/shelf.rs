//! Shelves: boards between two sides and a back, open to the front.

use nalgebra::{Point3, Vector2};
use rand::{Rng, RngExt};

use super::{Fixture, Furniture, FurnitureRole, FurnitureSurface, Outlook, floor, furniture_color, half, shaded};

/// A shelf of two or three compartments; the main surface is the lowest board that is used, the rest of the shelf is below it.
pub(super) fn shelf(rng: &mut impl Rng) -> Furniture {
    let color = furniture_color(rng);
    let (width, depth) = (rng.random_range(0.55..1.0), rng.random_range(0.26..0.4));
    let board = rng.random_range(0.014..0.026);
    let compartments = rng.random_range(2..=3usize);
    let below = rng.random_range(0.05..0.9);
    let (x, y) = (width / 2.0, depth / 2.0);
    let mut heights = vec![0.0];
    for _ in 0..compartments {
        heights.push(heights[heights.len() - 1] + rng.random_range(0.22..0.4));
    }
    let top = heights[compartments];
    let mut fixtures = Vec::new();
    let mut surfaces = Vec::new();
    for (level, &height) in heights.iter().enumerate() {
        let role = if level == compartments { FurnitureRole::ShelfTop } else { FurnitureRole::Board };
        fixtures.push(Fixture::between(role, Point3::new(-x, -y, height - board), Point3::new(x, y, height), color));
        let clear_m = heights.get(level + 1).map_or(f64::INFINITY, |above| above - board - height);
        // The top is under the open sky and would otherwise take most of what finds no room below.
        let weight = if level == compartments { 0.35 } else { 1.0 };
        surfaces
            .push(FurnitureSurface { clear_m, ..FurnitureSurface::open(role, Point3::new(0.0, 0.0, height), half(width, depth), weight) });
    }
    let dark = shaded(color, 0.88);
    for side in [-1.0, 1.0] {
        let (inner, outer) = (side * x, side * (x + board));
        let low = Point3::new(inner.min(outer), -y, -below);
        fixtures.push(Fixture::between(FurnitureRole::ShelfWall, low, Point3::new(inner.max(outer), y, top), dark));
    }
    let back = Point3::new(x + board, y + 0.008, top);
    fixtures.push(Fixture::between(FurnitureRole::ShelfWall, Point3::new(-x - board, y, -below), back, shaded(color, 0.8)));
    fixtures.push(floor(-below, rng));
    if rng.random_bool(0.5) {
        let wall = shaded([226, 222, 214], rng.random_range(0.75..1.05));
        let low = Point3::new(-2.0, y + 0.008, -below);
        fixtures.push(Fixture::between(FurnitureRole::Wall, low, Point3::new(2.0, y + 0.1, top + rng.random_range(0.3..0.9)), wall));
    }
    keep_two_neighbours(&mut surfaces, rng);
    Furniture { fixtures, surfaces, outlook: Outlook::front(0.65, [0.12, 0.6], [0.65, 1.2]) }
}

/// Things stand on two neighbouring levels, so that one picture shows them all.
fn keep_two_neighbours(surfaces: &mut [FurnitureSurface], rng: &mut impl Rng) {
    let first = rng.random_range(0..surfaces.len() - 1);
    for (level, surface) in surfaces.iter_mut().enumerate() {
        if level != first && level != first + 1 {
            surface.weight = 0.0;
        }
        // Not at the very edge, nor hidden in the corner behind a side.
        surface.half_extents_m = surface.half_extents_m.map(|h| h - 0.005).sup(&Vector2::repeat(0.01));
    }
}
