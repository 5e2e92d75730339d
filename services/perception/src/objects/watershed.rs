//! Pixels grouped by what is said of pairs of them: a mutex watershed.
//!
//! Each pair of pixels is said to be of one object or of two, more or less surely. The surest pairs come first: those of one object join their
//! groups unless something surer has kept the groups apart; those of two keep their groups apart from then on unless something surer has joined
//! them. Neither centers nor a number of objects are needed (Wolf et al., "The Mutex Watershed: Efficient, Parameter-Free Image Partitioning",
//! ECCV 2018; pairs at a distance join here, too, so that what is cut in two by something in front stays one).

/// Steps of sureness that are told apart.
const STEPS: usize = 1024;
/// Logit from which on everything is as sure as can be.
const SUREST: f32 = 12.0;

/// A pair of pixels and how likely they show one object.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pair {
    /// One pixel.
    pub one: u32,
    /// The other.
    pub other: u32,
    /// Logit of their showing the same object: below 0, two are more likely.
    pub same: f32,
}

/// The group of each of `pixels` pixels, named by one of its pixels. Among equally sure pairs the earlier one comes first; a pair that is no number
/// says nothing.
pub fn grouped(pixels: usize, pairs: &[Pair]) -> Vec<u32> {
    let mut groups = Groups::apart(pixels);
    for pair in surest_first(pairs) {
        let (one, other) = (groups.of(pair.one), groups.of(pair.other));
        if one == other || groups.are_kept_apart(one, other) {
            continue;
        }
        if pair.same > 0.0 {
            groups.join(one, other);
        } else {
            groups.keep_apart(one, other);
        }
    }
    (0..pixels as u32).map(|pixel| groups.of(pixel)).collect()
}

/// The pairs by falling sureness: a counting sort, which keeps the order of equals.
fn surest_first(pairs: &[Pair]) -> Vec<Pair> {
    let step = |pair: &Pair| STEPS - 1 - ((pair.same.abs() / SUREST).min(1.0) * (STEPS - 1) as f32) as usize;
    let told = || pairs.iter().filter(|pair| !pair.same.is_nan());
    let mut starts = [0usize; STEPS + 1];
    told().for_each(|pair| starts[step(pair) + 1] += 1);
    for k in 1..=STEPS {
        starts[k] += starts[k - 1];
    }
    let mut sorted = vec![Pair { one: 0, other: 0, same: 0.0 }; starts[STEPS]];
    for pair in told() {
        let next = &mut starts[step(pair)];
        sorted[*next] = *pair;
        *next += 1;
    }
    sorted
}

/// Disjoint sets of pixels, some of which are kept apart.
struct Groups {
    /// Towards a group's first pixel, which is its own parent.
    parents: Vec<u32>,
    sizes: Vec<u32>,
    /// Of each group, by its first pixel, the groups that it is kept apart from; each of those knows of it, too.
    apart: Vec<Vec<u32>>,
}

impl Groups {
    fn apart(pixels: usize) -> Self {
        Self { parents: (0..pixels as u32).collect(), sizes: vec![1; pixels], apart: vec![Vec::new(); pixels] }
    }

    fn of(&mut self, mut pixel: u32) -> u32 {
        while self.parents[pixel as usize] != pixel {
            let parent = self.parents[pixel as usize];
            self.parents[pixel as usize] = self.parents[parent as usize];
            pixel = parent;
        }
        pixel
    }

    fn are_kept_apart(&self, one: u32, other: u32) -> bool {
        let (a, b) = (&self.apart[one as usize], &self.apart[other as usize]);
        if a.len() <= b.len() { a.contains(&other) } else { b.contains(&one) }
    }

    fn keep_apart(&mut self, one: u32, other: u32) {
        self.apart[one as usize].push(other);
        self.apart[other as usize].push(one);
    }

