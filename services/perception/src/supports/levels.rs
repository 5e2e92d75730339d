//! The levels of a scene: what furniture offers to stand on, each one plane however much of it is covered, and the tops of things.
//!
//! What is seen of a covered table falls into pieces. Pieces of one plane are one level unless the camera looks through the plane between
//! them. A level is furniture when it is large, high over
//! whatever is below it, or hollow beneath; raised a little over another one it is the top of a thing that stands there.

use repose_geometry::{Footprint, Isometry3, Pinhole, Point2, Point3, Vector3};

use crate::readings::noise::DepthNoise;
use crate::readings::point_map::{PointMap, is_reading};
use crate::settings::LevelSettings;
use crate::supports::plane::LevelPlane;
use crate::supports::surfaces::SupportSurface;

/// Of so many readings one is looked at: neighbours say much the same.
const THINNED: usize = 3;
/// Points that a plane is fitted to, at most: more do not make it better.
const FITTED: usize = 2000;
/// Points of the whole picture that tell whether pieces belong together.
const LOOKED_AT: usize = 6000;

/// What a level is to the things of a scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LevelKind {
    /// A table, a board, a drawer's bottom: things stand on it.
    Furniture,
    /// Furniture far below other furniture, as a floor is.
    Floor,
    /// The top of something that stands on furniture.
    Top,
}

/// A level of the scene.
#[derive(Debug, Clone, PartialEq)]
pub struct Level {
    /// Where it is, also where it is covered.
    pub plane: LevelPlane,
    /// The convex outline of all its pieces.
    pub outline: Footprint,
    /// The same, and on to the picture's lower edge where nothing there was seen below it: what stands at the front hides what it stands on.
    pub extent: Footprint,
    /// Area of the cells that hold points of it, square metres.
    pub seen_m2: f32,
    /// What it is.
    pub kind: LevelKind,
}

/// The levels that a scene's level pieces belong to, and the noise of the readings on the largest.
#[derive(Debug, Clone, PartialEq)]
pub struct Levels {
    /// Lowest first.
    pub levels: Vec<Level>,
    /// Noise of single readings.
    pub noise: DepthNoise,
}

impl Levels {
    /// Furniture, floors among it.
    pub fn furniture(&self) -> impl Iterator<Item = &Level> {
        self.levels.iter().filter(|level| level.kind != LevelKind::Top)
    }
}

/// From where a picture was taken.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Viewpoint {
    /// The camera, world frame.
    pub camera: Point3<f32>,
    /// The directions in which the picture's lower corners look, those nearest to the ground however the camera is held, world frame.
    pub lower_corners: [Vector3<f32>; 2],
}

impl Viewpoint {
    /// Of a camera and its pose.
    pub fn new(camera: &Pinhole, world_from_camera: &Isometry3<f64>) -> Self {
        let towards = |[u, v]: [f64; 2]| (world_from_camera * camera.unproject(u, v, 1.0).coords).cast::<f32>();
        let (right, bottom) = (camera.width as f64 - 1.0, camera.height as f64 - 1.0);
        // Of equal ones, as where the camera looks straight down, those of the last row.
        let corners = [[0.0, bottom], [right, bottom], [0.0, 0.0], [right, 0.0]].map(towards);
        let mut lowest = [0, 1, 2, 3];
        lowest.sort_by(|a: &usize, b: &usize| corners[*a].z.total_cmp(&corners[*b].z));
        let [one, other, ..] = lowest;
        let lower_corners = [corners[one.min(other)], corners[one.max(other)]];
        Self { camera: Point3::from(world_from_camera.translation.vector).cast(), lower_corners }
    }

