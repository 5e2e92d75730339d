//! How an object stands, learned: whether it stands by itself, as it was seen or turned over, and whether another that rests against it comes down
//! when it is taken away.
//!
//! An object that leans tips as soon as it is set down elsewhere in the same attitude, and one that something leans on cannot be taken away
//! without moving that. Both are properties of the scene, not of a place: no search finds a way around them. They are fitted on objects of
//! training scenes that were set down alone, as they lay and on other sides, and taken away, in simulation (`repose train --network standing`).

use nalgebra::{Matrix3, Point3, Vector2, Vector3};
use repose_belief::shape::Shape;
use repose_belief::solid::CompletedSurface;
use repose_geometry::{Footprint, cloud};

use crate::scene::prepared::PreparedScene;
use crate::scene::traits::{StandingTraits, VOXEL_M};
use crate::scene::turned::Turned;

/// A measure of an object: its name, and how it is computed.
type OfObject = (&'static str, fn(&Stance<'_>) -> f64);

/// The measures of an object, in the order that the trees read: lengths in metres, angles in radians, shares from 0 to 1, flags 0 or 1.
const MEASURES: [OfObject; 31] = [
    // Its believed shape: height, spans seen from above, how far inside its base its axis is, how far its back is unknown; its points.
    ("height", |s| s.height_m),
    ("length", |s| s.traits.spans_m[0]),
    ("width", |s| s.traits.spans_m[1]),
    ("base_margin", |s| f64::from(s.shape.base.margin(&s.shape.axis))),
    ("back_unknown", |s| f64::from(s.shape.doubt.norm())),
    ("points", |s| s.points),
    // The tilt that tips it over the nearest edge of what it would stand on: with the far half as it stands, and with the far half as its near
    // one seen from the opposite side in all three directions, which is right for boxes and tubes in any attitude.
    ("tip_standing", |s| tip_rad(&CompletedSurface::standing(&s.cloud, s.shape))),
    ("tip_reflected", |s| tip_rad(&CompletedSurface::leaning(&s.cloud, s.shape))),
    // Its largest oblique face, and how much is level.
    ("oblique_share", |s| s.traits.oblique.share),
    ("oblique_off", |s| s.traits.oblique.off_rad),
    ("level_share", |s| s.traits.oblique.level_share),
    // Its points' longest and thinnest axes: how far from upright or level, and how long the others are beside the longest.
    ("long_axis_off", |s| s.axes.long_off_rad),
    ("thin_axis_off", |s| s.axes.thin_off_rad),
    ("second_span", |s| s.axes.second),
    ("third_span", |s| s.axes.third),
    // Its highest part from its lowest, seen from above: how far, in its heights, and whether that is towards its nearest neighbour.
    ("lean", |s| f64::from(s.lean.norm())),
    ("lean_slope", |s| f64::from(s.lean.norm()) / s.height_m.max(LEAST_HEIGHT_M)),
    ("lean_to_nearest", |s| s.nearest().map_or(0.0, |(_, towards)| f64::from(cosine(towards, &s.lean)))),
    // The nearest neighbour on that side, and on any; how many are near.
    ("gap_ahead", |s| s.gap_ahead_m()),
    ("gap", |s| s.nearest().map_or(FAR_M, |(gap_m, _)| gap_m.min(FAR_M))),
    ("near", |s| s.gaps.iter().filter(|(gap_m, _)| *gap_m <= NEAR_M).count() as f64),
    // What its lowest points span of what it all does; how far its axis is inside of their outline.
    ("foot_share", |s| s.foot_share()),
    ("foot_margin", |s| s.foot.as_ref().map_or(-FAR_M, |foot| f64::from(foot.margin(&s.shape.axis)).max(-FAR_M))),
    ("hidden_foot", |s| s.traits.hidden_foot_m),
    // What it stands on or beside.
    ("on_object", |s| flag(s.traits.on_object)),
    ("beside_furniture", |s| flag(s.traits.beside_furniture)),
    ("above_lowest", |s| s.above_lowest_m()),
    // Whether its top is round; where its middle is beside its axis, and upwards in its heights; whether something stands on it.
    ("crowned", |s| flag(!s.prepared.belief.carries(s.id))),
    ("off_axis", |s| f64::from(s.shape.axis_offset().norm())),
    ("middle_height", |s| s.middle_height()),
    ("carries", |s| flag(!s.prepared.belief.carried(s.id).is_empty())),
];

