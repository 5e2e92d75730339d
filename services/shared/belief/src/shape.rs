//! The whole shape of an object, guessed from the half of it that a camera saw.
//!
//! A stack of upright prisms: the object's height is cut into slabs, each with the convex outline of its points and of the same points
//! turned by half a turn about the object's axis. The axis stands in the middle of the outline where the top was seen whole (boxes,
//! cups, bowls); otherwise the object is taken to be about as deep as it is wide or high, whichever is less (bottles, balls).
//! How far its back reaches then is a guess: [`Shape::doubt`] says where more of it may be.
//! The bottom is the support under it: border cleaning trims the cloud's own.

use nalgebra::{Isometry3, Point2, Point3, Vector2};
use repose_geometry::{Footprint, cloud};

use crate::outlines::{area_centroid, outline_gap_m};
use crate::settings::ShapeSettings;

/// An upright prism.
#[derive(Debug, Clone, PartialEq)]
pub struct Slab {
    /// Bottom, world z, metres.
    pub low_m: f32,
    /// Top, world z, metres.
    pub high_m: f32,
    /// Outline seen from above, world frame.
    pub outline: Footprint,
}

/// A completed object, where it was observed (world frame).
#[derive(Debug, Clone, PartialEq)]
pub struct Shape {
    /// Centroid of the observed points (not the geometric centre).
    pub centroid: Point3<f64>,
    /// The axis, seen from above: where its centre of mass is believed to be.
    pub axis: Point2<f32>,
    /// Height of what it stands on, world z, metres.
    pub bottom_m: f32,
    /// Height of its top, world z, metres.
    pub top_m: f32,
    /// The prisms, from the bottom up, without gaps.
    pub slabs: Vec<Slab>,
    /// Outline of the part that touches what it stands on.
    pub base: Footprint,
    /// How much farther its back may reach than the prisms do, world axes seen from above, metres; zero where its top was seen whole.
    pub doubt: Vector2<f32>,
}

impl Shape {
    /// Completes an object from its points (world frame), the height it stands on and where the camera is, seen from above.
    ///
    /// `None` when the points have no extent from above.
    pub fn complete(points: &[Point3<f32>], bottom_m: f32, camera: &Point2<f32>, settings: &ShapeSettings) -> Option<Self> {
        let centroid = cloud::centroid(points)?;
        let robust = cloud::percentile_box(points, settings.stray_share, 1.0 - settings.stray_share)?.inflated(1e-4);
        let points: Vec<Point3<f32>> = points.iter().filter(|p| robust.contains(p)).copied().collect();
        let top_m = points.iter().map(|p| p.z).fold(bottom_m + settings.min_height_m, f32::max);
        let Axis { at: axis, doubt } = axis(&points, top_m, top_m - bottom_m, camera, settings)?;
        let whole = mirrored_outline(points.iter(), &axis)?;

        let height_m = top_m - bottom_m;
        let count = ((height_m / settings.slab_m).floor() as usize).clamp(1, settings.max_slabs);
        let step_m = height_m / count as f32;
        let mut slabs: Vec<Slab> = Vec::with_capacity(count);
        // From the top down: what is hidden or trimmed below looks like what is seen above it.
        let mut above = None;
        for k in (0..count).rev() {
            let (low_m, high_m) = (bottom_m + k as f32 * step_m, bottom_m + (k + 1) as f32 * step_m);
            let within: Vec<&Point3<f32>> = points.iter().filter(|p| p.z >= low_m && p.z <= high_m).collect();
            let own = (within.len() >= settings.min_slab_points).then(|| mirrored_outline(within.into_iter(), &axis)).flatten();
            let outline = own.or_else(|| above.clone()).unwrap_or_else(|| whole.clone());
            above = Some(outline.clone());
            slabs.push(Slab { low_m, high_m, outline: grown(&outline, &axis, settings.trim_m)? });
        }
        slabs.reverse();
        let slabs = merged(slabs, settings.same_area_ratio);
        let base_top_m = bottom_m + settings.base_m.max(settings.base_share * height_m);
        let near_bottom: Vec<&Point3<f32>> = points.iter().filter(|p| p.z <= base_top_m).collect();
        let base = (near_bottom.len() >= settings.min_slab_points).then(|| mirrored_outline(near_bottom.into_iter(), &axis)).flatten();
        let base = base.unwrap_or_else(|| slabs[0].outline.clone());
        Some(Self { centroid, axis, bottom_m, top_m, slabs, base, doubt })
    }

