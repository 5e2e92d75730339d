//! The grammar: every way to read a sentence, before anybody has looked at the scene.
//!
//! ```text
//! sentence    = [request] verb object places | [request] take object ["away from" object] ["and"] ["then"] verb "it" places
//!             | wish object [to be] places | object goes places
//! places      = term { [","] ["and" | "but"] term }          (places side by side need no word between them)
//! term        = [lead] ["not"] relation { ["and" | "but"] ["not"] relation } object { ("and" | "or" | "nor") object }
//! object      = [article] ["other"] { adjective } noun [number] { position | nearest | clause } | "number" n | "it"
//! ```
//! Each function takes a position and returns everything that can be read from there with the position after it: English is
//! ambiguous, and which readings make sense only the scene can tell.

mod objects;

use crate::description::{AnchorPhrase, Description, RelationPhrase, SentenceReading, Telling};
use crate::vocabulary::{self as v, PhraseTable, Taking};
use repose_proto::Relation;

/// What can be read from a position, each with the position after it.
type Read<T> = Vec<(T, usize)>;

/// How many readings of one part are followed up; no sentence that people say has as many.
const MOST_READINGS: usize = 64;
/// How deeply descriptions may be nested: "the ball near the box left of the can".
const DEEPEST: usize = 3;

/// Every reading of a whole sentence.
pub fn readings(words: &[String]) -> Vec<SentenceReading> {
    let text = Text { words };
    let mut found: Vec<SentenceReading> = Vec::new();
    let whole = [text.commands(), text.take_and_put(), text.wishes(), text.statements()];
    for (reading, end) in whole.into_iter().flatten() {
        if end == words.len() && !reading.terms.is_empty() && !found.contains(&reading) {
            found.push(reading);
        }
    }
    found
}

/// Whether a sentence asks for one thing after another: "… then …", "… and put the bowl …".
pub fn asks_for_several_things(words: &[String]) -> bool {
    let text = Text { words };
    (1..words.len()).any(|at| {
        let is_parted = ["and", ",", "then"].into_iter().any(|word| text.is(at - 1, word));
        let begins_anew = || text.one_of(at, v::VERBS).into_iter().any(|end| !text.object(end, 0).is_empty());
        text.is(at, "then") || (is_parted && begins_anew())
    })
}

/// Every reading of words as the description of an object.
pub fn descriptions(words: &[String]) -> Vec<Description> {
    let read = Text { words }.object(0, 0);
    let mut found: Vec<Description> = Vec::new();
    for (description, end) in read {
        if end == words.len() && !found.contains(&description) {
            found.push(description);
        }
    }
    found
}

/// Whether a word is in the vocabulary.
pub fn knows(word: &str) -> bool {
    fn has<T>(table: PhraseTable<T>, word: &str) -> bool {
        table.iter().any(|(phrase, _)| phrase.split(' ').any(|w| w == word))
    }
    let bare = [v::REQUESTS, v::VERBS, v::AWAY, v::WISHES, v::TO_BE, v::GOES, v::TO_THE, v::SIDE, v::ARTICLES, v::THAT_IS];
    word.parse::<u16>().is_ok()
        || v::OWN.contains(&word)
        || bare.iter().any(|table| has(table, word))
        || has(v::TAKES, word)
        || has(v::LEADS, word)
        || has(v::SIDES, word)
        || has(v::RELATIONS, word)
        || has(v::COLORS, word)
        || has(v::SHAPES, word)
        || has(v::PICKS, word)
        || has(v::MIDDLES, word)
        || has(v::ORDINALS, word)
        || has(v::PLACES, word)
        || has(v::MIDDLE_PLACES, word)
        || has(v::FROM, word)
        || has(v::DISTANCES, word)
        || v::NOUNS.iter().any(|(noun, (_, plural))| *noun == word || *plural == word)
}

struct Text<'a> {
    words: &'a [String],
}

