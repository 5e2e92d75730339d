//! The two ends of an object that another one covers in the middle, joined.
//!
//! Along a row or column of the picture the one end, what covers it and the other end follow each other. Where the surfaces on both
//! sides lie on one line in space, as they do for one object and seldom for two, the line votes for joining them. Ends of different
//! height stay apart.

use std::collections::BTreeMap;

use repose_geometry::{Image, Point3};

use crate::objects::hollows::rims;
use crate::readings::point_map::PointMap;
use crate::settings::HalvesSettings;

/// Pairs of components that continue each other behind a third one.
pub fn find(labels: &Image<u16>, in_camera: &PointMap, in_world: &PointMap, settings: &HalvesSettings) -> Vec<(u16, u16)> {
    let (width, height) = (labels.width(), labels.height());
    let mut votes = Votes::default();
    for v in 0..height {
        count_line(labels.pixels(), in_camera.pixels(), (0..width).map(|u| v * width + u), settings, &mut votes);
    }
    for u in 0..width {
        count_line(labels.pixels(), in_camera.pixels(), (0..height).map(|v| v * width + u), settings, &mut votes);
    }
    let most = labels.pixels().iter().copied().max().unwrap_or(0);
    let rims_m = rims(labels, in_world, usize::from(most) + 1);
    let continues = |((low, high), tally): ((u16, u16), Tally)| {
        let level = (rims_m[usize::from(low)] - rims_m[usize::from(high)]).abs() <= settings.rim_tolerance_m;
        let agree = tally.lines >= settings.min_lines && tally.agree as f64 >= settings.min_agreement * tally.lines as f64;
        (level && agree).then_some((low, high))
    };
    votes.0.into_iter().filter_map(continues).collect()
}

/// How many lines see a pair of ids on both sides of a third, and on how many the two continue each other.
#[derive(Debug, Clone, Copy, Default)]
struct Tally {
    lines: usize,
    agree: usize,
}

/// By (lower id, higher id).
#[derive(Debug, Default)]
struct Votes(BTreeMap<(u16, u16), Tally>);

/// A stretch of one id along a line of the picture, as indices of pixels.
#[derive(Debug, Clone, Copy)]
struct Run {
    id: u16,
    /// Positions along the line.
    from: usize,
    to: usize,
}

/// Adds what one row or column says.
fn count_line(ids: &[u16], points: &[Point3<f32>], line: impl Iterator<Item = usize>, settings: &HalvesSettings, votes: &mut Votes) {
    let line: Vec<usize> = line.collect();
    let mut runs: Vec<Run> = Vec::new();
    for (at, &i) in line.iter().enumerate().filter(|(_, i)| ids[**i] != 0) {
        match runs.last_mut() {
            Some(run) if run.id == ids[i] && at <= run.to + 2 => run.to = at,
            _ => runs.push(Run { id: ids[i], from: at, to: at }),
        }
    }
    for triple in runs.windows(3) {
        let [one, cover, other] = [triple[0], triple[1], triple[2]];
        let apart = cover.from - one.to <= settings.max_shadow_px && other.from - cover.to <= settings.max_shadow_px;
        // Three pixels at least: the one at the edge is skipped below.
        let long = |run: &Run| run.to - run.from + 1 >= settings.min_run_px.max(3);
        if one.id == other.id || one.id == cover.id || other.id == cover.id || !apart || !long(&one) || !long(&other) {
            continue;
        }
        let point = |at: usize| &points[line[at]];
        let in_front = point(cover.from).z + settings.cover_step_m < point(one.to).z
            && point(cover.to).z + settings.cover_step_m < point(other.from).z;
        if !in_front {
            continue;
        }
        // The pixel at the very edge is the least reliable: start one further in.
        let (near, far) = (one.to - 1, one.to.saturating_sub(settings.arm_px).max(one.from));
        let (other_near, other_far) = (other.from + 1, (other.from + settings.arm_px).min(other.to));
        let tolerance_m = settings.tolerance_m + settings.noise_per_m2 * point(near).z * point(near).z;
        let (start, end) = (point(far), point(other_far));
        let agrees = [near, other_near].into_iter().all(|at| distance_to_line(point(at), start, end) <= tolerance_m);
        let tally = votes.0.entry((one.id.min(other.id), one.id.max(other.id))).or_default();
        tally.lines += 1;
        tally.agree += usize::from(agrees);
    }
}

/// Distance of a point from the line through two others; infinite when those coincide or one is missing.
fn distance_to_line(p: &Point3<f32>, a: &Point3<f32>, b: &Point3<f32>) -> f32 {
    let along = b - a;
    let distance = along.cross(&(p - a)).norm() / along.norm();
    if distance.is_nan() { f32::INFINITY } else { distance }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::objects::components;
    use crate::objects::parts::Parts;
    use crate::readings::point_map::transformed;
    use crate::settings::ComponentSettings;
    use crate::synthetic::{Solid, cast, render};
    use repose_geometry::transform::look_at;
    use repose_geometry::{Pinhole, Vector3};

    const CAMERA: Pinhole = Pinhole { width: 320, height: 240, fx: 262.0, fy: 262.0, cx: 159.5, cy: 119.5 };

    /// How many objects there are before and after joining.
    fn counts(solids: &[Solid]) -> (usize, usize) {
        let world_from_camera = look_at(&Point3::new(0.0, -0.7, 0.4), &Point3::new(0.0, 0.0, 0.05), &Vector3::z());
        let in_camera = render(solids, &CAMERA, &world_from_camera);
        let foreground = cast(solids, &CAMERA, &world_from_camera).map(|s| s.is_some_and(|(_, solid)| solid > 0));
        let labels = components::find(&in_camera, &foreground, 262.0, &ComponentSettings::default(), &|_, _| false);
        let distinct =
            |labels: &Image<u16>| labels.pixels().iter().copied().filter(|id| *id != 0).collect::<std::collections::BTreeSet<u16>>().len();
        let before = distinct(&labels);
        let together = find(&labels, &in_camera, &transformed(&in_camera, &world_from_camera), &HalvesSettings::default());
        (before, distinct(&Parts { ids: labels, together: Vec::new() }.joined(&together)))
    }

    fn behind_a_pillar(left: Solid, right: Solid) -> [Solid; 4] {
        [Solid::table(0.0), Solid::cuboid([0.0, -0.2, 0.1], [0.03, 0.03, 0.1]), left, right]
    }

    #[test]
    fn a_bar_behind_a_pillar_is_one() {
        let half = |x: f64| Solid::cuboid([x, 0.05, 0.03], [0.075, 0.03, 0.03]);
        assert_eq!(counts(&behind_a_pillar(half(-0.075), half(0.075))), (3, 2));
    }

    #[test]
    fn boxes_of_different_height_or_place_behind_a_pillar_stay_two() {
        let one = Solid::cuboid([-0.09, 0.05, 0.03], [0.06, 0.03, 0.03]);
        for other in [Solid::cuboid([0.09, 0.05, 0.06], [0.06, 0.03, 0.06]), Solid::cuboid([0.09, 0.11, 0.03], [0.06, 0.03, 0.03])] {
            assert_eq!(counts(&behind_a_pillar(one, other)), (3, 3));
        }
    }
}