/// Neighbours are near within this distance, metres.
pub const NEAR_M: f64 = 0.03;
/// Distances are cut here, metres.
pub const FAR_M: f64 = 0.1;
/// The lowest part of an object is this high, metres, or …
const FOOT_M: f32 = 0.012;
/// … this share of its height, whichever is more.
const FOOT_SHARE: f32 = 0.15;
/// Points this near to the lowest one touch the ground, metres.
const CONTACT_M: f32 = 0.005;
/// The lowest and the highest part, for the direction of its lean, are these shares of its height.
const END_SHARE: f32 = 0.2;
/// Heights that lengths are told in are at least this, metres.
const LEAST_HEIGHT_M: f64 = 0.01;
/// A neighbour is ahead within this angle of the direction of the lean, as a cosine.
const AHEAD_COSINE: f32 = 0.5;

/// The names of the measures of an object and of how it was turned over, in the order that the trees read.
pub fn names() -> Vec<&'static str> {
    names_of_object().chain(Turned::MEASURES).collect()
}

/// The names of an object's own measures, as it lies.
pub fn names_of_object() -> impl Iterator<Item = &'static str> {
    MEASURES.iter().map(|(name, _)| *name)
}

/// An object where it was seen, with everything that the measures read.
#[derive(Debug, Clone)]
pub struct Stance<'a> {
    /// The scene.
    pub prepared: &'a PreparedScene,
    /// The object.
    pub id: u16,
    /// Its believed shape.
    pub shape: &'a Shape,
    /// How high that is, metres.
    pub height_m: f64,
    points: f64,
    /// Its points, thinned out, world frame.
    pub cloud: Vec<Point3<f32>>,
    /// What was seen of how it stands.
    pub traits: StandingTraits,
    axes: Axes,
    /// From the middle of its lowest part to that of its highest, seen from above, metres.
    pub lean: Vector2<f32>,
    /// How far every other object is, metres, and where it is seen from above.
    gaps: Vec<(f64, Vector2<f32>)>,
    /// The outline of its lowest points.
    foot: Option<Footprint>,
}

impl<'a> Stance<'a> {
    /// Of an object of a scene; none without an extent.
    pub fn of(prepared: &'a PreparedScene, id: u16) -> Option<Self> {
        let object = prepared.belief.objects.get(&id)?;
        let shape = object.shape.as_ref()?;
        let cloud = cloud::voxel_downsampled(&object.points, VOXEL_M);
        let others = prepared.belief.objects.iter().filter(|(other, _)| **other != id).filter_map(|(_, o)| o.shape.as_ref());
        Some(Self {
            prepared,
            id,
            shape,
            height_m: f64::from(shape.top_m - shape.bottom_m),
            points: object.points.len() as f64,
            traits: prepared.standing_traits(id)?,
            axes: Axes::of(&cloud),
            lean: lean(&cloud),
            gaps: others.map(|other| (shape.gap_m(other), other.axis - shape.axis)).collect(),
            foot: foot(&cloud, shape),
            cloud,
        })
    }

    /// Its measures where it was turned over in this way, in the order of [`names`]; all finite.
    pub fn measures(&self, turned: Option<&Turned<'_>>) -> Vec<f32> {
        with_turn(self.of_object(), turned)
    }

    /// Its own measures as it lies, in the order of [`names_of_object`].
    pub fn of_object(&self) -> Vec<f32> {
        MEASURES.iter().map(|(_, of)| of(self) as f32).collect()
    }

    /// Whether a shape is near enough to be that of a neighbour.
    pub fn is_near(&self, other: &Shape) -> bool {
        self.shape.gap_m(other) <= NEAR_M
    }

    fn nearest(&self) -> Option<&(f64, Vector2<f32>)> {
        self.gaps.iter().min_by(|a, b| a.0.total_cmp(&b.0))
    }

    fn gap_ahead_m(&self) -> f64 {
        let ahead = self.gaps.iter().filter(|(_, towards)| cosine(towards, &self.lean) >= AHEAD_COSINE);
        ahead.map(|(gap_m, _)| *gap_m).fold(FAR_M, f64::min)
    }

