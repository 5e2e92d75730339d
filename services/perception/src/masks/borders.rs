//! The uncertain band around every mask, which is ignored.
//!
//! Depth pixels at an object's border belong to it or to what is behind it by chance; left in, they stay behind when the object is
//! moved and placements come to stand on them. So each mask is dilated and eroded, and what lies between is dropped: paper, appendix
//! "Segmentation and Grasping". A pixel lies between for some mask exactly when the square window around it holds more than one
//! label, so all masks are done at once: where the least and the greatest label of the window differ.

use repose_geometry::Image;

use crate::settings::BorderSettings;

/// Which pixels lie in the band of some mask: in its dilation but not in its erosion by a square of half-width `radius_px`.
///
/// Background (0) counts as a label; the picture's edge is not a border.
pub fn border_band(labels: &Image<u16>, settings: &BorderSettings) -> Image<bool> {
    let (width, height) = (labels.width(), labels.height());
    let radius = settings.radius_px.min(width.max(height));
    let mut band = Image::filled(width, height, false);
    if radius == 0 || width == 0 || height == 0 {
        return band;
    }
    // The least and the greatest label in each pixel's row window. Repeating the row's ends is the same as leaving out what is beyond.
    let mut least = vec![0u16; width * height];
    let mut greatest = vec![0u16; width * height];
    let mut padded = vec![0u16; width + 2 * radius];
    for (v, row) in labels.pixels().chunks_exact(width).enumerate() {
        padded[..radius].fill(row[0]);
        padded[radius..radius + width].copy_from_slice(row);
        padded[radius + width..].fill(row[width - 1]);
        let (least, greatest) = (&mut least[v * width..(v + 1) * width], &mut greatest[v * width..(v + 1) * width]);
        least.copy_from_slice(&padded[..width]);
        greatest.copy_from_slice(&padded[..width]);
        for shift in 1..=2 * radius {
            take_extremes(least, greatest, &padded[shift..shift + width], &padded[shift..shift + width]);
        }
    }
    // Then over the rows of the window; a pixel is in the band when the two differ.
    let (mut low, mut high) = (vec![0u16; width], vec![0u16; width]);
    for (v, out) in band.pixels_mut().chunks_exact_mut(width).enumerate() {
        let row = |v: usize| v * width..(v + 1) * width;
        low.copy_from_slice(&least[row(v)]);
        high.copy_from_slice(&greatest[row(v)]);
        for beside in v.saturating_sub(radius)..(v + radius + 1).min(height) {
            take_extremes(&mut low, &mut high, &least[row(beside)], &greatest[row(beside)]);
        }
        for ((out, low), high) in out.iter_mut().zip(&low).zip(&high) {
            *out = low != high;
        }
    }
    band
}

/// Element by element, the lesser and the greater.
fn take_extremes(least: &mut [u16], greatest: &mut [u16], other_least: &[u16], other_greatest: &[u16]) {
    for (a, b) in least.iter_mut().zip(other_least) {
        *a = (*a).min(*b);
    }
    for (a, b) in greatest.iter_mut().zip(other_greatest) {
        *a = (*a).max(*b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The definition, mask by mask and pixel by pixel.
    fn by_definition(labels: &Image<u16>, radius: usize) -> Image<bool> {
        let mut band = Image::filled(labels.width(), labels.height(), false);
        for v in 0..labels.height() {
            for u in 0..labels.width() {
                let columns = u.saturating_sub(radius)..(u + radius + 1).min(labels.width());
                let window = |u: usize| (v.saturating_sub(radius)..(v + radius + 1).min(labels.height())).map(move |v| labels[(u, v)]);
                let ids: Vec<u16> = columns.flat_map(window).collect();
                band[(u, v)] = ids.iter().any(|&id| {
                    let dilated = id != 0;
                    let eroded = ids.iter().all(|&other| other == id);
                    dilated && !eroded
                });
            }
        }
        band
    }

    proptest! {
        #[test]
        fn all_masks_at_once_is_the_same_as_one_by_one(
            width in 1usize..14, height in 1usize..14, radius in 0usize..5, seed in prop::collection::vec(0u16..9, 196),
        ) {
            // Ids above 3 are background, so that masks are small and their windows often pure.
            let pixels = (0..width * height).map(|i| if seed[i] > 3 { 0 } else { seed[i] }).collect();
            let labels = Image::from_pixels(width, height, pixels).unwrap();
            prop_assert_eq!(border_band(&labels, &BorderSettings { radius_px: radius }), by_definition(&labels, radius));
        }

        #[test]
        fn a_box_loses_its_rim_and_its_surroundings(u0 in 4usize..8, v0 in 4usize..8, side in 7usize..12) {
            let mut labels = Image::filled(26, 26, 0u16);
            for v in v0..v0 + side {
                for u in u0..u0 + side {
                    labels[(u, v)] = 5;
                }
            }
            let band = border_band(&labels, &BorderSettings { radius_px: 2 });
            let kept = (0..26 * 26).filter(|&i| labels.pixels()[i] == 5 && !band.pixels()[i]).count();
            prop_assert_eq!(kept, (side - 4) * (side - 4));
            let banded = band.pixels().iter().filter(|b| **b).count();
            prop_assert_eq!(banded, (side + 4) * (side + 4) - (side - 4) * (side - 4));
        }
    }
}
