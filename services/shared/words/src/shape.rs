//! What an object's observed points say of its shape, and which nouns and adjectives that fits.
//!
//! A single view shows the top and the near side. Seen from above, the hull of a whole or half disc fills π/4 of the smallest rectangle
//! around it and that of a box all of it, so one ratio tells round from boxy. The points near the top tell a rim from a lid and a
//! shoulder from a dome.

use nalgebra::{Point3, Vector2};
use repose_geometry::{Aabb, Footprint};
use repose_relations::rectangle::rectangle_yaw_rad;

use crate::grade::Grade;

/// The top is the highest part of an object, this share of its height, but no thinner than a camera's noise.
const TOP_SHARE: f64 = 0.12;
const TOP_AT_LEAST_M: f64 = 0.004;
/// Fewer points than this near the top tell nothing about it.
const TOP_POINTS: usize = 25;
/// The inner part of the outline, as a share of its half extents.
const INNER_SHARE: f64 = 0.5;

/// The measured extents of an observed shape.
#[derive(Debug, Clone, PartialEq)]
pub struct ShapeMeasures {
    /// Longer and shorter edge of the smallest rectangle around it seen from above, metres.
    pub plan_m: [f64; 2],
    /// From its lowest observed point to its highest, metres.
    pub height_m: f64,
    /// Share of that rectangle that the hull of its points fills: π/4 for a disc, 1 for a box.
    pub fill: f64,
    /// Share of the points near its top that lie over the inner part of its outline: a quarter of a flat round lid's, none of a rim's.
    pub top_inside: Option<f64>,
    /// Longest extent of the points near its top, as a share of the outline's: 1 for a can, about 0.6 for a ball.
    pub top_width: Option<f64>,
}

impl ShapeMeasures {
    /// The shape of points whose z is up, metres; `None` for fewer than three that span an area.
    pub fn of(points: &[Point3<f32>]) -> Option<Self> {
        let rectangle = Rectangle::around(points)?;
        let spans = Aabb::of(points)?;
        let height_m = f64::from(spans.extent().z);
        let top_from = f64::from(spans.max.z) - (height_m * TOP_SHARE).max(TOP_AT_LEAST_M);
        let top: Vec<Point3<f32>> = points.iter().filter(|p| f64::from(p.z) >= top_from).copied().collect();
        let enough = top.len() >= TOP_POINTS;
        let top_inside = enough.then(|| top.iter().filter(|p| rectangle.is_inner(p)).count() as f64 / top.len() as f64);
        let top_width = Rectangle::around(&top).filter(|_| enough).map(|t| t.longer() / rectangle.longer());
        let plan_m = [rectangle.longer(), rectangle.shorter()];
        Some(Self { plan_m, height_m, fill: rectangle.fill, top_inside, top_width })
    }

    /// The volume of the box around it, cubic metres: what "large" is measured by.
    pub fn volume_m3(&self) -> f64 {
        self.plan_m[0] * self.plan_m[1] * self.height_m
    }

    fn height_over_length(&self) -> f64 {
        self.height_m / self.plan_m[0].max(1e-6)
    }

    fn height_over_width(&self) -> f64 {
        self.height_m / self.plan_m[1].max(1e-6)
    }

    /// Whether its outline is round.
    pub fn round(&self) -> Grade {
        let outline = Grade::at_most(self.fill, 0.86, 0.92);
        outline.and(Grade::at_most(self.plan_m[0] / self.plan_m[1].max(1e-6), 1.5, 2.2))
    }

    /// Whether its outline is a rectangle.
    pub fn boxy(&self) -> Grade {
        Grade::at_least(self.fill, 0.90, 0.85)
    }

    /// Whether it is much higher than wide.
    pub fn tall(&self) -> Grade {
        Grade::at_least(self.height_over_length(), 1.6, 1.2)
    }

    /// Whether it is much lower than wide.
    pub fn flat(&self) -> Grade {
        Grade::at_most(self.height_over_width(), 0.32, 0.45)
    }

    /// Whether it is open at the top: a rim and nothing inside it.
    pub fn hollow(&self) -> Grade {
        self.top_inside.map_or(Grade::Maybe, |share| Grade::at_most(share, 0.06, 0.14))
    }

