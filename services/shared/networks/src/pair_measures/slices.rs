//! A cloud cut level into bands: in each a few points make a circle, or an outline that half a turn completes.

use std::sync::OnceLock;

use nalgebra::Vector2;

use super::middles::Circle;

/// A band is about this high, metres; a cloud has [`LEAST_BANDS`] to [`MOST_BANDS`].
const BAND_M: f32 = 0.02;
const LEAST_BANDS: usize = 2;
const MOST_BANDS: usize = 6;
/// Bands with fewer points are left out.
const POINTS_LEAST: usize = 12;
/// Directions in which an outline's span is known beforehand.
const DIRECTIONS: usize = 16;

/// A level slice of a cloud, relative to the cloud's centroid.
#[derive(Debug, Clone)]
pub(super) struct Band {
    pub low_m: f32,
    pub high_m: f32,
    pub points: Vec<Vector2<f32>>,
    pub circle: Option<Circle>,
    /// The points' span in each of [`DIRECTIONS`].
    pub spans: [Span; DIRECTIONS],
}

/// The least and the most of points along a direction.
#[derive(Debug, Clone, Copy)]
pub(super) struct Span {
    pub least: f32,
    pub most: f32,
}

impl Span {
    pub fn of(points: &[Vector2<f32>], u: &Vector2<f32>) -> Self {
        let along = points.iter().map(|p| p.dot(u));
        along.fold(Self { least: f32::INFINITY, most: f32::NEG_INFINITY }, |span, v| Self {
            least: span.least.min(v),
            most: span.most.max(v),
        })
    }

    /// Along the opposite direction.
    pub fn opposite(self) -> Self {
        Self { least: -self.most, most: -self.least }
    }
}

/// All [`DIRECTIONS`], with their angles in radians.
pub(super) fn directions() -> &'static [(Vector2<f32>, f32); DIRECTIONS] {
    static ALL: OnceLock<[(Vector2<f32>, f32); DIRECTIONS]> = OnceLock::new();
    ALL.get_or_init(|| {
        std::array::from_fn(|d| {
            let angle_rad = std::f32::consts::TAU * d as f32 / DIRECTIONS as f32;
            (direction(angle_rad), angle_rad)
        })
    })
}

pub(super) fn direction(angle_rad: f32) -> Vector2<f32> {
    let (sin, cos) = angle_rad.sin_cos();
    Vector2::new(cos, sin)
}

/// The bands of a cloud, from coordinates by axis and the heights that they reach.
pub(super) fn bands([x, y, z]: &[Vec<f32>; 3], low_m: f32, high_m: f32) -> Vec<Band> {
    let height_m = (high_m - low_m).max(f32::EPSILON);
    let count = ((height_m / BAND_M) as usize).clamp(LEAST_BANDS, MOST_BANDS);
    let edge = |k: usize| low_m + height_m * k as f32 / count as f32;
    let band = |k: usize| {
        let (low_m, high_m) = (edge(k), edge(k + 1));
        let within = (0..z.len()).filter(|i| (low_m..=high_m).contains(&z[*i]));
        let points: Vec<Vector2<f32>> = within.map(|i| Vector2::new(x[i], y[i])).collect();
        (points.len() >= POINTS_LEAST).then(|| Band {
            low_m,
            high_m,
            circle: Circle::robust(&points, POINTS_LEAST),
            spans: directions().each_ref().map(|(u, _)| Span::of(&points, u)),
            points,
        })
    };
    (0..count).filter_map(band).collect()
}
