//! What stands on the furniture, cut into parts, and which parts are of one object.
//!
//! This is where others may decide: a network that knows what objects look like joins the same parts by what it says.

use repose_geometry::Image;

use super::coarse::CoarseView;
use super::foreground::Foreground;
use super::tops::{self, Basin, TopView};
use super::{components, halves, hollows};
use crate::settings::ComponentSettings;

/// Parts of the foreground of the coarse picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Parts {
    /// The part of each pixel: 1, 2, … from the largest down, 0 where nothing stands.
    pub ids: Image<u16>,
    /// Pairs of parts that geometry takes for one object.
    pub together: Vec<(u16, u16)>,
}

impl Parts {
    /// The object of each pixel where these pairs of parts are together: the least of its parts' ids. Pairs of ids that are none are nothing.
    pub fn joined(&self, together: &[(u16, u16)]) -> Image<u16> {
        let most = self.ids.pixels().iter().copied().max().unwrap_or(0);
        let mut joined: Vec<u16> = (0..=most).collect();
        for (one, other) in together.iter().filter(|(one, other)| (1..=most).contains(one) && (1..=most).contains(other)) {
            let (one, other) = (joined[usize::from(*one)], joined[usize::from(*other)]);
            let (from, to) = (one.max(other), one.min(other));
            joined.iter_mut().filter(|id| **id == from).for_each(|id| *id = to);
        }
        self.ids.map(|id| joined[usize::from(*id)])
    }
}

/// The parts of the foreground of a picture.
pub fn find(view: &CoarseView<'_>, foreground: &Foreground, settings: &ComponentSettings) -> Parts {
    let depth_m = view.in_camera.map(|p| p.z);
    let top_view = TopView {
        in_world: &foreground.in_world,
        depth_m: &depth_m,
        faces_up: view.faces_up,
        rises: &foreground.rises,
        focal_px: view.focal_px,
        noise: foreground.noise,
        camera_m: view.camera_m,
    };
    let storeys = tops::find(&top_view, &settings.tops);
    let mut ids = components::find(view.in_camera, &foreground.rises, view.focal_px, settings, &|i, j| storeys.part(i, j));
    let hollow = hollows::find(&mut ids, view.in_camera, view.in_world, &settings.hollows);
    let mut parts = Parts { ids, together: hollow };
    parts.together.extend(storeys.basins.iter().filter_map(|basin| floor_and_rim(&parts.ids, basin, settings.tops.max_rim)));
    let joined = parts.joined(&parts.together);
    let halves = halves::find(&joined, view.in_camera, view.in_world, &settings.halves);
    let Parts { ids, mut together } = parts;
    together.extend(halves);
    Parts { ids, together }
}

/// The part that is a basin's floor and the one that most of its border belongs to.
fn floor_and_rim(ids: &Image<u16>, basin: &Basin, least_share: f32) -> Option<(u16, u16)> {
    let most_frequent = |pixels: &[usize], but: u16| {
        let mut counts = std::collections::BTreeMap::new();
        for id in pixels.iter().map(|i| ids.pixels()[*i]).filter(|id| *id != but) {
            *counts.entry(id).or_insert(0usize) += 1;
        }
        counts.into_iter().max_by_key(|(id, count)| (*count, std::cmp::Reverse(*id)))
    };
    let (floor, _) = most_frequent(&basin.pixels, 0)?;
    let (rim, count) = most_frequent(&basin.around, floor)?;
    let others = basin.around.iter().filter(|i| ids.pixels()[**i] != floor).count();
    (rim != 0 && count as f32 >= least_share * others as f32).then_some((floor, rim))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_that_are_together_in_a_chain_are_one_object() {
        let ids = Image::from_pixels(6, 1, vec![0, 1, 2, 3, 4, 5]).unwrap();
        let parts = Parts { ids, together: Vec::new() };
        assert_eq!(parts.joined(&[(4, 3), (2, 4), (9, 1), (0, 1)]).pixels(), [0, 1, 2, 2, 2, 5]);
        assert_eq!(parts.joined(&[]), parts.ids);
    }
}