    /// Where the picture's lower corners look at a plane; less than both where one looks past it.
    fn lower_corners_on(&self, plane: &LevelPlane) -> impl Iterator<Item = Point2<f32>> {
        /// Nearer to level than this a ray meets the plane nowhere near, a tangent.
        const LEAST_FALL: f32 = 0.05;
        let above_m = plane.rise_m(&self.camera);
        let plane = *plane;
        let on = move |ray: &Vector3<f32>| {
            let fall = -(ray.z - plane.slope_x * ray.x - plane.slope_y * ray.y);
            (fall > LEAST_FALL && above_m > 0.0).then(|| (self.camera + ray * (above_m / fall)).xy())
        };
        self.lower_corners.iter().filter_map(on)
    }
}

/// Levels from the level `pieces` of a scene, objects not known yet. `in_camera` and `in_world` are the same points.
pub fn find(
    pieces: &[SupportSurface],
    in_camera: &PointMap,
    in_world: &PointMap,
    viewpoint: &Viewpoint,
    settings: &LevelSettings,
) -> Levels {
    let camera_m = viewpoint.camera.z;
    let pixels = in_world.pixels().iter().zip(in_camera.pixels());
    let readings: Vec<Reading> = pixels.filter(|(p, _)| is_reading(p)).map(|(p, seen)| (*p, seen.z)).step_by(THINNED).collect();
    let looked_at: Vec<Point3<f32>> = readings.iter().step_by(readings.len().div_ceil(LOOKED_AT).max(1)).map(|(p, _)| *p).collect();
    let mut noise = DepthNoise { per_m2: settings.usual_noise_per_m2 };
    let mut levels: Vec<Level> = Vec::new();
    let mut by_size: Vec<&SupportSurface> = pieces.iter().collect();
    by_size.sort_by(|a, b| b.seen_m2.total_cmp(&a.seen_m2));
    for (rank, piece) in by_size.into_iter().enumerate() {
        let own = of_piece(piece, &readings);
        let Some(plane) = fitted(&own, piece.height_m, noise, camera_m, settings) else { continue };
        if rank == 0 {
            noise = measured_noise(&own, &plane, camera_m, settings);
        }
        let joins = |level: &&mut Level| continues(level, piece, &plane, &own, &looked_at, noise, &viewpoint.camera, settings);
        match levels.iter_mut().find(joins) {
            Some(level) => {
                level.outline = level.outline.around_both(&piece.outline).unwrap_or_else(|| level.outline.clone());
                level.seen_m2 += piece.seen_m2;
            }
            None => {
                let outline = piece.outline.clone();
                levels.push(Level { plane, extent: outline.clone(), outline, seen_m2: piece.seen_m2, kind: LevelKind::Furniture });
            }
        }
    }
    levels.sort_by(|a, b| a.plane.height_at(&middle(&a.outline)).total_cmp(&b.plane.height_at(&middle(&b.outline))));
    tell_apart(&mut levels, &looked_at, settings);
    for level in &mut levels {
        level.extent = level.outline.clone();
        if level.kind == LevelKind::Furniture {
            extend(level, viewpoint, &looked_at, settings);
        }
    }
    Levels { levels, noise }
}

/// A reading with its depth, metres.
type Reading = (Point3<f32>, f32);

/// The readings around a piece's height over its outline, evenly thinned.
fn of_piece(piece: &SupportSurface, readings: &[Reading]) -> Vec<Reading> {
    /// Twice the slice that made the piece: its plane may tilt.
    const AROUND_M: f32 = 0.025;
    let near: Vec<Reading> = readings.iter().filter(|(p, _)| (p.z - piece.height_m).abs() <= AROUND_M).copied().collect();
    let stride = near.len().div_ceil(FITTED).max(1);
    near.into_iter().step_by(stride).filter(|(p, _)| piece.outline.contains(&p.xy())).collect()
}

