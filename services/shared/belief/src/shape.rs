//! The whole shape of an object, guessed from the half of it that a camera saw.
//!
//! A stack of upright prisms: the object's height is cut into slabs, each with the convex outline of its points and of the same points
//! turned by half a turn about the object's axis. The axis stands in the middle between its ends: the far one is believed ([`crate::back`]), the
//! others are where they were seen, or believed where something cuts the object off ([`crate::cut`]). [`Shape::doubt`] says where more of it
//! may be.
//! The bottom is the support under it: border cleaning trims the cloud's own.

use nalgebra::{Isometry3, Point2, Point3, Vector2};
use repose_geometry::Footprint;

use crate::far_side::far_side;
use crate::front::{Front, span};
use crate::outlines::{area_centroid, outline_gap_m};
use crate::settings::ShapeSettings;
use crate::unseen_end::UnseenEnd;

/// An upright prism.
#[derive(Debug, Clone, PartialEq)]
pub struct Slab {
    /// Bottom, world z, metres.
    pub low_m: f32,
    /// Top, world z, metres.
    pub high_m: f32,
    /// Where it likely ends, seen from above, world frame.
    pub outline: Footprint,
    /// Where it may end: what is to be kept clear. Around the outline, and the same where nothing tells them apart.
    pub reach: Footprint,
}

impl Slab {
    /// Between two heights, with one outline.
    pub fn of(low_m: f32, high_m: f32, outline: Footprint) -> Self {
        Self { low_m, high_m, reach: outline.clone(), outline }
    }

    /// With what its outlines become; none where one vanishes.
    fn with(&self, outlines: impl Fn(&Footprint) -> Option<Footprint>) -> Option<Self> {
        Some(Self { outline: outlines(&self.outline)?, reach: outlines(&self.reach)?, ..*self })
    }
}

/// A completed object, where it was observed (world frame).
#[derive(Debug, Clone, PartialEq)]
pub struct Shape {
    /// Centroid of the observed points (not the geometric centre).
    pub centroid: Point3<f64>,
    /// The axis, seen from above: where its centre of mass is believed to be.
    pub axis: Point2<f32>,
    /// About which half a turn takes what was seen of it to what was not, seen from above: in the middle between its ends.
    pub turn_axis: Point2<f32>,
    /// Outline of the part that touches what it stands on, as that half turn makes it.
    pub turn_base: Footprint,
    /// Height of what it stands on, world z, metres.
    pub bottom_m: f32,
    /// Height of its top, world z, metres.
    pub top_m: f32,
    /// The prisms, from the bottom up, without gaps.
    pub slabs: Vec<Slab>,
    /// Outline of the part that touches what it stands on.
    pub base: Footprint,
    /// How much farther its back may reach than the prisms do, world axes seen from above, metres.
    pub doubt: Vector2<f32>,
    /// Its ends that may be farther out than the prisms are ([`crate::farther`]); none where that was not asked.
    pub ends: Vec<UnseenEnd>,
    /// How likely its bottom is as high as is believed ([`crate::foot`]); 1 where that was not asked.
    pub foot_probability: f32,
    /// How much lower its bottom may be, metres; 0 where that was not asked.
    pub foot_doubt_m: f32,
    /// How likely its bottom is so near to where it is believed that it lands well where it is let go; 1 where that was not asked.
    pub landing_probability: f32,
}

/// What was not seen of an object, by belief, metres.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Hidden {
    /// How far it goes on behind what was seen of it.
    pub back_m: f32,
    /// How far it goes on at the near end, and to the left and right of it, where it is cut off there.
    pub near_m: f32,
    /// See `near_m`.
    pub left_m: f32,
    /// See `near_m`.
    pub right_m: f32,
    /// How far it goes on to either side beyond that.
    pub side_m: f32,
    /// How far it goes on at the near and at the far end alike.
    pub ends_m: f32,
    /// How much farther its back may be.
    pub doubt_m: f32,
}

