//! The vector of relations between a query and an anchor: its order, and by how much each holds.

/// How many relations there are.
pub const RELATIONS: usize = 10;

/// Two objects are near up to this distance between their surfaces (the paper's appendix, like all thresholds here).
pub const NEAR_M: f64 = 0.05;
/// Meshes touch up to this distance.
pub const TOUCHING_MESHES_M: f64 = 0.001;
/// Observed clouds touch up to this distance: the paper's baseline allows for the spacing of points.
pub const TOUCHING_CLOUDS_M: f64 = 0.0025;
/// Centres coincide up to this distance, seen from above.
///
/// The appendix says "within 1 mm" without a plane, and "`xy` distance on the table" for the baseline at the same threshold. Solid
/// things whose centres coincide in space do not exist, and 5.6 % of the paper's pairs are centered: horizontal is meant.
pub const CENTERED_M: f64 = 0.001;
/// Orientations agree up to (not including) this angle.
pub const ALIGNED_RAD: f64 = std::f64::consts::PI / 20.0;

/// Positions of the relations wherever they are a vector: the contract's order.
pub mod index {
    /// The query is to the left of the anchor.
    pub const LEFT_OF: usize = 0;
    /// The query is to the right of the anchor.
    pub const RIGHT_OF: usize = 1;
    /// The query is nearer the viewer than the anchor.
    pub const IN_FRONT_OF: usize = 2;
    /// The query is farther from the viewer than the anchor.
    pub const BEHIND: usize = 3;
    /// The query is above the anchor.
    pub const ABOVE: usize = 4;
    /// The query is below the anchor.
    pub const BELOW: usize = 5;
    /// Their surfaces are within [`super::NEAR_M`].
    pub const NEAR: usize = 6;
    /// Their surfaces touch.
    pub const TOUCHING: usize = 7;
    /// Their centres coincide seen from above.
    pub const CENTERED: usize = 8;
    /// Their orientations agree.
    pub const ALIGNED: usize = 9;
}

/// How far each relation is from changing its truth value; positive where it holds.
///
/// Metres, except the last (`aligned`), which is in radians. For the six directions it is the least slack over the rules that the
/// relation is made of. Moving either object by d metres changes no margin by more than d, so a relation that holds by more than that
/// still holds. Margins of `near` and `touching` are as exact as the distance they were made from ([`crate::ObservedObject::distance_m`]
/// is exact up to 1 cm past [`NEAR_M`], and a lower bound beyond).
///
/// A margin that is not a number holds nothing: boxes and distances with a NaN in them have no relations, and nothing panics.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Margins(pub [f64; RELATIONS]);

impl Margins {
    /// Which relations hold. A limit given as "at most" holds at the limit, one given as "less than" does not.
    pub fn holds(&self) -> [bool; RELATIONS] {
        std::array::from_fn(|i| match i {
            index::NEAR | index::TOUCHING | index::CENTERED => self.0[i] >= 0.0,
            _ => self.0[i] > 0.0,
        })
    }

    /// The margins from their parts; the directions of the exchanged pair give right, behind and above.
    pub(crate) fn new(directions: [f64; 6], distance_m: f64, touching_m: f64, center_offset_m: f64, turn_rad: f64) -> Self {
        let [left, right, front, behind, above, below] = directions;
        Self([
            left,
            right,
            front,
            behind,
            above,
            below,
            NEAR_M - distance_m,
            touching_m - distance_m,
            CENTERED_M - center_offset_m,
            ALIGNED_RAD - turn_rad,
        ])
    }
}
