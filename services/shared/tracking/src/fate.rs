//! What became of an object between two views, told from where its points were to be, where they are seen and what is read there.
//!
//! Not to be found where it was means one of two things, and the depth picture tells which: where the camera now looks through the place to
//! what is behind it, the object is gone from there; where something nearer covers the place, or nothing is read, it may well stand there
//! still.

use nalgebra::{Point3, Vector3};
use repose_proto::Scene;
use schemars::JsonSchema;
use serde::Serialize;

use crate::picture::DepthPicture;

/// Points of an object that are looked at.
const POINTS: usize = 300;
/// A share of the readings that decides what became of an object.
const MOST: f64 = 0.5;
/// Readings that are needed to say that something is gone.
const ENOUGH: usize = 12;
/// From here on an object was moved, metres: a centroid shifts by as much where another part of the object is seen.
const MOVED_M: f64 = 0.03;
/// From here on it fell, metres.
const FELL_M: f64 = 0.03;
/// Points up to so far apart are of the same place, metres.
const TOUCH_M: f64 = 0.02;

/// What became of an object.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case", tag = "fate")]
pub enum Fate {
    /// It stands where it was to be.
    Stands,
    /// It stands elsewhere.
    Moved {
        /// How far from where it was to be, metres.
        by_m: f64,
    },
    /// It lies lower than it was to be.
    Fell {
        /// How much lower, metres.
        by_m: f64,
    },
    /// Something covers the place where it was to be: it may be there.
    Hidden,
    /// The place where it was to be is empty, and nothing of its size is seen elsewhere.
    Gone,
}

/// Whether what was read where the points of an object were to be is behind them: nothing is there.
pub(crate) fn is_empty(points: &[Point3<f64>], picture: &DepthPicture) -> bool {
    let height_m = ends(points, 2).map_or(0.0, |[low_m, high_m]| high_m - low_m);
    let read: Vec<bool> = points.iter().filter_map(|p| picture.is_empty(p, height_m)).collect();
    let through = read.iter().filter(|is_empty| **is_empty).count();
    read.len() >= ENOUGH.min(points.len()) && through as f64 > MOST * points.len() as f64
}

/// Whether most points are behind what was read there, or nothing was.
pub(crate) fn is_covered(points: &[Point3<f64>], picture: &DepthPicture) -> bool {
    points.iter().filter(|p| picture.is_covered(p) != Some(false)).count() as f64 > MOST * points.len() as f64
}

/// How far points are from where they were to be. A part of them may be covered, or may have been before, so that what is compared is where both were
/// seen. What was turned round shows another side: of where its points were to be, what could be seen from here tells whether it stands there.
pub(crate) fn displaced(expected: &[Point3<f64>], seen: &[Point3<f64>], picture: Option<&DepthPicture>) -> Fate {
    let (Some(was), Some(is)) = (middle(expected), middle(seen)) else { return Fate::Stands };
    let open = picture.map_or_else(Vec::new, |picture| uncovered(expected, picture));
    let is_there = are_near(seen, expected) || are_near(expected, seen) || (open.len() >= ENOUGH && are_near(&open, seen));
    // Most of something large is still where it was to be when it is pushed, and of something tall when it sinks.
    let pushed = apart(&Point3::origin(), &Point3::from(pushed_by(&open, seen)));
    match (is_there, pushed, apart(&was, &is)) {
        (true, Fate::Stands, _) => Fate::Stands,
        // How far the ends have gone is at least that; the middle tells it better.
        (true, pushed, Fate::Stands) => pushed,
        (_, _, by_middle) => by_middle,
    }
}

/// The points that nothing covers: what was read there tells of them.
fn uncovered(points: &[Point3<f64>], picture: &DepthPicture) -> Vec<Point3<f64>> {
    points.iter().filter(|p| picture.is_covered(p) == Some(false)).copied().collect()
}

/// Whether most points are near others.
pub(crate) fn are_near(points: &[Point3<f64>], others: &[Point3<f64>]) -> bool {
    let is_near = |p: &&Point3<f64>| others.iter().any(|other| (*other - **p).norm() <= TOUCH_M);
    points.iter().filter(is_near).count() as f64 > MOST * points.len() as f64
}

/// From where to where something reaches along each axis, but for a few stray points.
pub(crate) type Reach = [Option<[f64; 2]>; 3];

pub(crate) fn reach(points: &[Point3<f64>]) -> Reach {
    [0, 1, 2].map(|axis| ends(points, axis))
}

/// Whether points that reach so far may be near each other, most of either.
pub(crate) fn meet(one: &Reach, other: &Reach) -> bool {
    one.iter().zip(other).all(|(a, b)| a.zip(*b).is_some_and(|(a, b)| a[0] <= b[1] + TOUCH_M && b[0] <= a[1] + TOUCH_M))
}

/// How far both ends of something have gone the same way, along each axis, from where those of its points that are open were to be. Where one end alone
/// has, more or less of it is covered.
fn pushed_by(open: &[Point3<f64>], seen: &[Point3<f64>]) -> Vector3<f64> {
    let along = |axis: usize| {
        let ([low_m, high_m], [low_now_m, high_now_m]) = (ends(open, axis)?, ends(seen, axis)?);
        let (low_by_m, high_by_m) = (low_now_m - low_m, high_now_m - high_m);
        let least_m = if low_by_m.abs() < high_by_m.abs() { low_by_m } else { high_by_m };
        (low_by_m * high_by_m > 0.0).then_some(least_m)
    };
    Vector3::from_fn(|axis, _| along(axis).unwrap_or(0.0))
}

/// From where to where points reach along an axis, but for a few stray ones; none without points.
fn ends(points: &[Point3<f64>], axis: usize) -> Option<[f64; 2]> {
    let mut along: Vec<f64> = points.iter().map(|p| p[axis]).collect();
    along.sort_by(f64::total_cmp);
    let strays = along.len() / 50;
    Some([*along.get(strays)?, *along.iter().nth_back(strays)?])
}

pub(crate) fn apart(was: &Point3<f64>, is: &Point3<f64>) -> Fate {
    let (by_m, lower_m) = ((is - was).norm(), was.z - is.z);
    match by_m {
        _ if lower_m >= FELL_M => Fate::Fell { by_m: lower_m },
        by_m if by_m >= MOVED_M => Fate::Moved { by_m },
        _ => Fate::Stands,
    }
}

pub(crate) fn middle(points: &[Point3<f64>]) -> Option<Point3<f64>> {
    let sum: Vector3<f64> = points.iter().map(|p| p.coords).sum();
    (!points.is_empty()).then(|| Point3::from(sum / points.len() as f64))
}

/// Some of an object's points, spread over its cloud.
pub(crate) fn points_of(scene: &Scene, id: u16) -> Vec<Point3<f64>> {
    let all: Vec<Point3<f64>> = scene.points_of(id).map(|p| Point3::from(p).cast()).collect();
    all.iter().step_by(all.len().div_ceil(POINTS).max(1)).copied().collect()
}