impl Shape {
    /// Completes an object from what was seen of it and what is believed not to have been.
    ///
    /// Where the camera saw past a place the likeness stays all the same: a handle moves the axis, so that what falls into free space is the likeness of
    /// the body, not that of the handle, and without it the body would have no back.
    pub fn complete(front: &Front, hidden: &Hidden, settings: &ShapeSettings) -> Option<Self> {
        let Front { points, away, across, .. } = front;
        let ([near_m, far_m], [right_m, left_m]) = (front.span(away), front.span(across));
        let deep_m = near_m - hidden.near_m + far_m + hidden.back_m;
        let wide_m = right_m - hidden.right_m + left_m + hidden.left_m;
        let axis = Point2::from(away * (deep_m / 2.0) + across * (wide_m / 2.0));
        let both: Vec<Point3<f32>> = points.iter().copied().chain(far_side(points, &axis)).collect();
        // Half a turn makes up for what is missing at one of two ends, not for what is missing at both.
        let both_m = [hidden.near_m.min(hidden.back_m), hidden.left_m.min(hidden.right_m)];
        let stack = Stack { axis, points: &both, lowest: &both, base_by_m: both_m, sides_by_m: [hidden.ends_m, hidden.side_m] };
        Some(Self { doubt: away * hidden.doubt_m, ..Self::stacked(front, &stack, settings)? })
    }

    /// Of an object of which a whole surface is believed; its axis is where its centre of mass is, and it stands on what of the surface is lowest. Its
    /// prisms keep clear of what the surface, turned by half a turn, fills too: half of it was never seen, and that half may be as wide.
    pub fn of_surface(surface: &Front, axis: Point2<f32>, settings: &ShapeSettings) -> Option<Self> {
        let along = [surface.away, surface.across];
        let [[near_m, far_m], [right_m, left_m]] = along.map(|along| surface.span(&along));
        let middle = Point2::from(along[0] * ((near_m + far_m) / 2.0) + along[1] * ((right_m + left_m) / 2.0));
        let both: Vec<Point3<f32>> = surface.points.iter().copied().chain(far_side(&surface.points, &middle)).collect();
        let stack = Stack { axis, points: &both, lowest: &surface.points, base_by_m: [0.0; 2], sides_by_m: [settings.trim_m; 2] };
        Self::stacked(surface, &stack, settings)
    }

    fn stacked(front: &Front, stack: &Stack<'_>, settings: &ShapeSettings) -> Option<Self> {
        let Stack { axis, points, lowest, base_by_m, sides_by_m } = stack;
        let grown = |outline: &Footprint, by_m: [f32; 2]| {
            stretched(outline, axis, &[(front.away, base_by_m[0] + by_m[0]), (front.across, base_by_m[1] + by_m[1])])
        };
        let (bottom_m, top_m) = (front.bottom_m, front.top_m);
        let whole = Footprint::of(*points)?;
        let height_m = top_m - bottom_m;
        let count = ((height_m / settings.slab_m).floor() as usize).clamp(1, settings.max_slabs);
        let step_m = height_m / count as f32;
        let within = |points: &[Point3<f32>], low_m: f32, high_m: f32| {
            let seen = front.points.iter().filter(|p| p.z >= low_m && p.z <= high_m).count();
            let within = points.iter().filter(|p| p.z >= low_m && p.z <= high_m);
            (seen >= settings.min_slab_points).then(|| Footprint::of(within)).flatten()
        };
        let mut slabs: Vec<Slab> = Vec::with_capacity(count);
        // From the top down: what is hidden or trimmed below looks like what is seen above it.
        let mut above = None;
        for k in (0..count).rev() {
            let (low_m, high_m) = (bottom_m + k as f32 * step_m, bottom_m + (k + 1) as f32 * step_m);
            let outline = within(points, low_m, high_m).or_else(|| above.clone()).unwrap_or_else(|| whole.clone());
            above = Some(outline.clone());
            slabs.push(Slab::of(low_m, high_m, grown(&outline, *sides_by_m)?));
        }
        slabs.reverse();
        let slabs = merged(slabs, settings.same_area_ratio);
        let base_top_m = bottom_m + settings.base_m.max(settings.base_share * height_m);
        let base = within(lowest, f32::NEG_INFINITY, base_top_m)
            .and_then(|base| grown(&base, [0.0; 2]))
            .unwrap_or_else(|| slabs[0].outline.clone());
        let doubt = Vector2::zeros();
        let turn_axis = *axis;
        Some(Self {
            centroid: front.centroid,
            axis: *axis,
            turn_axis,
            turn_base: base.clone(),
            bottom_m,
            top_m,
            slabs,
            base,
            doubt,
            ends: Vec::new(),
            foot_probability: 1.0,
            foot_doubt_m: 0.0,
            landing_probability: 1.0,
        })
    }

