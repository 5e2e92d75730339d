//! What the place where the query was seen tells about how it will stand elsewhere: whether it leans, and what it may lean on.
//!
//! An object that rests against something else, or lies across an edge, shows faces that are neither upright nor level, all in one
//! direction. Set down by itself in the same attitude it tips. Round things show oblique patches too, but in all directions.

use nalgebra::{Matrix3, Point3, Vector3};
use repose_geometry::{Footprint, cloud};

use crate::scene::prepared::PreparedScene;
use repose_belief::BelievedObject;
use repose_belief::columns::{ColumnRun, cells_of};
use repose_belief::outlines::separating_gap_m;
use repose_belief::shape::Shape;
use repose_belief::solid::CompletedSurface;

/// Points whose normals are looked at, at most.
const SAMPLE: usize = 240;
/// A normal is that of the points this near, metres.
const NEAR_M: f32 = 0.012;
/// The fewest points that have a normal.
const FEWEST: usize = 6;
/// A face is oblique from this far off upright and level, radians.
const OFF_RAD: f32 = 8.0 * std::f32::consts::PI / 180.0;
/// Normals this close are of one face, radians.
const SAME_RAD: f32 = 8.0 * std::f32::consts::PI / 180.0;
/// What leans on the query is this near to it, metres.
const LEANER_M: f64 = 0.02;
/// Faces are read from points this far apart, metres.
pub const VOXEL_M: f32 = 0.004;
/// Gaps are looked for within this distance, metres.
const GAP_M: f64 = 0.1;

/// The largest oblique face, and how much is level.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Oblique {
    /// Share of the points on it.
    pub share: f64,
    /// How far it is from upright or level, whichever is nearer, radians; 0 without such a face.
    pub off_rad: f64,
    /// Share of the points on level faces: what stands by itself mostly shows one.
    pub level_share: f64,
}

/// What may lean on the query: its neighbour with the largest oblique face.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Leaner {
    /// That face.
    pub oblique: Oblique,
    /// How far its outline reaches over the query's, both of what was seen from above, metres.
    pub over_m: f64,
}

/// What was seen of how the query stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StandingTraits {
    /// The largest oblique face.
    pub oblique: Oblique,
    /// Distance to the nearest other object's shape, metres; capped.
    pub gap_m: f64,
    /// Whether furniture rises beside it that it may lean on: a wall, the front of a drawer, a large box.
    pub beside_furniture: bool,
    /// What may lean on it.
    pub leaner: Leaner,
    /// Whether it stands on an object or in it.
    pub on_object: bool,
    /// How far below its lowest points its foot is believed to be, metres.
    pub hidden_foot_m: f64,
    /// Its longer and shorter span seen from above, metres.
    pub spans_m: [f64; 2],
}

/// An object leans where at least this share of its points is on one oblique face, …
const LEANING_SHARE: f64 = 0.25;
/// … at most this share is on level ones, and something is near enough to lean on.
const LEVEL_SHARE: f64 = 0.05;
/// Beside furniture it leans only where that face is at least this far off, radians: much that stands by itself in a drawer or on a shelf shows
/// faces that are a little oblique.
const FAR_OFF_RAD: f64 = 15.0 * std::f64::consts::PI / 180.0;
/// Furniture that reaches at least this far above an object's foot can be leaned on, metres, …
const RISES_M: f32 = 0.02;
/// … where so many cells of the floor plan in and around its outline show it.
const RISING_CELLS: usize = 6;

/// What an object's whole surface is believed to be: it tells how the object may be set up otherwise than it was seen.
pub fn solid_of(prepared: &PreparedScene, id: u16, object: &BelievedObject, shape: &Shape) -> CompletedSurface {
    let leans = prepared.standing_traits(id).is_some_and(|traits| traits.leans());
    if leans { CompletedSurface::leaning(&object.points, shape) } else { CompletedSurface::standing(&object.points, shape) }
}

impl StandingTraits {
    /// Whether it leans on something: set down elsewhere in the same attitude it would tip. What stands alone with an oblique face stands by itself.
    pub fn leans(&self) -> bool {
        let shows = self.oblique.share >= LEANING_SHARE && self.oblique.level_share <= LEVEL_SHARE;
        shows && (self.gap_m <= LEANER_M || (self.beside_furniture && self.oblique.off_rad >= FAR_OFF_RAD))
    }