    fn foot_share(&self) -> f64 {
        let whole_area = Footprint::of(&self.cloud).map_or(1.0, |f| f.area()).max(1e-6);
        f64::from(self.foot.as_ref().map_or(0.0, Footprint::area) / whole_area)
    }

    fn above_lowest_m(&self) -> f64 {
        let bottoms = self.prepared.belief.objects.values().filter_map(|o| o.shape.as_ref()).map(|s| s.bottom_m);
        f64::from(self.shape.bottom_m - bottoms.fold(self.shape.bottom_m, f32::min))
    }

    fn middle_height(&self) -> f64 {
        let mean_z = self.cloud.iter().map(|p| f64::from(p.z)).sum::<f64>() / self.cloud.len().max(1) as f64;
        (mean_z - f64::from(self.shape.bottom_m)) / self.height_m.max(LEAST_HEIGHT_M)
    }
}

/// An object's own measures and how it was turned over, in the order of [`names`].
pub fn with_turn(of_object: Vec<f32>, turned: Option<&Turned<'_>>) -> Vec<f32> {
    of_object.into_iter().chain(Turned::measures(turned).map(|value| value as f32)).collect()
}

fn flag(is: bool) -> f64 {
    f64::from(u8::from(is))
}

/// The outline of the lowest points of a cloud.
fn foot(cloud: &[Point3<f32>], shape: &Shape) -> Option<Footprint> {
    let lowest_m = cloud.iter().map(|p| p.z).fold(f32::INFINITY, f32::min);
    let height_m = FOOT_M.max(FOOT_SHARE * (shape.top_m - lowest_m));
    Footprint::of(cloud.iter().filter(|p| p.z <= lowest_m + height_m))
}

/// The cosine of the angle between two directions; 0 where one has no length.
pub fn cosine(a: &Vector2<f32>, b: &Vector2<f32>) -> f32 {
    let (a, b) = (a.try_normalize(1e-4), b.try_normalize(1e-4));
    a.zip(b).map_or(0.0, |(a, b)| a.dot(&b))
}

/// From the middle of a cloud's lowest part to that of its highest, seen from above, metres.
fn lean(cloud: &[Point3<f32>]) -> Vector2<f32> {
    let (low, high) = cloud.iter().fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), p| (low.min(p.z), high.max(p.z)));
    let part_m = END_SHARE * (high - low);
    let middle = |keep: &dyn Fn(f32) -> bool| {
        let kept: Vec<Vector2<f64>> = cloud.iter().filter(|p| keep(p.z)).map(|p| p.xy().coords.cast::<f64>()).collect();
        kept.iter().sum::<Vector2<f64>>() / kept.len().max(1) as f64
    };
    (middle(&|z| z >= high - part_m) - middle(&|z| z <= low + part_m)).cast::<f32>()
}

/// The tilt after which a solid's centre of mass is over the edge of what touches the ground, radians; negative where it is beyond it already.
fn tip_rad(solid: &CompletedSurface) -> f64 {
    let low_m = solid.points.iter().map(|p| p.z).fold(f32::INFINITY, f32::min);
    let Some(support) = Footprint::of(solid.points.iter().filter(|p| p.z <= low_m + CONTACT_M)) else { return -1.0 };
    f64::from(support.margin(&solid.center_of_mass.xy()).atan2((solid.center_of_mass.z - low_m).max(1e-3)))
}

/// The directions in which a cloud extends.
#[derive(Debug, Clone, Copy)]
struct Axes {
    long_off_rad: f64,
    thin_off_rad: f64,
    second: f64,
    third: f64,
}

