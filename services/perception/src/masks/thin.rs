//! Thin parts of masks: handles, shafts, legs.
//!
//! A part that is no wider than the band is eroded away as a whole, and what is not in the scene is no obstacle. Such parts are what opening a
//! mask takes from it. They are kept along their middle, which is eroding them less, as masks are that are thin as a whole.
//!
//! Labels that run over, slivers beside what covers an object, and readings between two surfaces make thin parts, too. So depth must confirm a
//! part: along its middle readings lie on one surface, and what is seen beside it lies behind it.

use repose_geometry::Image;

use crate::masks::borders::border_band;
use crate::readings::flying::StepLimit;
use crate::settings::{BorderSettings, Settings};

/// A part is at least so many times as long as the square that does not fit into it, …
const LEAST_LENGTHS: usize = 2;
/// … and has at least so many times its area. On real frames, rounded corners and bumps of labels have up to 49 pixels, of a square of 25.
const LEAST_AREAS: usize = 2;
/// One pixel of so many around a middle one may be another's: masks that follow readings have holes at their outlines.
const ONE_OTHER_OF: usize = 9;
/// The depth of a part at a place is the one that the nearest of so many readings there reach: all at its outline may be mixed with what is behind.
const NEAREST_OF: usize = 5;
/// Directions across a pixel in which is looked for what is beside it.
const ACROSS: [[isize; 2]; 4] = [[1, 0], [0, 1], [1, 1], [1, -1]];

/// A depth picture with masks.
#[derive(Debug, Clone, Copy)]
pub struct MaskedDepth<'a> {
    /// The object of each pixel, 0 = none.
    pub labels: &'a Image<u16>,
    /// Depth, metres; NaN where there is no reading.
    pub depth_m: &'a Image<f32>,
    /// The focal length of a picture of its readings, each in one pixel, pixels.
    pub focal_px: f32,
}

/// The pixels with a reading along the middle of thin parts, in order. `band` is the [`border_band`] of the masks; masks in `without`, which is
/// in order, are left out.
pub fn middles(picture: &MaskedDepth<'_>, band: &Image<bool>, without: &[u16], settings: &Settings) -> Vec<usize> {
    let labels = picture.labels;
    let widest = settings.borders.radius_px.min(labels.width().max(labels.height()));
    let step = StepLimit::new(&settings.flying, picture.focal_px);
    let mut middles = Vec::new();
    // What a wide band leaves nothing of may have parts that are too thin for half of it, too.
    for radius_px in std::iter::successors(Some(widest), |radius_px| Some(radius_px / 2)).take_while(|radius_px| *radius_px > 1) {
        let narrower = (radius_px < widest).then(|| border_band(labels, &BorderSettings { radius_px }));
        let mut waiting = opened_away(labels, narrower.as_ref().unwrap_or(band), radius_px);
        let parts = Parts { picture, radius_px, settings, step };
        for start in 0..waiting.len() {
            if waiting[start] {
                let part = connected(start, &mut waiting, labels);
                if without.binary_search(&labels.pixels()[start]).is_err() {
                    middles.extend(parts.middle_of(&part));
                }
            }
        }
    }
    middles.sort_unstable();
    middles.dedup();
    middles
}

/// Which pixels opening the masks by a square of half-width `radius_px` takes from them: those with none outside the band within it. A square
/// around a pixel outside the band is of one mask, so all masks are opened at once.
fn opened_away(labels: &Image<u16>, band: &Image<bool>, radius_px: usize) -> Vec<bool> {
    let (width, height) = (labels.width(), labels.height());
    if width == 0 || height == 0 {
        return Vec::new();
    }
    // Along the rows, then along the columns.
    let mut along_rows = vec![false; width * height];
    for (out, row) in along_rows.chunks_exact_mut(width).zip(band.pixels().chunks_exact(width)) {
        for shift in 0..=radius_px.min(width - 1) {
            take_free(&mut out[shift..], &row[..width - shift]);
            take_free(&mut out[..width - shift], &row[shift..]);
        }
    }
    let mut taken = vec![false; width * height];
    let mut opened = vec![false; width];
    for (v, (out, ids)) in taken.chunks_exact_mut(width).zip(labels.pixels().chunks_exact(width)).enumerate() {
        opened.fill(false);
        for beside in v.saturating_sub(radius_px)..(v + radius_px + 1).min(height) {
            for (opened, along) in opened.iter_mut().zip(&along_rows[beside * width..(beside + 1) * width]) {
                *opened |= *along;
            }
        }
        for ((out, opened), id) in out.iter_mut().zip(&opened).zip(ids) {
            *out = !*opened & (*id != 0);
        }
    }
    taken
}

