//! What objects stand on and in: tables, boxes, shelves, drawers, a kitchen.
//!
//! Furniture is made of [`Fixture`]s, boxes that never move, and says where objects can stand ([`FurnitureSurface`]) and from where a
//! camera sees them ([`Outlook`]). Each kind is built in a frame of its own (front towards −y, the main surface at z = 0) and then turned
//! about z, so that no direction of the world is special.

pub mod drawer;
pub mod fixture;
pub mod kind;
pub mod kitchen;
pub mod outlook;
pub mod shelf;
pub mod surface;
pub mod table;

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector2, Vector3};
use rand::{Rng, RngExt};

pub use fixture::{Fixture, FurnitureRole};
pub use kind::{KindWeights, SceneKind};
pub use outlook::{Focus, Outlook};
pub use surface::FurnitureSurface;
pub use table::Table;

/// Furniture of one scene.
#[derive(Debug, Clone)]
pub struct Furniture {
    /// What it is made of.
    pub fixtures: Vec<Fixture>,
    /// Where objects can stand; the first is the main surface, at z = 0.
    pub surfaces: Vec<FurnitureSurface>,
    /// From where a camera sees the objects.
    pub outlook: Outlook,
}

impl Furniture {
    /// Random furniture for a kind of scene. Tables are `table`, when that is fixed; other kinds have no use for it.
    pub fn sample(kind: SceneKind, table: &Table, rng: &mut impl Rng) -> Self {
        let built = match kind {
            SceneKind::OpenTable | SceneKind::Clutter | SceneKind::Stacking | SceneKind::Pile => table.furniture(rng),
            SceneKind::LargeBox => table::with_large_box(table, rng),
            SceneKind::Shelf => shelf::shelf(rng),
            SceneKind::Drawer => drawer::drawer(rng),
            SceneKind::Kitchen => kitchen::kitchen(rng),
            SceneKind::Desk => table::desk(table, rng),
        };
        let stays = matches!(table, Table::Fixed { .. }) && kind.is_on_table();
        if stays { built } else { built.turned(rng.random_range(-std::f64::consts::PI..std::f64::consts::PI)) }
    }

    /// The same, turned about the world's z axis.
    fn turned(mut self, yaw_rad: f64) -> Self {
        let turn = Isometry3::from_parts(Translation3::identity(), UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad));
        for fixture in &mut self.fixtures {
            fixture.world_from_fixture = turn * fixture.world_from_fixture;
        }
        for surface in &mut self.surfaces {
            surface.world_from_surface = turn * surface.world_from_surface;
        }
        self.outlook.azimuth_rad = self.outlook.azimuth_rad.map(|a| a + yaw_rad);
        self
    }
}

/// A floor far enough to fill every picture, its top at `height_m`.
fn floor(height_m: f64, rng: &mut impl Rng) -> Fixture {
    let shade = rng.random_range(0.7..1.1f32);
    let color = [150.0f32, 146.0, 140.0].map(|c| (c * shade) as u8);
    Fixture::new(FurnitureRole::Floor, Vector3::new(4.0, 4.0, 0.025), Isometry3::translation(0.0, 0.0, height_m - 0.025), color)
}

/// The color of a piece of furniture: wood, white or painted.
fn furniture_color(rng: &mut impl Rng) -> [u8; 3] {
    const WOODS: [[f32; 3]; 5] =
        [[196.0, 160.0, 116.0], [150.0, 108.0, 72.0], [222.0, 205.0, 178.0], [228.0, 228.0, 224.0], [120.0, 124.0, 130.0]];
    if rng.random_bool(0.25) {
        return crate::objects::color::random_color(rng).map(|c| (f32::from(c) * 0.5 + 90.0) as u8);
    }
    let shade = rng.random_range(0.85..1.1f32);
    WOODS[rng.random_range(0..WOODS.len())].map(|c| (c * shade).min(250.0) as u8)
}

/// The same color in another shade, so that adjoining boards can be told apart.
fn shaded(color: [u8; 3], factor: f32) -> [u8; 3] {
    color.map(|c| (f32::from(c) * factor).min(255.0) as u8)
}

