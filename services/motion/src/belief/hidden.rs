//! What is not seen of an object: its middle, its far side, and how it goes on down to what it stands on.
//!
//! One camera sees the near half. Most things that people set down look alike from opposite sides, so the far half is taken to be what was seen,
//! turned by half a turn about the vertical through the middle: right for boxes, cans and bowls, and within the same bounds for anything else.
//! What hides the lower part of a thing does not end it there: its outline goes straight down to its foot. Neither is believed where the
//! camera saw past the place: [`Sight`] carves the guess.

use nalgebra::{Point3, Vector3};
use repose_geometry::{Aabb, Footprint, cloud};

use crate::belief::sight::Sight;
use crate::scene::{PlanningScene, SupportSurface};

/// Where the middle of what was seen within `bounds` is taken to be: `hidden_m` further from the camera, on the level.
pub fn middle(bounds: &Aabb, camera_in_world: &Point3<f64>, hidden_m: f64) -> Point3<f64> {
    let seen = bounds.center().cast::<f64>();
    let away = seen - camera_in_world;
    seen + Vector3::new(away.x, away.y, 0.0).try_normalize(1e-9).unwrap_or_else(Vector3::zeros) * hidden_m
}

/// The points' likenesses on the far side of the vertical through `middle`.
pub fn far_side(points: &[Point3<f32>], middle: &Point3<f64>) -> Vec<Point3<f32>> {
    let [x, y] = [2.0 * middle.x as f32, 2.0 * middle.y as f32];
    points.iter().map(|p| Point3::new(x - p.x, y - p.y, p.z)).collect()
}

/// Guesses the hidden parts of a scene's objects.
#[derive(Debug, Clone, Copy)]
pub struct Guess<'a> {
    /// The scene.
    pub scene: &'a PlanningScene,
    /// What was seen to be free.
    pub sight: &'a Sight,
    /// How far an object's middle is taken to lie behind the middle of what was seen of it, metres.
    pub hidden_m: f64,
    /// Spacing of the points that stand for an object, metres.
    pub spacing_m: f32,
    /// How much of an object is missing at each border of what was seen of it, as borders are cleaned away: its rim is moved out by as
    /// much, metres.
    pub border_m: f32,
}

/// An object's lowest seen points may be this far above what it stands on, for its borders are cleaned away, metres.
const TRIMMED_M: f32 = 0.015;
/// Lowest points: those within this of the lowest, metres.
const LOW_M: f32 = 0.015;
/// Share of the lowest points that are taken for stray ones.
const STRAY_SHARE: f64 = 0.02;
/// Width of the strip around an object in which what it stands on shows, metres.
const STRIP_M: f32 = 0.03;
/// Points of the strip within [`LEVEL_M`] of each other that make a level: so many, or this share of all, whichever is more.
const LEVEL_POINTS: (usize, f32) = (12, 0.1);
const LEVEL_M: f32 = 0.012;
/// Share of the places under an object, all the way down to a level, that may be seen to be free.
const SEEN_FREE: f64 = 0.3;
/// Depth inside an object's silhouette at which the places under it are tried, metres.
const INSIDE_M: f32 = 0.01;
/// Places that are tried along the object.
const TRIED: usize = 24;
/// Step downwards, metres.
const STEP_M: f32 = 0.01;

