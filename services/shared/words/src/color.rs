//! Color names from the observed colors of an object's points.
//!
//! The eleven basic color terms of English (Berlin and Kay, 1969) as soft regions of OKLCh (Ottosson, 2020): lightness, chroma and hue
//! as people see them, from sRGB. Each point belongs to a name by a weight between 0 and 1; an object's share of a name is the mean
//! over its points. Whether something without a hue is white, grey or black is decided by its lighter points, since its shaded side is
//! darker than it is.

use crate::grade::Grade;

/// A basic color term.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum ColorTerm {
    /// No hue, light.
    White,
    /// No hue, between.
    Grey,
    /// No hue, dark.
    Black,
    /// Red.
    Red,
    /// Orange.
    Orange,
    /// Dark orange or yellow.
    Brown,
    /// Yellow.
    Yellow,
    /// Green.
    Green,
    /// Blue.
    Blue,
    /// Purple.
    Purple,
    /// Light red or magenta.
    Pink,
}

impl ColorTerm {
    /// Every name.
    pub const ALL: [Self; 11] = [
        Self::White,
        Self::Grey,
        Self::Black,
        Self::Red,
        Self::Orange,
        Self::Brown,
        Self::Yellow,
        Self::Green,
        Self::Blue,
        Self::Purple,
        Self::Pink,
    ];

    /// The name in English.
    pub fn as_str(self) -> &'static str {
        ["white", "grey", "black", "red", "orange", "brown", "yellow", "green", "blue", "purple", "pink"][self as usize]
    }
}

/// The regions of names with a hue: hue in degrees (the second end may pass 360), lightness, least chroma; in the order of [`ColorTerm`].
/// Neighbours overlap: a color on the border between two may be called either.
const REGIONS: [(ColorTerm, [f64; 2], [f64; 2], f64); 9] = [
    (ColorTerm::Red, [8.0, 42.0], [0.20, 0.68], 0.09),
    (ColorTerm::Orange, [44.0, 78.0], [0.62, 0.90], 0.10),
    (ColorTerm::Brown, [38.0, 95.0], [0.15, 0.62], 0.03),
    (ColorTerm::Yellow, [82.0, 118.0], [0.66, 1.00], 0.08),
    (ColorTerm::Green, [120.0, 175.0], [0.15, 0.97], 0.04),
    (ColorTerm::Blue, [215.0, 285.0], [0.15, 0.95], 0.05),
    (ColorTerm::Purple, [292.0, 340.0], [0.15, 0.72], 0.06),
    (ColorTerm::Pink, [335.0, 388.0], [0.68, 0.97], 0.06),
    // Magenta: called pink when light or strong, purple when dark.
    (ColorTerm::Pink, [338.0, 366.0], [0.55, 0.97], 0.14),
];
/// How far outside a region a color still partly belongs to it: hue in degrees, lightness, chroma.
const HUE_MARGIN_DEG: f64 = 14.0;
const LIGHTNESS_MARGIN: f64 = 0.08;
const CHROMA_MARGIN: f64 = 0.03;
/// Chroma up to which a color has no hue to speak of.
const COLORLESS_CHROMA: f64 = 0.03;
/// The quantile of lightness that says how light a colorless surface is where light falls on it.
const LIT_QUANTILE: f64 = 0.8;
/// Shares of an object's points from which it is, or may be, called by a name.
const SURE_SHARE: f64 = 0.5;
const POSSIBLE_SHARE: f64 = 0.18;

/// How much of an object each color name covers.
#[derive(Debug, Clone, PartialEq)]
pub struct ColorShares {
    shares: [f64; ColorTerm::ALL.len()],
}

impl ColorShares {
    /// The shares of an object's points; `None` without any.
    pub fn of(colors: &[[u8; 3]]) -> Option<Self> {
        if colors.is_empty() {
            return None;
        }
        let mut shares = [0.0; ColorTerm::ALL.len()];
        let mut colorless = 0.0;
        let mut lightness: Vec<f64> = Vec::new();
        for rgb in colors {
            let [l, chroma, hue_deg] = oklch(*rgb);
            let without_hue = falls(chroma, COLORLESS_CHROMA, CHROMA_MARGIN);
            colorless += without_hue;
            if without_hue > 0.5 {
                lightness.push(l);
            }
            // A name that has two regions is said once of a point that is in both.
            let mut weights = [0.0; ColorTerm::ALL.len()];
            for (color, hues, lights, least_chroma) in REGIONS {
                let weight =
                    hue_weight(hue_deg, hues) * trapezoid(l, lights, LIGHTNESS_MARGIN) * rises(chroma, least_chroma, CHROMA_MARGIN);
                weights[color as usize] = f64::max(weights[color as usize], weight);
            }
            for (share, weight) in shares.iter_mut().zip(weights) {
                *share += weight / colors.len() as f64;
            }
        }
        if !lightness.is_empty() {
            lightness.sort_by(f64::total_cmp);
            let lit = lightness[((lightness.len() - 1) as f64 * LIT_QUANTILE) as usize];
            let share = colorless / colors.len() as f64;
            shares[ColorTerm::White as usize] = share * rises(lit, 0.80, 0.12);
            shares[ColorTerm::Grey as usize] = share * trapezoid(lit, [0.46, 0.72], 0.09);
            shares[ColorTerm::Black as usize] = share * falls(lit, 0.34, 0.12);
        }
        Some(Self { shares: shares.map(|s| s.min(1.0)) })
    }

    /// How much of the object a name covers, 0 to 1.
    pub fn share(&self, color: ColorTerm) -> f64 {
        self.shares[color as usize]
    }

    /// Whether people would call the object that.
    pub fn is(&self, color: ColorTerm) -> Grade {
        Grade::at_least(self.share(color), SURE_SHARE, POSSIBLE_SHARE)
    }

