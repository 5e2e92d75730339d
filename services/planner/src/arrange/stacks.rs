//! Stacks: what stands on objects, directly or on others, and what of it carries nothing itself, and so can be taken first.

use std::collections::{BTreeSet, VecDeque};

/// What stands on objects, or on others that stand on them, lowest first; `carried` tells what stands on an object. Each comes once: objects that lean
/// on each other may each be said to stand on the other.
pub fn above<'a>(objects: impl IntoIterator<Item = u16>, carried: impl Fn(u16) -> &'a [u16]) -> Vec<u16> {
    let mut open: VecDeque<u16> = objects.into_iter().collect();
    let (mut known, mut above) = (BTreeSet::new(), Vec::new());
    while let Some(under) = open.pop_front() {
        for load in carried(under).iter().copied().filter(|load| known.insert(*load)) {
            open.push_back(load);
            above.push(load);
        }
    }
    above
}

/// Of [`above`] what carries nothing itself.
pub fn bare_above<'a>(objects: impl IntoIterator<Item = u16>, carried: impl Fn(u16) -> &'a [u16]) -> Vec<u16> {
    above(objects, &carried).into_iter().filter(|load| carried(*load).is_empty()).collect()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;

    #[test]
    fn the_tops_of_stacks_are_found_and_a_circle_has_an_end() {
        let loads = BTreeMap::from([(1, vec![2, 5]), (2, vec![3]), (6, vec![7]), (7, vec![6, 8])]);
        let carried = |id: u16| loads.get(&id).map_or(&[][..], Vec::as_slice);
        assert_eq!(bare_above([1], carried), [5, 3]);
        assert_eq!(bare_above([1, 2], carried), [5, 3], "each once");
        assert_eq!((above([6], carried), bare_above([6], carried)), (vec![7, 6, 8], vec![8]));
        assert_eq!((above([1], carried), bare_above([3, 4], carried)), (vec![2, 5, 3], Vec::new()));
    }
}