    /// The larger group takes the smaller one in, with all that this is kept apart from.
    fn join(&mut self, one: u32, other: u32) {
        let (from, to) = if self.sizes[one as usize] < self.sizes[other as usize] { (one, other) } else { (other, one) };
        self.parents[from as usize] = to;
        self.sizes[to as usize] += self.sizes[from as usize];
        for third in std::mem::take(&mut self.apart[from as usize]) {
            let knows = &mut self.apart[third as usize];
            if knows.contains(&to) {
                knows.retain(|group| *group != from);
                continue;
            }
            knows.iter_mut().filter(|group| **group == from).for_each(|group| *group = to);
            self.apart[to as usize].push(third);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn pair(one: u32, other: u32, same: f32) -> Pair {
        Pair { one, other, same }
    }

    /// Which pixels are together, whatever their group is called.
    fn together(groups: &[u32]) -> Vec<Vec<bool>> {
        groups.iter().map(|a| groups.iter().map(|b| a == b).collect()).collect()
    }

    #[test]
    fn what_is_surely_two_is_not_joined_by_a_chain_of_lesser_pairs() {
        let chain = [pair(0, 1, 3.0), pair(1, 2, 2.0), pair(2, 3, 3.0)];
        assert_eq!(together(&grouped(4, &chain))[0], [true; 4]);
        let cut = [chain[0], chain[1], chain[2], pair(0, 3, -2.5)];
        assert_eq!(together(&grouped(4, &cut))[0], [true, true, false, false]);
        let doubted = [chain[0], chain[1], chain[2], pair(0, 3, -1.0)];
        assert_eq!(together(&grouped(4, &doubted))[0], [true; 4]);
    }

    #[test]
    fn a_pair_at_a_distance_joins_what_is_cut_in_two() {
        let pairs = [pair(0, 1, 3.0), pair(3, 4, 3.0), pair(1, 2, -3.0), pair(2, 3, -3.0), pair(1, 3, 2.0)];
        let groups = together(&grouped(5, &pairs));
        assert!(groups[0][4] && !groups[0][2]);
    }

    #[test]
    fn what_is_no_number_says_nothing_and_nothing_is_alone() {
        assert_eq!(grouped(2, &[pair(0, 1, f32::NAN)]), [0, 1]);
        assert!(grouped(0, &[]).is_empty());
    }

    /// The same rule, worked out without any index: groups as sets, the pairs sorted whole.
    fn by_hand(pixels: u32, pairs: &[Pair]) -> Vec<Vec<bool>> {
        let mut groups: Vec<Vec<u32>> = (0..pixels).map(|p| vec![p]).collect();
        let mut apart: Vec<(u32, u32)> = Vec::new();
        for pair in surest_first(pairs) {
            let at = |groups: &[Vec<u32>], p: u32| groups.iter().position(|g| g.contains(&p)).unwrap();
            let (a, b) = (at(&groups, pair.one), at(&groups, pair.other));
            let kept = |&(x, y): &(u32, u32)| {
                (groups[a].contains(&x) && groups[b].contains(&y)) || (groups[a].contains(&y) && groups[b].contains(&x))
            };
            if a == b || apart.iter().any(kept) {
                continue;
            }
            if pair.same > 0.0 {
                let moved = groups[b].clone();
                groups[a].extend(moved);
                groups.remove(b);
            } else {
                apart.push((pair.one, pair.other));
            }
        }
        (0..pixels).map(|p| (0..pixels).map(|q| groups.iter().any(|g| g.contains(&p) && g.contains(&q))).collect()).collect()
    }

    proptest! {
        #[test]
        fn groups_are_those_of_the_rule(raw in prop::collection::vec((0u32..12, 0u32..12, -8.0f32..8.0), 0..60)) {
            let pairs: Vec<Pair> = raw.into_iter().filter(|(a, b, _)| a != b).map(|(a, b, same)| pair(a, b, same)).collect();
            prop_assert_eq!(together(&grouped(12, &pairs)), by_hand(12, &pairs));
        }
    }
}
