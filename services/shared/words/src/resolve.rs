//! From readings to the one goal that a scene leaves of them.

use repose_proto::{GoalTerm, Relation};
use repose_relations::observed_margins;

use crate::description::{AnchorPhrase, Clause, Description, Head, SentenceReading};
use crate::grade::Grade;
use crate::look::ObjectAppearance;
use crate::refused::{Reason, RefusedSentence};
use crate::selection::{best, by_build, by_distance, fitting, picked};
use crate::{ResolvedPhrase, Understood};

/// How far on the right side of an anchor's middle an object must be for "that is left of it" where the rule does not hold, metres.
const SIDE_M: f64 = 0.02;

/// Why a reading has no meaning on a scene.
enum Problem {
    /// A clause or a pick tells nothing apart: the words belong elsewhere.
    Needless,
    /// Why, and the ids of the objects in question.
    Refused(Reason, Vec<u16>),
}

/// The goal that all readings which mean anything agree on.
pub fn only_goal(readings: &[SentenceReading], words: &[String], looks: &[ObjectAppearance]) -> Result<Understood, RefusedSentence> {
    let mut goals: Vec<Understood> = Vec::new();
    let mut problems: Vec<(Reason, Vec<u16>)> = Vec::new();
    let resolver = Resolver { words, looks: looks.iter().collect(), places_follow: true };
    for reading in readings {
        match resolver.goal(reading) {
            Ok(goal) if goals.iter().any(|g| same(g, &goal)) => {}
            Ok(goal) => goals.push(goal),
            Err(Problem::Needless) => {}
            Err(Problem::Refused(reason, ids)) => problems.push((reason, ids)),
        }
    }
    if goals.len() > 1 {
        let (reason, ids) = several(&goals);
        return Err(RefusedSentence::about(reason, looks, &ids));
    }
    match goals.pop() {
        Some(goal) if goal.goal.iter().any(|t| t.holds) => Ok(goal),
        Some(_) => Err(RefusedSentence::about(Reason::OnlyNegative, looks, &[])),
        None => {
            // The reading that came closest says most.
            let (reason, ids) =
                problems.into_iter().min_by_key(|(reason, _)| distance_from_meaning(reason)).unwrap_or((Reason::NoRequest, Vec::new()));
            Err(RefusedSentence::about(reason, looks, &ids))
        }
    }
}

/// The object that all readings of a phrase which mean anything agree on.
pub fn only_object(descriptions: &[Description], words: &[String], looks: &[ObjectAppearance]) -> Result<u16, RefusedSentence> {
    let resolver = Resolver { words, looks: looks.iter().collect(), places_follow: false };
    let (mut found, mut problems): (Vec<u16>, Vec<(Reason, Vec<u16>)>) = (Vec::new(), Vec::new());
    for description in descriptions {
        match resolver.one(description, &mut Said::default()) {
            Ok(look) if found.contains(&look.id) => {}
            Ok(look) => found.push(look.id),
            Err(Problem::Needless) => {}
            Err(Problem::Refused(reason, ids)) => problems.push((reason, ids)),
        }
    }
    match found[..] {
        [id] => Ok(id),
        [] => {
            let phrase = words.join(" ");
            let none = (Reason::NoObject { phrase, colorless: false }, Vec::new());
            let (reason, ids) = problems.into_iter().min_by_key(|(reason, _)| distance_from_meaning(reason)).unwrap_or(none);
            Err(RefusedSentence::about(reason, looks, &ids))
        }
        _ => Err(RefusedSentence::about(Reason::SeveralObjects { phrase: words.join(" ") }, looks, &found)),
    }
}

fn distance_from_meaning(reason: &Reason) -> u8 {
    match reason {
        Reason::Itself { .. } => 0,
        Reason::SeveralObjects { .. } => 1,
        _ => 2,
    }
}

fn same(a: &Understood, b: &Understood) -> bool {
    a.query == b.query && a.goal.iter().all(|t| b.goal.contains(t)) && b.goal.iter().all(|t| a.goal.contains(t))
}

/// Why goals that do not agree are refused, and all objects that they are about.
fn several(goals: &[Understood]) -> (Reason, Vec<u16>) {
    let mut ids: Vec<u16> = goals.iter().flat_map(|g| g.goal.iter().map(|t| t.anchor).chain([g.query])).collect();
    ids.sort_unstable();
    ids.dedup();
    (Reason::SeveralGoals { goals: goals.iter().map(told).collect() }, ids)
}

fn told(understood: &Understood) -> String {
    let terms: Vec<String> = understood.goal.iter().map(ToString::to_string).collect();
    format!("object {} to {}", understood.query, terms.join(", "))
}

