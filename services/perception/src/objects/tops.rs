//! Flat tops, and what stands on them.
//!
//! A book, a box or a laptop shows a flat top that ends in a step downwards; what rises from the middle of it is another thing. A floor
//! that a rim surrounds (a bowl's, a plate's, a tray's) is no such top: it belongs to the rim. What stands on a top is cut from it along
//! the line where it begins to rise, however shallow the crease is.

use repose_geometry::{Footprint, Image, Point3};

use crate::readings::noise::DepthNoise;
use crate::readings::point_map::PointMap;
use crate::readings::upward::arm_px;
use crate::settings::TopSettings;
use crate::supports::extent::Extent;
use crate::supports::plane::LevelPlane;

/// Farthest beyond a border that is looked, pixels.
const MAX_LOOK_PX: usize = 24;

/// What of the picture stands on which top.
#[derive(Debug, Clone, PartialEq)]
pub struct Storeys {
    /// The highest top that a pixel lies on or stands on: 1, 2, …; 0 where none is below it.
    pub top: Image<u16>,
    /// Whether it stands on it rather than being a part of it.
    pub stands: Image<bool>,
    /// Flat floors that rims surround.
    pub basins: Vec<Basin>,
}

/// A flat floor that something higher surrounds.
#[derive(Debug, Clone, PartialEq)]
pub struct Basin {
    /// Its pixels.
    pub pixels: Vec<usize>,
    /// Pixels a little outside of its border.
    pub around: Vec<usize>,
}

impl Storeys {
    /// Whether the border between a top and what stands on it runs between two pixels.
    pub fn part(&self, i: usize, j: usize) -> bool {
        let (top, stands) = (self.top.pixels(), self.stands.pixels());
        top[i] == top[j] && top[i] != 0 && stands[i] != stands[j]
    }
}

/// What tops are looked for in.
pub struct TopView<'a> {
    /// World points, their heights averaged over their like.
    pub in_world: &'a PointMap,
    /// Depths of the same pixels, metres.
    pub depth_m: &'a Image<f32>,
    /// Which of them face up.
    pub faces_up: &'a Image<bool>,
    /// Which of them rise above the furniture.
    pub rises: &'a Image<bool>,
    /// Focal length of the picture, pixels.
    pub focal_px: f32,
    /// Noise of the averaged heights.
    pub noise: DepthNoise,
    /// The camera's height, metres.
    pub camera_m: f32,
}

impl TopView<'_> {
    fn sigma_m(&self, i: usize) -> f32 {
        self.noise.height_m(self.depth_m.pixels()[i], self.camera_m - self.in_world.pixels()[i].z)
    }

    fn beside(&self, i: usize) -> impl Iterator<Item = usize> {
        let (width, height) = (self.in_world.width(), self.in_world.height());
        let (u, v) = (i % width, i / width);
        [(u > 0).then(|| i - 1), (u + 1 < width).then(|| i + 1), (v > 0).then(|| i - width), (v + 1 < height).then(|| i + width)]
            .into_iter()
            .flatten()
    }
}

/// A flat top.
struct Top {
    plane: LevelPlane,
    outline: Footprint,
    pixels: Vec<usize>,
    height_m: f32,
}

/// The tops of a picture and what stands on each.
pub fn find(view: &TopView<'_>, settings: &TopSettings) -> Storeys {
    let (width, height) = (view.in_world.width(), view.in_world.height());
    let mut storeys = Storeys { top: Image::filled(width, height, 0), stands: Image::filled(width, height, false), basins: Vec::new() };
    let mut seen = vec![false; width * height];
    let mut own = vec![false; width * height];
    let mut tops: Vec<Top> = Vec::new();
    for start in 0..seen.len() {
        if let Some(region) = grown(view, start, &mut seen, settings) {
            let Some(top) = flat(view, &region, settings) else { continue };
            match rim(view, &top, &mut own, settings) {
                Some(around) => storeys.basins.push(Basin { pixels: top.pixels, around }),
                None => tops.push(top),
            }
        }
    }
    tops.sort_by(|a, b| a.height_m.total_cmp(&b.height_m));
    for (number, top) in (1..=u16::MAX).zip(&tops) {
        spread(view, top, number, &mut storeys, settings);
    }
    storeys
}