    /// The shape after a turn about world z and a translation. None where an outline vanishes, which a rigid motion does not do.
    pub fn carried(&self, motion: &Isometry3<f64>) -> Option<Self> {
        let there = |p: &Point2<f32>| (motion * Point3::new(p.x, p.y, 0.0).cast::<f64>()).cast::<f32>();
        let outline = |o: &Footprint| Footprint::of(&o.corners().iter().map(there).collect::<Vec<_>>());
        let rise_m = motion.translation.z as f32;
        let slab = |s: &Slab| Some(Slab { low_m: s.low_m + rise_m, high_m: s.high_m + rise_m, ..s.with(outline)? });
        Some(Self {
            centroid: motion * self.centroid,
            axis: there(&self.axis).xy(),
            turn_axis: there(&self.turn_axis).xy(),
            turn_base: outline(&self.turn_base)?,
            bottom_m: self.bottom_m + rise_m,
            top_m: self.top_m + rise_m,
            slabs: self.slabs.iter().map(slab).collect::<Option<_>>()?,
            base: outline(&self.base)?,
            doubt: self.doubt_after(motion),
            ends: self.ends_after(motion),
            foot_probability: self.foot_probability,
            foot_doubt_m: self.foot_doubt_m,
            landing_probability: self.landing_probability,
        })
    }

    /// The shape of something that is known to reach to more places, seen from above. None where its outline vanishes.
    pub fn reaching(&self, places: &[Point2<f32>]) -> Option<Self> {
        let with = |outline: &Footprint| Footprint::of_places(outline.corners().iter().chain(places).copied());
        let slabs: Vec<Slab> = self.slabs.iter().map(|s| s.with(with)).collect::<Option<_>>()?;
        let (before, top) = (&self.slabs.last()?.outline, &slabs.last()?.outline);
        let reach_m = |outline: &Footprint, back: &Vector2<f32>| span(outline.corners(), back)[1];
        // What is known of its back is no longer in doubt.
        let known_m = |back: &Vector2<f32>| reach_m(top, back) - reach_m(before, back);
        let doubt = self.doubt.try_normalize(1e-6).map_or(self.doubt, |back| back * (self.doubt.norm() - known_m(&back)).max(0.0));
        let mut ends = self.ends.clone();
        for end in &mut ends {
            *end = end.beyond((reach_m(top, &end.outwards) - reach_m(before, &end.outwards)).max(0.0));
        }
        // As far to one side of its middle as to the other.
        let moved = area_centroid(top) - area_centroid(before);
        let (axis, turn_axis) = (self.axis + moved, self.turn_axis + moved);
        Some(Self { axis, turn_axis, doubt, ends, base: with(&self.base)?, turn_base: with(&self.turn_base)?, slabs, ..self.clone() })
    }

    /// The same with its top at another height, above its bottom.
    pub fn up_to(mut self, top_m: f32) -> Self {
        if let Some(slab) = self.slabs.last_mut().filter(|slab| top_m > slab.low_m) {
            (slab.high_m, self.top_m) = (top_m, top_m);
        }
        self
    }

    /// Where more of its back may be after a motion that may set it on another side, seen from above.
    pub fn doubt_after(&self, motion: &Isometry3<f64>) -> Vector2<f32> {
        (motion.rotation * self.doubt.push(0.0).cast::<f64>()).xy().cast::<f32>()
    }

    /// Its ends after a motion that may set it on another side.
    pub fn ends_after(&self, motion: &Isometry3<f64>) -> Vec<UnseenEnd> {
        self.ends.iter().filter_map(|end| end.moved(motion)).collect()
    }

    /// The shape with all that it and its back may be. None where an outline vanishes.
    pub fn with_doubt(&self) -> Option<Self> {
        let swept = |outline: &Footprint| Footprint::of_places(outline.corners().iter().flat_map(|c| [*c, c + self.doubt]));
        let slabs = self.slabs.iter().map(|slab| Some(Slab::of(slab.low_m, slab.high_m, swept(&slab.reach)?))).collect::<Option<_>>()?;
        Some(Self { slabs, ..self.clone() })
    }