/// What has been said before a phrase.
#[derive(Clone, Default)]
struct Said {
    /// The newest noun, for "one".
    noun: Option<Head>,
    /// The object to move, once it is known.
    moved: Option<u16>,
    /// Anchors so far, for "it".
    anchors: Vec<u16>,
}

struct Resolver<'a> {
    words: &'a [String],
    looks: Vec<&'a ObjectAppearance>,
    /// Whether words after a phrase may say where to put the object. Where they cannot, a clause that is not needed to tell the object must
    /// merely be true of it: "the bowl right of the plate" is the only bowl, if it stands there.
    places_follow: bool,
}

impl<'a> Resolver<'a> {
    fn goal(&self, reading: &SentenceReading) -> Result<Understood, Problem> {
        let mut said = Said::default();
        let query = self.moved(reading, &mut said)?;
        said.moved = Some(query);
        let mut taken = vec![ResolvedPhrase { phrase: self.phrase(&reading.query), object: query }];
        let mut goal: Vec<GoalTerm> = Vec::new();
        let mut of_anchor: Option<Understood> = None;
        for term in &reading.terms {
            let anchor_before = said.anchors.last().copied();
            let mut anchors = Vec::new();
            for anchor in &term.anchors {
                let (phrase, ids) = self.anchors(anchor, &mut said)?;
                taken.extend(ids.iter().map(|id| ResolvedPhrase { phrase: phrase.clone(), object: *id }));
                anchors.extend(ids);
            }
            let mut asked: Vec<GoalTerm> = Vec::new();
            for (relation, holds) in term.relations.iter().flat_map(|(all, holds)| all.iter().map(|r| (*r, *holds))) {
                asked.extend(anchors.iter().map(|anchor| GoalTerm { relation, anchor: *anchor, holds }));
            }
            if let Some(query) = anchor_before.filter(|_| term.of_anchor) {
                of_anchor = Some(Understood { query, goal: asked.clone(), taken: Vec::new() });
            }
            for term in asked {
                if !goal.contains(&term) {
                    goal.push(term);
                }
            }
            said.anchors.extend(anchors);
        }
        let understood = Understood { query, goal, taken };
        match of_anchor {
            None => Ok(understood),
            Some(other) => {
                let (reason, ids) = several(&[understood, other]);
                Err(Problem::Refused(reason, ids))
            }
        }
    }

    /// The object to move. It is none of its anchors: "put the object left of the box" is not about the box.
    fn moved(&self, reading: &SentenceReading, said: &mut Said) -> Result<u16, Problem> {
        let (reason, mut ids) = match self.one(&reading.query, said) {
            Err(Problem::Refused(reason @ Reason::SeveralObjects { .. }, ids)) if !reading.query.plural => (reason, ids),
            found => return found.map(|look| look.id),
        };
        let anchors = reading.terms.iter().flat_map(|t| &t.anchors).filter_map(|anchor| match anchor {
            AnchorPhrase::Described(description) => self.one(description, &mut said.clone()).ok(),
            AnchorPhrase::It => None,
        });
        let anchors: Vec<u16> = anchors.map(|look| look.id).collect();
        ids.retain(|id| !anchors.contains(id));
        if let [id] = ids[..] { Ok(id) } else { Err(Problem::Refused(reason, ids)) }
    }

    fn anchors(&self, anchor: &AnchorPhrase, said: &mut Said) -> Result<(String, Vec<u16>), Problem> {
        let AnchorPhrase::Described(description) = anchor else {
            let mut ids = said.anchors.clone();
            ids.sort_unstable();
            ids.dedup();
            let reason = Reason::SeveralObjects { phrase: "it".to_owned() };
            return if ids.len() == 1 { Ok(("it".to_owned(), ids)) } else { Err(Problem::Refused(reason, ids)) };
        };
        if !description.plural {
            return Ok((self.phrase(description), vec![self.one(description, said)?.id]));
        }
        let all = self.all(description, said)?;
        let ids: Vec<u16> = all.iter().map(|l| l.id).filter(|id| Some(*id) != said.moved).collect();
        if ids.is_empty() { Err(self.nothing(description, Vec::new())) } else { Ok((self.phrase(description), ids)) }
    }

