//! How likely an object fills the space over a level and under it, by the network that completes shapes ([`crate::completion`]): a bottom that is believed
//! too low has nothing over it, and one that is believed too high has something under it. The network sees what the trees that choose among levels are not
//! told: the whole object, and what is around it.

use std::collections::BTreeMap;

use rayon::prelude::*;
use repose_networks::completion::SLABS;

use crate::completion::filled;
use crate::foot_levels::Level;
use crate::shape::Shape;
use crate::standing::ObservedGeometry;

/// How many numbers [`Filling::measures`] has.
const COUNT: usize = 9;
/// Said of a slab under the grid, and of one over it or where the network says nothing.
const UNDER: f32 = -1.0;
const UNKNOWN: f32 = -2.0;
/// A level is that of the slab which this is in, over it, metres.
const OVER_M: f32 = 0.002;

/// The network that completes shapes is told of levels at most so far below the object's lowest points, metres: its slabs are an eighth of the whole.
const DEEPEST_M: f32 = 0.2;

/// How likely an object that is believed to stand at some height fills the slabs over that.
#[derive(Debug, Clone, Copy)]
pub struct Filling {
    /// Where they begin, world z, and how high each is, metres.
    bottom_m: f32,
    slab_m: f32,
    /// How likely its likeliest place is filled, by slab.
    most: [f32; SLABS],
    /// How much of it is, as a share of the slab of which most is.
    shares: [f32; SLABS],
}

impl Filling {
    /// Of all objects of which the network says something, by the shapes that they are told with: as the rules complete them, with nothing said yet of how
    /// likely the foot is.
    pub fn of(seen: &ObservedGeometry<'_>, shapes: &BTreeMap<u16, Shape>) -> BTreeMap<u16, Self> {
        let of = |(id, shape): (&u16, &Shape)| {
            let told = seen.told(*id, shape)?;
            let cells = filled(&told)?;
            let of_slab = |with: fn(f32, f32) -> f32| std::array::from_fn(|slab| cells.iter().map(|cell| cell[slab]).fold(0.0, with));
            let (most, sums): ([f32; SLABS], [f32; SLABS]) = (of_slab(f32::max), of_slab(|sum, cell| sum + cell));
            let largest = sums.iter().copied().fold(f32::MIN_POSITIVE, f32::max);
            Some((*id, Self { bottom_m: told.grid.bottom_m, slab_m: told.grid.slab_m, most, shares: sums.map(|sum| sum / largest) }))
        };
        shapes.par_iter().filter_map(of).collect()
    }

    /// What it says of a level: how likely the slabs over it, under it, next over and next under are filled, how much of the first two is; the same of
    /// the lowest two slabs of all, and how far the level is over them, metres.
    pub fn measures(&self, level_m: f32) -> [f32; COUNT] {
        let first = ((level_m + OVER_M - self.bottom_m) / self.slab_m.max(1e-4)).floor();
        let of = |slabs: &[f32; SLABS], slab: f32| {
            if slab < 0.0 { UNDER } else { slabs.get(slab as usize).copied().unwrap_or(UNKNOWN) }
        };
        let most = [0.0, -1.0, 1.0, -2.0].map(|off| of(&self.most, first + off));
        let shares = [0.0, -1.0].map(|off| of(&self.shares, first + off));
        [most[0], most[1], most[2], most[3], shares[0], shares[1], self.most[0], self.most[1], level_m - self.bottom_m]
    }

    /// What is said of a level of which the network says nothing.
    pub const UNSAID: [f32; COUNT] = [UNKNOWN; COUNT];
}

/// Where each object would stand if it stood as low as it may, of its levels that are not too deep, world z, metres.
pub fn lowest(levels: &BTreeMap<u16, Vec<Level>>, seen: &ObservedGeometry<'_>) -> BTreeMap<u16, f32> {
    let of = |(id, levels): (&u16, &Vec<Level>)| {
        let deepest_m = seen.extents.get(id)?.lowest_m - DEEPEST_M;
        let low_m = levels.iter().map(|level| level.height_m).filter(|height_m| *height_m >= deepest_m).reduce(f32::min)?;
        Some((*id, low_m))
    };
    levels.iter().filter_map(of).collect()
}

/// Adds to what is measured of levels what the network says, told that objects stand as low as they may and where the rule says.
pub fn add(levels: &mut BTreeMap<u16, Vec<Level>>, fillings: [&BTreeMap<u16, Filling>; 2]) {
    for (id, levels) in levels {
        for level in levels {
            let of =
                |fillings: &BTreeMap<u16, Filling>| fillings.get(id).map_or(Filling::UNSAID, |filling| filling.measures(level.height_m));
            level.measures.extend(fillings.map(of).concat());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_said_of_a_level_is_of_the_slabs_over_and_under_it() {
        let most = [0.1, 0.2, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4];
        let filling = Filling { bottom_m: 0.1, slab_m: 0.01, most, shares: most.map(|likely| likely / 2.0) };
        let [over, under, next_over, next_under, share_over, share_under, first, second, above_m] = filling.measures(0.12);
        assert_eq!([over, under, next_over, next_under], [0.9, 0.2, 0.8, 0.1]);
        assert_eq!([share_over, share_under, first, second], [0.45, 0.1, 0.1, 0.2]);
        assert!((above_m - 0.02).abs() < 1e-6);
        // What is measured a little lower than a slab's bottom is at it.
        assert_eq!(filling.measures(0.1185)[..2], [0.9, 0.2]);
        assert_eq!(filling.measures(0.1)[..4], [0.1, UNDER, 0.2, UNDER]);
        assert_eq!(filling.measures(0.3)[..2], [UNKNOWN, UNKNOWN]);
    }
}
