//! How wide a picture repeats each of its camera's readings.
//!
//! A driver that registers depth into a larger color picture gives each reading to all the pixels that it covers there (librealsense's `align`,
//! `depth_image_proc`): blocks of two or three pixels a side hold one count. Beside a pixel is then the same reading once more, and what is done to the
//! next two pixels is done to one reading.
//!
//! That neighbours are equal proves little: those of a flat wall are, to a count. What hangs in the air between two surfaces tells. A camera's own picture
//! shows it in single pixels, for the next one mixes the two by another share; a picture that repeats them shows it as wide as it repeats.

use std::ops::Range;

use repose_geometry::Image;

/// Fewer neighbours are equal in a picture that repeats its readings by half or more, a share of those along either side of the picture. Of its own readings
/// those down the picture seldom are: the camera looks at things from above.
const LEAST_EQUAL: f32 = 0.4;
/// Of so many rows one tells how many neighbours are equal: an odd number, for every other row may be one that repeats.
const TOLD: usize = 5;
/// What hangs between two surfaces is farther than this from both, as a share of its depth.
const OFF: f32 = 0.02;
/// Nothing is repeated wider than this, pixels.
const WIDEST_PX: usize = 6;
/// Where fewer places hang in the air they say nothing.
const FEWEST: usize = 6;
/// At least this share of them are about equally wide, where readings are repeated.
const LEAST_ALIKE: f32 = 0.75;
/// Most rows, and columns, in which they are looked for.
const MOST_LINES: usize = 256;

/// How many pixels wide and high each reading is repeated, on average and rounded; 1 in a camera's own picture, and where nothing tells. `depth_m` holds
/// NaN where there is no reading.
pub fn repeat_px(depth_m: &Image<f32>) -> usize {
    if !has_equal_neighbours(depth_m) {
        return 1;
    }
    let pixels = depth_m.pixels();
    let mut of_width = [0; WIDEST_PX + 1];
    for lines in lines(depth_m) {
        let every = lines.len().div_ceil(MOST_LINES).max(1);
        for line in lines.into_iter().step_by(every) {
            for run in line.runs(pixels).filter(|run| run.px() <= WIDEST_PX && run.hangs()) {
                of_width[run.px()] += 1;
            }
        }
    }
    let places: usize = of_width.iter().sum();
    if places < FEWEST {
        return 1;
    }
    let wide_px: usize = of_width.iter().enumerate().map(|(px, places)| px * places).sum();
    let repeat_px = (2 * wide_px + places) / (2 * places);
    // Thin things are of any width; what is one reading wide is as wide everywhere, to a pixel.
    let alike: usize = (2.max(repeat_px - 1)..=repeat_px + 1).filter_map(|px| of_width.get(px)).sum();
    if alike as f32 >= LEAST_ALIKE * places as f32 { repeat_px } else { 1 }
}

/// The nearest other readings to the left and right of each pixel, above and below it, in a picture that repeats each reading so wide; NaN where
/// nothing was read before. What is equal for longer than a reading is repeated is one surface with itself.
pub fn others(depth_m: &Image<f32>, repeat_px: usize) -> [Vec<f32>; 4] {
    let pixels = depth_m.pixels();
    let [rows, columns] = lines(depth_m);
    let [mut left, mut right, mut above, mut below] = std::array::from_fn(|_| vec![f32::NAN; pixels.len()]);
    for (lines, before, after) in [(rows, &mut left, &mut right), (columns, &mut above, &mut below)] {
        for line in lines {
            for run in line.runs(pixels) {
                // Drivers give the pixels where two readings meet to the nearer one.
                let is_surface = run.px() > repeat_px + 1;
                let (one, other) = if is_surface { (run.here, run.here) } else { (run.before, run.after) };
                for at in run.along.map(|k| line.at(k)) {
                    (before[at], after[at]) = (one, other);
                }
            }
        }
    }
    [left, right, above, below]
}