/// A horizontal rectangle's half extents from its edge lengths.
fn half(width_m: f64, depth_m: f64) -> Vector2<f64> {
    Vector2::new(width_m / 2.0, depth_m / 2.0)
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;
    use parry3d::query::Ray;
    use rand::SeedableRng;
    use rand_pcg::Pcg64;

    use super::*;
    use crate::convert;

    /// The fixture that a ray meets first, and how far away.
    fn hit<'a>(fixtures: &'a [Fixture], from: &Point3<f64>, towards: Vector3<f64>) -> Option<(&'a Fixture, f64)> {
        let ray = Ray::new(convert::vector(&from.cast()), convert::vector(&Point3::from(towards).cast()));
        fixtures
            .iter()
            .filter_map(|f| f.collider().cast_ray(&convert::pose(&f.world_from_fixture), &ray, 10.0, true).map(|t| (f, f64::from(t))))
            .min_by(|a, b| a.1.total_cmp(&b.1))
    }

    #[test]
    fn under_every_surface_is_furniture_and_over_it_the_room_it_says() {
        for kind in SceneKind::ALL {
            for seed in 0..5 {
                let furniture = Furniture::sample(kind, &Table::default(), &mut Pcg64::seed_from_u64(seed));
                assert_eq!(furniture.surfaces[0].height_m(), 0.0, "{kind:?}: the main surface");
                for surface in &furniture.surfaces {
                    let (mut on_it, mut tried) = (0, 0);
                    for (x, y) in (0..49).map(|k| (f64::from(k % 7) / 3.0 - 1.0, f64::from(k / 7) / 3.0 - 1.0)) {
                        let local = Point3::new(x * 0.98 * surface.half_extents_m.x, y * 0.98 * surface.half_extents_m.y, 0.004);
                        let from = surface.world_from_surface * local;
                        tried += 1;
                        // What stands on the surface (a large box, a tray) fills a part of it.
                        let Some((below, depth)) = hit(&furniture.fixtures, &from, -Vector3::z()) else { continue };
                        if depth == 0.0 {
                            continue;
                        }
                        assert!(
                            (depth - 0.004).abs() < 1e-4 && below.role == surface.role,
                            "{kind:?} {seed}: {depth} over {:?}",
                            below.role
                        );
                        on_it += 1;
                        let above = hit(&furniture.fixtures, &from, Vector3::z()).map_or(f64::INFINITY, |(_, height)| height + 0.004);
                        assert!(above >= surface.clear_m - 1e-4, "{kind:?} {seed}: {above} clear");
                    }
                    assert!(on_it * 10 >= tried * 4, "{kind:?} {seed}: {on_it} of {tried} on {:?}", surface.role);
                }
            }
        }
    }

    #[test]
    fn kinds_have_the_surfaces_that_they_are_about() {
        let mut roles = [const { std::collections::BTreeSet::new() }; SceneKind::ALL.len()];
        for kind in SceneKind::ALL {
            for seed in 0..20 {
                let furniture = Furniture::sample(kind, &Table::default(), &mut Pcg64::seed_from_u64(seed));
                roles[kind.index()].extend(furniture.surfaces.iter().filter(|s| s.weight > 0.0).map(|s| s.role.name()));
                if kind == SceneKind::Drawer || kind == SceneKind::Kitchen {
                    let inside = furniture.surfaces.iter().find(|s| s.role == FurnitureRole::DrawerBottom).expect("a drawer or a tray");
                    let wall = furniture.fixtures.iter().filter(|f| f.role == FurnitureRole::DrawerWall).map(Fixture::top_m);
                    assert!(wall.fold(f64::MIN, f64::max) > inside.height_m() + 0.02, "walls stand over the bottom");
                }
            }
        }
        let of = |kind: SceneKind| roles[kind.index()].iter().copied().collect::<Vec<_>>();
        assert_eq!(of(SceneKind::OpenTable), ["tabletop"]);
        assert_eq!(of(SceneKind::LargeBox), ["large_box", "tabletop"]);
        assert_eq!(of(SceneKind::Shelf), ["board", "shelf_top"]);
        assert_eq!(of(SceneKind::Drawer), ["cabinet_top", "drawer_bottom", "tabletop"]);
        assert_eq!(of(SceneKind::Desk), ["tabletop"]);
        assert_eq!(of(SceneKind::Pile), ["tabletop"]);
        assert_eq!(of(SceneKind::Kitchen), ["drawer_bottom", "worktop"]);
    }
}