    /// Of an object where it was seen; none without an extent.
    pub fn of(prepared: &PreparedScene, id: u16) -> Option<Self> {
        let object = prepared.belief.objects.get(&id)?;
        let shape = object.shape.as_ref()?;
        let cloud = &cloud::voxel_downsampled(&object.points, VOXEL_M);
        let others =
            || prepared.belief.objects.iter().filter(move |(other, _)| **other != id).filter_map(|(_, o)| Some((o, o.shape.as_ref()?)));
        let near = || others().filter(|(_, other)| shape.gap_m(other) <= LEANER_M);
        let leaners = near().map(|(other, _)| Leaner {
            oblique: oblique(&cloud::voxel_downsampled(&other.points, VOXEL_M)),
            over_m: overlap_m(cloud, &other.points),
        });
        let mut lowest: Vec<f32> = cloud.iter().map(|p| p.z).collect();
        lowest.sort_by(f32::total_cmp);
        let lowest_m = lowest.get(lowest.len() / 50).copied().unwrap_or(shape.bottom_m);
        Some(Self {
            oblique: oblique(cloud),
            gap_m: others().map(|(_, other)| shape.gap_m(other)).fold(GAP_M, f64::min),
            beside_furniture: beside_furniture(prepared, shape),
            leaner: leaners.max_by(|a, b| a.oblique.share.total_cmp(&b.oblique.share)).unwrap_or_default(),
            on_object: prepared.belief.objects.keys().any(|other| prepared.belief.carried(*other).contains(&id)),
            hidden_foot_m: f64::from((lowest_m - shape.bottom_m).max(0.0)),
            spans_m: spans_m(shape),
        })
    }
}

/// Whether furniture rises in or around the outline of a shape, high enough to lean on.
fn beside_furniture(prepared: &PreparedScene, shape: &Shape) -> bool {
    let columns = &prepared.belief.columns;
    let rises = |run: &ColumnRun| run.object == 0 && run.high_m > shape.bottom_m + RISES_M && run.low_m < shape.top_m;
    shape.slabs.iter().any(|slab| {
        let around = cells_of(&slab.outline, LEANER_M as f32, columns);
        around.filter(|center| columns.at(center).iter().any(rises)).take(RISING_CELLS).count() == RISING_CELLS
    })
}

/// How far the outlines of two clouds reach over each other, seen from above, metres; 0 where they do not.
fn overlap_m(a: &[Point3<f32>], b: &[Point3<f32>]) -> f64 {
    let outlines = Footprint::of(a).zip(Footprint::of(b));
    outlines.map_or(0.0, |(a, b)| f64::from((-separating_gap_m(a.corners(), b.corners())).max(0.0)))
}

/// The spans of a shape seen from above along and across its longest direction.
pub fn spans_m(shape: &Shape) -> [f64; 2] {
    let corners: Vec<_> = shape.slabs.iter().flat_map(|slab| slab.outline.corners()).collect();
    let widths = (0..12).map(|k| {
        let direction = nalgebra::Rotation2::new(k as f32 * std::f32::consts::PI / 12.0) * nalgebra::Vector2::x();
        let along = corners.iter().map(|c| c.coords.dot(&direction));
        let (low, high) = along.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)));
        f64::from(high - low)
    });
    widths.fold([0.0, f64::INFINITY], |[longest, shortest], w| [w.max(longest), w.min(shortest)])
}

/// The largest oblique face of a cloud.
fn oblique(cloud: &[Point3<f32>]) -> Oblique {
    let step = cloud.len().div_ceil(SAMPLE).max(1);
    let normals: Vec<Vector3<f32>> = cloud.iter().step_by(step).filter_map(|p| normal(p, cloud)).collect();
    let off = |n: &Vector3<f32>| {
        let from_upright = n.z.abs().clamp(0.0, 1.0).acos();
        from_upright.min(std::f32::consts::FRAC_PI_2 - from_upright)
    };
    let same = SAME_RAD.cos();
    let on_face_of = |n: &Vector3<f32>| normals.iter().filter(|other| other.dot(n).abs() >= same).count();
    let faces = normals.iter().filter(|n| off(n) > OFF_RAD).map(|n| (on_face_of(n), off(n)));
    let (count, off_rad) = faces.max_by(|a, b| a.0.cmp(&b.0).then(b.1.total_cmp(&a.1))).unwrap_or((0, 0.0));
    let level = normals.iter().filter(|n| n.z.abs() >= OFF_RAD.cos()).count();
    let share = |count: usize| count as f64 / normals.len().max(1) as f64;
    Oblique { share: share(count), off_rad: f64::from(off_rad), level_share: share(level) }
}

