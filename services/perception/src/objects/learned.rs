//! What the network for masks says of the coarse picture: which pixels show objects, grouped into one id each.
//!
//! The network says of each pixel whether it shows an object, and of pairs of pixels whether they show the same one
//! ([`repose_networks::masks`]); a mutex watershed groups them ([`super::watershed`]). It reads depth alone: where there is color, alike and
//! unlike pixels weigh beside what it says, which decides where two things touch without a step between them.

use std::sync::OnceLock;

use repose_geometry::{Image, Pinhole, Vector3};
use repose_networks::WeightsError;
use repose_networks::masks::{MaskInputs, MaskLogits, MaskNetwork, OFFSETS};

use super::color::{NO_COLOR, Rgb, difference};
use super::watershed::{Pair, grouped};
use crate::settings::LearnedSettings;

/// The network with the weights that come with the program, or why they cannot be read.
fn network() -> Result<&'static MaskNetwork, &'static WeightsError> {
    static NETWORK: OnceLock<Result<MaskNetwork, WeightsError>> = OnceLock::new();
    NETWORK.get_or_init(MaskNetwork::embedded).as_ref()
}

/// What the network says of a picture; none without weights that can be read. `depth_m` holds NaN where there is no reading; `up` is the unit
/// vector against gravity in the camera's frame.
pub fn logits(depth_m: &Image<f32>, camera: &Pinhole, up: &Vector3<f64>) -> Option<MaskLogits> {
    let network = network().ok()?;
    Some(network.logits(&MaskInputs::new(depth_m.pixels(), camera, up)))
}

/// An id for each object that the network sees: 1, 2, … from the largest down (ties by first pixel), 0 elsewhere. `depth_m` holds NaN where there is
/// no reading, and no object. Where the picture has `colors` they have a say in which pixels show one object.
pub fn ids(logits: &MaskLogits, depth_m: &Image<f32>, colors: Option<&Image<Rgb>>, settings: &LearnedSettings) -> Image<u16> {
    let (width, height) = (depth_m.width(), depth_m.height());
    let shows_object = |i: usize| logits.pixels[i][0] > settings.object_from && !depth_m.pixels()[i].is_nan();
    let object: Vec<bool> = (0..width * height).map(shows_object).collect();
    let mut pairs = Vec::with_capacity(object.iter().filter(|o| **o).count() * OFFSETS.len());
    for i in (0..width * height).filter(|i| object[*i]) {
        let (u, v) = (i % width, i / width);
        for (k, [du, dv]) in OFFSETS.into_iter().enumerate() {
            let Some(column) = u.checked_add_signed(du).filter(|u| *u < width) else { continue };
            let Some(row) = v.checked_add_signed(dv).filter(|v| *v < height) else { continue };
            let j = row * width + column;
            if object[j] {
                let of_colors = colors.map_or(0.0, |colors| of_colors(colors.pixels()[i], colors.pixels()[j], settings));
                let same = logits.pixels[i][1 + k] - settings.same_from + of_colors;
                pairs.push(Pair { one: i as u32, other: j as u32, same });
            }
        }
    }
    numbered(&grouped(width * height, &pairs), &object, width, height)
}

/// What the colors of two pixels add to the logit of their showing one object; nothing where one has none.
fn of_colors(one: Rgb, other: Rgb, settings: &LearnedSettings) -> f32 {
    if one == NO_COLOR || other == NO_COLOR {
        return 0.0;
    }
    let difference = difference(one, other) / settings.color_levels;
    if difference < 1.0 { settings.alike * (1.0 - difference) } else { -settings.unlike * (difference - 1.0).min(1.0) }
}

/// Fewest pixels of a group that is told of at all.
const LEAST_TOLD: u32 = 12;

/// The groups of object pixels as ids, from the largest down; those of a few pixels have none.
fn numbered(groups: &[u32], object: &[bool], width: usize, height: usize) -> Image<u16> {
    let mut sizes = vec![0u32; groups.len()];
    for (group, _) in groups.iter().zip(object).filter(|(_, object)| **object) {
        sizes[*group as usize] += 1;
    }
    let mut order: Vec<usize> = (0..sizes.len()).filter(|group| sizes[*group] >= LEAST_TOLD).collect();
    order.sort_by_key(|group| (std::cmp::Reverse(sizes[*group]), *group));
    order.truncate(usize::from(u16::MAX));
    let mut ids = vec![0u16; sizes.len()];
    for (group, id) in order.into_iter().zip(1..) {
        ids[group] = id;
    }
    let mut picture = Image::filled(width, height, 0u16);
    for ((id, group), object) in picture.pixels_mut().iter_mut().zip(groups).zip(object) {
        *id = if *object { ids[*group as usize] } else { 0 };
    }
    picture
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(rows: &[&str]) -> Image<u16> {
        let ids = rows.iter().flat_map(|row| row.chars()).map(|c| c.to_digit(10).unwrap_or(0) as u16).collect();
        Image::from_pixels(rows[0].len(), rows.len(), ids).unwrap()
    }

    #[test]
    fn pixels_are_grouped_by_what_the_network_says_of_pairs() {
        // Two rows of eight: objects in columns 0 to 2 and 3 to 5, furniture in 6, no reading in 7.
        let same = |u: usize, du: isize| {
            let other = u as isize + du;
            if (0..6).contains(&other) && u / 3 == other as usize / 3 { 5.0 } else { -5.0 }
        };
        let pixel = |u: usize| {
            let mut logits = [0.0; 1 + OFFSETS.len()];
            logits[0] = if u == 6 { -4.0 } else { 4.0 };
            for (out, [du, _]) in logits[1..].iter_mut().zip(OFFSETS) {
                *out = same(u, du);
            }
            logits
        };
        let logits = MaskLogits { width: 8, height: 4, pixels: (0..32).map(|i| pixel(i % 8)).collect() };
        let depth_m = Image::from_pixels(8, 4, (0..32).map(|i| if i % 8 == 7 { f32::NAN } else { 0.8 }).collect()).unwrap();
        assert_eq!(ids(&logits, &depth_m, None, &LearnedSettings::default()), picture(&["11122200"; 4]));
    }

    #[test]
    fn colors_decide_where_the_network_is_not_sure() {
        let settings = LearnedSettings { same_from: 0.0, ..LearnedSettings::default() };
        let depth_m = Image::filled(8, 4, 0.8);
        let of = |same: f32, left: Rgb, right: Rgb| {
            let mut pixel = [same; 1 + OFFSETS.len()];
            pixel[0] = 4.0;
            let logits = MaskLogits { width: 8, height: 4, pixels: vec![pixel; 32] };
            let colors = Image::from_pixels(8, 4, (0..32).map(|i| if i % 8 < 4 { left } else { right }).collect()).unwrap();
            ids(&logits, &depth_m, Some(&colors), &settings)
        };
        let (red, blue) = ([180, 40, 40], [40, 40, 180]);
        let (one, two) = (picture(&["11111111"; 4]), picture(&["11112222"; 4]));
        assert_eq!([of(1.0, red, red), of(-1.0, red, red)], [one.clone(), one.clone()]);
        assert_eq!([of(1.0, red, blue), of(5.0, red, blue)], [two, one.clone()], "what the network is sure of is one in two colors");
        let apart = of(-1.0, NO_COLOR, NO_COLOR);
        assert!(apart.pixels().iter().all(|id| *id == 0), "single pixels without a color are not alike");
        assert_eq!(of(0.5, red, NO_COLOR), one, "and are not unlike others");
    }
}
