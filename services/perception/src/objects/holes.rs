//! Masks of objects that the camera hardly reads, completed by color.
//!
//! Dark and shiny sides and tops seen at a glance give no depth, and masks follow readings. A pixel without a reading goes to the mask, or the
//! background, that reaches it at the least cost over such pixels: a step costs one, and more across a difference in color (the geodesic distance
//! of Criminisi et al., "GeoS: Geodesic Image Segmentation", ECCV 2008). An object that is read well keeps to its readings: what lies
//! without one beside it is mostly the shadow of the camera's projector or second eye, and color and depth are a few pixels apart.
//! Pictures that were registered from points have no color either where nothing was read: nothing is completed there.

use repose_geometry::Image;

use super::color::{NO_COLOR, Rgb, difference};
use crate::settings::HoleSettings;

/// Gives the masks of `labels` pixels that are `unread`, where color leads there from what was read of them.
pub fn complete(labels: &mut Image<u16>, unread: &Image<bool>, colors: &Image<Rgb>, settings: &HoleSettings) {
    let readings = counts(labels, unread, false);
    let gaining = |won: &Image<u16>| -> Vec<bool> {
        let enough = |(won, readings): (&usize, &usize)| *won as f32 >= settings.least_gain * (*readings).max(1) as f32;
        counts(won, unread, true).iter().zip(&readings).enumerate().map(|(id, counts)| id != 0 && enough(counts)).collect()
    };
    let holes = Holes { labels, unread, colors, reach: settings.reach };
    let mut open = unread.clone();
    open.pixels_mut().iter_mut().zip(colors.pixels()).for_each(|(open, color)| *open &= *color != NO_COLOR);
    // Against the background no mask gains more: mostly none gains enough without it, and all is done.
    let unopposed = holes.won(&open, |id| id != 0);
    if !gaining(&unopposed).contains(&true) {
        return;
    }
    let won = holes.won(&unopposed.map(|id| *id != 0), |_| true);
    let gaining = gaining(&won);
    let pixels = labels.pixels_mut().iter_mut().zip(won.pixels());
    pixels.filter(|(_, won)| gaining.get(usize::from(**won)).is_some_and(|gains| *gains)).for_each(|(label, won)| *label = *won);
}

/// How many pixels with or without a reading each id has.
fn counts(ids: &Image<u16>, unread: &Image<bool>, without: bool) -> Vec<usize> {
    let most = ids.pixels().iter().copied().max().unwrap_or(0);
    let mut counts = vec![0; usize::from(most) + 1];
    let of_kind = ids.pixels().iter().zip(unread.pixels()).filter(|(_, unread)| **unread == without);
    of_kind.for_each(|(id, _)| counts[usize::from(*id)] += 1);
    counts
}

/// What masks may be completed over.
struct Holes<'a> {
    labels: &'a Image<u16>,
    unread: &'a Image<bool>,
    colors: &'a Image<Rgb>,
    /// The highest cost.
    reach: u16,
}

