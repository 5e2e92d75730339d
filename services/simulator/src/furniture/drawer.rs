//! Open drawers, pulled from a cabinet's front, and trays on tables.

use nalgebra::{Point3, Vector2};
use rand::{Rng, RngExt};

use super::{Fixture, Furniture, FurnitureRole, FurnitureSurface, Outlook, Table, floor, furniture_color, half, shaded};

/// A box without a lid: what a drawer is when it is open.
#[derive(Debug, Clone, Copy)]
pub(super) struct OpenBox {
    /// Middle of the bottom's upper face.
    pub middle: Point3<f64>,
    /// Half its inner edge lengths, metres.
    pub half_inner_m: Vector2<f64>,
    /// Height of the walls over the bottom, metres.
    pub depth_m: f64,
    /// Thickness of walls and bottom, metres.
    pub wall_m: f64,
}

impl OpenBox {
    /// Bottom and four walls, and the surface inside; `weight` is how often objects are put there.
    pub fn built(&self, color: [u8; 3], weight: f64) -> (Vec<Fixture>, FurnitureSurface) {
        let (m, x, y, w) = (self.middle, self.half_inner_m.x, self.half_inner_m.y, self.wall_m);
        let (bottom, rim) = (m.z - w, m.z + self.depth_m);
        let part = |role, low: [f64; 2], high: [f64; 2], z: [f64; 2]| {
            Fixture::between(role, Point3::new(m.x + low[0], m.y + low[1], z[0]), Point3::new(m.x + high[0], m.y + high[1], z[1]), color)
        };
        let fixtures = vec![
            part(FurnitureRole::DrawerBottom, [-x, -y], [x, y], [bottom, m.z]),
            part(FurnitureRole::DrawerWall, [-x - w, -y - w], [-x, y + w], [bottom, rim]),
            part(FurnitureRole::DrawerWall, [x, -y - w], [x + w, y + w], [bottom, rim]),
            part(FurnitureRole::DrawerWall, [-x, -y - w], [x, -y], [bottom, rim]),
            part(FurnitureRole::DrawerWall, [-x, y], [x, y + w], [bottom, rim]),
        ];
        (fixtures, FurnitureSurface::open(FurnitureRole::DrawerBottom, m, self.half_inner_m, weight))
    }
}

/// A drawer pulled out of a front (the plane y = `front_y`, towards −y).
#[derive(Debug, Clone, Copy)]
pub(super) struct PulledDrawer {
    /// The cabinet's front.
    pub front_y: f64,
    /// Middle of the drawer along the front.
    pub middle_x: f64,
    /// Outer width, metres.
    pub width_m: f64,
    /// How far it is pulled out, metres.
    pub pulled_m: f64,
    /// Upper edge of its front panel.
    pub top_z: f64,
    /// Height of the panel, metres.
    pub panel_m: f64,
}

impl PulledDrawer {
    /// The drawer with its front panel and handle, and the surface inside.
    pub fn built(&self, color: [u8; 3], weight: f64, rng: &mut impl Rng) -> (Vec<Fixture>, FurnitureSurface) {
        const PANEL_M: f64 = 0.018;
        let wall = rng.random_range(0.009..0.014);
        let depth = self.panel_m - rng.random_range(0.025..0.045);
        // The drawer's back stays inside the cabinet's front, and what is behind it is closed.
        let inner = half(self.width_m - 2.0 * wall - 0.01, self.pulled_m - PANEL_M - 2.0 * wall);
        let middle_y = self.front_y - wall - inner.y;
        let bottom_z = self.top_z - self.panel_m + wall + 0.006;
        let open = OpenBox { middle: Point3::new(self.middle_x, middle_y, bottom_z), half_inner_m: inner, depth_m: depth, wall_m: wall };
        let (mut fixtures, surface) = open.built(shaded(color, 1.08), weight);
        let panel_y = [self.front_y - self.pulled_m, self.front_y - self.pulled_m + PANEL_M];
        let (x, z) = (self.width_m / 2.0, [self.top_z - self.panel_m, self.top_z]);
        let panel = |low: [f64; 3], high: [f64; 3], color| Fixture::between(FurnitureRole::Front, low.into(), high.into(), color);
        fixtures.push(panel([self.middle_x - x, panel_y[0], z[0]], [self.middle_x + x, panel_y[1], z[1]], color));
        fixtures.push(handle(self.middle_x, panel_y[0], (z[0] + z[1]) / 2.0));
        (fixtures, surface)
    }
}