/// The pixels connected to `start` that face up at about one height each to the next; `None` where they are too few.
fn grown(view: &TopView<'_>, start: usize, seen: &mut [bool], settings: &TopSettings) -> Option<Vec<usize>> {
    let (points, up, rises) = (view.in_world.pixels(), view.faces_up.pixels(), view.rises.pixels());
    if seen[start] || !up[start] || !rises[start] {
        return None;
    }
    seen[start] = true;
    let mut region = vec![start];
    let mut next = 0;
    while next < region.len() {
        let i = region[next];
        next += 1;
        let step_m = settings.least_m + settings.like_deviations * view.sigma_m(i);
        for j in view.beside(i) {
            if !seen[j] && up[j] && rises[j] && (points[j].z - points[i].z).abs() <= step_m {
                seen[j] = true;
                region.push(j);
            }
        }
    }
    (region.len() >= settings.min_pixels).then_some(region)
}

/// The top that a region of pixels is, where most of it lies in one plane.
fn flat(view: &TopView<'_>, region: &[usize], settings: &TopSettings) -> Option<Top> {
    const ROUNDS: usize = 3;
    let points = view.in_world.pixels();
    let mut on = region.to_vec();
    let mut plane = LevelPlane { height_m: 0.0, slope_x: 0.0, slope_y: 0.0 };
    for _ in 0..ROUNDS {
        let fitted: Vec<Point3<f32>> = on.iter().map(|i| points[*i]).collect();
        plane = LevelPlane::fit(&fitted, settings.max_slope)?;
        let near = |i: &usize| plane.rise_m(&points[*i]).abs() <= settings.least_m + settings.on_deviations * view.sigma_m(*i);
        on = region.iter().copied().filter(near).collect();
    }
    if on.len() < settings.min_pixels || (on.len() as f32) < settings.min_flat * region.len() as f32 {
        return None;
    }
    let own: Vec<Point3<f32>> = on.iter().map(|i| points[*i]).collect();
    let outline = Footprint::of(&own)?;
    let height_m = own.iter().map(|p| p.z).sum::<f32>() / own.len() as f32;
    (outline.area() >= settings.min_area_m2).then_some(Top { plane, outline, pixels: on, height_m })
}

/// The pixels around a flat region where most of them are higher than it: a rim. `own` is room for a mark for each pixel, none of them set.
fn rim(view: &TopView<'_>, top: &Top, own: &mut [bool], settings: &TopSettings) -> Option<Vec<usize>> {
    let (width, height) = (view.in_world.width() as isize, view.in_world.height() as isize);
    top.pixels.iter().for_each(|i| own[*i] = true);
    let (mut higher, mut around) = (0usize, Vec::new());
    for i in &top.pixels {
        let (u, v) = (*i as isize % width, *i as isize / width);
        for (du, dv) in [(-1, 0), (1, 0), (0, -1), (0, 1)] {
            let at = |steps: isize| {
                let (u, v) = (u + du * steps, v + dv * steps);
                ((0..width).contains(&u) && (0..height).contains(&v)).then_some((v * width + u) as usize)
            };
            if at(1).is_some_and(|j| own[j]) {
                continue;
            }
            let look = arm_px(view.depth_m.pixels()[*i], view.focal_px, settings.look_m, MAX_LOOK_PX) as isize;
            let Some(j) = at(look) else { continue };
            if own[j] {
                continue;
            }
            let p = &view.in_world.pixels()[j];
            around.push(j);
            // False without a reading: a step leaves a shadow.
            higher += usize::from(top.plane.rise_m(p) > settings.least_m + settings.on_deviations * view.sigma_m(j));
        }
    }
    top.pixels.iter().for_each(|i| own[*i] = false);
    (higher as f32 > settings.max_rim * around.len() as f32).then_some(around)
}