impl Holes<'_> {
    /// Of each open pixel the id, of those that `starts` says, whose readings reach it over open pixels at the least cost; 0 where none do.
    fn won(&self, open: &Image<bool>, starts: impl Fn(u16) -> bool) -> Image<u16> {
        let (width, height) = (open.width(), open.height());
        let mut front = Front {
            won: Image::filled(width, height, 0),
            costs: vec![u16::MAX; width * height],
            waiting: vec![Vec::new(); usize::from(self.reach) + 1],
        };
        let from: Vec<bool> = self.labels.pixels().iter().zip(self.unread.pixels()).map(|(id, unread)| !unread && starts(*id)).collect();
        // Few of the open pixels are beside one that is read: they are told before anything is worked out.
        for v in 0..height {
            for u in 0..width {
                let i = v * width + u;
                let is_beside = |there: bool, j: usize| there && from[j];
                let reached = open.pixels()[i]
                    && (is_beside(u > 0, i.wrapping_sub(1))
                        || is_beside(u + 1 < width, i + 1)
                        || is_beside(v > 0, i.wrapping_sub(width))
                        || is_beside(v + 1 < height, i + width));
                if reached {
                    for j in self.beside(i).filter(|j| from[*j]) {
                        front.offer(i, self.step(i, j), self.labels.pixels()[j]);
                    }
                }
            }
        }
        for cost in 0..=self.reach {
            while let Some(i) = front.waiting[usize::from(cost)].pop() {
                for j in self.beside(i).filter(|j| open.pixels()[*j]) {
                    front.offer(j, cost.saturating_add(self.step(i, j)), front.won.pixels()[i]);
                }
            }
        }
        front.won
    }

    /// What it costs to go from a pixel to the one beside it.
    fn step(&self, i: usize, j: usize) -> u16 {
        1 + difference(self.colors.pixels()[i], self.colors.pixels()[j]).round() as u16
    }

    /// The pixels beside one.
    fn beside(&self, i: usize) -> impl Iterator<Item = usize> + use<> {
        let (width, height) = (self.labels.width(), self.labels.height());
        let (u, v) = (i % width, i / width);
        let beside =
            [(u > 0).then(|| i - 1), (u + 1 < width).then_some(i + 1), (v > 0).then(|| i - width), (v + 1 < height).then_some(i + width)];
        beside.into_iter().flatten()
    }
}

/// How far ids have come: pixels wait in the order of their costs (Dial's queue).
struct Front {
    won: Image<u16>,
    costs: Vec<u16>,
    /// By cost.
    waiting: Vec<Vec<usize>>,
}

impl Front {
    /// An id reaches a pixel at a cost.
    fn offer(&mut self, i: usize, cost: u16, id: u16) {
        if cost < self.costs[i]
            && let Some(waiting) = self.waiting.get_mut(usize::from(cost))
        {
            waiting.push(i);
            (self.costs[i], self.won.pixels_mut()[i]) = (cost, id);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RED: Rgb = [180, 40, 40];
    const DARK_RED: Rgb = [150, 34, 34];
    const GREY: Rgb = [120, 120, 120];

    /// A row of pixels three times over: labels, `?` where nothing was read; colors by letter.
    fn completed(labels: &str, colors: &str) -> String {
        let image = |row: Vec<u16>| Image::from_pixels(row.len(), 3, row.repeat(3)).unwrap();
        let unread = image(labels.chars().map(|c| u16::from(c == '?')).collect()).map(|unread| *unread == 1);
        let color = |c: char| match c {
            'r' => RED,
            'd' => DARK_RED,
            '-' => NO_COLOR,
            _ => GREY,
        };
        let colors = Image::from_pixels(colors.len(), 3, colors.chars().map(color).collect::<Vec<_>>().repeat(3)).unwrap();
        let mut labels = image(labels.chars().map(|c| c.to_digit(10).unwrap_or(0) as u16).collect());
        complete(&mut labels, &unread, &colors, &HoleSettings { reach: 40, least_gain: 0.5 });
        labels.pixels()[..labels.width()].iter().map(|id| id.to_string()).collect()
    }

    #[test]
    fn an_object_that_is_hardly_read_is_completed_as_far_as_its_color_goes() {
        assert_eq!(completed("0011??????00", "ggrrrrddddgg"), "001111111100", "over a face in another light");
        assert_eq!(completed("0011??????00", "ggrrrrrggggg"), "001111100000", "the rest is of the background");
        assert_eq!(completed("0011??????22", "ggrrrrrggggg"), "001111122222");
    }

    #[test]
    fn where_the_picture_has_no_color_nothing_is_completed() {
        assert_eq!(completed("0011??????00", "ggrr------gg"), "001100000000");
        assert_eq!(completed("0011??????00", "ggrrrr----gg"), "001111000000");
    }

    #[test]
    fn what_is_read_well_keeps_to_its_readings() {
        assert_eq!(completed("0111111??000", "grrrrrrrrggg"), "011111100000", "two of six are a shadow");
    }

    #[test]
    fn nothing_is_completed_further_than_the_reach() {
        let long = completed(&format!("11{}", "?".repeat(60)), &"r".repeat(62));
        assert_eq!(long.matches('1').count(), 42);
    }
}