/// Element by element, whether it was so or is outside the band.
fn take_free(out: &mut [bool], band: &[bool]) {
    for (out, banded) in out.iter_mut().zip(band) {
        *out |= !*banded;
    }
}

/// The pixels of one mask that wait and hang together with `start`; they wait no longer.
fn connected(start: usize, waiting: &mut [bool], labels: &Image<u16>) -> Vec<usize> {
    let (width, height, ids) = (labels.width(), labels.height(), labels.pixels());
    waiting[start] = false;
    let mut part = vec![start];
    let mut next = 0;
    while let Some(&at) = part.get(next) {
        next += 1;
        for beside in around(at, 1, width, height) {
            if waiting[beside] && ids[beside] == ids[start] {
                waiting[beside] = false;
                part.push(beside);
            }
        }
    }
    part
}

/// The pixels of the square of half-width `reach_px` around one, as far as it lies in the picture.
fn around(at: usize, reach_px: usize, width: usize, height: usize) -> impl Iterator<Item = usize> {
    let (u, v) = (at % width, at / width);
    let columns = u.saturating_sub(reach_px)..(u + reach_px + 1).min(width);
    let rows = v.saturating_sub(reach_px)..(v + reach_px + 1).min(height);
    rows.flat_map(move |v| columns.clone().map(move |u| v * width + u))
}

/// Telling what parts of masks are that erosion by a radius takes.
struct Parts<'a> {
    picture: &'a MaskedDepth<'a>,
    radius_px: usize,
    settings: &'a Settings,
    /// How far readings of one surface are apart, as flying ones are judged.
    step: StepLimit,
}

