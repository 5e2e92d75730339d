//! Goals in words, without a model: "put the red mug to the left of the box, not near the bowl" becomes an object and goal terms.
//!
//! A small grammar over what perception knows of an object: its colors, its size, its shape by measured extent, where it is among the
//! others, its number. [`understand`] finds every reading of a sentence on the looks of a scene's objects ([`looks_of`]), and answers
//! only if exactly one goal remains; otherwise it refuses and names the objects in question. What it does not know it does not guess:
//! a word outside its vocabulary refuses the sentence. Pure: no I/O, no async, no global state.

mod color;
mod description;
mod grade;
mod grammar;
mod look;
mod refused;
mod resolve;
mod selection;
mod shape;
mod vocabulary;
mod words;

use repose_proto::GoalTerm;

pub use color::{ColorShares, ColorTerm, oklch};
pub use grade::Grade;
pub use look::{ObjectAppearance, looks_of};
pub use refused::{Reason, RefusedSentence};
pub use shape::{ShapeKind, ShapeMeasures};

/// A phrase of the sentence, and the object it refers to.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ResolvedPhrase {
    /// The phrase, lower case.
    pub phrase: String,
    /// The object's id.
    pub object: u16,
}

/// What a sentence asks for.
#[derive(Debug, Clone, PartialEq)]
pub struct Understood {
    /// The object to move.
    pub query: u16,
    /// What must hold, in the order of the sentence.
    pub goal: Vec<GoalTerm>,
    /// Every phrase for an object, in the order of the sentence.
    pub taken: Vec<ResolvedPhrase>,
}

/// Longest sentence that is read, characters.
pub const MAX_CHARACTERS: usize = 400;

/// Reads a sentence about a scene.
///
/// # Errors
/// [`RefusedSentence`] with the objects in question where the sentence has no meaning that can be planned, or more than one.
pub fn understand(sentence: &str, looks: &[ObjectAppearance]) -> Result<Understood, RefusedSentence> {
    let words = known_words(sentence, looks)?;
    let readings = grammar::readings(&words);
    if readings.is_empty() {
        let reason = if grammar::asks_for_several_things(&words) { Reason::SeveralThings } else { Reason::NoRequest };
        return Err(RefusedSentence::about(reason, looks, &[]));
    }
    resolve::only_goal(&readings, &words, looks)
}

/// The object that a phrase means: "the red mug", "the box left of the bowl", "number 3".
///
/// # Errors
/// [`RefusedSentence`] with the objects in question where the phrase means none of them, or may mean several.
pub fn find(phrase: &str, looks: &[ObjectAppearance]) -> Result<u16, RefusedSentence> {
    let words = known_words(phrase, looks)?;
    let descriptions = grammar::descriptions(&words);
    if descriptions.is_empty() {
        return Err(RefusedSentence::about(Reason::NoDescription { phrase: phrase.to_owned() }, looks, &[]));
    }
    resolve::only_object(&descriptions, &words, looks)
}

/// Whether a sentence or a phrase names an object by its number ("object 3", "#3"): those are the numbers of one scene.
pub fn names_by_number(text: &str) -> bool {
    words::words_of(text).iter().any(|word| word.parse::<u16>().is_ok())
}

/// The words of a text, all of which must be in the vocabulary.
fn known_words(text: &str, looks: &[ObjectAppearance]) -> Result<Vec<String>, RefusedSentence> {
    if text.chars().count() > MAX_CHARACTERS {
        return Err(RefusedSentence::about(Reason::TooLong, looks, &[]));
    }
    let words = words::words_of(text);
    match words.iter().find(|word| !grammar::knows(word)) {
        Some(unknown) => Err(RefusedSentence::about(Reason::UnknownWord { word: unknown.clone() }, looks, &[])),
        None => Ok(words),
    }
}