/// The plane of a piece: what lies on it within a few standard deviations decides, in rounds.
fn fitted(own: &[Reading], height_m: f32, noise: DepthNoise, camera_m: f32, settings: &LevelSettings) -> Option<LevelPlane> {
    const ROUNDS: usize = 4;
    let mut plane = LevelPlane { height_m, slope_x: 0.0, slope_y: 0.0 };
    for round in 0..ROUNDS {
        let wide = if round == 0 { 2.0 } else { 1.0 };
        let on = |(p, depth_m): &&Reading| {
            let band_m = settings.least_clearance_m + settings.clearance_deviations * noise.height_m(*depth_m, camera_m - p.z);
            plane.rise_m(p).abs() <= wide * band_m
        };
        let points: Vec<Point3<f32>> = own.iter().filter(on).map(|(p, _)| *p).collect();
        plane = LevelPlane::fit(&points, settings.max_slope)?;
    }
    Some(plane)
}

/// The noise of a large level's readings.
fn measured_noise(own: &[Reading], plane: &LevelPlane, camera_m: f32, settings: &LevelSettings) -> DepthNoise {
    let one = DepthNoise { per_m2: 1.0 };
    let shares = own.iter().map(|(p, depth_m)| plane.rise_m(p) / one.height_m(*depth_m, camera_m - p.z).max(0.01)).collect();
    let usual = settings.usual_noise_per_m2;
    let per_m2 = DepthNoise::explaining(shares).map_or(usual, |noise| noise.per_m2);
    DepthNoise { per_m2: per_m2.clamp(0.25 * usual, 3.0 * usual) }
}

/// Whether a piece is more of a level: in its plane, and nothing between the two was seen to be lower.
#[expect(clippy::too_many_arguments, reason = "a private predicate over what `find` holds")]
fn continues(
    level: &Level,
    piece: &SupportSurface,
    plane: &LevelPlane,
    own: &[Reading],
    looked_at: &[Point3<f32>],
    noise: DepthNoise,
    camera: &Point3<f32>,
    settings: &LevelSettings,
) -> bool {
    let at = middle(&piece.outline);
    let off_m = (level.plane.height_at(&at) - plane.height_at(&at)).abs();
    // The plane of a large piece is known well; carried on over a distance, its slope is what errs.
    let depth_m = own.first().map_or(1.0, |(_, depth_m)| *depth_m);
    let tolerance_m = settings.least_clearance_m + settings.clearance_deviations * noise.height_m(depth_m, camera.z - plane.height_at(&at));
    if off_m > tolerance_m {
        return false;
    }
    let Some(both) = level.outline.around_both(&piece.outline) else { return false };
    let between = |at: &Point2<f32>| !level.outline.contains(at) && !piece.outline.contains(at) && both.margin(at) > 0.0;
    !is_seen_through(&level.plane, camera, looked_at, between, settings)
}

/// Takes a level on to the picture's lower edge and from there to under the camera (what stands there is seen where it is high), unless
/// something there was seen below it.
fn extend(level: &mut Level, viewpoint: &Viewpoint, looked_at: &[Point3<f32>], settings: &LevelSettings) {
    for corner in viewpoint.lower_corners_on(&level.plane).chain([viewpoint.camera.xy()]) {
        let Some(wider) = Footprint::of_places(level.extent.corners().iter().copied().chain([corner])) else { continue };
        let added = |at: &Point2<f32>| !level.extent.contains(at) && wider.margin(at) > 0.0;
        if !is_seen_through(&level.plane, &viewpoint.camera, looked_at, added, settings) {
            level.extent = wider;
        }
    }
}

/// Whether the camera looks through a plane in some region of it: more than a few of what it sees there lies below.
fn is_seen_through(
    plane: &LevelPlane,
    camera: &Point3<f32>,
    looked_at: &[Point3<f32>],
    region: impl Fn(&Point2<f32>) -> bool,
    settings: &LevelSettings,
) -> bool {
    let above_m = plane.rise_m(camera);
    let (mut below, mut all) = (0usize, 0usize);
    for p in looked_at {
        let rise_m = plane.rise_m(p);
        let is_below = rise_m < -settings.seen_below_m;
        // What lies below was seen through the plane where the line of sight crosses it.
        let at = if is_below { (camera + (p - camera) * (above_m / (above_m - rise_m))).xy() } else { p.xy() };
        if region(&at) {
            all += 1;
            below += usize::from(is_below);
        }
    }
    below as f32 > settings.max_below_share * all as f32
}