impl Axes {
    fn of(cloud: &[Point3<f32>]) -> Self {
        let mean = cloud::centroid(cloud).unwrap_or_else(Point3::origin).coords;
        let off_mean = cloud.iter().map(|p| (p.coords.cast::<f64>() - mean).cast::<f32>());
        let scatter: Matrix3<f32> = off_mean.map(|off: Vector3<f32>| off * off.transpose()).sum();
        let eigen = scatter.symmetric_eigen();
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
        let [long, second, thin] = order;
        let span = |k: usize| f64::from(eigen.eigenvalues[k].max(0.0).sqrt());
        let longest = span(long).max(1e-6);
        let off_rad = |k: usize| {
            let from_upright = f64::from(eigen.eigenvectors[(2, k)].abs().clamp(0.0, 1.0).acos());
            from_upright.min(std::f64::consts::FRAC_PI_2 - from_upright)
        };
        Self { long_off_rad: off_rad(long), thin_off_rad: off_rad(thin), second: span(second) / longest, third: span(thin) / longest }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::synthetic::{Prepared, SceneBuilder};

    fn of<'a>(stance: &'a Stance<'_>) -> impl Fn(&str) -> f32 + 'a {
        |name| stance.measures(None)[names().iter().position(|n| *n == name).unwrap()]
    }

    #[test]
    fn what_is_measured_is_what_it_is_called() {
        let prepared = SceneBuilder::table()
            .object(1, [0.0, 0.0], [0.06, 0.05, 0.1])
            .object(2, [0.08, 0.0], [0.06, 0.05, 0.03])
            .object_at(3, [0.08, 0.0], 0.03, [0.05, 0.04, 0.05])
            .prepared();
        let is = |value: f32, expected: f32, within: f32| assert!((value - expected).abs() < within, "{value}, not {expected}");
        let stance = |id| Stance::of(&prepared, id).unwrap();
        let (first, low) = (stance(1), stance(2));
        let value = of(&first);
        is(value("height"), 0.1, 0.006);
        is(value("length"), 0.066, 0.02);
        // Over the edge of 5 cm from a middle 5 cm high.
        is(value("tip_standing"), 0.5, 0.15);
        is(value("tip_reflected"), 0.5, 0.15);
        assert!(value("oblique_share") < 0.1 && value("level_share") > 0.1);
        // Two centimetres, less what outlines are grown by.
        is(value("gap"), 0.012, 0.006);
        assert_eq!((value("near"), value("on_object"), value("carries"), value("crowned")), (2.0, 0.0, 0.0, 0.0));
        let value = of(&low);
        assert_eq!((value("carries"), value("near")), (1.0, 2.0));
        let above = stance(3);
        assert_eq!(of(&above)("on_object"), 1.0);
        is(of(&above)("above_lowest"), 0.03, 0.008);
    }

    #[test]
    fn a_board_that_leans_tips_over_what_touches_the_ground_and_a_block_does_not() {
        let board = |lean_rad: f32| -> CompletedSurface {
            let turn = nalgebra::Rotation3::from_axis_angle(&Vector3::x_axis(), lean_rad);
            let points: Vec<Point3<f32>> = (0..1200)
                .map(|k| Point3::new((k % 20) as f32 * 0.004, (k / 20 % 3) as f32 * 0.004, (k / 60) as f32 * 0.008))
                .map(|p| turn * p)
                .collect();
            let middle = points.iter().map(|p| p.coords).sum::<Vector3<f32>>() / points.len() as f32;
            CompletedSurface { seen: points.len(), points, center_of_mass: middle.into() }
        };
        assert!(tip_rad(&board(0.0)) > 0.03);
        assert!(tip_rad(&board(0.5)) < 0.0);
    }

    #[test]
    fn how_a_cloud_lies_and_leans_is_told_as_well_far_from_the_origin() {
        // A leaning block, of coordinates that are as exact 800 m away.
        let at = |k: usize| [k % 10 * 8 + k / 100 * 5, k / 10 % 10 * 4, k / 100 * 13].map(|step| step as f32 / 1024.0);
        let cloud: Vec<Point3<f32>> = (0..1500).map(|k| at(k).into()).collect();
        let far: Vec<Point3<f32>> = cloud.iter().map(|p| p + Vector3::new(800.0, -500.0, 0.0)).collect();
        assert!(lean(&cloud).x > 0.03 && (lean(&cloud) - lean(&far)).norm() < 1e-6, "{} {}", lean(&cloud), lean(&far));
        let told = |cloud: &[Point3<f32>]| {
            let Axes { long_off_rad, thin_off_rad, second, third } = Axes::of(cloud);
            [long_off_rad, thin_off_rad, second, third]
        };
        for (near, far) in told(&cloud).into_iter().zip(told(&far)) {
            assert!((near - far).abs() < 1e-4, "{near}, not {far}");
        }
    }
}