impl Guess<'_> {
    /// An object as a whole: what was seen of `points` (its own, world frame) and what is believed to be there too, about `spacing_m` apart.
    pub fn whole(&self, id: u16, points: &[Point3<f32>]) -> Vec<Point3<f32>> {
        let seen = cloud::voxel_downsampled(points, self.spacing_m);
        let Some(bounds) = Aabb::of(&seen) else { return seen };
        let middle = middle(&bounds, &self.scene.camera_in_world, self.hidden_m);
        let hidden = far_side(&seen, &middle).into_iter().filter(|p| !self.is_free(p));
        let mut whole: Vec<Point3<f32>> = seen.iter().copied().chain(hidden).collect();
        if let (Some(outline), Some(foot_m)) = (Footprint::of(&whole), self.foot_m(id, points)) {
            let rim = whole.iter().filter(|p| outline.margin(&p.xy()) < self.spacing_m);
            let outwards = |p: &Point3<f32>| {
                let away = (p.xy() - middle.xy().cast::<f32>()).try_normalize(1e-6).unwrap_or_default() * self.border_m;
                Point3::new(p.x + away.x, p.y + away.y, p.z)
            };
            let rim: Vec<Point3<f32>> = rim.map(outwards).collect();
            for place in rim {
                whole.push(place);
                let steps = ((place.z - foot_m) / self.spacing_m) as usize;
                let below = (1..=steps).map(|k| Point3::new(place.x, place.y, place.z - k as f32 * self.spacing_m));
                whole.extend(below.take_while(|p| !self.is_free(p)));
            }
        }
        cloud::voxel_downsampled(&whole, self.spacing_m)
    }

    fn is_free(&self, place: &Point3<f32>) -> bool {
        self.sight.is_free(&place.cast())
    }

    /// The height down to which an object is believed to reach, world z, metres; `None` without points.
    ///
    /// That of what shows around it or under it. Where that is far below its lowest seen point (something hides its foot, or what it
    /// stands on is itself hidden by it) it is believed unless the camera saw past the object's place there.
    pub fn foot_m(&self, id: u16, points: &[Point3<f32>]) -> Option<f32> {
        let lowest_m = cloud::percentile_box(points, STRAY_SHARE, 1.0)?.min.z;
        let level_m = self.level_under(id, points, lowest_m);
        if !level_m.is_finite() || lowest_m - level_m <= TRIMMED_M || !self.looked_under(points, lowest_m, level_m) {
            return Some(if level_m.is_finite() { level_m } else { lowest_m });
        }
        Some(lowest_m - TRIMMED_M)
    }

    /// The highest level up to the lowest seen point that something else shows under the object or around it; −∞ when nothing does.
    fn level_under(&self, id: u16, points: &[Point3<f32>], lowest_m: f32) -> f32 {
        let Some(outline) = Footprint::of(points) else { return f32::NEG_INFINITY };
        let middle = cloud::centroid(points).unwrap_or_else(Point3::origin);
        let below_m = f64::from(lowest_m + LEVEL_M);
        let surface_m = self.scene.support_below(middle.x, middle.y, below_m, id).map_or(f32::NEG_INFINITY, |m| m as f32);
        // What is nearer to the camera than the object may hide its foot, and carries nothing.
        let camera = self.scene.camera_in_world.xy().cast::<f32>();
        let Some(away) = (middle.xy().cast::<f32>() - camera).try_normalize(1e-3) else { return surface_m };
        let depth = |p: &Point3<f32>| (p.xy() - camera).dot(&away);
        let front_m = points.iter().map(depth).fold(f32::INFINITY, f32::min);
        // Nearly all of a scene is elsewhere, which is cheap to see.
        let corners = || outline.corners().iter();
        let low = corners().fold(outline.corners()[0], |low, c| low.inf(c)).map(|v| v - STRIP_M);
        let high = corners().fold(outline.corners()[0], |high, c| high.sup(c)).map(|v| v + STRIP_M);
        let is_near = |p: &Point3<f32>| p.x >= low.x && p.y >= low.y && p.x <= high.x && p.y <= high.y;
        let labelled = self.scene.points.iter().zip(&self.scene.labels);
        let around = labelled.filter(|(p, label)| {
            let reach_m = if **label == 0 { STRIP_M } else { 0.0 };
            **label != id && p.z < lowest_m + LEVEL_M && is_near(p) && depth(p) > front_m && outline.margin(&p.xy()) > -reach_m
        });
        let mut heights: Vec<f32> = around.map(|(p, _)| p.z).collect();
        heights.sort_by(|a, b| b.total_cmp(a));
        let needed = LEVEL_POINTS.0.max((LEVEL_POINTS.1 * heights.len() as f32) as usize);
        let shared = heights.windows(needed).find(|w| w[0] - w[needed - 1] <= LEVEL_M);
        surface_m.max(shared.map_or(f32::NEG_INFINITY, |w| w[needed / 2]))
    }

    /// Whether the camera saw past the places where the object would be if it went on from its lowest seen points down to a level.
    fn looked_under(&self, points: &[Point3<f32>], lowest_m: f32, level_m: f32) -> bool {
        let camera = self.scene.camera_in_world.xy().cast::<f32>();
        let low: Vec<&Point3<f32>> = points.iter().filter(|p| p.z <= lowest_m + LOW_M).collect();
        let (mut tried, mut free) = (0usize, 0usize);
        for p in low.iter().step_by(low.len().div_ceil(TRIED).max(1)) {
            let away = (p.xy() - camera).try_normalize(1e-3).unwrap_or_default();
            let inside = p.xy() + away * INSIDE_M;
            for k in 1..((lowest_m - level_m) / STEP_M) as usize {
                tried += 1;
                free += usize::from(self.is_free(&Point3::new(inside.x, inside.y, lowest_m - k as f32 * STEP_M)));
            }
        }
        free as f64 > SEEN_FREE * tried as f64
    }

    /// How deep a surface of the furniture is solid, as far as the camera did not look under it; `None` for the lowest there.
    ///
    /// A box on a table shows its top and its near sides only; a shelf's board shows what is under it.
    pub fn solid_m(&self, surface: &SupportSurface) -> Option<f64> {
        let bounds = Aabb::of(&surface.footprint.corners().iter().map(|c| Point3::new(c.x, c.y, 0.0)).collect::<Vec<_>>())?;
        let middle = bounds.center();
        let lower_m = self.scene.support_below(f64::from(middle.x), f64::from(middle.y), surface.height_m - f64::from(TRIMMED_M), 0)?;
        let at = |k: usize, low: f32, high: f32| low + (high - low) * (k as f32 + 0.5) / SIDE as f32;
        let places: Vec<(f32, f32)> = (0..SIDE * SIDE)
            .map(|k| (at(k % SIDE, bounds.min.x, bounds.max.x), at(k / SIDE, bounds.min.y, bounds.max.y)))
            .filter(|(x, y)| surface.footprint.margin(&nalgebra::Point2::new(*x, *y)) > INSIDE_M)
            .collect();
        let seen_free = |height_m: f64| places.iter().filter(|(x, y)| self.is_free(&Point3::new(*x, *y, height_m as f32))).count();
        let steps = ((surface.height_m - lower_m) / f64::from(STEP_M)) as usize;
        let looked = (2..steps).find(|k| seen_free(surface.height_m - *k as f64 * f64::from(STEP_M)) * 10 > places.len());
        Some(looked.map_or(surface.height_m - lower_m, |k| (k - 1) as f64 * f64::from(STEP_M)))
    }
}

