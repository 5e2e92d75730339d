//! Where the camera did not see: behind and inside objects, behind missing readings, and outside the picture.
//!
//! A missing return, a flying pixel and an object's shadow on the table all say the same: nobody looked there. A cube counts as seen when
//! the camera's reading in its direction lies at least as far as the cube itself, so that a ray went through it or ended in it. Everything
//! else above the furniture is unseen, which is neither free nor solid. What is too far away for the scene was seen all the same.

use repose_geometry::{Image, Isometry3, Pinhole, Point3};
use repose_proto::{Frame, UnseenSpace};

use crate::settings::UnseenSettings;
use crate::supports::surfaces::SupportSurface;

/// How far above the highest furniture the cubes reach at least, where they must grow to reach it at all, metres: things stand on it.
const HEADROOM_M: f64 = 0.3;

/// Things are stood on furniture that is no farther below the largest than this, metres: a step, a tray, a lower board. A floor is farther.
const BELOW_M: f32 = 0.35;

/// Farther than this no depth camera measures, whatever it says, metres.
const FARTHEST_M: f32 = 20.0;

/// How far a frame's camera saw in each pixel of the coarse picture, one of `stride` columns and rows: `depth_m`, NaN where there is no reading,
/// and without end where it read something beyond `max_depth_m`, and all around as well.
pub fn sight_m(depth_m: &Image<f32>, stride: usize, frame: &Frame, max_depth_m: f32) -> Image<f32> {
    let (width, height, unit_m) = (frame.camera.width, frame.camera.height, frame.camera.depth_unit_m as f32);
    let is_far = |u: usize, v: usize| {
        let count = frame.depth[v * width + u];
        let reading_m = f32::from(count) * unit_m;
        Frame::is_reading(count) && reading_m > max_depth_m && reading_m <= FARTHEST_M
    };
    let columns = depth_m.width();
    let mut sight_m = depth_m.clone();
    for (i, z) in sight_m.pixels_mut().iter_mut().enumerate().filter(|(_, z)| z.is_nan()) {
        let (u, v) = (i % columns * stride, i / columns * stride);
        let is_within = u > 0 && v > 0 && u + 1 < width && v + 1 < height;
        if is_within && [(u, v), (u - 1, v), (u + 1, v), (u, v - 1), (u, v + 1)].into_iter().all(|(u, v)| is_far(u, v)) {
            *z = f32::INFINITY;
        }
    }
    sight_m
}

/// The depth picture that rays are followed in.
pub struct RayView<'a> {
    /// Depth, NaN where there is no reading, infinite beyond what is told.
    pub depth_m: &'a Image<f32>,
    /// The camera of that (coarse) picture.
    pub camera: Pinhole,
    /// Its pose.
    pub world_from_camera: &'a Isometry3<f64>,
}