    /// How far the observed centroid is above the bottom, metres.
    pub fn centroid_height_m(&self) -> f32 {
        self.centroid.z as f32 - self.bottom_m
    }

    /// From the observed centroid to the axis, seen from above, world frame.
    pub fn axis_offset(&self) -> Vector2<f32> {
        self.axis - self.centroid.xy().cast::<f32>()
    }

    /// Distance to another shape, metres; 0 when they overlap.
    pub fn gap_m(&self, other: &Self) -> f64 {
        let mut best = f64::INFINITY;
        for (a, b) in self.slabs.iter().flat_map(|a| other.slabs.iter().map(move |b| (a, b))) {
            let vertical_m = f64::from((a.low_m - b.high_m).max(b.low_m - a.high_m).max(0.0));
            if vertical_m < best {
                best = best.min(vertical_m.hypot(f64::from(outline_gap_m(a.outline.corners(), b.outline.corners()))));
            }
        }
        best
    }

    /// The corners of all prisms, world frame.
    pub fn corners(&self) -> impl Iterator<Item = Point3<f32>> + '_ {
        self.slabs
            .iter()
            .flat_map(|s| s.outline.corners().iter().flat_map(move |c| [Point3::new(c.x, c.y, s.low_m), Point3::new(c.x, c.y, s.high_m)]))
    }
}

/// An outline that reaches farther from the axis, to both sides of each direction, by so many metres.
fn stretched(outline: &Footprint, axis: &Point2<f32>, by: &[(Vector2<f32>, f32); 2]) -> Option<Footprint> {
    let half_m = |along: &Vector2<f32>| outline.corners().iter().map(|c| (c - axis).dot(along).abs()).fold(1e-4, f32::max);
    let halves = by.map(|(along, by_m)| (along, by_m / half_m(&along)));
    let moved = |c: &Point2<f32>| {
        let away = halves.iter().map(|(along, share)| along * ((c - axis).dot(along) * share)).sum::<Vector2<f32>>();
        c + away
    };
    Footprint::of_places(outline.corners().iter().map(moved))
}

/// What the prisms of a shape are made of.
struct Stack<'a> {
    /// Its axis, seen from above.
    axis: Point2<f32>,
    /// Points all over it, world frame.
    points: &'a [Point3<f32>],
    /// Those that its base is made of, as far as they are low enough.
    lowest: &'a [Point3<f32>],
    /// How much farther than those it reaches from its axis, its base included: away from the camera and towards it, and across that, metres.
    base_by_m: [f32; 2],
    /// How much farther beyond that it reaches above its base, metres.
    sides_by_m: [f32; 2],
}

/// Joins neighbouring slabs of nearly the same outline, so that a box is one prism: of nearly the same area and in the same place. What crosses another as
/// wide is not like it, nor is what leans away over it; so all slabs of a prism together are no larger either.
pub(crate) fn merged(slabs: Vec<Slab>, same_area_ratio: f32) -> Vec<Slab> {
    let mut out: Vec<Slab> = Vec::with_capacity(slabs.len());
    // What the slabs of the last prism cover together.
    let mut covered: Option<Footprint> = None;
    for slab in slabs {
        let with_it = covered.as_ref().and_then(|covered| covered.around_both(&slab.outline));
        match (out.last_mut(), with_it) {
            (Some(last), Some(with_it)) if are_alike(&last.outline, &slab.outline, &with_it, same_area_ratio) => {
                if slab.reach.area() > last.reach.area() {
                    (last.outline, last.reach) = (slab.outline, slab.reach);
                }
                last.high_m = slab.high_m;
                covered = Some(with_it);
            }
            _ => {
                covered = Some(slab.outline.clone());
                out.push(slab);
            }
        }
    }
    out
}