/// Marks what lies on a top and what stands on it, from its own pixels outwards.
fn spread(view: &TopView<'_>, top: &Top, number: u16, storeys: &mut Storeys, settings: &TopSettings) {
    let points = view.in_world.pixels();
    let extent = Extent::new(&top.outline, settings.inset_m);
    let mut open = top.pixels.clone();
    for i in &top.pixels {
        storeys.top.pixels_mut()[*i] = number;
        storeys.stands.pixels_mut()[*i] = false;
    }
    while let Some(i) = open.pop() {
        for j in view.beside(i) {
            if storeys.top.pixels()[j] == number || !view.rises.pixels()[j] {
                continue;
            }
            let (rise, sigma_m) = (top.plane.rise_m(&points[j]), view.sigma_m(j));
            let band_m = settings.least_m + settings.on_deviations * sigma_m;
            if rise > -band_m && extent.margin_m(&points[j]) > settings.inset_m {
                storeys.top.pixels_mut()[j] = number;
                storeys.stands.pixels_mut()[j] = rise > band_m;
                open.push(j);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::readings::point_map::transformed;
    use crate::readings::upward::upward_facing;
    use crate::synthetic::{Solid, cast, render};
    use repose_geometry::transform::look_at;
    use repose_geometry::{Pinhole, Vector3};

    const CAMERA: Pinhole = Pinhole { width: 320, height: 240, fx: 262.0, fy: 262.0, cx: 159.5, cy: 119.5 };

    /// Of each solid but the table, how many of its pixels lie on a top and how many stand on one.
    fn on_and_standing(solids: &[Solid]) -> Vec<[usize; 2]> {
        let world_from_camera = look_at(&Point3::new(0.1, -0.5, 0.6), &Point3::origin(), &Vector3::z());
        let in_camera = render(solids, &CAMERA, &world_from_camera);
        let in_world = transformed(&in_camera, &world_from_camera);
        let depth_m = in_camera.map(|p| p.z);
        let faces_up = upward_facing(&in_world, &depth_m, 262.0, 0.44);
        let seen = cast(solids, &CAMERA, &world_from_camera);
        let rises = seen.map(|s| s.is_some_and(|(_, solid)| solid > 0));
        let view = TopView {
            in_world: &in_world,
            depth_m: &depth_m,
            faces_up: &faces_up,
            rises: &rises,
            focal_px: 262.0,
            noise: DepthNoise { per_m2: 0.001 },
            camera_m: 0.6,
        };
        let storeys = find(&view, &TopSettings::default());
        let of = |solid: usize, stands: bool| {
            let own = seen.pixels().iter().enumerate().filter(|(_, s)| s.is_some_and(|(_, k)| k == solid));
            own.filter(|(i, _)| storeys.top.pixels()[*i] != 0 && storeys.stands.pixels()[*i] == stands).count()
        };
        (1..solids.len()).map(|solid| [of(solid, false), of(solid, true)]).collect()
    }

    #[test]
    fn a_thing_in_the_middle_of_a_book_stands_on_it() {
        let book = Solid::cuboid([0.0, 0.0, 0.015], [0.12, 0.09, 0.015]);
        let cup = Solid::cuboid([0.03, 0.0, 0.06], [0.03, 0.03, 0.03]);
        let found = on_and_standing(&[Solid::table(0.0), book, cup]);
        assert!(found[0][0] > 1000 && found[0][1] < found[0][0] / 50, "{found:?}");
        assert!(found[1][1] > 200, "{found:?}");
    }

    #[test]
    fn the_floor_of_a_tray_is_no_top() {
        let wall = |x: f64, y: f64, half_x: f64, half_y: f64| Solid::cuboid([x, y, 0.02], [half_x, half_y, 0.02]);
        let floor = Solid::cuboid([0.0, 0.0, 0.003], [0.1, 0.1, 0.003]);
        let walls = [wall(0.0, -0.1, 0.1, 0.006), wall(0.0, 0.1, 0.1, 0.006), wall(-0.1, 0.0, 0.006, 0.1), wall(0.1, 0.0, 0.006, 0.1)];
        let mut solids = vec![Solid::table(0.0), floor];
        solids.extend(walls);
        assert_eq!(on_and_standing(&solids)[0], [0, 0]);
    }
}