/// The mean of an outline's corners.
fn middle(outline: &Footprint) -> Point2<f32> {
    let sum = outline.corners().iter().fold(nalgebra::Vector2::zeros(), |sum, c| sum + c.coords);
    Point2::from(sum / outline.corners().len().max(1) as f32)
}

/// Says of each level, from the lowest up, what it is.
fn tell_apart(levels: &mut [Level], looked_at: &[Point3<f32>], settings: &LevelSettings) {
    for k in 0..levels.len() {
        let (lower, rest) = levels.split_at_mut(k);
        let Some(level) = rest.first_mut() else { break };
        let at = middle(&level.outline);
        let height_m = level.plane.height_at(&at);
        let carries = |below: &&Level| below.kind != LevelKind::Top && below.outline.margin(&at) > -settings.rim_m;
        let raised_m = lower.iter().filter(carries).map(|below| height_m - below.plane.height_at(&at)).fold(f32::INFINITY, f32::min);
        let hollow = || {
            let beneath =
                |p: &&Point3<f32>| level.plane.rise_m(p) < -settings.hollow_m && level.outline.margin(&p.xy()) > settings.hollow_m / 2.0;
            looked_at.iter().filter(beneath).count() >= settings.hollow_readings
        };
        let area_m2 = level.outline.area();
        let large = area_m2 >= settings.large_m2 || diameter_m(&level.outline) >= settings.large_m;
        let is_board = area_m2 >= settings.large_m2 / 2.0 && raised_m >= settings.lowest_board_m && hollow();
        let is_top = raised_m <= settings.highest_top_m && !large && !is_board;
        level.kind = if is_top { LevelKind::Top } else { LevelKind::Furniture };
    }
    let heights: Vec<f32> = levels.iter().filter(|l| l.kind != LevelKind::Top).map(|l| l.plane.height_at(&middle(&l.outline))).collect();
    let highest_m = heights.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    for level in levels.iter_mut().filter(|level| level.kind == LevelKind::Furniture) {
        let far_below = level.plane.height_at(&middle(&level.outline)) < highest_m - settings.floor_below_m;
        if far_below {
            level.kind = LevelKind::Floor;
        }
    }
}