/// Whether two outlines are of nearly the same area, and what they cover together with others is, too.
fn are_alike(a: &Footprint, b: &Footprint, together: &Footprint, ratio: f32) -> bool {
    let (smaller, larger) = (a.area().min(b.area()), a.area().max(b.area()));
    smaller >= ratio * larger && larger >= ratio * together.area()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points every 4 mm on the faces of a box that a camera at −y, above, sees: front and top.
    fn seen_box(center: [f32; 2], size: [f32; 3]) -> Vec<Point3<f32>> {
        let steps = size.map(|s| (s / 0.004).round() as i32);
        let mut points = Vec::new();
        for i in 0..=steps[0] {
            let x = center[0] + size[0] * (i as f32 / steps[0] as f32 - 0.5);
            points.extend((1..=steps[2]).map(|k| Point3::new(x, center[1] - size[1] / 2.0, size[2] * k as f32 / steps[2] as f32)));
            points.extend((0..=steps[1]).map(|j| Point3::new(x, center[1] + size[1] * (j as f32 / steps[1] as f32 - 0.5), size[2])));
        }
        points
    }

    #[test]
    fn slabs_of_one_outline_are_one_prism_and_those_that_cross_or_lean_away_over_each_other_are_not() {
        let outline = |at: [f32; 2], half: [f32; 2]| {
            let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
            Footprint::of(&corners.map(|[x, y]: [f32; 2]| Point3::new(at[0] + x * half[0], at[1] + y * half[1], 0.0))).unwrap()
        };
        let joined = |outlines: Vec<Footprint>| {
            let slab = |(k, outline)| Slab::of(0.01 * k as f32, 0.01 * (k + 1) as f32, outline);
            merged(outlines.into_iter().enumerate().map(slab).collect(), ShapeSettings::default().same_area_ratio)
        };
        let box_of = joined(vec![outline([0.0, 0.0], [0.04, 0.03]); 5]);
        assert!(box_of.len() == 1 && box_of[0].low_m == 0.0 && (box_of[0].high_m - 0.05).abs() < 1e-6, "{box_of:?}");
        let cross = joined(vec![outline([0.0, 0.0], [0.07, 0.02]), outline([0.0, 0.0], [0.02, 0.07])]);
        assert_eq!(cross.len(), 2, "each as wide as the other, and across it");
        // 45 degrees off upright: no prism is of more than two slabs, a centimetre aside.
        let leaning = joined((0..8).map(|k| outline([0.01 * k as f32, 0.0], [0.03, 0.03])).collect());
        assert!(leaning.len() >= 4, "{leaning:?}");
    }

    fn complete(points: &[Point3<f32>], eye: Point2<f32>, hidden: &Hidden) -> Shape {
        let settings = ShapeSettings::default();
        Shape::complete(&Front::of(points, 0.0, &eye, &settings).unwrap(), hidden, &settings).unwrap()
    }

    #[test]
    fn a_box_seen_from_the_front_and_above_is_one_prism_of_its_size() {
        let points = seen_box([0.1, 0.5], [0.08, 0.06, 0.12]);
        let shape = complete(&points, Point2::new(0.1, -0.5), &Hidden::default());
        assert!((shape.axis - Point2::new(0.1, 0.5)).norm() < 0.002, "{}", shape.axis);
        assert_eq!((shape.slabs.len(), shape.doubt), (1, Vector2::zeros()));
        let area = shape.slabs[0].outline.area();
        assert!((0.0047..0.0063).contains(&area), "{area}");
        assert!(shape.centroid.y < 0.5, "the observed centroid is nearer the camera than the axis");
        assert!(shape.base.margin(&Point2::new(0.1, 0.52)) > 0.0, "the hidden back is part of the base");
    }

    #[test]
    fn what_is_cut_off_at_an_end_or_at_both_is_made_up_for() {
        let (whole, eye) = (seen_box([0.0, 0.5], [0.12, 0.06, 0.1]), Point2::new(0.0, -0.5));
        let reach_m = |shape: &Shape| {
            let corners = shape.slabs[0].outline.corners().iter();
            corners.fold([0.0f32; 2], |[left, right], c| [left.min(c.x), right.max(c.x)])
        };
        let cut = |left_m: f32, right_m: f32| {
            let seen: Vec<Point3<f32>> = whole.iter().filter(|p| (-0.06 + left_m..=0.06 - right_m).contains(&p.x)).copied().collect();
            complete(&seen, eye, &Hidden { left_m, right_m, ..Hidden::default() })
        };
        for (left_m, right_m) in [(0.0, 0.04), (0.05, 0.0), (0.02, 0.02), (0.01, 0.03)] {
            let shape = cut(left_m, right_m);
            let [left, right] = reach_m(&shape);
            assert!((left + 0.06).abs() < 0.006 && (right - 0.06).abs() < 0.006, "{left_m} {right_m}: {left} to {right}");
            assert!(shape.axis.x.abs() < 0.004 && shape.base.margin(&shape.axis) > 0.02, "{}", shape.axis);
        }
    }

    #[test]
    fn of_a_whole_surface_the_base_is_what_is_lowest_and_the_prisms_keep_clear_of_its_half_turn() {
        // Half of a rectangle: its middle is not that of its box.
        let points: Vec<Point3<f32>> = (0..=30)
            .flat_map(|i| (0..=20).flat_map(move |j| (0..=10).map(move |k| [i, j, k])))
            .filter(|[i, j, _]| i * 20 <= (20 - j) * 30)
            .map(|[i, j, k]| Point3::new(i as f32 * 0.004, j as f32 * 0.004, k as f32 * 0.004))
            .collect();
        let settings = ShapeSettings::default();
        let front = Front::of(&points, 0.0, &Point2::new(0.04, 0.027), &settings).unwrap();
        let shape = Shape::of_surface(&front, Point2::new(0.04, 0.027), &settings).unwrap();
        let area = shape.base.area();
        assert!((0.0042..0.0056).contains(&area), "half of a rectangle of 12 cm by 8 cm: {area}");
        assert!(shape.slabs[0].outline.area() > 0.008, "the whole of it: {}", shape.slabs[0].outline.area());
        assert_eq!(shape.axis, Point2::new(0.04, 0.027));
    }

    #[test]
    fn a_carried_shape_is_the_same_shape_elsewhere() {
        let points = seen_box([0.1, 0.5], [0.08, 0.06, 0.12]);
        let shape = complete(&points, Point2::new(0.1, -0.5), &Hidden::default());
        let turn = nalgebra::Rotation3::from_axis_angle(&nalgebra::Vector3::z_axis(), 0.8);
        let motion = Isometry3::from_parts(nalgebra::Translation3::new(-0.3, 0.2, 0.05), turn.into());
        let carried = shape.carried(&motion).unwrap();
        assert!((carried.slabs[0].outline.area() - shape.slabs[0].outline.area()).abs() < 1e-6);
        assert!((carried.bottom_m - 0.05).abs() < 1e-6 && (carried.top_m - shape.top_m - 0.05).abs() < 1e-6);
        assert!((carried.centroid_height_m() - shape.centroid_height_m()).abs() < 1e-6);
        let back = carried.carried(&motion.inverse()).unwrap();
        assert!((back.axis - shape.axis).norm() < 1e-6 && (back.centroid - shape.centroid).norm() < 1e-9);
    }

    #[test]
    fn the_front_half_of_a_bottle_is_completed_to_a_round_one() {
        // A cylinder of radius 3 cm, 18 cm high, with a neck of 1 cm: only the half towards −y is seen.
        let mut points = Vec::new();
        for k in 1..=45 {
            let z = k as f32 * 0.004;
            let radius = if z > 0.14 { 0.01 } else { 0.03 };
            points.extend((0..=40).map(|i| {
                let angle = std::f32::consts::PI * (1.0 + i as f32 / 40.0);
                Point3::new(radius * angle.cos(), 0.5 + radius * angle.sin(), z)
            }));
        }
        let shape = complete(&points, Point2::new(0.0, -0.5), &Hidden { back_m: 0.03, doubt_m: 0.02, ..Hidden::default() });
        assert!((shape.axis - Point2::new(0.0, 0.5)).norm() < 0.004, "{}", shape.axis);
        assert!((shape.doubt.y - 0.02).abs() < 1e-4 && shape.doubt.x.abs() < 0.002, "on the far side: {}", shape.doubt);
        assert!(shape.slabs.len() >= 2);
        assert!(shape.slabs[0].outline.area() > 3.0 * shape.slabs.last().unwrap().outline.area());
    }
}