    /// The name that fits best, if any does.
    pub fn name(&self) -> Option<ColorTerm> {
        let best = ColorTerm::ALL.into_iter().max_by(|a, b| self.share(*a).total_cmp(&self.share(*b)))?;
        (self.share(best) >= POSSIBLE_SHARE).then_some(best)
    }
}

/// Lightness (0 to 1), chroma (0 to about 0.3) and hue (degrees, 0 to 360) of an 8-bit sRGB color.
pub fn oklch(rgb: [u8; 3]) -> [f64; 3] {
    let [r, g, b] = rgb.map(|c| {
        let c = f64::from(c) / 255.0;
        if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
    });
    let l = (0.4122214708 * r + 0.5363325363 * g + 0.0514459929 * b).cbrt();
    let m = (0.2119034982 * r + 0.6806995451 * g + 0.1073969566 * b).cbrt();
    let s = (0.0883024619 * r + 0.2817188376 * g + 0.6299787005 * b).cbrt();
    let lightness = 0.2104542553 * l + 0.7936177850 * m - 0.0040720468 * s;
    let a = 1.9779984951 * l - 2.4285922050 * m + 0.4505937099 * s;
    let b = 0.0259040371 * l + 0.7827717662 * m - 0.8086757660 * s;
    [lightness, a.hypot(b), b.atan2(a).to_degrees().rem_euclid(360.0)]
}

/// 1 from `edge` upwards, falling to 0 over `margin` below it.
fn rises(value: f64, edge: f64, margin: f64) -> f64 {
    ((value - edge) / margin + 1.0).clamp(0.0, 1.0)
}

/// 1 up to `edge`, falling to 0 over `margin` above it.
fn falls(value: f64, edge: f64, margin: f64) -> f64 {
    ((edge - value) / margin + 1.0).clamp(0.0, 1.0)
}

fn trapezoid(value: f64, [low, high]: [f64; 2], margin: f64) -> f64 {
    rises(value, low, margin).min(falls(value, high, margin))
}

fn hue_weight(hue_deg: f64, hues: [f64; 2]) -> f64 {
    // A region, or its margin, may reach beyond either end of the circle.
    [hue_deg - 360.0, hue_deg, hue_deg + 360.0].into_iter().map(|h| trapezoid(h, hues, HUE_MARGIN_DEG)).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plain_colors_have_their_names() {
        let named = [
            ([250, 250, 250], ColorTerm::White),
            ([128, 128, 128], ColorTerm::Grey),
            ([20, 20, 22], ColorTerm::Black),
            ([220, 20, 30], ColorTerm::Red),
            ([110, 20, 25], ColorTerm::Red),
            ([110, 5, 35], ColorTerm::Red),
            ([255, 140, 0], ColorTerm::Orange),
            ([139, 69, 19], ColorTerm::Brown),
            ([240, 215, 40], ColorTerm::Yellow),
            ([30, 130, 50], ColorTerm::Green),
            ([140, 220, 140], ColorTerm::Green),
            ([30, 60, 200], ColorTerm::Blue),
            ([20, 30, 90], ColorTerm::Blue),
            ([130, 180, 240], ColorTerm::Blue),
            ([120, 40, 160], ColorTerm::Purple),
            ([245, 150, 185], ColorTerm::Pink),
        ];
        for (rgb, color) in named {
            let shares = ColorShares::of(&[rgb]).expect("a point");
            assert_eq!(shares.name(), Some(color), "{rgb:?}: {:?}", oklch(rgb));
            assert_eq!(shares.is(color), Grade::Yes, "{rgb:?}: {}", shares.share(color));
        }
    }

    #[test]
    fn a_shaded_side_leaves_white_white_and_two_colors_leave_either_possible() {
        let white: Vec<[u8; 3]> = (0..100).map(|i| [150 + i; 3]).collect();
        assert_eq!(ColorShares::of(&white).expect("points").is(ColorTerm::White), Grade::Yes);
        let mut striped = vec![[220, 20, 30]; 30];
        striped.extend([[30, 60, 200]; 70]);
        let shares = ColorShares::of(&striped).expect("points");
        assert_eq!(
            (shares.is(ColorTerm::Blue), shares.is(ColorTerm::Red), shares.is(ColorTerm::Green)),
            (Grade::Yes, Grade::Maybe, Grade::No)
        );
    }

    #[test]
    fn a_name_with_two_regions_counts_a_point_once() {
        let mut printed = vec![[255, 105, 180]; 40];
        printed.extend([[30, 60, 200]; 60]);
        let shares = ColorShares::of(&printed).expect("points");
        assert_eq!((shares.name(), shares.is(ColorTerm::Pink)), (Some(ColorTerm::Blue), Grade::Maybe));
        assert!((shares.share(ColorTerm::Pink) - 0.4).abs() < 1e-9);
    }

    #[test]
    fn red_does_not_end_where_the_circle_of_hues_does() {
        let wine = [125, 45, 75];
        assert!(oklch(wine)[2] > 355.0, "{:?}", oklch(wine));
        assert_eq!(ColorShares::of(&[wine]).expect("a point").name(), Some(ColorTerm::Red));
    }

    #[test]
    fn oklch_of_primaries_is_as_published() {
        let close = |rgb, expected: [f64; 3]| {
            let got = oklch(rgb);
            assert!((0..3).all(|k| (got[k] - expected[k]).abs() < [0.01, 0.01, 1.0][k]), "{rgb:?}: {got:?}");
        };
        close([255, 0, 0], [0.628, 0.258, 29.2]);
        close([0, 255, 0], [0.866, 0.295, 142.5]);
        close([0, 0, 255], [0.452, 0.313, 264.1]);
    }
}