/// Whether so many neighbours are equal, across and down the picture, that it may repeat readings.
fn has_equal_neighbours(depth_m: &Image<f32>) -> bool {
    let width = depth_m.width().max(1);
    let (mut across, mut down) = (Equals::default(), Equals::default());
    let rows = || depth_m.pixels().chunks_exact(width);
    for (row, below) in rows().zip(rows().skip(1)).step_by(TOLD) {
        across.count(row, &row[1..]);
        down.count(row, below);
    }
    across.are_many() && down.are_many()
}

/// How many of neighbouring readings are equal.
#[derive(Debug, Clone, Copy, Default)]
struct Equals {
    pairs: usize,
    equal: usize,
}

impl Equals {
    fn count(&mut self, some: &[f32], others: &[f32]) {
        self.pairs += some.iter().zip(others).map(|(a, b)| usize::from(!a.is_nan() & !b.is_nan())).sum::<usize>();
        self.equal += some.iter().zip(others).map(|(a, b)| usize::from(a == b)).sum::<usize>();
    }

    fn are_many(&self) -> bool {
        self.equal as f32 > LEAST_EQUAL * self.pairs as f32
    }
}

/// The rows and the columns of a picture.
fn lines(picture: &Image<f32>) -> [Vec<Line>; 2] {
    let (width, height) = (picture.width(), picture.height());
    let row = |v: usize| Line { first: v * width, step: 1, count: width };
    let column = |u: usize| Line { first: u, step: width, count: height };
    [(0..height).map(row).collect(), (0..width).map(column).collect()]
}

/// Pixels along a row or a column.
#[derive(Debug, Clone, Copy)]
struct Line {
    first: usize,
    step: usize,
    count: usize,
}

impl Line {
    /// The pixel at a place along the line.
    fn at(self, along: usize) -> usize {
        self.first + along * self.step
    }

    /// Its stretches of one reading; pixels without one are alone.
    fn runs(self, pixels: &[f32]) -> impl Iterator<Item = Run> {
        let z = move |along: usize| pixels[self.at(along)];
        let mut from = 0;
        std::iter::from_fn(move || {
            if from == self.count {
                return None;
            }
            let here = z(from);
            let to = (from + 1..self.count).find(|k| z(*k) != here).unwrap_or(self.count);
            let before = if from > 0 { z(from - 1) } else { f32::NAN };
            let after = if to < self.count { z(to) } else { f32::NAN };
            let run = Run { along: from..to, before, here, after };
            from = to;
            Some(run)
        })
    }
}

/// Pixels that follow each other along a line and hold one reading, with those before and after them, metres.
#[derive(Debug, Clone)]
struct Run {
    along: Range<usize>,
    before: f32,
    here: f32,
    after: f32,
}

impl Run {
    fn px(&self) -> usize {
        self.along.len()
    }

