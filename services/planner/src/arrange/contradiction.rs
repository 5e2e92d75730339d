//! Goals that no arrangement of any objects satisfies, told without looking at a scene.
//!
//! Who stands `left_of` another has its centre to the left of the other's (the paper's definition asks more than that): so the relation is a
//! strict order of centres, and so are `in_front_of` and `below`. A circle in one of them cannot be; nor can a term together with its
//! negation, `touching` without `near`, or `centered` beside something.

use std::collections::{BTreeMap, VecDeque};

use repose_proto::arrange::ObjectGoal;
use repose_proto::{GoalTerm, Relation};

/// A term with the object that it is about.
type Stated = (u16, GoalTerm);

/// The terms that contradict each other, as few as there are; none where nothing does.
pub fn contradiction(goals: &[ObjectGoal]) -> Option<Vec<ObjectGoal>> {
    let stated: Vec<Stated> = goals.iter().flat_map(|goal| goal.terms.iter().map(|term| (goal.object, *term))).collect();
    let pairs = stated.iter().enumerate().flat_map(|(i, a)| stated[i + 1..].iter().map(move |b| [*a, *b]));
    let of_two = pairs.filter(|[a, b]| excludes(a, b) || excludes(b, a)).map(|pair| pair.to_vec()).next();
    of_two.or_else(|| shortest_circle(&stated)).map(|terms| grouped(&terms))
}

/// The order of centres that a term asks for: along which axis, who has less of it, and who more.
fn order((object, term): &Stated) -> Option<(usize, u16, u16)> {
    let (axis, less_first) = match term.relation {
        Relation::LeftOf => (0, true),
        Relation::RightOf => (0, false),
        Relation::InFrontOf => (1, true),
        Relation::Behind => (1, false),
        Relation::Below => (2, true),
        Relation::Above => (2, false),
        Relation::Near | Relation::Touching | Relation::Centered | Relation::Aligned => return None,
    };
    let (less, more) = if less_first { (*object, term.anchor) } else { (term.anchor, *object) };
    Some((axis, less, more))
}

/// Whether one term, which must hold, rules the other out.
fn excludes(a: &Stated, b: &Stated) -> bool {
    let pair = |(object, term): &Stated| (*object.min(&term.anchor), *object.max(&term.anchor));
    if !a.1.holds || pair(a) != pair(b) {
        return false;
    }
    match (order(a), order(b), b.1.holds) {
        // The same order, denied.
        (Some(one), Some(other), false) => one == other,
        // Level neighbours are not centered.
        (Some((axis, ..)), None, true) => axis < 2 && b.1.relation == Relation::Centered,
        (None, None, false) => a.1.relation == b.1.relation || (a.1.relation, b.1.relation) == (Relation::Touching, Relation::Near),
        _ => false,
    }
}

/// The fewest terms that order centres in a circle.
fn shortest_circle(stated: &[Stated]) -> Option<Vec<Stated>> {
    let circles = (0..3).flat_map(|axis| {
        let edges: Vec<(u16, u16, Stated)> = stated
            .iter()
            .filter(|s| s.1.holds)
            .filter_map(|s| order(s).filter(|o| o.0 == axis).map(|(_, less, more)| (less, more, *s)))
            .collect();
        edges.iter().filter_map(|(less, more, first)| Some([vec![*first], way(&edges, *more, *less)?].concat())).collect::<Vec<_>>()
    });
    circles.min_by_key(Vec::len)
}

/// The terms along the shortest way from one object to another.
fn way(edges: &[(u16, u16, Stated)], from: u16, to: u16) -> Option<Vec<Stated>> {
    let mut reached: BTreeMap<u16, Vec<Stated>> = BTreeMap::from([(from, Vec::new())]);
    let mut open = VecDeque::from([from]);
    while let Some(at) = open.pop_front() {
        if at == to {
            return reached.remove(&to);
        }
        for (_, more, stated) in edges.iter().filter(|(less, ..)| *less == at) {
            if !reached.contains_key(more) {
                let terms = [reached[&at].clone(), vec![*stated]].concat();
                reached.insert(*more, terms);
                open.push_back(*more);
            }
        }
    }
    None
}

fn grouped(stated: &[Stated]) -> Vec<ObjectGoal> {
    let mut by_object: BTreeMap<u16, Vec<GoalTerm>> = BTreeMap::new();
    for (object, term) in stated {
        by_object.entry(*object).or_default().push(*term);
    }
    by_object.into_iter().map(|(object, terms)| ObjectGoal { object, terms }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Objects with their terms.
    type Texts<'a> = &'a [(u16, &'a [&'a str])];

    fn found(texts: Texts<'_>) -> Option<Vec<String>> {
        let goal =
            |(object, terms): &(u16, &[&str])| ObjectGoal { object: *object, terms: terms.iter().map(|t| t.parse().unwrap()).collect() };
        let goals: Vec<ObjectGoal> = texts.iter().map(goal).collect();
        contradiction(&goals).map(|goals| goals.iter().map(ToString::to_string).collect())
    }

    #[test]
    fn circles_of_an_order_and_terms_that_exclude_each_other_are_named() {
        let cases: [(Texts<'_>, &[&str]); 7] = [
            (&[(1, &["left_of:2"]), (2, &["left_of:3"]), (3, &["left_of:1", "near:2"])], &["1=left_of:2", "2=left_of:3", "3=left_of:1"]),
            (&[(1, &["left_of:2"]), (2, &["left_of:1"])], &["1=left_of:2", "2=left_of:1"]),
            (&[(1, &["above:2", "near:3"]), (2, &["above:1"])], &["1=above:2", "2=above:1"]),
            (&[(1, &["near:2", "not:near:2"])], &["1=near:2,not:near:2"]),
            (&[(1, &["touching:2"]), (2, &["not:near:1"])], &["1=touching:2", "2=not:near:1"]),
            (&[(1, &["left_of:2"]), (2, &["not:right_of:1"])], &["1=left_of:2", "2=not:right_of:1"]),
            (&[(1, &["centered:2", "behind:2"])], &["1=centered:2,behind:2"]),
        ];
        for (goals, expected) in cases {
            assert_eq!(found(goals).as_deref(), Some(expected.iter().map(|s| (*s).to_owned()).collect::<Vec<_>>().as_slice()), "{goals:?}");
        }
    }

    #[test]
    fn what_can_be_is_let_through() {
        let cases: [Texts<'_>; 4] = [
            &[(1, &["left_of:2"]), (2, &["right_of:1"])],
            &[(1, &["left_of:2"]), (2, &["behind:1"]), (3, &["left_of:1"])],
            &[(1, &["near:2", "not:touching:2"])],
            &[(1, &["above:2", "centered:2"]), (2, &["not:left_of:1"])],
        ];
        for goals in cases {
            assert_eq!(found(goals), None, "{goals:?}");
        }
    }
}