/// Places along each side of a surface that are tried.
const SIDE: usize = 6;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic;
    use nalgebra::Point2;

    const SPACING_M: f32 = 0.008;

    fn scene(objects: &[(u16, Vec<Point3<f32>>)]) -> PlanningScene {
        let points = synthetic::table_points();
        let labels = vec![0; points.len()];
        let mut scene = PlanningScene { points, labels, surfaces: vec![synthetic::table()], camera_in_world: synthetic::CAMERA };
        for (label, points) in objects {
            scene.labels.extend(std::iter::repeat_n(*label, points.len()));
            scene.points.extend(points);
        }
        scene
    }

    fn whole(scene: &PlanningScene, id: u16) -> Vec<Point3<f32>> {
        let sight = Sight::new(&scene.camera_in_world, &scene.points);
        Guess { scene, sight: &sight, hidden_m: 0.0, spacing_m: SPACING_M, border_m: 0.0 }.whole(id, &scene.points_of(id))
    }

    fn has(cloud: &[Point3<f32>], at: [f64; 3]) -> bool {
        cloud.iter().any(|p| (p - Point3::from(at).cast::<f32>()).norm() < 0.012)
    }

    #[test]
    fn the_far_side_of_a_box_is_where_it_was_not_seen() {
        let points = synthetic::seen_box([0.5, 0.1], [0.12, 0.05, 0.10], 0.4);
        let whole = whole(&scene(&[(1, points.clone())]), 1);
        // The middles of the four upright faces of a box of that size, turned by 0.4 rad.
        let (sin, cos) = 0.4f64.sin_cos();
        for (u, v) in [(0.06, 0.0), (-0.06, 0.0), (0.0, 0.025), (0.0, -0.025)] {
            let face = [0.5 + cos * u - sin * v, 0.1 + sin * u + cos * v, 0.05];
            assert!(has(&whole, face), "face at {u}, {v}; seen {}", has(&points, face));
        }
    }

    #[test]
    fn a_foot_behind_something_reaches_the_table_and_one_on_a_box_does_not() {
        // A tall box of which a wide one in front hides the lower half; and one on top of the wide one, which furniture is (label 0).
        let front = synthetic::seen_box([0.6, 0.0], [0.16, 0.3, 0.12], 0.0);
        let mut behind = synthetic::seen_box([0.46, 0.0], [0.05, 0.14, 0.2], 0.0);
        behind.retain(|p| p.z > 0.09);
        let on_top: Vec<Point3<f32>> =
            synthetic::seen_box([0.62, 0.08], [0.06, 0.06, 0.1], 0.0).into_iter().map(|p| p + Vector3::z() * 0.12).collect();
        let scene = scene(&[(0, front), (1, behind), (2, on_top)]);
        let sight = Sight::new(&scene.camera_in_world, &scene.points);
        let guess = Guess { scene: &scene, sight: &sight, hidden_m: 0.0, spacing_m: SPACING_M, border_m: 0.0 };
        let foot_m = |id: u16| guess.foot_m(id, &scene.points_of(id)).expect("points");
        assert!(foot_m(1).abs() < 0.002, "{}", foot_m(1));
        assert!((foot_m(2) - 0.12).abs() < 0.005, "{}", foot_m(2));
        assert!(has(&whole(&scene, 1), [0.435, 0.0, 0.03]), "its hidden foot is there");
        assert!(whole(&scene, 2).iter().all(|p| p.z > 0.11));
    }

    #[test]
    fn nothing_is_believed_where_the_camera_saw_past() {
        // A plate on a thin post, both seen: under the plate is nothing.
        let mut table = synthetic::seen_box([0.5, 0.0], [0.03, 0.03, 0.15], 0.0);
        table.extend(synthetic::seen_box([0.5, 0.0], [0.14, 0.14, 0.16], 0.0).into_iter().filter(|p| p.z > 0.148));
        let whole = whole(&scene(&[(1, table)]), 1);
        assert!(!has(&whole, [0.565, 0.065, 0.06]) && !has(&whole, [0.565, -0.065, 0.06]), "under the near corners");
        assert!(has(&whole, [0.5, 0.0, 0.16]));
    }

    #[test]
    fn a_box_is_solid_to_the_table_and_a_board_is_not() {
        let outline = [[0.45, -0.15], [0.65, -0.15], [0.65, 0.15], [0.45, 0.15]].map(Point2::from);
        let top = SupportSurface::new(0.2, &outline, None).expect("an area");
        let solid_m = |points: Vec<Point3<f32>>| {
            let mut scene = scene(&[(0, points)]);
            scene.surfaces.push(top.clone());
            let sight = Sight::new(&scene.camera_in_world, &scene.points);
            let guess = Guess { scene: &scene, sight: &sight, hidden_m: 0.0, spacing_m: SPACING_M, border_m: 0.0 };
            (guess.solid_m(&scene.surfaces[0]), guess.solid_m(&scene.surfaces[1]))
        };
        let whole = synthetic::seen_box([0.55, 0.0], [0.2, 0.3, 0.2], 0.0);
        let (table, solid) = solid_m(whole.clone());
        assert!(table.is_none() && (solid.expect("there is a table under it") - 0.2).abs() < 0.01, "{solid:?}");
        let board = whole.into_iter().filter(|p| p.z > 0.18).collect();
        let (_, solid) = solid_m(board);
        assert!(solid.expect("there is a table under it") < 0.12, "{solid:?}");
    }
}
