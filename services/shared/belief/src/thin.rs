//! Thin parts of an object among the points that are left out as stray: a handle often has fewer points than those.
//!
//! The end of a solid does not. Half a percent of the side of a cone is the last fourteenth of its height, half a percent of a square the last
//! twentieth of its diagonal. What reaches out farther with so few points is thin, or stray. Strays are alone; the points of a part follow one
//! another from where the rest of the object ends.

use std::collections::BTreeSet;

use nalgebra::{Point3, Vector3};
use repose_geometry::{Aabb, PointGrid};

use crate::settings::ThinSettings;

/// Which of an object's points are ends of thin parts that reach out of the box around all but the stray ones.
pub fn beyond(points: &[Point3<f32>], around: &Aabb, settings: &ThinSettings) -> BTreeSet<usize> {
    let out_m = |p: &Point3<f32>| (around.min - p).sup(&(p - around.max)).sup(&Vector3::zeros());
    let far_m = (around.extent() * settings.beyond_share).sup(&Vector3::repeat(settings.beyond_m));
    let is_far = |p: &Point3<f32>| {
        let out_m = out_m(p);
        (0..3).any(|k| out_m[k] > far_m[k])
    };
    let outside: Vec<usize> = (0..points.len()).filter(|i| !around.contains(&points[*i])).collect();
    let mut found = BTreeSet::new();
    // Most objects end here.
    if !outside.iter().any(|i| is_far(&points[*i])) {
        return found;
    }
    let grid = PointGrid::new(outside.iter().map(|i| points[*i]).collect(), settings.gap_m);
    let place = |k: &u32| &grid.points()[*k as usize];
    let mut waiting: BTreeSet<u32> = (0..outside.len() as u32).collect();
    while let Some(start) = waiting.pop_first() {
        let mut part = vec![start];
        let mut next = 0;
        while let Some(&k) = part.get(next) {
            next += 1;
            grid.for_each_within(place(&k), settings.gap_m, |beside, _| {
                if waiting.remove(&beside) {
                    part.push(beside);
                }
            });
        }
        let starts_here = part.iter().any(|k| out_m(place(k)).norm() <= settings.start_m);
        part.retain(|k| is_far(place(k)));
        if starts_here && part.len() >= settings.min_points {
            found.extend(part.iter().map(|k| outside[*k as usize]));
        }
    }
    found
}
