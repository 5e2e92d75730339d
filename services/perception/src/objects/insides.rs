//! What the rim of an object surrounds: the floor of an open box, a tray, a plate or a bowl.
//!
//! A floor a few millimetres above the table does not rise above what cameras err by, and would be taken for the table. But a rim goes around it:
//! the table beyond is not reached without going over something higher. Whether it is the object's own, or the table seen through a ring or
//! a handle, its colors and its height beside those of the table around tell. Where neither does it is told as no object that may be either.

use std::cmp::Ordering;
use std::collections::BTreeMap;

use repose_geometry::{Footprint, Image, Point3};
use repose_proto::LeftOutReason;

use super::coarse::CoarsePicture;
use super::color::{NO_COLOR, Rgb, difference};
use super::find::Found;
use super::regions::{MAX_LOOK_PX, Regions, is_nobodys};
use crate::readings::upward::arm_px;
use crate::settings::InsideSettings;
use crate::supports::extent::Extent;
use crate::supports::plane::LevelPlane;

/// Colors that a side is known by.
const KNOWN_COLORS: usize = 48;
/// The share of pixels like the object where no colors say.
const LIKE_EITHER: f32 = 0.5;
/// Steepest slope of the table around an object, which errors of the camera's pose give it.
const MAX_SLOPE: f32 = 0.05;

/// Gives objects what their rims surround, and tells of what may be the table.
pub fn find(found: &mut Found, picture: &CoarsePicture, colors: Option<&Image<Rgb>>, settings: &InsideSettings) {
    let regions = Regions::of(found, picture, settings);
    let mut taken = false;
    for number in 1..=regions.sizes.len() as u32 {
        let Some(inside) = Inside::of(&regions, number, found, picture, settings) else { continue };
        match inside.owner(&regions, found, picture, colors, settings) {
            Owner::Object => {
                inside.pixels.iter().for_each(|i| found.ids.pixels_mut()[*i] = inside.rim);
                taken = true;
            }
            Owner::Either => tell(found, &inside),
            Owner::Table => {}
        }
    }
    if taken {
        found.renumber();
    }
}

/// Whose what a rim surrounds is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Owner {
    Object,
    Table,
    Either,
}

/// Tells of what a rim surrounds as no object, but for what is told of already.
fn tell(found: &mut Found, inside: &Inside) {
    let ids = found.ids.pixels_mut();
    let Some(new) = ids.iter().copied().max().and_then(|most| most.checked_add(1)) else { return };
    inside.pixels.iter().for_each(|i| ids[*i] = if ids[*i] == 0 { new } else { ids[*i] });
    found.no_objects.insert(new, LeftOutReason::Enclosed);
    found.furniture.insert(new);
}

/// What an object's rim surrounds.
struct Inside {
    /// Its region.
    region: u32,
    /// Its pixels.
    pixels: Vec<usize>,
    /// The object that the rim is of.
    rim: u16,
    /// That object from above.
    extent: Extent,
}

impl Inside {
    /// A region as what a rim surrounds; `None` where it is small or open.
    fn of(regions: &Regions, region: u32, found: &Found, picture: &CoarsePicture, settings: &InsideSettings) -> Option<Self> {
        let (size, among) = regions.sizes.get(region as usize - 1)?;
        if *size < settings.min_pixels {
            return None;
        }
        let of = regions.of.pixels();
        let pixels: Vec<usize> = among.clone().filter(|i| of[*i] == region).collect();
        let rim = rim(regions, &pixels, region, found, picture, settings)?;
        let points = picture.in_world.pixels();
        let of_rim = found.ids.pixels().iter().zip(points).filter(|(id, _)| **id == rim).map(|(_, p)| p);
        let extent = Extent::new(&Footprint::of(of_rim)?, settings.around_m);
        let within = pixels.iter().filter(|i| extent.margin_m(&points[**i]) > 0.0).count();
        (within as f32 >= settings.min_within * *size as f32).then_some(Self { region, pixels, rim, extent })
    }

