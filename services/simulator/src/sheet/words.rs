//! Relations in words, short enough for a picture's margin.

use repose_proto::Relation;
use repose_relations::RELATIONS;

/// For each object what holds from it to others, as in `left_of 2 3; near 2 (4.1 mm)`; empty where nothing does.
///
/// Each fact is said once: of a relation and its mirror image (`left_of`, `right_of`) the first, and a symmetric one by the lower id.
/// `relations` and `gaps_m` are `[n * n]` of `query * n + anchor`; ids are 1, 2, … in order.
pub fn relations_in_words(relations: &[[bool; RELATIONS]], gaps_m: &[f32], n: usize) -> Vec<String> {
    const DIRECTED: [Relation; 3] = [Relation::LeftOf, Relation::InFrontOf, Relation::Above];
    const SYMMETRIC: [Relation; 4] = [Relation::Near, Relation::Touching, Relation::Centered, Relation::Aligned];
    let of_query = |query: usize| {
        let said = |relation: &Relation| {
            let first = if SYMMETRIC.contains(relation) { query + 1 } else { 0 };
            let anchors: Vec<String> = (first..n)
                .filter(|anchor| *anchor != query && relations[query * n + anchor][relation.index()])
                .map(|anchor| match relation {
                    Relation::Near => format!("{} ({:.1} mm)", anchor + 1, 1000.0 * gaps_m[query * n + anchor]),
                    _ => (anchor + 1).to_string(),
                })
                .collect();
            (!anchors.is_empty()).then(|| format!("{} {}", relation.as_str(), anchors.join(" ")))
        };
        DIRECTED.iter().chain(&SYMMETRIC).filter_map(said).collect::<Vec<_>>().join("; ")
    };
    (0..n).map(of_query).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_fact_is_said_once() {
        let mut relations = vec![[false; RELATIONS]; 9];
        let mut holds = |query: usize, anchor: usize, relation: Relation| relations[query * 3 + anchor][relation.index()] = true;
        holds(0, 1, Relation::LeftOf);
        holds(0, 2, Relation::LeftOf);
        holds(1, 0, Relation::RightOf);
        holds(2, 0, Relation::RightOf);
        for (a, b) in [(1, 2), (2, 1)] {
            holds(a, b, Relation::Near);
            holds(a, b, Relation::Touching);
        }
        let mut gaps_m = vec![0.1; 9];
        (gaps_m[5], gaps_m[7]) = (0.0004, 0.0004);
        assert_eq!(relations_in_words(&relations, &gaps_m, 3), ["left_of 2 3", "near 3 (0.4 mm); touching 3", ""]);
    }
}