/// A bar handle before a front at `y`.
pub(super) fn handle(x: f64, y: f64, z: f64) -> Fixture {
    Fixture::between(FurnitureRole::Front, Point3::new(x - 0.06, y - 0.025, z - 0.006), Point3::new(x + 0.06, y, z + 0.006), [96, 98, 102])
}

/// A cabinet with an open drawer, or a tray on a table.
pub(super) fn drawer(rng: &mut impl Rng) -> Furniture {
    if rng.random_bool(0.35) { tray(rng) } else { cabinet(rng) }
}

/// A chest whose top is z = 0, its uppermost drawer pulled out.
fn cabinet(rng: &mut impl Rng) -> Furniture {
    let color = furniture_color(rng);
    let (width, depth) = (rng.random_range(0.42..0.8), rng.random_range(0.38..0.5));
    let (height, top) = (rng.random_range(0.4..0.95), rng.random_range(0.016..0.03));
    let (x, y) = (width / 2.0, depth / 2.0);
    let body = Fixture::between(FurnitureRole::Cabinet, Point3::new(-x, -y, -height), Point3::new(x, y, -top), shaded(color, 0.9));
    let lid = Fixture::between(FurnitureRole::CabinetTop, Point3::new(-x, -y, -top), Point3::new(x, y, 0.0), color);
    let pulled = PulledDrawer {
        front_y: -y,
        middle_x: 0.0,
        width_m: width - 0.006,
        pulled_m: rng.random_range(0.24..0.38),
        top_z: -top - 0.004,
        panel_m: rng.random_range(0.13..0.22),
    };
    let (drawer, inside) = pulled.built(color, 1.0, rng);
    let mut fixtures = vec![lid, body];
    fixtures.extend(drawer);
    closed_fronts(&mut fixtures, [-x, x], -y, [-height, pulled.top_z - pulled.panel_m - 0.006], color);
    fixtures.push(floor(-height, rng));
    let on_top = FurnitureSurface::open(FurnitureRole::CabinetTop, Point3::origin(), half(width, depth), 0.7);
    Furniture { fixtures, surfaces: vec![on_top, inside], outlook: Outlook::front(1.0, [0.65, 1.2], [0.6, 1.15]) }
}

/// The fronts of closed drawers below an open one.
pub(super) fn closed_fronts(fixtures: &mut Vec<Fixture>, x: [f64; 2], front_y: f64, z: [f64; 2], color: [u8; 3]) {
    let count = ((z[1] - z[0]) / 0.24).floor().max(1.0);
    let each = (z[1] - z[0]) / count;
    for k in 0..count as usize {
        let low = z[0] + each * k as f64 + 0.003;
        let (from, to) = (Point3::new(x[0] + 0.003, front_y - 0.016, low), Point3::new(x[1] - 0.003, front_y, low + each - 0.006));
        fixtures.push(Fixture::between(FurnitureRole::Front, from, to, color));
        fixtures.push(handle((x[0] + x[1]) / 2.0, front_y - 0.016, low + each * 0.7));
    }
}

/// A tray or an open carton on a table.
fn tray(rng: &mut impl Rng) -> Furniture {
    let table = Table::Random { half_m: [0.42, 0.6], height_m: [0.4, 0.9], round: 0.0, wall: 0.2 };
    let mut built = table.furniture(rng);
    let wall_m = rng.random_range(0.006..0.012);
    let open = OpenBox {
        middle: Point3::new(rng.random_range(-0.12..0.12), rng.random_range(-0.12..0.12), wall_m),
        half_inner_m: Vector2::new(rng.random_range(0.15..0.24), rng.random_range(0.12..0.18)),
        depth_m: rng.random_range(0.03..0.11),
        wall_m,
    };
    let (tray, inside) = open.built(furniture_color(rng), 1.5);
    built.fixtures.extend(tray);
    built.surfaces.push(inside);
    built.outlook.elevation_rad = [0.6, 1.2];
    built
}
