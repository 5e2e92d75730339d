//! A box that never moves: the only thing that furniture is made of.

use nalgebra::{Isometry3, Point3, Vector3};
use parry3d::shape::SharedShape;
use rapier3d::math::Pose;
use repose_geometry::TriMesh;

use crate::contact::PlacedParts;
use crate::objects::body::cuboid_mesh;

/// The role of a fixture or surface in its piece of furniture.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum FurnitureRole {
    /// The floor that everything stands on.
    Floor,
    /// A wall behind the furniture.
    Wall,
    /// The top of a table.
    Tabletop,
    /// What carries a table's top.
    TableBase,
    /// A large box standing on a table.
    LargeBox,
    /// A board of a shelf.
    Board,
    /// The uppermost board of a shelf.
    ShelfTop,
    /// A shelf's sides and back.
    ShelfWall,
    /// A cabinet below its top.
    Cabinet,
    /// The top of a cabinet.
    CabinetTop,
    /// The bottom of an open drawer or a tray.
    DrawerBottom,
    /// The walls of an open drawer or a tray.
    DrawerWall,
    /// A handle, or the front of a closed drawer or door.
    Front,
    /// A kitchen's worktop.
    Worktop,
}

impl FurnitureRole {
    /// The name in snake case.
    pub fn name(self) -> &'static str {
        match self {
            Self::Floor => "floor",
            Self::Wall => "wall",
            Self::Tabletop => "tabletop",
            Self::TableBase => "table_base",
            Self::LargeBox => "large_box",
            Self::Board => "board",
            Self::ShelfTop => "shelf_top",
            Self::ShelfWall => "shelf_wall",
            Self::Cabinet => "cabinet",
            Self::CabinetTop => "cabinet_top",
            Self::DrawerBottom => "drawer_bottom",
            Self::DrawerWall => "drawer_wall",
            Self::Front => "front",
            Self::Worktop => "worktop",
        }
    }
}

/// Furniture: a box that never moves.
#[derive(Debug, Clone)]
pub struct Fixture {
    /// What it is.
    pub role: FurnitureRole,
    /// Half its edge lengths, metres.
    pub half_extents_m: Vector3<f64>,
    /// Where it is.
    pub world_from_fixture: Isometry3<f64>,
    /// Its surface.
    pub mesh: TriMesh,
    /// Color in full light.
    pub color: [u8; 3],
    /// Coulomb friction coefficient.
    pub friction: f32,
}

impl Fixture {
    /// A box between two corners (world frame), edges along the axes.
    pub fn between(role: FurnitureRole, low: Point3<f64>, high: Point3<f64>, color: [u8; 3]) -> Self {
        let center = nalgebra::center(&low, &high);
        Self::new(role, (high - low) / 2.0, Isometry3::translation(center.x, center.y, center.z), color)
    }

    /// A box with a pose.
    pub fn new(role: FurnitureRole, half_extents_m: Vector3<f64>, world_from_fixture: Isometry3<f64>, color: [u8; 3]) -> Self {
        Self { role, half_extents_m, world_from_fixture, mesh: cuboid_mesh(half_extents_m.cast()), color, friction: 0.6 }
    }

    /// Height of its upper face, metres. Furniture stands level.
    pub fn top_m(&self) -> f64 {
        self.world_from_fixture.translation.z + self.half_extents_m.z
    }

    pub(crate) fn collider(&self) -> SharedShape {
        let half = self.half_extents_m.cast::<f32>();
        SharedShape::cuboid(half.x, half.y, half.z)
    }

    pub(crate) fn placed(&self) -> Option<PlacedParts> {
        PlacedParts::new(&[(Pose::IDENTITY, self.collider())], &self.world_from_fixture)
    }
}