    /// Whose it is, by its colors and height beside those of the object and of the table around.
    fn owner(
        &self,
        regions: &Regions,
        found: &Found,
        picture: &CoarsePicture,
        colors: Option<&Image<Rgb>>,
        settings: &InsideSettings,
    ) -> Owner {
        let points = picture.in_world.pixels();
        let height_m = median(self.pixels.iter().map(|i| points[*i].z).collect());
        let is_around = |i: &usize| {
            let margin_m = self.extent.margin_m(&points[*i]);
            is_nobodys(found, found.ids.pixels()[*i])
                && regions.of.pixels()[*i] != self.region
                && (-settings.around_m..0.0).contains(&margin_m)
        };
        let is_table = |i: &usize| picture.faces_up.pixels()[*i] && (points[*i].z - height_m).abs() <= settings.around_m;
        let table: Vec<usize> = (0..points.len()).filter(|i| is_around(i) && is_table(i)).collect();
        if table.len() < settings.min_pixels {
            return Owner::Either;
        }
        let of_table: Vec<Point3<f32>> = table.iter().map(|i| points[*i]).collect();
        let Some(plane) = LevelPlane::fit(&of_table, MAX_SLOPE) else { return Owner::Either };
        let rise_m = median(self.pixels.iter().map(|i| plane.rise_m(&points[*i])).collect());
        let depth_m = median(self.pixels.iter().map(|i| picture.depth_m.pixels()[*i]).collect());
        let like_object = colors.map_or(LIKE_EITHER, |colors| self.share_like_object(&table, found, colors));
        let clear_m = settings.least_m + settings.noise_per_m2 * depth_m * depth_m;
        if like_object >= settings.same_color && rise_m > 0.0 || like_object > 1.0 - settings.same_color && rise_m >= clear_m {
            Owner::Object
        } else if like_object <= 1.0 - settings.same_color && rise_m < clear_m {
            Owner::Table
        } else {
            Owner::Either
        }
    }

    /// The share of its colored pixels that are nearer to a color of the object's than to any of the table's; half where one of them has none.
    fn share_like_object(&self, table: &[usize], found: &Found, colors: &Image<Rgb>) -> f32 {
        let object: Vec<usize> = (0..found.ids.pixels().len()).filter(|i| found.ids.pixels()[*i] == self.rim).collect();
        let colors_of = |pixels: &[usize], most: usize| -> Vec<Rgb> {
            let known: Vec<Rgb> = pixels.iter().map(|i| colors.pixels()[*i]).filter(|color| *color != NO_COLOR).collect();
            let every = known.len().div_ceil(most).max(1);
            known.into_iter().step_by(every).collect()
        };
        let (object, table) = (colors_of(&object, KNOWN_COLORS), colors_of(table, KNOWN_COLORS));
        let asked = colors_of(&self.pixels, 10 * KNOWN_COLORS);
        if object.is_empty() || table.is_empty() || asked.is_empty() {
            return LIKE_EITHER;
        }
        let nearest = |color: Rgb, known: &[Rgb]| known.iter().map(|other| difference(color, *other)).fold(f32::INFINITY, f32::min);
        // What is as near to both says nothing.
        let vote = |color: &Rgb| match nearest(*color, &object).total_cmp(&nearest(*color, &table)) {
            Ordering::Less => 1.0,
            Ordering::Equal => 0.5,
            Ordering::Greater => 0.0,
        };
        asked.iter().map(vote).sum::<f32>() / asked.len() as f32
    }
}

/// The object that most of a region's border is beside and that is nowhere lower; `None` where there is none, or a way out.
fn rim(regions: &Regions, pixels: &[usize], region: u32, found: &Found, picture: &CoarsePicture, settings: &InsideSettings) -> Option<u16> {
    let (width, height) = (picture.camera.width as isize, picture.camera.height as isize);
    let (of, points) = (regions.of.pixels(), picture.in_world.pixels());
    let is_object = |id: u16| id != 0 && !found.no_objects.contains_key(&id);
    let mut beside: BTreeMap<u16, usize> = BTreeMap::new();
    let (mut all, mut open) = (0usize, 0usize);
    for &i in pixels {
        let (u, v) = (i as isize % width, i as isize / width);
        for (du, dv) in [(-1, 0), (1, 0), (0, -1), (0, 1)] {
            let at = |steps: isize| {
                let (u, v) = (u + du * steps, v + dv * steps);
                ((0..width).contains(&u) && (0..height).contains(&v)).then_some((v * width + u) as usize)
            };
            // The picture's edge says nothing.
            let Some(next) = at(1) else { continue };
            if of[next] == region {
                continue;
            }
            let depth_m = picture.depth_m.pixels()[i];
            let look = arm_px(depth_m, picture.camera.fx as f32, settings.look_m, MAX_LOOK_PX) as isize;
            let met = (1..=look).map(at).find(|j| j.is_none_or(|j| of[j] == region || is_object(found.ids.pixels()[j])));
            let step_m = settings.step_m + settings.noise_per_m2 * depth_m * depth_m;
            match met {
                // Out of the picture, or only a hole in the readings.
                Some(None) => {}
                Some(Some(j)) if of[j] == region => {}
                Some(Some(j)) if points[j].z >= points[i].z - step_m => {
                    all += 1;
                    *beside.entry(found.ids.pixels()[j]).or_insert(0) += 1;
                }
                Some(Some(_)) | None => {
                    all += 1;
                    open += 1;
                }
            }
        }
    }
    let (rim, count) = beside.into_iter().max_by_key(|(id, count)| (*count, std::cmp::Reverse(*id)))?;
    let is_closed = open as f32 <= settings.max_open * all as f32 && count as f32 >= settings.min_rim * all as f32;
    is_closed.then_some(rim)
}

