//! How different two colors are, light aside.

/// Red, green, blue.
pub type Rgb = [u8; 3];

/// What pixels hold that have no color, as where depth is wider than color: it says nothing of what shows there.
pub const NO_COLOR: Rgb = [0; 3];

/// What a level of brightness counts beside one of hue: faces of one thing are lit differently.
const BRIGHTNESS: f32 = 0.3;

/// The difference of two colors in levels: what of it no change of light explains, at the brightness of the darker one, and a share of the
/// difference in brightness. Dark colors have hardly a hue, and hardly differ.
pub fn difference(one: Rgb, other: Rgb) -> f32 {
    let [one, other] = [one, other].map(|color| color.map(f32::from));
    let dot = |a: &[f32; 3], b: &[f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let (one_level, other_level) = (dot(&one, &one).sqrt(), dot(&other, &other).sqrt());
    let darker = one_level.min(other_level);
    if darker == 0.0 {
        return BRIGHTNESS * one_level.max(other_level);
    }
    let cosine = (dot(&one, &other) / (one_level * other_level)).min(1.0);
    darker * (2.0 - 2.0 * cosine).sqrt() + BRIGHTNESS * (one_level - other_level).abs()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_hue_differs_more_than_another_light_and_nothing_from_itself() {
        assert_eq!(difference([200, 40, 40], [200, 40, 40]), 0.0);
        let shaded = difference([200, 40, 40], [140, 28, 28]);
        let other_hue = difference([200, 40, 40], [40, 200, 40]);
        assert!(shaded < 25.0 && other_hue > 200.0, "{shaded} {other_hue}");
        assert!(difference([3, 0, 0], [0, 3, 0]) < 5.0, "what is black has no hue");
        assert_eq!(difference([0, 0, 0], [0, 0, 0]), 0.0);
    }
}
