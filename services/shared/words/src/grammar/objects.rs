//! Descriptions of objects: articles, adjectives, nouns and numbers, and what follows a noun.

use super::{DEEPEST, Read, Text, bounded};
use crate::description::{Clause, Description, Distance, Head, Pick, Telling};
use crate::vocabulary as v;

impl Text<'_> {
    /// A description with a noun, a number, or a superlative.
    pub(super) fn object(&self, at: usize, depth: usize) -> Read<Description> {
        let mut found = self.any_object(at, depth);
        found.retain(|(d, _)| d.head.is_some() || d.number.is_some());
        found
    }

    pub(super) fn any_object(&self, at: usize, depth: usize) -> Read<Description> {
        let mut found = Vec::new();
        if depth > DEEPEST {
            return found;
        }
        for start in self.maybe(at, v::ARTICLES) {
            let (other, start) = if self.is(start, "other") { (true, start + 1) } else { (false, start) };
            let bare = Description { other, ..Description::default() };
            for (described, end) in self.adjectives(&bare, start) {
                for (named, end) in self.noun(&described, end, end > start) {
                    found.extend(self.after_noun(named, end, depth));
                }
            }
        }
        for (description, end) in &mut found {
            description.span = (at, *end);
        }
        bounded(found)
    }

    /// Any number of adjectives. An ordinal counts by the comparison after it, "second largest", or by what follows the noun.
    fn adjectives(&self, so_far: &Description, at: usize) -> Read<Description> {
        let mut found = vec![(so_far.clone(), at)];
        let mut longer = |next: &Description, at: usize| found.extend(self.adjectives(next, at));
        for (color, end) in self.any(at, v::COLORS) {
            longer(&Description { colors: with(&so_far.colors, color), ..so_far.clone() }, end);
        }
        for (shape, end) in self.any(at, v::SHAPES) {
            longer(&Description { shapes: with(&so_far.shapes, shape), ..so_far.clone() }, end);
        }
        let picks = self.any(at, v::PICKS);
        // "Farthest right" is no comparison by how far away and another by how far right; "farthest right of the box" is one and a place.
        let longest = picks.iter().map(|(_, end)| *end).max().filter(|end| self.one_of(*end, v::SIDE).is_empty());
        for ((measure, least), end) in picks.into_iter().filter(|(_, end)| longest.is_none_or(|longest| *end == longest)) {
            let pick = Pick { measure, least, rank: Some(so_far.ordinal.unwrap_or(1)), telling: Telling::Always };
            longer(&Description { picks: with(&so_far.picks, pick), ordinal: None, ..so_far.clone() }, end);
        }
        for (measure, end) in self.any(at, v::MIDDLES) {
            let pick = Pick { measure, least: true, rank: None, telling: Telling::Always };
            longer(&Description { picks: with(&so_far.picks, pick), ..so_far.clone() }, end);
        }
        if so_far.ordinal.is_none() {
            for (rank, end) in self.any(at, v::ORDINALS) {
                longer(&Description { ordinal: Some(rank), ..so_far.clone() }, end);
            }
        }
        bounded(found)
    }

    /// A noun, a number, both, or (after adjectives) nothing.
    fn noun(&self, described: &Description, at: usize, has_adjectives: bool) -> Read<Description> {
        let mut found = Vec::new();
        let numbered = |at: usize| -> Option<(u16, usize)> {
            let at = if self.is(at, "number") { at + 1 } else { at };
            Some((self.words.get(at)?.parse().ok()?, at + 1))
        };
        for (noun, (head, plural)) in v::NOUNS {
            if self.is(at, noun) {
                let named = Description { head: Some(*head), ..described.clone() };
                if let Some((number, end)) = numbered(at + 1) {
                    found.push((Description { number: Some(number), ..named.clone() }, end));
                }
                found.push((named, at + 1));
            }
            if self.is(at, plural) {
                found.push((Description { head: Some(*head), plural: true, ..described.clone() }, at + 1));
            }
        }
        if self.is(at, "number")
            && let Some((number, end)) = numbered(at)
        {
            found.push((Description { number: Some(number), ..described.clone() }, end));
        }
        if has_adjectives {
            // "the largest" is a whole phrase, "the left" is not.
            let compared = ["est", "er", "most"].iter().any(|ending| self.words[at - 1].ends_with(ending));
            let head = (compared && !described.picks.is_empty() && described.ordinal.is_none()).then_some(Head::One);
            found.push((Description { head, ..described.clone() }, at));
        }
        found
    }

    /// What follows a noun and belongs to it.
    fn after_noun(&self, named: Description, at: usize, depth: usize) -> Read<Description> {
        let mut found = Vec::new();
        if let Some(rank) = named.ordinal {
            for ((measure, least), end) in self.any(at, v::FROM) {
                let pick = Pick { measure, least, rank: Some(rank), telling: Telling::Always };
                let counted = Description { picks: with(&named.picks, pick), ordinal: None, ..named.clone() };
                found.extend(self.after_noun(counted, end, depth));
            }
            return found;
        }
        let that_is = self.one_of(at, v::THAT_IS).into_iter().map(|at| (at, Telling::Always));
        let starts: Vec<(usize, Telling)> = std::iter::once((at, Telling::IfNeeded)).chain(that_is).collect();
        for (at, telling) in starts.iter().copied() {
            for ((measure, least), end) in self.any(at, v::PLACES) {
                let pick = Pick { measure, least, rank: Some(1), telling };
                found.extend(self.after_noun(Description { picks: with(&named.picks, pick), ..named.clone() }, end, depth));
            }
            for (measure, end) in self.any(at, v::MIDDLE_PLACES) {
                let pick = Pick { measure, least: true, rank: None, telling };
                found.extend(self.after_noun(Description { picks: with(&named.picks, pick), ..named.clone() }, end, depth));
            }
            if named.distance.is_none() {
                for (nearest, at) in self.any(at, v::DISTANCES) {
                    for (to, end) in self.object(at, depth + 1) {
                        let distance = Distance { nearest, to: Box::new(to), telling };
                        found.push((Description { distance: Some(distance), ..named.clone() }, end));
                    }
                }
            }
        }
        for (at, telling) in starts {
            for ((relations, holds), at) in self.relation(at, true) {
                // "The bowl on the plate" describes a bowl that stands there, whether or not there is another.
                let describes = telling == Telling::IfNeeded && relations.iter().any(|relation| v::SELDOM.contains(relation));
                let telling = if describes { Telling::IfTrue } else { telling };
                for (anchor, end) in self.object(at, depth + 1).into_iter().filter(|_| holds) {
                    let clause = Clause { relations, anchor: Box::new(anchor), telling };
                    found.push((Description { clauses: with(&named.clauses, clause), ..named.clone() }, end));
                }
            }
        }
        found.push((named, at));
        found
    }
}

fn with<T: Clone>(items: &[T], more: T) -> Vec<T> {
    items.iter().cloned().chain([more]).collect()
}