impl Text<'_> {
    fn is(&self, at: usize, word: &str) -> bool {
        self.words.get(at).is_some_and(|w| w == word)
    }

    /// The position after a phrase, if it stands there. The empty phrase stands everywhere.
    fn after(&self, at: usize, phrase: &str) -> Option<usize> {
        phrase.split(' ').filter(|w| !w.is_empty()).try_fold(at, |at, word| self.is(at, word).then_some(at + 1))
    }

    fn any<T: Copy>(&self, at: usize, table: PhraseTable<T>) -> Read<T> {
        table.iter().filter_map(|(phrase, meaning)| Some((*meaning, self.after(at, phrase)?))).collect()
    }

    /// Positions after one of a table's phrases, or none of them.
    fn maybe(&self, at: usize, table: PhraseTable<()>) -> Vec<usize> {
        std::iter::once(at).chain(self.any(at, table).into_iter().map(|(_, end)| end)).collect()
    }

    fn one_of(&self, at: usize, table: PhraseTable<()>) -> Vec<usize> {
        self.any(at, table).into_iter().map(|(_, end)| end).collect()
    }

    /// The position after a word that may stand there.
    fn skip(&self, at: usize, word: &str) -> usize {
        if self.is(at, word) { at + 1 } else { at }
    }

    /// A comma, or nothing.
    fn comma(&self, at: usize) -> usize {
        self.skip(at, ",")
    }

    // Sentences.

    /// "Put X …". Before "and put it" a verb that takes puts nothing: see [`Self::take_and_put`].
    fn commands(&self) -> Read<SentenceReading> {
        let mut found = Vec::new();
        for start in self.maybe(self.comma(0), v::REQUESTS) {
            let takes = !self.any(start, v::TAKES).is_empty();
            for at in self.one_of(start, v::VERBS) {
                if !(takes && self.puts_it_after(at)) {
                    found.extend(self.object_with_places(at, &[]));
                }
            }
        }
        found
    }

    fn wishes(&self) -> Read<SentenceReading> {
        self.one_of(0, v::WISHES).into_iter().flat_map(|at| self.object_with_places(at, v::TO_BE)).collect()
    }

    fn statements(&self) -> Read<SentenceReading> {
        let said = self.object(0, 0).into_iter().flat_map(|(mut query, at)| {
            query.close();
            let goes = self.one_of(at, v::GOES);
            goes.into_iter()
                .flat_map(|at| self.terms(at))
                .map(move |(terms, end)| (SentenceReading { query: query.clone(), terms }, end))
                .collect::<Vec<_>>()
        });
        bounded(said.collect())
    }

    fn object_with_places(&self, at: usize, between: PhraseTable<()>) -> Read<SentenceReading> {
        let said = self.object(at, 0).into_iter().flat_map(|(query, at)| {
            let mut closed = query.clone();
            closed.close();
            let open_at = self.comma(at);
            let mut readings = Vec::new();
            for start in self.maybe(open_at, between) {
                for (terms, end) in self.terms(start) {
                    let query = if start == open_at { self.before_places(&query, at, &terms) } else { Some(closed.clone()) };
                    readings.extend(query.map(|query| (SentenceReading { query, terms }, end)));
                }
            }
            readings
        });
        bounded(said.collect())
    }

    /// The object to move whose phrase ends at a position, if it can with nothing but a comma between it and these places.
    fn before_places(&self, query: &Description, at: usize, terms: &[RelationPhrase]) -> Option<Description> {
        // In "left of the box, near the bowl" both are places, and so is the first in "left of the box not near the bowl": one must be.
        let is_place = self.is(at, ",") || terms.iter().all(RelationPhrase::is_negative);
        if is_place && query.clauses.iter().any(|clause| clause.telling != Telling::Always) {
            return None;
        }
        let mut query = query.clone();
        // "Put the mug to the left" says where to, "on the left" where it is.
        let says_where_to = ["to the left", "to the right"].into_iter().any(|way| at >= 3 && self.after(at - 3, way) == Some(at));
        if let Some(pick) = query.picks.last_mut().filter(|pick| says_where_to && pick.telling != Telling::Always) {
            pick.telling = Telling::Never;
        }
        Some(query)
    }

    /// "Take X and put it …", and "take X away from Y and put it …". Any other place before "and put it" is where X is now. "Move X left of Y
    /// and put it …" can be read so only if "left of Y" is needed to tell X, for it may as well say where to move it.
    fn take_and_put(&self) -> Read<SentenceReading> {
        let mut found = Vec::new();
        let verbs = self.maybe(self.comma(0), v::REQUESTS).into_iter().flat_map(|at| self.any(at, v::TAKES));
        for (taking, at) in verbs {
            for (mut query, at) in self.object(at, 0) {
                match taking {
                    Taking::Lifts | Taking::Removes => query.close(),
                    Taking::Moves => query.say_only_what_is_needed(),
                }
                let away = if taking == Taking::Lifts { Vec::new() } else { self.away_from(at) };
                for (first, at) in std::iter::once((Vec::new(), self.skip(at, "up"))).chain(away) {
                    let at = self.skip(self.skip(self.comma(at), "and"), "then");
                    for (more, end) in self.put_it(at).into_iter().flat_map(|at| self.terms(self.comma(at))) {
                        let terms = first.iter().cloned().chain(more).collect();
                        found.push((SentenceReading { query: query.clone(), terms }, end));
                    }
                }
            }
        }
        bounded(found)
    }

    /// Positions after "put it", "set it", … "Keep it" puts nothing.
    fn put_it(&self, at: usize) -> Vec<usize> {
        let verbs = self.one_of(at, v::VERBS).into_iter().filter(|_| !self.is(at, "keep"));
        verbs.filter(|&at| self.is(at, "it")).map(|at| at + 1).collect()
    }

    /// Whether "put it" comes later, and not "do not put it".
    fn puts_it_after(&self, at: usize) -> bool {
        (at..self.words.len()).any(|at| !self.is(at - 1, "not") && !self.put_it(at).is_empty())
    }

    // Places.

    fn terms(&self, at: usize) -> Read<Vec<RelationPhrase>> {
        let mut found = Vec::new();
        for (term, end) in self.term(at, None) {
            let mut frontier = vec![(vec![term], end)];
            while let Some((terms, end)) = frontier.pop() {
                for (next, end) in self.next_terms(&terms, end) {
                    frontier.push((terms.iter().cloned().chain(next).collect(), end));
                }
                found.push((terms, end));
                if found.len() >= MOST_READINGS {
                    break;
                }
            }
        }
        bounded(found)
    }

    /// "Away from X", with further terms that say where the object must not be, before words that show where they end.
    fn away_from(&self, at: usize) -> Read<Vec<RelationPhrase>> {
        if self.any(at, v::AWAY).is_empty() {
            return Vec::new();
        }
        let mut found = self.terms(at);
        found.retain(|(terms, _)| terms.iter().all(RelationPhrase::is_negative));
        for (terms, _) in &mut found {
            for anchor in terms.iter_mut().flat_map(|term| &mut term.anchors) {
                if let AnchorPhrase::Described(description) = anchor {
                    description.close();
                }
            }
        }
        found
    }

    /// A further term. After "not …" a bare "and" leaves open whether the "not" goes on.
    fn next_terms(&self, before: &[RelationPhrase], at: usize) -> Read<Vec<RelationPhrase>> {
        let comma = self.comma(at);
        let (word, start) = match ["and", "but"].into_iter().find(|w| self.is(comma, w)) {
            Some(word) => (Some(word), comma + 1),
            None => (None, comma),
        };
        let goes_on = comma == at && word == Some("and") && self.any(start, v::LEADS).is_empty();
        let open = goes_on && before.last().is_some_and(|t| t.said_not);
        let mut found: Read<Vec<RelationPhrase>> = Vec::new();
        for (term, end) in self.term(start, None) {
            if open && term.relations.iter().all(|r| r.1) {
                let relations = term.relations.iter().map(|(r, _)| (*r, false)).collect();
                found.push((vec![RelationPhrase { relations, ..term.clone() }], end));
            }
            found.push((vec![term], end));
        }
        if self.is(start, "neither") {
            for (first, at) in self.term(start + 1, Some(false)) {
                if self.is(at, "nor") {
                    found.extend(self.term(at + 1, Some(false)).into_iter().map(|(second, end)| (vec![first.clone(), second], end)));
                }
            }
        }
        // With nothing between, "the box and the mug right of the plate" may be the start of a second request.
        if start == at && before.last().is_some_and(|t| t.joined) && !self.is_about_it(start) {
            for first in found.iter_mut().filter_map(|(terms, _)| terms.first_mut()) {
                first.of_anchor = true;
            }
        }
        found
    }

    /// Whether a lead stands there that can only be about the object to move: "so that it is", "without".
    fn is_about_it(&self, at: usize) -> bool {
        let about_it = |phrase: &str| phrase.split(' ').any(|w| matches!(w, "it" | "without"));
        v::LEADS.iter().any(|&(phrase, _)| about_it(phrase) && self.after(at, phrase).is_some())
    }

    fn term(&self, at: usize, polarity: Option<bool>) -> Read<RelationPhrase> {
        let mut found = Vec::new();
        let leads = std::iter::once((true, at)).chain(self.any(at, v::LEADS));
        for (lead, at) in leads {
            let (said, at) = if self.is(at, "not") { (false, at + 1) } else { (true, at) };
            for (relations, at) in self.relations(at, polarity.unwrap_or(true) && lead && said) {
                let negated = relations.iter().all(|r| !r.1);
                for ((anchors, joined), end) in self.anchors(at, negated) {
                    let (relations, said_not) = (relations.clone(), negated && !(said && lead));
                    found.push((RelationPhrase { relations, said_not, anchors, joined, of_anchor: false }, end));
                }
            }
        }
        bounded(found)
    }

    /// One or more relations to the same anchors: "behind and to the left of", "near but not touching".
    fn relations(&self, at: usize, holds: bool) -> Read<Vec<(&'static [Relation], bool)>> {
        let mut found = Vec::new();
        for (first, at) in self.relation(at, holds) {
            found.push((vec![first], at));
        }
        let whole = self.relation(at, holds).into_iter().map(|(first, at)| (first, false, at));
        let short = self.short_side(at, holds).into_iter().map(|(first, at)| (first, true, at));
        for (first, is_short, at) in whole.chain(short) {
            let at = self.comma(at);
            let Some(word) = ["and", "but"].into_iter().find(|w| self.is(at, w)) else { continue };
            let (said, at) = if self.is(at + 1, "not") { (false, at + 2) } else { (true, at + 1) };
            let holds = if word == "and" { holds && said } else { said };
            for (second, end) in self.relation(at, holds) {
                // "On the left and near the bowl" does not say left of what.
                if !is_short || second.0.iter().all(|relation| v::LEVEL_SIDES.contains(relation)) {
                    found.push((vec![first, second], end));
                }
            }
        }
        found
    }

    fn relation(&self, at: usize, holds: bool) -> Read<(&'static [Relation], bool)> {
        let mut found: Read<_> = self.any(at, v::RELATIONS).into_iter().map(|((r, positive), end)| ((r, positive == holds), end)).collect();
        // "right next to", "right behind".
        if self.is(at, "right") {
            found.extend(self.any(at + 1, v::RELATIONS).into_iter().map(|((r, positive), end)| ((r, positive == holds), end)));
        }
        for (side, at) in self.side(at) {
            found.extend(self.one_of(at, v::SIDE).into_iter().map(|end| ((side, holds), end)));
        }
        found
    }

    /// "to the left", where the rest of it comes with the next relation: "to the left and in front of the box".
    fn short_side(&self, at: usize, holds: bool) -> Read<(&'static [Relation], bool)> {
        self.side(at).into_iter().map(|(side, end)| ((side, holds), end)).collect()
    }

    fn side(&self, at: usize) -> Read<&'static [Relation]> {
        self.one_of(at, v::TO_THE).into_iter().flat_map(|at| self.any(at, v::SIDES)).collect()
    }

    /// One or more anchors, and whether "and" joins whole phrases. "the green and the blue mug": the first takes the noun of the second.
    fn anchors(&self, at: usize, negated: bool) -> Read<(Vec<AnchorPhrase>, bool)> {
        let mut found = Vec::new();
        for (first, at) in self.anchor(at) {
            let whole = !matches!(&first, AnchorPhrase::Described(d) if d.head.is_none() && d.number.is_none());
            if whole {
                found.push(((vec![first.clone()], false), at));
            }
            let between = match self.words.get(at).map(String::as_str) {
                Some("and") => Some(at + 1),
                Some("or" | "nor") if negated => Some(at + 1),
                _ => None,
            };
            for ((rest, rest_joined), end) in between.into_iter().flat_map(|at| self.anchors(at, negated)) {
                let mut first = first.clone();
                if let (AnchorPhrase::Described(d), Some(AnchorPhrase::Described(next))) = (&mut first, rest.first())
                    && d.head.is_none()
                    && d.number.is_none()
                {
                    d.head = next.head;
                }
                let joined = rest_joined || (whole && self.is(at, "and"));
                found.push(((std::iter::once(first).chain(rest).collect(), joined), end));
            }
        }
        bounded(found)
    }

    fn anchor(&self, at: usize) -> Read<AnchorPhrase> {
        let mut found: Read<AnchorPhrase> = self.any_object(at, 0).into_iter().map(|(d, end)| (AnchorPhrase::Described(d), end)).collect();
        if self.is(at, "it") {
            found.push((AnchorPhrase::It, at + 1));
        }
        found
    }
}

fn bounded<T>(mut found: Read<T>) -> Read<T> {
    found.truncate(MOST_READINGS);
    found
}