    /// The shape after a turn about world z and a translation. None where an outline vanishes, which a rigid motion does not do.
    pub fn carried(&self, motion: &Isometry3<f64>) -> Option<Self> {
        let there = |p: &Point2<f32>| (motion * Point3::new(p.x, p.y, 0.0).cast::<f64>()).cast::<f32>();
        let outline = |o: &Footprint| Footprint::of(&o.corners().iter().map(there).collect::<Vec<_>>());
        let rise_m = motion.translation.z as f32;
        let slab = |s: &Slab| Some(Slab { low_m: s.low_m + rise_m, high_m: s.high_m + rise_m, outline: outline(&s.outline)? });
        Some(Self {
            centroid: motion * self.centroid,
            axis: there(&self.axis).xy(),
            bottom_m: self.bottom_m + rise_m,
            top_m: self.top_m + rise_m,
            slabs: self.slabs.iter().map(slab).collect::<Option<_>>()?,
            base: outline(&self.base)?,
            doubt: (motion.rotation * self.doubt.push(0.0).cast::<f64>()).xy().cast::<f32>(),
        })
    }

    /// The shape of something that is known to reach to more places, seen from above. None where its outline vanishes.
    pub fn reaching(&self, places: &[Point2<f32>]) -> Option<Self> {
        let with = |outline: &Footprint| {
            Footprint::of(&outline.corners().iter().chain(places).map(|c| Point3::new(c.x, c.y, 0.0)).collect::<Vec<_>>())
        };
        let slabs: Vec<Slab> = self.slabs.iter().map(|s| Some(Slab { outline: with(&s.outline)?, ..s.clone() })).collect::<Option<_>>()?;
        let (before, top) = (&self.slabs.last()?.outline, &slabs.last()?.outline);
        let reach_m =
            |outline: &Footprint, back: &Vector2<f32>| outline.corners().iter().map(|c| c.coords.dot(back)).fold(f32::MIN, f32::max);
        // What is known of its back is no longer in doubt.
        let known_m = |back: &Vector2<f32>| reach_m(top, back) - reach_m(before, back);
        let doubt = self.doubt.try_normalize(1e-6).map_or(self.doubt, |back| back * (self.doubt.norm() - known_m(&back)).max(0.0));
        // As far to one side of its middle as to the other.
        let axis = self.axis + (area_centroid(top) - area_centroid(before));
        Some(Self { axis, doubt, base: with(&self.base)?, slabs, ..self.clone() })
    }