/// The cubes above the furniture among `surfaces` that were not seen; `None` without furniture.
///
/// The grid spans the furniture's outlines and rises from the largest one, which may be a floor, or what is a little lower, past the highest.
pub fn space(view: &RayView<'_>, surfaces: &[SupportSurface], settings: &UnseenSettings) -> Option<UnseenSpace> {
    let furniture = || surfaces.iter().filter(|s| s.object.is_none());
    let main = furniture().max_by(|a, b| a.seen_m2.total_cmp(&b.seen_m2))?;
    let corners = || furniture().flat_map(|s| s.outline.corners());
    // To the micrometre, as everything that a scene's id is made of.
    let micro = |value: f64| (value * 1e6).round() / 1e6 + 0.0;
    let low = corners().fold([f32::INFINITY; 2], |low, c| [low[0].min(c.x), low[1].min(c.y)]).map(|m| micro(f64::from(m)));
    let high = corners().fold([f32::NEG_INFINITY; 2], |high, c| [high[0].max(c.x), high[1].max(c.y)]).map(|m| micro(f64::from(m)));
    let longest_m = (high[0] - low[0]).max(high[1] - low[1]);
    let wide_m = settings.cell_m.max(longest_m / UnseenSpace::MAX_SIDE as f64);
    let heights = || furniture().map(|s| s.height_m);
    let lowest_m = heights().filter(|height_m| *height_m >= main.height_m - BELOW_M).fold(main.height_m, f32::min);
    let rise_m = f64::from(heights().fold(main.height_m, f32::max) - lowest_m);
    let levels = UnseenSpace::LEVELS as f64;
    let high_m = if rise_m < levels * wide_m { wide_m } else { (rise_m + HEADROOM_M) / levels };
    let cell_m = micro(high_m).max(1e-6);
    let side = |k: usize| (((high[k] - low[k]) / cell_m - 1e-3).ceil() as usize).clamp(1, UnseenSpace::MAX_SIDE);
    let (columns, rows) = (side(0), side(1));
    let origin_m = [low[0], low[1], micro(f64::from(lowest_m))];

    let camera_from_world = view.world_from_camera.inverse();
    let to_camera = |x: f64, y: f64, z: f64| (camera_from_world * Point3::new(x, y, z)).cast::<f32>();
    let up = (camera_from_world.rotation * repose_geometry::Vector3::new(0.0, 0.0, cell_m)).cast::<f32>();
    let rays = Rays::new(view, cell_m as f32);
    let half = cell_m / 2.0;
    let mut hidden = Vec::with_capacity(columns * rows);
    for row in 0..rows {
        for column in 0..columns {
            let (x, y) = (origin_m[0] + column as f64 * cell_m + half, origin_m[1] + row as f64 * cell_m + half);
            let mut center = to_camera(x, y, origin_m[2] + half);
            let mut bits = 0u32;
            for level in 0..UnseenSpace::LEVELS {
                bits |= u32::from(!rays.see(&center)) << level;
                center += up;
            }
            hidden.push(bits);
        }
    }
    Some(UnseenSpace { origin_m, cell_m, columns, rows, hidden })
}

/// Rays from the camera through cubes of one size.
struct Rays<'a> {
    depth_m: &'a Image<f32>,
    fx: f32,
    fy: f32,
    cx: f32,
    cy: f32,
    half_m: f32,
}

impl<'a> Rays<'a> {
    fn new(view: &RayView<'a>, cell_m: f32) -> Self {
        let camera = &view.camera;
        Self {
            depth_m: view.depth_m,
            fx: camera.fx as f32,
            fy: camera.fy as f32,
            // Half a pixel more, so that cutting off the fraction rounds.
            cx: camera.cx as f32 + 0.5,
            cy: camera.cy as f32 + 0.5,
            half_m: cell_m / 2.0,
        }
    }

    /// Whether the ray to the middle of a cube reaches it, or most of those half a cube beside it where a single reading is missing.
    fn see(&self, center: &Point3<f32>) -> bool {
        if center.z <= self.half_m {
            return false;
        }
        let inverse = 1.0 / center.z;
        let (u, v) = (self.fx * center.x * inverse + self.cx, self.fy * center.y * inverse + self.cy);
        let least_m = center.z - self.half_m;
        if self.reaches(u, v, least_m) {
            return true;
        }
        let (du, dv) = ((self.fx * self.half_m * inverse).max(1.0), (self.fy * self.half_m * inverse).max(1.0));
        let beside = [(u - du, v), (u + du, v), (u, v - dv), (u, v + dv)];
        beside.into_iter().filter(|(u, v)| self.reaches(*u, *v, least_m)).count() >= 3
    }