/// The middle one of some numbers, NaN of none.
fn median(mut values: Vec<f32>) -> f32 {
    let middle = values.len() / 2;
    if values.is_empty() { f32::NAN } else { *values.select_nth_unstable_by(middle, f32::total_cmp).1 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::Settings;
    use crate::synthetic::{Solid, cast, render};
    use repose_geometry::transform::look_at;
    use repose_geometry::{Pinhole, Vector3};

    const CAMERA: Pinhole = Pinhole { width: 320, height: 240, fx: 262.0, fy: 262.0, cx: 159.5, cy: 119.5 };
    const RED: Rgb = [180, 40, 40];
    const GREY: Rgb = [120, 120, 120];

    /// Four walls of 5 cm around a place.
    fn walls([x, y]: [f64; 2]) -> [Solid; 4] {
        let wall = |dx: f64, dy: f64, half_x: f64, half_y: f64| Solid::cuboid([x + dx, y + dy, 0.025], [half_x, half_y, 0.025]);
        [wall(0.0, -0.1, 0.1, 0.005), wall(0.0, 0.1, 0.1, 0.005), wall(-0.1, 0.0, 0.005, 0.1), wall(0.1, 0.0, 0.005, 0.1)]
    }

    fn floor([x, y]: [f64; 2], height_m: f64) -> Solid {
        Solid::cuboid([x, y, height_m / 2.0], [0.1, 0.1, height_m / 2.0])
    }

    /// What becomes of the pixels of the second solid, behind the table, where those after it are one object with its walls: their most frequent
    /// id, and why that is none. `colors` are the table's, the second solid's and the walls'.
    fn fate(solids: &[Solid], colors: Option<[Rgb; 3]>) -> (u16, Option<LeftOutReason>) {
        let world_from_camera = look_at(&Point3::new(0.0, -0.35, 0.55), &Point3::origin(), &Vector3::z());
        let in_camera = render(solids, &CAMERA, &world_from_camera);
        let picture = CoarsePicture::new(in_camera, &world_from_camera, &CAMERA, 1, &Settings::default());
        let seen = cast(solids, &CAMERA, &world_from_camera);
        let of = |i: usize| seen.pixels()[i].map(|(_, solid)| solid);
        let mut found = Found::objects(seen.map(|s| s.map_or(0, |(_, solid)| u16::from(solid > 1))));
        let colors = colors.map(|colors| seen.map(|s| s.map_or(GREY, |(_, solid)| colors[solid.min(2)])));
        find(&mut found, &picture, colors.as_ref(), &InsideSettings::default());
        let mut counts = BTreeMap::new();
        (0..320 * 240).filter(|i| of(*i) == Some(1)).for_each(|i| *counts.entry(found.ids.pixels()[i]).or_insert(0usize) += 1);
        let id = counts.into_iter().max_by_key(|(_, n)| *n).map_or(0, |(id, _)| id);
        (id, found.no_objects.get(&id).copied())
    }

    fn box_at(center: [f64; 2], floor_m: f64) -> Vec<Solid> {
        [Solid::table(0.0), floor(center, floor_m)].into_iter().chain(walls(center)).collect()
    }

    #[test]
    fn a_floor_that_rises_clearly_is_the_objects_and_a_thin_one_is_by_its_color() {
        assert_eq!(fate(&box_at([0.0, 0.0], 0.006), None), (1, None));
        assert_eq!(fate(&box_at([0.0, 0.0], 0.001), Some([GREY, RED, RED])), (1, None));
    }

    #[test]
    fn what_shows_through_a_ring_is_the_table_by_its_color_and_else_told() {
        // As high as cameras err.
        let through = |colors| fate(&box_at([0.0, 0.0], 0.0002), colors);
        assert_eq!(through(Some([GREY, GREY, RED])), (0, None));
        assert_eq!(through(Some([GREY; 3])).1, Some(LeftOutReason::Enclosed));
        assert_eq!(through(None).1, Some(LeftOutReason::Enclosed));
        // Depth is wider than color there.
        assert_eq!(through(Some([GREY, NO_COLOR, NO_COLOR])).1, Some(LeftOutReason::Enclosed));
        assert_eq!(through(Some([NO_COLOR, NO_COLOR, RED])).1, Some(LeftOutReason::Enclosed));
    }

    #[test]
    fn what_the_picture_cuts_off_is_surrounded_and_what_a_side_is_open_of_is_not() {
        assert_eq!(fate(&box_at([0.33, 0.0], 0.006), None), (1, None));
        let mut open = box_at([0.0, 0.0], 0.006);
        open.remove(2);
        assert_eq!(fate(&open, None), (0, None));
    }
}
