//! Colors of pictures for people: objects by id, depth by a map.

use repose_geometry::Image;

use crate::Rgb;

/// Where nothing is drawn.
pub const PAPER: Rgb = [255, 255, 255];
/// Text.
pub const INK: Rgb = [20, 20, 20];

/// Colors of objects, by id; chosen to be told apart.
const PALETTE: [Rgb; 12] = [
    [230, 97, 92],
    [92, 158, 230],
    [120, 196, 100],
    [240, 180, 70],
    [160, 110, 210],
    [80, 200, 200],
    [235, 130, 190],
    [150, 130, 100],
    [190, 210, 80],
    [110, 120, 230],
    [220, 150, 120],
    [100, 170, 140],
];

/// The color that stands for an object.
pub fn object_color(id: u16) -> Rgb {
    PALETTE[usize::from(id.wrapping_sub(1)) % PALETTE.len()]
}

/// Depth (metres, 0 = no reading) from near, bright, to far, dark blue; no reading is black.
///
/// The map spans the 1st to the 99th percentile of what was read, so that a stray does not take the contrast.
pub fn depth_colors(depth_m: &Image<f32>) -> Image<Rgb> {
    /// From far to near; equal steps of brightness, so that shapes show in print too.
    const MAP: [[f32; 3]; 5] = [[40.0, 30.0, 90.0], [50.0, 90.0, 140.0], [35.0, 145.0, 140.0], [95.0, 200.0, 95.0], [250.0, 230.0, 60.0]];
    let mut read: Vec<f32> = depth_m.pixels().iter().copied().filter(|z| *z > 0.0).collect();
    read.sort_unstable_by(f32::total_cmp);
    let percentile = |share: f32| read.get((share * read.len().saturating_sub(1) as f32) as usize).copied().unwrap_or(1.0);
    let (near, far) = (percentile(0.01), percentile(0.99));
    depth_m.map(|z| {
        if *z <= 0.0 {
            return [0; 3];
        }
        let at = ((far - z) / (far - near).max(1e-6)).clamp(0.0, 1.0) * (MAP.len() - 1) as f32;
        let low = (at as usize).min(MAP.len() - 2);
        std::array::from_fn(|k| (MAP[low][k] + (MAP[low + 1][k] - MAP[low][k]) * (at - low as f32)) as u8)
    })
}

/// Objects in their colors on a grey picture of what is behind them.
pub fn label_colors(labels: &Image<u16>, color: &Image<Rgb>) -> Image<Rgb> {
    let brightness = |[r, g, b]: Rgb| u32::from(r) / 4 + u32::from(g) / 2 + u32::from(b) / 4;
    // A little of the shading stays, so that two things of one color in front of each other are still two.
    let shown = |label: u16, pixel: Rgb| match label {
        0 => [(brightness(pixel) / 2 + 90) as u8; 3],
        _ => object_color(label).map(|c| (u32::from(c) * (400 + brightness(pixel)) / 600).min(255) as u8),
    };
    let pixels = labels.pixels().iter().zip(color.pixels()).map(|(label, pixel)| shown(*label, *pixel)).collect();
    Image::from_pixels(labels.width(), labels.height(), pixels).unwrap_or_else(|_| color.clone())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn objects_keep_their_colors_whatever_they_look_like() {
        let labels = Image::from_pixels(4, 1, vec![0, 1, 1, 2]).unwrap();
        let shown = label_colors(&labels, &Image::from_pixels(4, 1, vec![[255; 3], [0; 3], [255; 3], [128; 3]]).unwrap());
        let [background, dark, bright, other] = [0, 1, 2, 3].map(|k| shown.pixels()[k]);
        assert!(background[0] == background[1] && background[1] == background[2]);
        // Red is the largest channel of the first object's color and the smallest of the second's.
        assert!(dark[0] > dark[1] && bright[0] > bright[1] && bright[0] > dark[0] && other[0] < other[2]);
    }

    #[test]
    fn no_reading_is_black_and_nearer_is_brighter() {
        let depth = Image::from_pixels(4, 1, vec![0.0, 0.5, 1.5, 2.0]).unwrap();
        let colors = depth_colors(&depth);
        let brightness = |k: usize| colors.pixels()[k].iter().map(|c| u32::from(*c)).sum::<u32>();
        assert_eq!(colors.pixels()[0], [0; 3]);
        assert!(brightness(1) > brightness(2) && brightness(2) > 0);
        let constant = depth_colors(&Image::filled(2, 2, 0.7));
        assert!(constant.pixels().iter().all(|c| *c != [0; 3]), "one depth is no hole");
    }
}