/// The normal of the surface at a point; none where too few points are near.
fn normal(at: &Point3<f32>, cloud: &[Point3<f32>]) -> Option<Vector3<f32>> {
    let near: Vec<Vector3<f32>> = cloud.iter().map(|p| p - at).filter(|d| d.norm_squared() <= NEAR_M * NEAR_M).collect();
    if near.len() < FEWEST {
        return None;
    }
    let mean = near.iter().sum::<Vector3<f32>>() / near.len() as f32;
    let scatter: Matrix3<f32> = near.iter().map(|d| (d - mean) * (d - mean).transpose()).sum();
    let eigen = scatter.symmetric_eigen();
    let thinnest = eigen.eigenvalues.imin();
    Some(eigen.eigenvectors.column(thinnest).into_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::synthetic::{Prepared, SceneBuilder};

    /// A square of 8 cm whose normal leans from upright by an angle.
    fn leaning(angle_rad: f32) -> Vec<Point3<f32>> {
        let turn = nalgebra::Rotation3::from_axis_angle(&Vector3::x_axis(), angle_rad);
        (0..400).map(|k| turn * Point3::new((k % 20) as f32 * 0.004, (k / 20) as f32 * 0.004, 0.0)).collect()
    }

    #[test]
    fn a_leaning_face_is_oblique_and_upright_and_level_ones_are_not() {
        let off = |degrees: f32| oblique(&leaning(degrees.to_radians()));
        for (degrees, level_share) in [(0.0, 1.0), (90.0, 0.0), (3.0, 1.0)] {
            assert_eq!(off(degrees), Oblique { level_share, ..Oblique::default() }, "{degrees}");
        }
        for (degrees, expected) in [(30.0f64, 30.0f64), (70.0, 20.0)] {
            let found = off(degrees as f32);
            assert!(found.share > 0.95 && (found.off_rad.to_degrees() - expected).abs() < 2.0, "{degrees}: {found:?}");
        }
    }

    #[test]
    fn what_shows_an_oblique_face_and_no_level_one_leans_where_there_is_something_to_lean_on() {
        let traits = |oblique: Oblique, gap_m: f64| StandingTraits {
            oblique,
            gap_m,
            beside_furniture: false,
            leaner: Leaner::default(),
            on_object: false,
            hidden_foot_m: 0.0,
            spans_m: [0.1, 0.1],
        };
        let (wall, table) = (oblique(&leaning(0.5)), oblique(&leaning(0.0)));
        assert!(traits(wall, 0.0).leans());
        assert!(!traits(wall, 0.08).leans(), "it stands alone");
        assert!(!traits(table, 0.0).leans(), "it lies level");
        let beside = |oblique: Oblique| StandingTraits { beside_furniture: true, ..traits(oblique, 0.08) };
        assert!(beside(wall).leans() && !beside(oblique(&leaning(0.2))).leans() && !beside(table).leans());
    }

    #[test]
    fn furniture_that_rises_beside_an_object_can_be_leaned_on_and_what_is_low_or_far_cannot() {
        let beside = |wall: [f64; 3], y: f64| {
            let scene = SceneBuilder::table().object(0, [0.0, y], wall).object(1, [0.0, 0.0], [0.06, 0.06, 0.08]).prepared();
            let shape = scene.belief.objects[&1].shape.clone().unwrap();
            beside_furniture(&scene, &shape)
        };
        assert!(beside([0.3, 0.03, 0.15], 0.055));
        assert!(!beside([0.3, 0.03, 0.012], 0.055), "no higher than its foot");
        assert!(!beside([0.3, 0.03, 0.15], 0.12), "far behind it");
    }

    #[test]
    fn a_balls_patches_are_oblique_but_no_face() {
        let at = |k: usize| {
            let (turn, height) = (k as f32 * 2.4, k as f32 / 600.0);
            let radius = (1.0 - height * height).sqrt();
            Point3::new(radius * turn.cos(), radius * turn.sin(), height) * 0.04
        };
        let found = oblique(&(0..600).map(at).collect::<Vec<_>>());
        assert!(found.share < 0.2, "{found:?}");
    }
}