    /// The same with its top at another height, above its bottom.
    pub fn up_to(mut self, top_m: f32) -> Self {
        if let Some(slab) = self.slabs.last_mut().filter(|slab| top_m > slab.low_m) {
            (slab.high_m, self.top_m) = (top_m, top_m);
        }
        self
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

/// The corners of an outline with every corner moved away from the axis by `by_m`.
fn grown(outline: &Footprint, axis: &Point2<f32>, by_m: f32) -> Option<Footprint> {
    let corners: Vec<Point3<f32>> = outline
        .corners()
        .iter()
        .map(|c| {
            let away = c - axis;
            let moved = c + away.try_normalize(1e-6).unwrap_or_else(Vector2::zeros) * by_m;
            Point3::new(moved.x, moved.y, 0.0)
        })
        .collect();
    Footprint::of(&corners)
}

/// The outline of points and of their images under half a turn about the axis.
fn mirrored_outline<'a>(points: impl Iterator<Item = &'a Point3<f32>>, axis: &Point2<f32>) -> Option<Footprint> {
    let both: Vec<Point3<f32>> = points.flat_map(|p| [*p, Point3::new(2.0 * axis.x - p.x, 2.0 * axis.y - p.y, p.z)]).collect();
    Footprint::of(&both)
}

/// Where an object's upright axis is believed to be.
#[derive(Debug, Clone, Copy)]
struct Axis {
    at: Point2<f32>,
    doubt: Vector2<f32>,
}

/// Where the object's upright axis is believed to be, and how far that is a guess.
fn axis(points: &[Point3<f32>], top_m: f32, height_m: f32, camera: &Point2<f32>, settings: &ShapeSettings) -> Option<Axis> {
    let whole = Footprint::of(points)?;
    let rim_low_m = top_m - settings.rim_m.max(settings.rim_share * height_m);
    let rim = Footprint::of(points.iter().filter(|p| p.z >= rim_low_m));
    let middle = area_centroid(&whole);
    let certain = Axis { at: middle, doubt: Vector2::zeros() };
    let Some(away) = (middle - camera).try_normalize(1e-3) else { return Some(certain) };
    if rim.is_some_and(|rim| rim.area() >= settings.whole_top_ratio * whole.area()) {
        return Some(certain);
    }
    let across = Vector2::new(-away.y, away.x);
    let span = |direction: &Vector2<f32>| {
        let values = whole.corners().iter().map(|c| c.coords.dot(direction));
        values.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
    };
    let ((near, far), (left, right)) = (span(&away), span(&across));
    // Both sides of what was seen lost their borders.
    let width = right - left + 2.0 * settings.trim_m;
    let depth = (far - near).max(width.min(height_m));
    let at = Point2::from(away * (near + depth / 2.0) + across * ((left + right) / 2.0));
    Some(Axis { at, doubt: away * (settings.doubt_share * (right - left)).min(settings.max_doubt_m) })
}

/// Joins neighbouring slabs of nearly the same area, so that a box is one prism.
fn merged(slabs: Vec<Slab>, same_area_ratio: f32) -> Vec<Slab> {
    let mut out: Vec<Slab> = Vec::with_capacity(slabs.len());
    for slab in slabs {
        match out.last_mut() {
            Some(last) if alike(last.outline.area(), slab.outline.area(), same_area_ratio) => {
                if slab.outline.area() > last.outline.area() {
                    last.outline = slab.outline;
                }
                last.high_m = slab.high_m;
            }
            _ => out.push(slab),
        }
    }
    out
}

fn alike(a: f32, b: f32, ratio: f32) -> bool {
    a.min(b) >= ratio * a.max(b)
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
    fn a_box_seen_from_the_front_and_above_is_one_prism_of_its_size() {
        let points = seen_box([0.1, 0.5], [0.08, 0.06, 0.12]);
        let shape = Shape::complete(&points, 0.0, &Point2::new(0.1, -0.5), &ShapeSettings::default()).unwrap();
        assert!((shape.axis - Point2::new(0.1, 0.5)).norm() < 0.002, "{}", shape.axis);
        assert_eq!((shape.slabs.len(), shape.doubt), (1, Vector2::zeros()));
        let area = shape.slabs[0].outline.area();
        assert!((0.0048..0.0063).contains(&area), "{area}");
        assert!(shape.centroid.y < 0.5, "the observed centroid is nearer the camera than the axis");
        assert!(shape.base.margin(&Point2::new(0.1, 0.52)) > 0.0, "the hidden back is part of the base");
    }

    #[test]
    fn a_carried_shape_is_the_same_shape_elsewhere() {
        let points = seen_box([0.1, 0.5], [0.08, 0.06, 0.12]);
        let shape = Shape::complete(&points, 0.0, &Point2::new(0.1, -0.5), &ShapeSettings::default()).unwrap();
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
        let shape = Shape::complete(&points, 0.0, &Point2::new(0.0, -0.5), &ShapeSettings::default()).unwrap();
        assert!((shape.axis - Point2::new(0.0, 0.5)).norm() < 0.004, "{}", shape.axis);
        assert!(shape.doubt.y > 0.02 && shape.doubt.x.abs() < 0.002, "it may be deeper than it is wide: {}", shape.doubt);
        assert!(shape.slabs.len() >= 2);
        assert!(shape.slabs[0].outline.area() > 3.0 * shape.slabs.last().unwrap().outline.area());
    }
}