impl Parts<'_> {
    /// The middle of a part; nothing where it is too small or depth does not confirm it.
    fn middle_of(&self, part: &[usize]) -> Vec<usize> {
        let side = 2 * self.radius_px + 1;
        if part.len() < LEAST_AREAS * side * side || self.length(part) < LEAST_LENGTHS * side {
            return Vec::new();
        }
        let mut middle = Vec::new();
        let (mut readings, mut looks, mut behind) = (0usize, 0usize, 0usize);
        for &at in part.iter().filter(|at| self.is_middle(**at)) {
            let depth_m = self.picture.depth_m.pixels()[at];
            if depth_m.is_nan() {
                continue;
            }
            readings += 1;
            let near_m = self.near_m(at);
            if (depth_m - near_m).abs() > self.step.at_m(near_m) {
                continue;
            }
            middle.push(at);
            for stands_out in ACROSS.iter().filter_map(|across| self.stands_out(at, near_m, *across)) {
                looks += 1;
                behind += usize::from(stands_out);
            }
        }
        // Where nothing was read beside a part, in its own shadow, there was nothing to be mixed with.
        let is_one = middle.len() >= side && 2 * middle.len() >= readings && 4 * behind >= 3 * looks;
        if is_one { middle } else { Vec::new() }
    }

    /// The longer side of the upright rectangle around a part, pixels.
    fn length(&self, part: &[usize]) -> usize {
        let width = self.picture.labels.width();
        let (mut least, mut most) = ([usize::MAX; 2], [0usize; 2]);
        for at in part {
            for (k, along) in [at % width, at / width].into_iter().enumerate() {
                least[k] = least[k].min(along);
                most[k] = most[k].max(along);
            }
        }
        (most[0] - least[0]).max(most[1] - least[1]) + 1
    }

    /// Whether a pixel is so far from the borders of its mask that half the erosion leaves it, but for holes.
    fn is_middle(&self, at: usize) -> bool {
        let reach_px = self.radius_px / 2;
        let side = 2 * reach_px + 1;
        let ids = self.picture.labels.pixels();
        let others = self.around(at, reach_px).filter(|beside| ids[*beside] != ids[at]).count();
        ONE_OTHER_OF * others <= side * side
    }

    /// The depth of the part at a pixel that has a reading, metres.
    fn near_m(&self, at: usize) -> f32 {
        let (ids, depths) = (self.picture.labels.pixels(), self.picture.depth_m.pixels());
        let own = self.around(at, self.radius_px).filter(|beside| ids[*beside] == ids[at]);
        let mut own_m: Vec<f32> = own.map(|beside| depths[beside]).filter(|depth_m| !depth_m.is_nan()).collect();
        let nearest = own_m.len() / NEAREST_OF;
        *own_m.select_nth_unstable_by(nearest, f32::total_cmp).1
    }

    /// Whether what others show on both sides of a pixel lies behind the part; `None` where nothing was read of it.
    fn stands_out(&self, at: usize, near_m: f32, [du, dv]: [isize; 2]) -> Option<bool> {
        let levels = &self.settings.levels;
        let noise_m = levels.usual_noise_per_m2 * near_m * near_m;
        let clear_m = near_m + levels.least_clearance_m + levels.clearance_deviations * noise_m;
        // From the middle, twice the radius is out of the part and past the readings at its outline.
        let reach = 2 * self.radius_px as isize;
        match (self.other_m(at, [reach * du, reach * dv]), self.other_m(at, [-reach * du, -reach * dv])) {
            (None, None) => None,
            (Some(side_m), None) | (None, Some(side_m)) => Some(side_m > clear_m),
            // A plane's inverse depth is linear in the picture: their mean is what the part hides of a slanted table. What is much nearer on one
            // side covers the part, or is what the readings are mixed of.
            (Some(a_m), Some(b_m)) => Some(2.0 * a_m * b_m / (a_m + b_m) > clear_m && a_m.min(b_m) > near_m - self.step.at_m(near_m)),
        }
    }

    /// The reading at an offset from a pixel where it is not of the same mask, metres.
    fn other_m(&self, at: usize, [du, dv]: [isize; 2]) -> Option<f32> {
        let labels = self.picture.labels;
        let (u, v) = ((at % labels.width()).checked_add_signed(du)?, (at / labels.width()).checked_add_signed(dv)?);
        let depth_m = *self.picture.depth_m.get(u, v)?;
        (!depth_m.is_nan() && *labels.get(u, v)? != labels.pixels()[at]).then_some(depth_m)
    }

    fn around(&self, at: usize, reach_px: usize) -> impl Iterator<Item = usize> {
        around(at, reach_px, self.picture.labels.width(), self.picture.labels.height())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::{Solid, cast};
    use proptest::prelude::*;
    use rand::{RngExt, SeedableRng};
    use rand_pcg::Pcg64;
    use repose_geometry::transform::look_at;
    use repose_geometry::{Pinhole, Point3, Vector3};

    const WIDTH: usize = 160;
    const HEIGHT: usize = 120;
    const FOCAL_PX: f32 = 525.0;
    /// Depth of the near objects, metres.
    const NEAR_M: f32 = 0.75;

    /// Depth of a table that slants towards the camera, by the picture's row, metres.
    fn table_m(v: usize) -> f32 {
        1.0 / (1.0 + 0.0015 * v as f32)
    }

    /// What is kept of a picture's masks, as columns and rows.
    fn kept(labels: &Image<u16>, depth_m: &Image<f32>, focal_px: f32) -> Vec<(usize, usize)> {
        let settings = Settings::default();
        let band = border_band(labels, &settings.borders);
        let middles = middles(&MaskedDepth { labels, depth_m, focal_px }, &band, &[], &settings);
        middles.into_iter().map(|at| (at % labels.width(), at / labels.width())).collect()
    }

    /// Labels and depths, by column and row; of the depths also by label.
    fn drawn(label: impl Fn(usize, usize) -> u16, depth_m: impl Fn(usize, usize, u16) -> f32) -> (Image<u16>, Image<f32>) {
        let places = || (0..WIDTH * HEIGHT).map(|at| (at % WIDTH, at / WIDTH));
        let labels = places().map(|(u, v)| label(u, v)).collect();
        let depths = places().map(|(u, v)| depth_m(u, v, label(u, v))).collect();
        (Image::from_pixels(WIDTH, HEIGHT, labels).unwrap(), Image::from_pixels(WIDTH, HEIGHT, depths).unwrap())
    }

    /// A mug of 50 x 60 pixels with a handle of 4 pixels to its right.
    fn mug(u: usize, v: usize) -> u16 {
        let is_body = (30..80).contains(&u) && (30..90).contains(&v);
        let is_handle = (80..100).contains(&u) && (40..80).contains(&v) && !(u < 96 && (44..76).contains(&v));
        u16::from(is_body || is_handle)
    }

    /// A screwdriver: a handle of 20 pixels with a shaft of 3 by 50 pixels.
    fn screwdriver(u: usize, v: usize) -> u16 {
        let is_handle = (20..80).contains(&u) && (50..70).contains(&v);
        let is_shaft = (80..130).contains(&u) && (58..=60).contains(&v);
        u16::from(is_handle || is_shaft)
    }

    /// A near object on the table.
    fn near(_: usize, v: usize, id: u16) -> f32 {
        if id == 0 { table_m(v) } else { NEAR_M }
    }

    #[test]
    fn the_handle_of_a_mug_is_kept_along_its_middle() {
        let (labels, depth_m) = drawn(mug, near);
        let kept = kept(&labels, &depth_m, FOCAL_PX);
        assert!((130..=150).contains(&kept.len()), "{}", kept.len());
        assert!(kept.iter().all(|(u, v)| (80..99).contains(u) && (41..79).contains(v)), "not its outline, and not the mug: {kept:?}");
        assert!((80..99).all(|u| kept.iter().any(|at| at.0 == u)) && (41..79).all(|v| kept.iter().any(|at| at.1 == v)));
    }

    #[test]
    fn a_cameras_faults_leave_a_handle() {
        for seed in 0..8 {
            let mut rng = Pcg64::seed_from_u64(seed);
            let (labels, mut depth_m) = drawn(mug, near);
            let is_edge = |u: usize, v: usize| {
                [(u - 1, v), (u + 1, v), (u, v - 1), (u, v + 1)].iter().any(|beside| labels[*beside] != labels[(u, v)])
            };
            for (u, v) in (1..HEIGHT - 1).flat_map(|v| (1..WIDTH - 1).map(move |u| (u, v))) {
                let (fate, share, noise) =
                    (rng.random_range(0.0..1.0f32), rng.random_range(0.0..1.0f32), rng.random_range(-0.002..0.002f32));
                depth_m[(u, v)] += noise;
                if labels[(u, v)] != 0 && is_edge(u, v) && fate < 0.45 {
                    let mixed_m = NEAR_M + share * (table_m(v) - NEAR_M);
                    depth_m[(u, v)] = if fate < 0.25 { f32::NAN } else { mixed_m };
                }
            }
            // Masks that are given, and masks that end where nothing was read.
            let mut found = labels.clone();
            let holes = found.pixels_mut().iter_mut().zip(depth_m.pixels()).filter(|(_, z)| z.is_nan());
            holes.for_each(|(id, _)| *id = 0);
            for masks in [&labels, &found] {
                let kept = kept(masks, &depth_m, FOCAL_PX);
                assert!((90..=150).contains(&kept.len()), "{} with seed {seed}", kept.len());
                assert!(kept.iter().all(|at| (depth_m[*at] - NEAR_M).abs() < 0.015), "nothing in between, with seed {seed}");
            }
        }
    }

    #[test]
    fn the_shaft_of_a_screwdriver_is_kept_as_a_line() {
        let middle: Vec<(usize, usize)> = (80..129).map(|u| (u, 59)).collect();
        let above_table = |height_m: f32| move |_: usize, v: usize, id: u16| if id == 0 { table_m(v) } else { table_m(v) - height_m };
        let (labels, depth_m) = drawn(screwdriver, above_table(0.015));
        assert_eq!(kept(&labels, &depth_m, FOCAL_PX), middle, "it lies on the table");
        // In a picture of half the size everything is as wide as twice the pixels, and the table slants more from one to the next.
        let (labels, depth_m) = drawn(screwdriver, above_table(0.012));
        assert_eq!(kept(&labels, &depth_m, FOCAL_PX / 2.0), middle, "in a small picture");
        let receding = |u: usize, v: usize, id: u16| if id == 0 { 1.3 * table_m(v) } else { NEAR_M + 0.003 * u.saturating_sub(80) as f32 };
        let (labels, depth_m) = drawn(screwdriver, receding);
        assert_eq!(kept(&labels, &depth_m, FOCAL_PX), middle, "it points away from the camera");
        let mixed = |u: usize, v: usize, id: u16| match (id, u, v) {
            (0, ..) => table_m(v),
            (_, 80.., 58 | 60) => 0.5 * (NEAR_M + table_m(v)),
            _ => NEAR_M,
        };
        let (labels, depth_m) = drawn(screwdriver, mixed);
        assert_eq!(kept(&labels, &depth_m, FOCAL_PX), middle, "both its borders are mixed with the table");
    }

    #[test]
    fn what_labels_show_beside_an_object_is_no_part_of_it() {
        // A box of 60 x 40 pixels with a tail of some rows from its right side.
        let with_tail = |rows: usize| {
            move |u: usize, v: usize| {
                let is_box = (20..80).contains(&u) && (20..60).contains(&v);
                u16::from(is_box || ((80..120).contains(&u) && (38..38 + rows).contains(&v)))
            }
        };
        let tail_on_table = |u: usize, v: usize, id: u16| if id == 0 || u >= 80 { table_m(v) } else { NEAR_M };
        for rows in 1..=4 {
            let (labels, depth_m) = drawn(with_tail(rows), tail_on_table);
            assert!(kept(&labels, &depth_m, FOCAL_PX).is_empty(), "{rows} rows of the table");
        }
        let (labels, depth_m) = drawn(with_tail(1), near);
        assert!(kept(&labels, &depth_m, FOCAL_PX).is_empty(), "a line of which every reading may be mixed");
    }

    #[test]
    fn readings_between_a_box_and_the_table_are_no_ridge() {
        // Right of the box (columns 40 to 69) there are four columns that go over from its depth to the table's.
        let mut rng = Pcg64::seed_from_u64(3);
        let random: Vec<f32> = (0..WIDTH * HEIGHT).map(|_| rng.random_range(0.0..1.0)).collect();
        let beside = |u: usize, v: usize| (70..74).contains(&u) && (30..70).contains(&v);
        let blurred = |is_random: bool, u: usize, v: usize, id: u16| {
            let share = if is_random { random[v * WIDTH + u] } else { (u as f32 - 69.0) / 5.0 };
            match (id, beside(u, v)) {
                (_, true) => NEAR_M + share * (table_m(v) - NEAR_M),
                (0, _) => table_m(v),
                (1, _) => NEAR_M,
                _ => table_m(v) - 0.05,
            }
        };
        let of_box = |u: usize, v: usize| u16::from((40..74).contains(&u) && (30..70).contains(&v));
        // They belong to the mask of what lies beside the box, as an arm along its side.
        let of_other = |u: usize, v: usize| match (u, v) {
            (40..70, 30..70) => 1,
            (70..74, 30..70) | (60..110, 70..110) => 2,
            _ => 0,
        };
        // They go on above the box.
        let beyond =
            |u: usize, v: usize| u16::from((40..70).contains(&u) && (30..70).contains(&v) || (70..74).contains(&u) && (5..70).contains(&v));
        for is_random in [false, true] {
            let (labels, depth_m) = drawn(of_box, |u, v, id| blurred(is_random, u, v, id));
            assert!(kept(&labels, &depth_m, FOCAL_PX).is_empty(), "the box's own");
            let (labels, depth_m) = drawn(of_other, |u, v, id| blurred(is_random, u, v, id));
            assert!(kept(&labels, &depth_m, FOCAL_PX).is_empty(), "another object's");
        }
        let hanging = |u: usize, v: usize, id: u16| match (id, u) {
            (0, _) => table_m(v),
            (_, 70..) => NEAR_M + random[v * WIDTH + u] * (table_m(v) - NEAR_M),
            _ => NEAR_M,
        };
        let (labels, depth_m) = drawn(beyond, hanging);
        assert!(kept(&labels, &depth_m, FOCAL_PX).is_empty(), "in the air");
    }

    #[test]
    fn a_sliver_beside_what_covers_an_object_is_no_part_of_it() {
        // Of object 2 four rows show above the nearer object 1, and a large piece beside it.
        let label = |u: usize, v: usize| match (u, v) {
            (40..100, 40..90) => 1,
            (40..140, 36..90) => 2,
            _ => 0,
        };
        let depth_m = |_: usize, v: usize, id: u16| match id {
            0 => table_m(v),
            1 => 0.7,
            _ => 0.8,
        };
        let (labels, depths) = drawn(label, depth_m);
        assert!(kept(&labels, &depths, FOCAL_PX).is_empty());
    }

    #[test]
    fn masks_that_are_left_out_are_not_looked_at() {
        let settings = Settings::default();
        let (labels, depth_m) = drawn(mug, near);
        let picture = MaskedDepth { labels: &labels, depth_m: &depth_m, focal_px: FOCAL_PX };
        assert!(middles(&picture, &border_band(&labels, &settings.borders), &[1], &settings).is_empty());
    }

    #[test]
    fn a_wider_band_is_narrowed_step_by_step() {
        // With a radius of four pixels a part of seven keeps what two leave of it, and one of four what one leaves.
        let label = |u: usize, v: usize| {
            let is_body = (20..60).contains(&u) && (20..100).contains(&v);
            let is_arm = (60..130).contains(&u) && ((30..37).contains(&v) || (80..84).contains(&v));
            u16::from(is_body || is_arm)
        };
        let (labels, depth_m) = drawn(label, near);
        let settings = Settings { borders: BorderSettings { radius_px: 4 }, ..Settings::default() };
        let picture = MaskedDepth { labels: &labels, depth_m: &depth_m, focal_px: FOCAL_PX };
        let kept = middles(&picture, &border_band(&labels, &settings.borders), &[], &settings);
        let rows = |u: usize| kept.iter().filter(|at| *at % WIDTH == u).map(|at| at / WIDTH).collect::<Vec<usize>>();
        assert_eq!(rows(100), [32, 33, 34, 81, 82]);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(12))]
        #[test]
        fn boxes_have_no_thin_parts(eye in (-0.5..0.5f64, -0.9..-0.5f64, 0.3..0.9f64), turn in 0usize..3) {
            let camera = Pinhole { width: 320, height: 240, fx: 262.0, fy: 262.0, cx: 159.5, cy: 119.5 };
            let world_from_camera = look_at(&Point3::new(eye.0, eye.1, eye.2), &Point3::origin(), &Vector3::z());
            let mut sizes = [0.03, 0.05, 0.08];
            sizes.rotate_left(turn);
            let [a, b, c] = sizes;
            let solids = [
                Solid::table(0.0),
                Solid::cuboid([-0.15, 0.0, a], [b, c, a]),
                Solid::cuboid([0.1, 0.12, b], [c, a, b]),
                Solid::cuboid([0.12, -0.1, c], [a, b, c]),
            ];
            let seen = cast(&solids, &camera, &world_from_camera);
            let depth_m = seen.map(|s| s.map_or(f32::NAN, |(z, _)| z as f32));
            let labels = seen.map(|s| s.map_or(0, |(_, solid)| solid as u16));
            let kept = kept(&labels, &depth_m, 262.0);
            prop_assert!(kept.is_empty(), "{kept:?}");
        }
    }
}
