//! From readings to the one goal that a scene leaves of them.

use repose_proto::{GoalTerm, Relation};
use repose_relations::observed_margins;

use crate::description::{AnchorPhrase, Clause, Description, Head, SentenceReading, Telling};
use crate::grade::Grade;
use crate::look::ObjectAppearance;
use crate::refused::{Reason, RefusedSentence};
use crate::selection::{best, by_build, by_distance, fitting, may_be_called, picked_by_all};
use crate::{ResolvedPhrase, Understood};

/// How far on the right side of an anchor's middle an object must be for "that is left of it" where the rule does not hold, metres.
const SIDE_M: f64 = 0.02;

/// Why a reading has no meaning on a scene, and the ids of the objects in question.
type Problem = (Reason, Vec<u16>);

/// The goal that all readings which mean anything agree on.
pub fn only_goal(readings: &[SentenceReading], words: &[String], looks: &[ObjectAppearance]) -> Result<Understood, RefusedSentence> {
    let mut goals: Vec<Understood> = Vec::new();
    let mut problems: Vec<Problem> = Vec::new();
    let resolver = Resolver { words, looks: looks.iter().collect(), places_follow: true };
    for reading in readings {
        match resolver.goal(reading) {
            Ok(goal) if goals.iter().any(|g| same(g, &goal)) => {}
            Ok(goal) => goals.push(goal),
            Err(problem) => problems.push(problem),
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
    let (mut found, mut problems): (Vec<u16>, Vec<Problem>) = (Vec::new(), Vec::new());
    for description in descriptions {
        match resolver.one(description, &mut Said::default()) {
            Ok(look) if found.contains(&look.id) => {}
            Ok(look) => found.push(look.id),
            Err(problem) => problems.push(problem),
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
        Reason::SeveralObjects { .. } | Reason::Plural { .. } => 1,
        // Its words belong elsewhere, in a reading that may say more.
        Reason::WhichOrWhere { .. } => 3,
        _ => 2,
    }
}

fn same(a: &Understood, b: &Understood) -> bool {
    a.query == b.query && a.goal.iter().all(|t| b.goal.contains(t)) && b.goal.iter().all(|t| a.goal.contains(t))
}

/// Why goals that do not agree are refused, and all objects that they are about.
fn several(goals: &[Understood]) -> Problem {
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
    /// Anchors that come later, for "the other mug next to the red mug".
    later: Vec<u16>,
}

impl Said {
    /// Whether an object was named, so that another one is "the other".
    fn names(&self, look: &ObjectAppearance) -> bool {
        self.moved == Some(look.id) || self.anchors.contains(&look.id) || self.later.contains(&look.id)
    }
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
        let (mut goal, mut denied_together): (Vec<GoalTerm>, Vec<Vec<GoalTerm>>) = (Vec::new(), Vec::new());
        let mut of_anchor: Option<Understood> = None;
        for term in &reading.terms {
            let anchor_before = said.anchors.last().copied();
            let (mut anchors, mut phrases) = (Vec::new(), Vec::new());
            for anchor in &term.anchors {
                let (phrase, ids) = self.anchors(anchor, &mut said)?;
                taken.extend(ids.iter().map(|id| ResolvedPhrase { phrase: phrase.clone(), object: *id }));
                anchors.extend(ids);
                phrases.push(phrase);
            }
            let is_middle = term.relations.iter().any(|(all, holds)| *holds && all.contains(&Relation::Centered));
            if is_middle && anchors.len() > 1 {
                return Err((Reason::MiddleOfSeveral { phrase: phrases.join(" and ") }, anchors));
            }
            let mut asked: Vec<GoalTerm> = Vec::new();
            for (relation, holds) in term.relations.iter().flat_map(|(all, holds)| all.iter().map(|r| (*r, *holds))) {
                asked.extend(anchors.iter().map(|anchor| GoalTerm { relation, anchor: *anchor, holds }));
            }
            for (all, _) in term.relations.iter().filter(|(all, holds)| !holds && all.len() > 1) {
                let denied =
                    |anchor: &u16| all.iter().map(|r| GoalTerm { relation: *r, anchor: *anchor, holds: false }).collect::<Vec<_>>();
                denied_together.extend(anchors.iter().map(denied));
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
        leave_what_is_asked(&mut goal, &denied_together);
        let understood = Understood { query, goal, taken };
        match of_anchor {
            None => Ok(understood),
            Some(other) => Err(several(&[understood, other])),
        }
    }

    /// The object to move. It is none of its anchors: "put the object left of the box" is not about the box.
    fn moved(&self, reading: &SentenceReading, said: &mut Said) -> Result<u16, Problem> {
        if reading.query.other {
            said.later = self.plain_anchors(reading, said);
        }
        let found = self.one(&reading.query, said);
        said.later.clear();
        let (reason, mut ids) = match found {
            Err((reason @ Reason::SeveralObjects { .. }, ids)) => (reason, ids),
            found => return found.map(|look| look.id),
        };
        let anchors = self.plain_anchors(reading, said);
        ids.retain(|id| !anchors.contains(id));
        if let [id] = ids[..] { Ok(id) } else { Err((reason, ids)) }
    }

    /// The anchors that are told by their phrases alone.
    fn plain_anchors(&self, reading: &SentenceReading, said: &Said) -> Vec<u16> {
        let anchors = reading.terms.iter().flat_map(|t| &t.anchors).filter_map(|anchor| match anchor {
            AnchorPhrase::Described(description) => self.one(description, &mut said.clone()).ok(),
            AnchorPhrase::It => None,
        });
        anchors.map(|look| look.id).collect()
    }

    fn anchors(&self, anchor: &AnchorPhrase, said: &mut Said) -> Result<(String, Vec<u16>), Problem> {
        let AnchorPhrase::Described(description) = anchor else {
            let mut ids = said.anchors.clone();
            ids.sort_unstable();
            ids.dedup();
            let reason = Reason::SeveralObjects { phrase: "it".to_owned() };
            return if ids.len() == 1 { Ok(("it".to_owned(), ids)) } else { Err((reason, ids)) };
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
            [look] if Some(look.id) == said.moved => Err((Reason::Itself { phrase: self.phrase(description) }, vec![look.id])),
            [look] if !description.plural => Ok(look),
            _ => {
                let phrase = self.phrase(description);
                let reason = if description.plural { Reason::Plural { phrase } } else { Reason::SeveralObjects { phrase } };
                Err((reason, ids_of(&found)))
            }
        }
    }

    /// Every object that a description fits, at least one.
    fn all(&self, description: &Description, said: &mut Said) -> Result<Vec<&'a ObjectAppearance>, Problem> {
        let head = match description.head {
            Some(Head::One) => said.noun.or(Some(Head::Any)),
            head => head,
        };
        let mut among = self.looks.clone();
        if description.other {
            let (named, others): (Vec<_>, Vec<_>) = among.into_iter().partition(|look| said.names(look));
            if !named.iter().any(|look| may_be_called(head, look)) {
                let reason = Reason::OtherThanWhat { phrase: self.phrase(description) };
                return Err((reason, ids_of(&fitting(description, head, &others))));
            }
            among = others;
        }
        // A lone ball says of "the black one" that it is no ball.
        let is_lone = description.head == Some(Head::One) && !among.iter().any(|look| may_be_called(head, look) && !said.names(look));
        let head = if is_lone { Some(Head::Any) } else { head };
        let found = self.selected(description, head, &among, said)?;
        if matches!(description.head, Some(Head::Kind(_))) {
            said.noun = description.head;
        }
        if found.is_empty() {
            // Whatever fits but for where it is said to be is in question.
            let anywhere = Description { clauses: Vec::new(), ..description.clone() };
            let near_misses = self.selected(&anywhere, head, &among, &mut said.clone()).unwrap_or_default();
            return Err(self.nothing(description, ids_of(&near_misses)));
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
        let mut found = self.compared(description, head, among, said)?;
        if description.number.is_some() && !found.is_empty() && description.compares() {
            // Compared with nothing but itself, any object is the largest. Where without the number another one is meant, one of the two is a slip.
            let unnumbered = Description { number: None, ..description.clone() };
            let meant = self.compared(&unnumbered, head, among, &mut said.clone())?;
            found.retain(|look| meant.is_empty() || meant.iter().any(|other| other.id == look.id));
        }
        Ok(found)
    }

    /// The objects that are left of those that fit when clauses and comparisons have been applied.
    fn compared(
        &self,
        description: &Description,
        head: Option<Head>,
        among: &[&'a ObjectAppearance],
        said: &mut Said,
    ) -> Result<Vec<&'a ObjectAppearance>, Problem> {
        let mut found = fitting(description, head, among);
        for clause in &description.clauses {
            let anchor = self.one(&clause.anchor, &mut Said { noun: said.noun, ..Said::default() })?;
            said.anchors.push(anchor.id);
            found = best(found.into_iter().filter(|l| l.id != anchor.id).map(|look| (holds(clause, look, anchor), look)).collect());
        }
        for word in &description.shapes {
            found = by_build(*word, &found);
        }
        found = picked_by_all(&description.picks, &found);
        if let Some(distance) = &description.distance {
            let to = self.one(&distance.to, &mut Said { noun: said.noun, ..Said::default() })?;
            said.anchors.push(to.id);
            found = by_distance(distance.nearest, to, &found);
        }
        Ok(found)
    }

    /// Fails where the object is told without words that may as well say where to put it.
    fn needed(&self, description: &Description, head: Option<Head>, among: &[&'a ObjectAppearance], said: &Said) -> Result<(), Problem> {
        let told = |without: &Description| self.selected(without, head, among, &mut said.clone());
        let needless = |told: &[&ObjectAppearance]| Err((Reason::WhichOrWhere { phrase: self.phrase(description) }, ids_of(told)));
        let is_open = |telling: Telling| telling != Telling::Always;
        let bare = Description { clauses: Vec::new(), ..description.clone() };
        let clauses = &description.clauses;
        if clauses.iter().any(|clause| is_open(clause.telling)) {
            let told = told(&bare)?;
            if matches!(told[..], [look] if !self.describe(clauses, look, said)) {
                return needless(&told);
            }
        }
        let tellings = description.picks.iter().map(|pick| pick.telling).chain(description.distance.iter().map(|d| d.telling));
        if tellings.clone().any(is_open) {
            let picks = description.picks.iter().copied().filter(|pick| !is_open(pick.telling)).collect();
            let distance = description.distance.clone().filter(|distance| !is_open(distance.telling));
            let told = told(&Description { picks, distance, ..bare })?;
            if told.len() == 1 || tellings.clone().any(|telling| telling == Telling::Never) {
                return needless(&told);
            }
        }
        Ok(())
    }

    /// Whether clauses that are not needed to tell an object may still describe it: they surely are true of it.
    fn describe(&self, clauses: &[Clause], look: &ObjectAppearance, said: &Said) -> bool {
        clauses.iter().filter(|clause| clause.telling != Telling::Always).all(|clause| {
            let anchor = self.one(&clause.anchor, &mut Said { noun: said.noun, ..Said::default() });
            clause.telling == Telling::IfTrue
                && anchor.is_ok_and(|anchor| anchor.id != look.id && holds(clause, look, anchor) == Grade::Yes)
        })
    }

    fn nothing(&self, description: &Description, in_question: Vec<u16>) -> Problem {
        let colorless = !description.colors.is_empty() && self.looks.iter().all(|l| l.colors.is_none());
        (Reason::NoObject { phrase: self.phrase(description), colorless }, in_question)
    }

    fn phrase(&self, description: &Description) -> String {
        self.words[description.span.0..description.span.1].join(" ")
    }
}

/// "On the plate but not in the middle of it" denies the middle alone, though that is on the plate, too: of relations that are denied together those
/// hold that the sentence asks for, so the others are denied.
fn leave_what_is_asked(goal: &mut Vec<GoalTerm>, denied_together: &[Vec<GoalTerm>]) {
    for denied in denied_together {
        let is_asked = |term: &GoalTerm| goal.contains(&GoalTerm { holds: true, ..*term });
        let (asked, others): (Vec<GoalTerm>, Vec<GoalTerm>) = denied.iter().copied().partition(is_asked);
        if !others.is_empty() {
            goal.retain(|term| !asked.contains(term));
        }
    }
}

fn ids_of(looks: &[&ObjectAppearance]) -> Vec<u16> {
    looks.iter().map(|look| look.id).collect()
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