    /// The one object that a description fits.
    fn one(&self, description: &Description, said: &mut Said) -> Result<&'a ObjectAppearance, Problem> {
        let mut found = self.all(description, said)?;
        if found.len() > 1 {
            found.retain(|look| Some(look.id) != said.moved);
        }
        match found[..] {
            [look] if Some(look.id) == said.moved => {
                Err(Problem::Refused(Reason::Itself { phrase: self.phrase(description) }, vec![look.id]))
            }
            [look] if !description.plural => Ok(look),
            _ => {
                let reason = Reason::SeveralObjects { phrase: self.phrase(description) };
                Err(Problem::Refused(reason, found.iter().map(|l| l.id).collect()))
            }
        }
    }

    /// Every object that a description fits, at least one.
    fn all(&self, description: &Description, said: &mut Said) -> Result<Vec<&'a ObjectAppearance>, Problem> {
        let head = match description.head {
            Some(Head::One) => said.noun.or(Some(Head::Any)),
            head => head,
        };
        let among: Vec<&ObjectAppearance> =
            self.looks.iter().copied().filter(|l| !(description.other && Some(l.id) == said.moved)).collect();
        let mut found = self.selected(description, head, &among, said)?;
        if found.is_empty() && description.head == Some(Head::One) {
            found = self.selected(description, Some(Head::Any), &among, said)?;
        }
        if matches!(description.head, Some(Head::Kind(_))) {
            said.noun = description.head;
        }
        if found.is_empty() {
            // Whatever fits but for where it is said to be is in question.
            let anywhere = Description { clauses: Vec::new(), ..description.clone() };
            let near_misses = self.selected(&anywhere, head, &among, &mut said.clone()).unwrap_or_default();
            return Err(self.nothing(description, near_misses.iter().map(|l| l.id).collect()));
        }
        Ok(found)
    }

    fn selected(
        &self,
        description: &Description,
        head: Option<Head>,
        among: &[&'a ObjectAppearance],
        said: &mut Said,
    ) -> Result<Vec<&'a ObjectAppearance>, Problem> {
        if self.places_follow {
            self.needed(description, head, among, said)?;
        }
        let mut found = fitting(description, head, among);
        for clause in &description.clauses {
            let anchor = self.one(&clause.anchor, &mut Said { noun: said.noun, ..Said::default() })?;
            said.anchors.push(anchor.id);
            found = best(found.into_iter().filter(|l| l.id != anchor.id).map(|look| (holds(clause, look, anchor), look)).collect());
        }
        for word in &description.shapes {
            found = by_build(*word, &found);
        }
        for pick in &description.picks {
            found = picked(*pick, &found);
        }
        if let Some((nearest, to)) = &description.distance {
            let to = self.one(to, &mut Said { noun: said.noun, ..Said::default() })?;
            said.anchors.push(to.id);
            found = by_distance(*nearest, to, &found);
        }
        Ok(found)
    }

    /// Fails where an object is told without a clause or a pick that may as well say where to put it.
    fn needed(&self, description: &Description, head: Option<Head>, among: &[&'a ObjectAppearance], said: &Said) -> Result<(), Problem> {
        let tells =
            |without: &Description| -> Result<bool, Problem> { Ok(self.selected(without, head, among, &mut said.clone())?.len() == 1) };
        let bare = Description { clauses: Vec::new(), ..description.clone() };
        if description.clauses.iter().any(|c| c.only_if_needed) && tells(&bare)? {
            return Err(Problem::Needless);
        }
        if description.picks.iter().any(|p| p.only_if_needed) {
            let picks = description.picks.iter().copied().filter(|p| !p.only_if_needed).collect();
            if tells(&Description { picks, distance: None, ..bare })? {
                return Err(Problem::Needless);
            }
        }
        Ok(())
    }

    fn nothing(&self, description: &Description, in_question: Vec<u16>) -> Problem {
        let colorless = !description.colors.is_empty() && self.looks.iter().all(|l| l.colors.is_none());
        Problem::Refused(Reason::NoObject { phrase: self.phrase(description), colorless }, in_question)
    }

    fn phrase(&self, description: &Description) -> String {
        self.words[description.span.0..description.span.1].join(" ")
    }
}

/// Whether a clause holds of an object: surely by the rule that goals are judged by, perhaps on the right side of the anchor's middle.
fn holds(clause: &Clause, look: &ObjectAppearance, anchor: &ObjectAppearance) -> Grade {
    let by_rule = observed_margins(&look.observed, &anchor.observed).holds();
    let [dx, dy, dz]: [f64; 3] = std::array::from_fn(|k| look.center_in_viewer_m[k] - anchor.center_in_viewer_m[k]);
    let beyond = |offset: f64| if offset > SIDE_M { Grade::Maybe } else { Grade::No };
    let one = |relation: &Relation| match relation {
        relation if by_rule[relation.index()] => Grade::Yes,
        Relation::LeftOf => beyond(-dx),
        Relation::RightOf => beyond(dx),
        Relation::InFrontOf => beyond(-dy),
        Relation::Behind => beyond(dy),
        Relation::Above => beyond(dz).and(if look.observed.distance_m(&anchor.observed) < SIDE_M { Grade::Yes } else { Grade::No }),
        _ => Grade::No,
    };
    clause.relations.iter().map(one).fold(Grade::Yes, Grade::and)
}