    /// Whether it lies in the air between what is before and after it.
    fn hangs(&self) -> bool {
        let off_m = OFF * self.here;
        let between = |near: f32, far: f32| self.here - near > off_m && far - self.here > off_m;
        between(self.before, self.after) || between(self.after, self.before)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A picture registered into one of `scale` times as many columns and rows, as librealsense's `align` does it: each reading fills the pixels from the
    /// one where its upper left corner comes to lie to that of its lower right corner, and where two meet the nearer one stays.
    pub(crate) fn registered(own: &Image<f32>, scale: f64) -> Image<f32> {
        let side = |n: usize| (n as f64 * scale) as usize;
        let mut larger = Image::filled(side(own.width()), side(own.height()), f32::NAN);
        let corner = |at: usize| (at as f64 * scale).round() as usize;
        for (v, u) in (0..own.height()).flat_map(|v| (0..own.width()).map(move |u| (v, u))) {
            for row in corner(v)..=corner(v + 1).min(larger.height() - 1) {
                for column in corner(u)..=corner(u + 1).min(larger.width() - 1) {
                    // The reading where one of the two is none.
                    larger[(column, row)] = larger[(column, row)].min(own[(u, v)]);
                }
            }
        }
        larger
    }

    /// Two surfaces that slant down the picture, 0.9 m and 1.3 m away, with outlines like a comb's; between them single pixels that mix both by another share each.
    pub(crate) fn comb() -> Image<f32> {
        let depth_m = |i: usize| {
            let (u, v) = (i % 95, i / 95);
            // A millimetre from row to row, and as much up and down within it.
            let slant_m = 0.001 * v as f32 + 0.001 * ((u * 7 + v * 13) % 3) as f32;
            let share = 0.3 + 0.01 * ((u * 5 + v * 3) % 40) as f32;
            match u % 24 {
                0..11 => 0.9 + slant_m,
                11 | 23 => 0.9 + slant_m + 0.4 * share,
                _ => 1.3 + slant_m,
            }
        };
        Image::from_pixels(95, 72, (0..95 * 72).map(depth_m).collect()).unwrap()
    }

    #[test]
    fn a_picture_that_was_registered_into_a_larger_one_is_known_by_what_hangs_in_the_air() {
        assert_eq!(repeat_px(&comb()), 1);
        for (scale, expected) in [(1.9, 2), (2.0, 2), (2.15, 2), (3.0, 3)] {
            assert_eq!(repeat_px(&registered(&comb(), scale)), expected, "{scale}");
        }
    }

    #[test]
    fn equal_neighbours_alone_are_no_repetition() {
        let flat = Image::filled(64, 48, 1.0f32);
        assert_eq!(repeat_px(&flat), 1);
        // Boxes seen from straight above, and single pixels that mix them with the table.
        let depth_m = |i: usize| match (i % 64 % 16, i / 64) {
            (4..12, 8..40) => 0.9,
            (12, 8..40) => 0.95,
            _ => 1.0,
        };
        assert_eq!(repeat_px(&Image::from_pixels(64, 48, (0..64 * 48).map(depth_m).collect()).unwrap()), 1);
        assert_eq!(repeat_px(&Image::filled(64, 48, f32::NAN)), 1);
        assert_eq!(repeat_px(&Image::filled(0, 0, f32::NAN)), 1);
    }

    #[test]
    fn thin_things_of_several_widths_are_no_repetition() {
        // Rods before a wall, and before them the edge of something near: in a picture without noise each of one reading.
        let row: Vec<f32> = [1, 2, 4, 6, 1].iter().flat_map(|px| [vec![0.9f32; 8], vec![1.1; *px], vec![1.4; 8]].concat()).collect();
        let picture = Image::from_pixels(row.len(), 40, row.repeat(40)).unwrap();
        assert_eq!(repeat_px(&picture), 1);
        let alike = Image::from_pixels(90, 40, [vec![0.9f32; 8], vec![1.1; 2], vec![1.4; 8]].concat().repeat(5 * 40)).unwrap();
        assert_eq!(repeat_px(&alike), 2, "as wide everywhere");
    }

    #[test]
    fn the_nearest_other_readings_are_looked_for_past_repeated_ones() {
        let none = f32::NAN;
        let row = [1.0, 1.0, 1.5, 1.5, 2.0, 2.0, 2.0, 2.0, none, 3.0, 3.0];
        let picture = Image::from_pixels(11, 1, row.to_vec()).unwrap();
        let [left, right, above, below] = others(&picture, 2);
        let told = |side: &[f32]| side.iter().map(|z| if z.is_nan() { 0 } else { (z * 10.0).round() as i32 }).collect::<Vec<i32>>();
        // Four equal ones are a surface.
        assert_eq!(told(&left), [0, 0, 10, 10, 20, 20, 20, 20, 20, 0, 0]);
        assert_eq!(told(&right), [15, 15, 20, 20, 20, 20, 20, 20, 30, 0, 0]);
        assert!(above.iter().chain(&below).all(|z| z.is_nan()));
    }
}