    fn regular(&self) -> Grade {
        let edges = [self.plan_m[0], self.plan_m[1], self.height_m];
        Grade::at_least(edges.iter().copied().fold(f64::INFINITY, f64::min) / edges.iter().copied().fold(1e-6, f64::max), 0.75, 0.6)
    }
}

/// The kind of shape that a noun names. Sizes are those of tabletop objects.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ShapeKind {
    /// Box, carton, packet.
    Box,
    /// Cube.
    Cube,
    /// Book, notebook.
    Book,
    /// Ball, sphere.
    Ball,
    /// Can, tin, jar, cylinder.
    Can,
    /// Bottle.
    Bottle,
    /// Mug, cup, glass.
    Mug,
    /// Bowl.
    Bowl,
    /// Plate, dish, saucer.
    Plate,
}

impl ShapeKind {
    /// Whether a shape may be called that.
    pub fn fits(self, shape: &ShapeMeasures) -> Grade {
        let slender = shape.height_over_length();
        let solid = shape.hollow().opposite();
        match self {
            // A flat box is sooner called something else, an open one is still a box.
            Self::Box => shape.boxy().and(if shape.flat() == Grade::Yes { Grade::Maybe } else { Grade::Yes }),
            Self::Cube => shape.boxy().and(shape.regular()),
            Self::Book => shape.boxy().and(shape.flat()),
            Self::Ball => {
                let dome = shape.top_width.map_or(Grade::Maybe, |w| Grade::within(w, [0.3, 0.82], [0.2, 0.9]));
                shape.round().and(solid).and(dome).and(Grade::within(slender, [0.75, 1.3], [0.55, 1.5]))
            }
            Self::Can => {
                let lid = shape.top_width.map_or(Grade::Maybe, |w| Grade::at_least(w, 0.83, 0.7));
                shape.round().and(solid).and(lid).and(Grade::within(slender, [0.7, 2.6], [0.5, 3.5]))
            }
            Self::Bottle => shape.round().and(Grade::at_least(slender, 1.8, 1.4)),
            Self::Mug => {
                let in_hand = Grade::at_most(shape.plan_m[0], 0.15, 0.19);
                shape.round().and(shape.hollow()).and(in_hand).and(Grade::within(slender, [0.6, 2.0], [0.45, 2.6]))
            }
            Self::Bowl => {
                let wide = Grade::at_least(shape.plan_m[0], 0.10, 0.08);
                shape.round().and(shape.hollow()).and(wide).and(Grade::within(slender, [0.22, 0.7], [0.15, 0.85]))
            }
            Self::Plate => shape.round().and(shape.flat()),
        }
    }
}

/// The smallest rectangle around points seen from above.
struct Rectangle {
    /// The direction of its first edge.
    along: Vector2<f64>,
    center: Vector2<f64>,
    /// Half the edges, along and across.
    half: [f64; 2],
    /// The hull's share of its area.
    fill: f64,
}

impl Rectangle {
    fn around(points: &[Point3<f32>]) -> Option<Self> {
        let hull = Footprint::of(points)?;
        let yaw_rad = rectangle_yaw_rad(points)?;
        let (along, across) = (Vector2::new(yaw_rad.cos(), yaw_rad.sin()), Vector2::new(-yaw_rad.sin(), yaw_rad.cos()));
        let spanned = |axis: &Vector2<f64>| {
            let along = hull.corners().iter().map(|c| c.coords.cast::<f64>().dot(axis));
            along.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| [low.min(x), high.max(x)])
        };
        let (u, v) = (spanned(&along), spanned(&across));
        let center = along * (u[0] + u[1]) / 2.0 + across * (v[0] + v[1]) / 2.0;
        let half = [(u[1] - u[0]) / 2.0, (v[1] - v[0]) / 2.0];
        Some(Self { along, center, half, fill: f64::from(hull.area()) / (4.0 * half[0] * half[1]).max(1e-9) })
    }

    fn longer(&self) -> f64 {
        2.0 * self.half[0].max(self.half[1])
    }

    fn shorter(&self) -> f64 {
        2.0 * self.half[0].min(self.half[1])
    }

    fn is_inner(&self, p: &Point3<f32>) -> bool {
        let from_center = p.xy().coords.cast::<f64>() - self.center;
        let across = Vector2::new(-self.along.y, self.along.x);
        let (u, v) = (from_center.dot(&self.along) / self.half[0], from_center.dot(&across) / self.half[1]);
        u.hypot(v) <= INNER_SHARE
    }
}