    fn reaches(&self, u: f32, v: f32, least_m: f32) -> bool {
        // The casts saturate: what is left of or above the picture must be told apart first.
        u >= 0.0 && v >= 0.0 && self.depth_m.get(u as usize, v as usize).is_some_and(|z| *z >= least_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::{Solid, cast};
    use repose_geometry::transform::look_at;
    use repose_geometry::{Footprint, Vector3};
    use repose_proto::CameraModel;

    const CAMERA: Pinhole = Pinhole { width: 320, height: 240, fx: 262.0, fy: 262.0, cx: 159.5, cy: 119.5 };

    fn table() -> SupportSurface {
        let outline = [(-0.4, -0.3), (0.4, -0.3), (0.4, 0.3), (-0.4, 0.3)].map(|(x, y)| Point3::new(x, y, 0.0f32));
        SupportSurface { height_m: 0.0, outline: Footprint::of(&outline).unwrap(), seen_m2: 0.48, object: None, sloping: None }
    }

    /// What is unseen of a table with a box of 10 cm in its middle, from in front; `spoil` changes the picture first.
    fn unseen(spoil: impl Fn(&mut Image<f32>)) -> UnseenSpace {
        let world_from_camera = look_at(&Point3::new(0.0, -0.8, 0.5), &Point3::origin(), &Vector3::z());
        let solids = [Solid::table(0.0), Solid::cuboid([0.0, 0.0, 0.05], [0.05, 0.05, 0.05])];
        let mut depth_m = cast(&solids, &CAMERA, &world_from_camera).map(|s| s.map_or(f32::NAN, |(z, _)| z as f32));
        spoil(&mut depth_m);
        let view = RayView { depth_m: &depth_m, camera: CAMERA, world_from_camera: &world_from_camera };
        space(&view, &[table()], &UnseenSettings::default()).unwrap()
    }

    #[test]
    fn the_inside_and_the_shadow_of_a_box_are_unseen_and_the_rest_is_seen() {
        let space = unseen(|_| ());
        assert_eq!((space.columns, space.rows, space.origin_m), (40, 30, [-0.4, -0.3, 0.0]));
        let hides = |x: f64, y: f64, z: f64| space.hides([x, y, z]).unwrap();
        assert!(hides(0.0, 0.0, 0.05), "inside");
        assert!(hides(0.0, 0.09, 0.03), "behind, low");
        assert!(!hides(0.0, 0.09, 0.15), "behind, above");
        assert!(!hides(0.0, -0.15, 0.03) && !hides(0.25, 0.1, 0.03), "before and beside");
        assert!(!hides(0.0, 0.29, 0.03), "behind, where the ray over the box comes down again");
        assert_eq!(space.hides([9.0, 0.0, 0.0]), None);
        let share = space.hidden.iter().map(|bits| bits.count_ones()).sum::<u32>() as f64 / (1200.0 * 32.0);
        assert!(share > 0.005 && share < 0.6, "{share}");
    }

    #[test]
    fn missing_readings_are_unseen_and_a_lone_one_is_not() {
        let hole = |radius: isize| {
            move |depth_m: &mut Image<f32>| {
                // Where the camera sees the table at (0.25, 0).
                for v in -radius..=radius {
                    for u in -radius..=radius {
                        depth_m[((229 + u) as usize, (119 + v) as usize)] = f32::NAN;
                    }
                }
            }
        };
        assert_eq!(unseen(hole(12)).hides([0.25, 0.0, 0.01]), Some(true));
        assert_eq!(unseen(hole(0)), unseen(|_| ()));
    }

    #[test]
    fn what_is_too_far_away_for_the_scene_was_seen_and_what_was_not_read_was_not() {
        let camera = CameraModel { width: 8, height: 8, fx: 9.0, fy: 9.0, cx: 3.5, cy: 3.5, depth_unit_m: 1e-4, world_from_camera: None };
        // A wall at 5 m, in every second column and row of which there is …
        let mut counts = vec![50_000; 64];
        let pixel = |column: usize, row: usize| 2 * row * 8 + 2 * column;
        // … a place that was not read, one that was not read beside it, and one where the camera says so by its greatest count.
        counts[pixel(1, 2)] = 0;
        counts[pixel(2, 2) + 1] = 0;
        counts[pixel(3, 3)] = u16::MAX;
        let frame = Frame::new("test".to_owned(), 0, camera, counts);
        let mut depth_m = Image::filled(4, 4, f32::NAN);
        depth_m[(1, 1)] = 0.9;
        let sight_m = sight_m(&depth_m, 2, &frame, 4.0);
        assert!(sight_m[(2, 1)] == f32::INFINITY && sight_m[(3, 1)] == f32::INFINITY && sight_m[(1, 1)] == 0.9);
        assert!([(1, 2), (2, 2), (3, 3), (0, 1)].iter().all(|at| sight_m[*at].is_nan()));
    }

    #[test]
    fn a_table_high_above_a_wider_floor_is_within_the_grid() {
        let world_from_camera = look_at(&Point3::new(0.0, -1.4, 1.4), &Point3::new(0.0, 0.0, 0.7), &Vector3::z());
        let solids = [Solid::table(0.0), Solid::cuboid([0.0, 0.0, 0.4], [0.3, 0.3, 0.4])];
        let depth_m = cast(&solids, &CAMERA, &world_from_camera).map(|s| s.map_or(f32::NAN, |(z, _)| z as f32));
        let view = RayView { depth_m: &depth_m, camera: CAMERA, world_from_camera: &world_from_camera };
        let raised = |height_m| SupportSurface { height_m, seen_m2: 0.2, ..table() };
        let of = |height_m| space(&view, &[table(), raised(height_m)], &UnseenSettings::default()).unwrap();
        let high = of(0.8);
        assert_eq!((high.hides([0.0, 0.0, 0.78]), high.hides([0.0, 0.0, 0.88])), (Some(true), Some(false)));
        assert!((high.cell_m * 32.0 - 1.1).abs() < 1e-4, "{}", high.cell_m);
        // What the cubes reach at their own size, they reach as ever.
        assert_eq!(of(0.6), space(&view, &[table()], &UnseenSettings::default()).unwrap());
    }

    #[test]
    fn on_a_lower_board_missing_readings_are_unseen_as_on_the_table() {
        let world_from_camera = look_at(&Point3::new(0.0, -0.8, 0.5), &Point3::origin(), &Vector3::z());
        let board = Solid::cuboid([0.25, 0.0, -0.11], [0.15, 0.3, 0.01]);
        let solids = [Solid::cuboid([-0.2, 0.0, -0.01], [0.25, 0.3, 0.01]), board, Solid::table(-0.8)];
        let mut depth_m = cast(&solids, &CAMERA, &world_from_camera).map(|s| s.map_or(f32::NAN, |(z, _)| z as f32));
        // Where the camera sees the board at (0.25, 0.1) nothing comes back.
        let at = world_from_camera.inverse() * Point3::new(0.25, 0.1, -0.1);
        let (u, v) = ((CAMERA.fx * at.x / at.z + CAMERA.cx) as isize, (CAMERA.fy * at.y / at.z + CAMERA.cy) as isize);
        for (du, dv) in (-12..=12).flat_map(|du| (-12..=12).map(move |dv| (du, dv))) {
            depth_m[((u + du) as usize, (v + dv) as usize)] = f32::NAN;
        }
        let view = RayView { depth_m: &depth_m, camera: CAMERA, world_from_camera: &world_from_camera };
        let lower = |height_m: f32| {
            let outline = [(0.1, -0.3), (0.4, -0.3), (0.4, 0.3), (0.1, 0.3)].map(|(x, y)| Point3::new(x, y, height_m));
            SupportSurface { height_m, outline: Footprint::of(&outline).unwrap(), seen_m2: 0.18, object: None, sloping: None }
        };
        let of = |surfaces: &[SupportSurface]| space(&view, surfaces, &UnseenSettings::default()).unwrap();
        let both = of(&[table(), lower(-0.1)]);
        assert_eq!((both.hides([0.25, 0.1, -0.09]), both.hides([0.25, -0.2, -0.09])), (Some(true), Some(false)));
        // A floor far below changes nothing.
        assert_eq!(of(&[table(), lower(-0.8)]), of(&[table()]));
    }

    #[test]
    fn without_furniture_there_is_no_grid() {
        let world_from_camera = Isometry3::identity();
        let depth_m = Image::filled(4, 4, f32::NAN);
        let view = RayView { depth_m: &depth_m, camera: CAMERA, world_from_camera: &world_from_camera };
        let top = SupportSurface { object: Some(3), ..table() };
        assert_eq!(space(&view, &[top], &UnseenSettings::default()), None);
    }
}
