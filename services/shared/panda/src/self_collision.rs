//! Whether the arm touches itself.
//!
//! The table names the pairs of links that can touch within the position limits. It is derived, not copied: neighbours in the chain overlap
//! by construction, other pairs never meet, and a test samples the configurations to see that exactly the rest is in the table.

use crate::{PlacedSphere, SPHERE_COUNT, spheres::Link};

/// Pairs of links that can touch.
pub const SELF_COLLISION_PAIRS: &[(Link, Link)] = &[
    (Link::Link0, Link::Link5),
    (Link::Link0, Link::Link6),
    (Link::Link0, Link::Link7),
    (Link::Link0, Link::Hand),
    (Link::Link0, Link::LeftFinger),
    (Link::Link0, Link::RightFinger),
    (Link::Link1, Link::Link5),
    (Link::Link1, Link::Link6),
    (Link::Link1, Link::Link7),
    (Link::Link1, Link::Hand),
    (Link::Link1, Link::LeftFinger),
    (Link::Link1, Link::RightFinger),
    (Link::Link2, Link::Link5),
    (Link::Link2, Link::Link6),
    (Link::Link2, Link::Link7),
    (Link::Link2, Link::Hand),
    (Link::Link2, Link::LeftFinger),
    (Link::Link2, Link::RightFinger),
    (Link::Link5, Link::Hand),
    (Link::Link5, Link::LeftFinger),
    (Link::Link5, Link::RightFinger),
];

/// Whether any sphere of one link overlaps a sphere of another that it must not touch.
///
/// `spheres` are those of [`crate::spheres_in_base`].
pub fn self_collides(spheres: &[PlacedSphere; SPHERE_COUNT]) -> bool {
    SELF_COLLISION_PAIRS.iter().any(|&(a, b)| links_touch(spheres, a, b))
}

fn links_touch(spheres: &[PlacedSphere; SPHERE_COUNT], a: Link, b: Link) -> bool {
    spheres[a.sphere_range()].iter().any(|p| {
        spheres[b.sphere_range()].iter().any(|q| {
            let reach_m = p.radius_m + q.radius_m;
            (p.center - q.center).norm_squared() < reach_m * reach_m
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{LIMITS, LinkFrames, READY, spheres::LINKS, spheres_in_base};
    use rand::{RngExt, SeedableRng};

    #[test]
    fn the_ready_pose_is_free_and_a_folded_arm_is_not() {
        assert!(!self_collides(&spheres_in_base(&LinkFrames::at(&READY), 0.08)));
        let folded = [0.0, -1.5, 0.0, -3.0, 0.0, 0.1, 0.0];
        assert!(self_collides(&spheres_in_base(&LinkFrames::at(&folded), 0.08)));
    }

    #[test]
    fn the_table_holds_exactly_the_pairs_of_links_that_sometimes_touch() {
        let mut rng = rand_pcg::Pcg64::seed_from_u64(1);
        const SAMPLES: usize = 20_000;
        let mut touches = [[0usize; LINKS.len()]; LINKS.len()];
        for _ in 0..SAMPLES {
            let joints = LIMITS.between(&std::array::from_fn(|_| rng.random_range(0.0..1.0)));
            let spheres = spheres_in_base(&LinkFrames::at(&joints), 0.08);
            for (i, k) in pairs() {
                touches[i][k] += usize::from(links_touch(&spheres, LINKS[i], LINKS[k]));
            }
        }
        for (i, k) in pairs() {
            let sometimes = (1..SAMPLES).contains(&touches[i][k]);
            let listed = SELF_COLLISION_PAIRS.contains(&(LINKS[i], LINKS[k]));
            assert_eq!(sometimes, listed, "{:?} and {:?} touched in {} of {SAMPLES}", LINKS[i], LINKS[k], touches[i][k]);
        }
    }

    fn pairs() -> impl Iterator<Item = (usize, usize)> {
        (0..LINKS.len()).flat_map(|i| (i + 1..LINKS.len()).map(move |k| (i, k)))
    }
}
