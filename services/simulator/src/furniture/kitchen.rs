//! The paper's evaluation kitchen: a counter whose top drawer is pulled open (section 3 and the appendix, "Cabinet Placement").

use nalgebra::Point3;
use rand::{Rng, RngExt};

use super::drawer::{PulledDrawer, closed_fronts};
use super::{Fixture, Furniture, FurnitureRole, FurnitureSurface, Outlook, floor, furniture_color, half, shaded};

/// Worktop at z = 0 with a backsplash, units below it side by side, the top drawer of the middle one open.
pub(super) fn kitchen(rng: &mut impl Rng) -> Furniture {
    const TOE_M: f64 = 0.1;
    let (color, worktop) = (furniture_color(rng), shaded([206, 200, 190], rng.random_range(0.45..1.15)));
    let (depth, thickness, height) = (rng.random_range(0.56..0.64), rng.random_range(0.028..0.042), rng.random_range(0.86..0.94));
    let unit = rng.random_range(0.5..0.68);
    let (x, y) = (unit * 1.5, depth / 2.0);
    // The fronts are flush with the worktop's edge, and the open drawer wholly before it: nothing hides under the worktop.
    let front_y = -y + 0.018;
    let mut fixtures = vec![
        Fixture::between(FurnitureRole::Worktop, Point3::new(-x, -y, -thickness), Point3::new(x, y, 0.0), worktop),
        Fixture::between(
            FurnitureRole::Cabinet,
            Point3::new(-x, front_y, TOE_M - height),
            Point3::new(x, y, -thickness),
            shaded(color, 0.85),
        ),
        Fixture::between(
            FurnitureRole::Cabinet,
            Point3::new(-x, front_y + 0.08, -height),
            Point3::new(x, y, TOE_M - height),
            shaded(color, 0.5),
        ),
        Fixture::between(
            FurnitureRole::Wall,
            Point3::new(-x - 0.8, y, -height),
            Point3::new(x + 0.8, y + 0.1, rng.random_range(0.45..0.8)),
            shaded([232, 230, 224], rng.random_range(0.8..1.05)),
        ),
    ];
    let pulled = PulledDrawer {
        front_y: -y,
        middle_x: 0.0,
        width_m: unit - 0.006,
        pulled_m: rng.random_range(0.3..0.42),
        top_z: -thickness - 0.004,
        panel_m: rng.random_range(0.15..0.2),
    };
    let (drawer, inside) = pulled.built(color, 1.0, rng);
    fixtures.extend(drawer);
    let below = pulled.top_z - pulled.panel_m - 0.006;
    closed_fronts(&mut fixtures, [-unit / 2.0, unit / 2.0], front_y, [TOE_M - height, below], color);
    for side in [-1.0, 1.0] {
        let middle = side * unit;
        closed_fronts(&mut fixtures, [middle - unit / 2.0, middle + unit / 2.0], front_y, [TOE_M - height, -thickness - 0.004], color);
    }
    fixtures.push(floor(-height, rng));
    let counter = FurnitureSurface::open(FurnitureRole::Worktop, Point3::origin(), half(2.0 * x, depth), 1.4);
    Furniture { fixtures, surfaces: vec![counter, inside], outlook: Outlook::front(0.8, [0.6, 1.1], [0.7, 1.25]) }
}
