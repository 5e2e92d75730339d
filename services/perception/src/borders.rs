//! The uncertain band around every mask, which is ignored.
//!
//! Depth pixels at an object's border belong to it or to what is behind it by chance; left in, they stay behind when the object is
//! moved and placements come to stand on them. So each mask is dilated and eroded, and what lies between is dropped: paper, appendix
//! "Segmentation and Grasping". A pixel lies between for some mask exactly when the square window around it holds more than one
//! label, so all masks are done at once, with two passes of run lengths and no work per object.

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
    // First along rows: a pixel is mixed when its row window holds a second label.
    for (row, out) in labels.pixels().chunks_exact(width).zip(band.pixels_mut().chunks_exact_mut(width)) {
        for u in 1..width {
            if row[u] != row[u - 1] {
                out[u.saturating_sub(radius)..(u + radius).min(width)].fill(true);
            }
        }
    }
    // Then along columns: a window is pure when its rows are, and their middle pixels agree. `until[u]` is the first row that the
    // latest impurity above no longer reaches; impurities below reach up when they are met.
    let rows_mixed = band.clone();
    let (labels, rows_mixed) = (labels.pixels(), rows_mixed.pixels());
    let out = band.pixels_mut();
    let mut until = vec![0usize; width];
    for v in 0..height {
        for (u, until) in until.iter_mut().enumerate() {
            let i = v * width + u;
            let changes = v > 0 && labels[i] != labels[i - width];
            let starts = rows_mixed[i] && (v == 0 || !rows_mixed[i - width]);
            if changes || starts {
                for above in v.saturating_sub(radius)..v {
                    out[above * width + u] = true;
                }
            }
            if changes {
                *until = (*until).max(v + radius);
            }
            if rows_mixed[i] {
                *until = (*until).max(v + radius + 1);
            }
            if v < *until {
                out[i] = true;
            }
        }
    }
    band
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