/// The greatest distance between two corners, metres.
fn diameter_m(outline: &Footprint) -> f32 {
    let corners = outline.corners();
    corners.iter().flat_map(|a| corners.iter().map(move |b| (a - b).norm())).fold(0.0, f32::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::readings::point_map::transformed;
    use crate::readings::upward::upward_facing;
    use crate::settings::Settings;
    use crate::supports::surfaces;
    use crate::synthetic::{Solid, render};
    use repose_geometry::UnitQuaternion;
    use repose_geometry::transform::look_at;

    const CAMERA: Pinhole = Pinhole { width: 320, height: 240, fx: 262.0, fy: 262.0, cx: 159.5, cy: 119.5 };

    /// The levels of solids seen from in front and above: kind, height and how far a place lies inside the extent.
    fn levels_of(solids: &[Solid]) -> Vec<Level> {
        let world_from_camera = look_at(&Point3::new(0.0, -0.9, 0.8), &Point3::new(0.0, 0.1, 0.0), &Vector3::z());
        let in_camera = render(solids, &CAMERA, &world_from_camera);
        let in_world = transformed(&in_camera, &world_from_camera);
        let settings = Settings::default();
        let faces_up = upward_facing(&in_world, &in_camera.map(|p| p.z), 262.0, settings.surfaces.max_tilt_rad);
        let facing = in_world.pixels().iter().zip(faces_up.pixels()).filter(|(_, up)| **up).map(|(p, _)| (*p, 0));
        let pieces = surfaces::find(facing, &settings.surfaces, settings.levels.max_slope);
        find(&pieces, &in_camera, &in_world, &Viewpoint::new(&CAMERA, &world_from_camera), &settings.levels).levels
    }

    fn kinds(solids: &[Solid]) -> Vec<(LevelKind, i32)> {
        levels_of(solids).iter().map(|l| (l.kind, (l.plane.height_at(&middle(&l.outline)) * 100.0).round() as i32)).collect()
    }

    #[test]
    fn the_lower_corners_are_those_nearest_to_the_ground_however_the_camera_is_held() {
        let upright = look_at(&Point3::new(0.0, -0.9, 0.8), &Point3::new(0.0, 0.1, 0.0), &Vector3::z());
        let ahead = upright * Vector3::z();
        let corners = |roll_rad: f64| {
            let held = upright * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll_rad);
            Viewpoint::new(&CAMERA, &held).lower_corners
        };
        for roll_rad in [0.0, 1.2, 2.8, 4.5] {
            assert!(corners(roll_rad).iter().all(|corner| f64::from(corner.z) < ahead.z - 0.1), "{roll_rad}: {:?}", corners(roll_rad));
        }
        let [left, right] = corners(0.0);
        assert!(left.x < 0.0 && right.x > 0.0, "in the order of the picture");
    }

    #[test]
    fn a_table_that_a_row_of_things_cuts_in_two_is_one_level() {
        let table = Solid::cuboid([0.0, 0.1, -0.02], [0.45, 0.5, 0.02]);
        let row = Solid::cuboid([0.0, 0.1, 0.08], [0.46, 0.04, 0.08]);
        let found = levels_of(&[table, row]);
        let furniture: Vec<_> = found.iter().filter(|level| level.plane.height_m.abs() < 0.02).collect();
        assert!(furniture.len() == 1 && furniture[0].kind == LevelKind::Furniture, "{found:?}");
        for y in [-0.2, 0.1, 0.35] {
            assert!(furniture[0].outline.margin(&Point2::new(0.0, y)) > 0.05, "{y}");
        }
    }

    #[test]
    fn two_tables_with_the_floor_seen_between_them_stay_two() {
        let table = |x: f64| Solid::cuboid([x, 0.1, -0.02], [0.2, 0.3, 0.02]);
        let found = kinds(&[table(-0.35), table(0.35), Solid::table(-0.7)]);
        assert_eq!(found, [(LevelKind::Floor, -70), (LevelKind::Furniture, 0), (LevelKind::Furniture, 0)]);
    }

    #[test]
    fn a_thick_book_is_a_top_and_a_board_over_the_table_is_furniture() {
        let book = Solid::cuboid([-0.2, -0.1, 0.02], [0.12, 0.09, 0.02]);
        let board = Solid::cuboid([0.1, 0.45, 0.25], [0.4, 0.14, 0.01]);
        let found = kinds(&[Solid::table(0.0), book, board]);
        assert_eq!(found, [(LevelKind::Furniture, 0), (LevelKind::Top, 4), (LevelKind::Furniture, 26)]);
    }

    #[test]
    fn a_table_goes_on_under_what_stands_at_its_front_unless_the_floor_shows_there() {
        let front = Solid::cuboid([0.0, -0.42, 0.03], [0.6, 0.12, 0.03]);
        let place = Point2::new(0.0, -0.45);
        let covered = levels_of(&[Solid::table(0.0), front]);
        let table = covered.iter().find(|level| level.kind == LevelKind::Furniture).unwrap();
        assert!(table.extent.margin(&place) > 0.0 && table.outline.margin(&place) < 0.0, "{table:?}");
        let ends = levels_of(&[Solid::cuboid([0.0, 0.3, -0.02], [0.5, 0.5, 0.02]), Solid::table(-0.7)]);
        let table = ends.iter().find(|level| level.kind == LevelKind::Furniture).unwrap();
        assert!(table.extent.margin(&place) < 0.0, "{table:?}");
    }
}
