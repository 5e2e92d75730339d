//! Why a sentence is not acted upon, with the objects in question.

use crate::look::ObjectAppearance;

/// Why a sentence was refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Reason {
    /// Longer than anything that is meant.
    #[error("the sentence exceeds {} characters", crate::MAX_CHARACTERS)]
    TooLong,
    /// A word outside the vocabulary.
    #[error("unknown word {word:?}")]
    UnknownWord {
        /// The first such word.
        word: String,
    },
    /// Known words that ask for no placement.
    #[error("not understood as a request to place an object; try \"put the red mug to the left of the box, not near the bowl\"")]
    NoRequest,
    /// One thing after another.
    #[error("the sentence asks for more than one thing; say one at a time")]
    SeveralThings,
    /// Known words that describe no object.
    #[error("{phrase:?} is not understood as an object; try \"the red mug\" or \"the box left of the bowl\"")]
    NoDescription {
        /// The phrase.
        phrase: String,
    },
    /// Several objects fit a phrase.
    #[error("{phrase:?} may mean several objects")]
    SeveralObjects {
        /// The phrase.
        phrase: String,
    },
    /// A phrase is about several objects where there can be one.
    #[error("{phrase:?} is about several objects, where one is expected")]
    Plural {
        /// The phrase.
        phrase: String,
    },
    /// "The other" of which no first was named.
    #[error("{phrase:?} does not say which one it is other than")]
    OtherThanWhat {
        /// The phrase.
        phrase: String,
    },
    /// The end of a phrase is not needed to tell the object, and may be a part of the place.
    #[error("{phrase:?} may say which object is meant or where to put it; \"that is\" tells which, relations joined by \"and\" tell where")]
    WhichOrWhere {
        /// The phrase, with its end.
        phrase: String,
    },
    /// In the middle of several objects: between them is no relation.
    #[error("nothing is in the middle of each of {phrase:?}, and no relation here says \"between\"")]
    MiddleOfSeveral {
        /// The phrases of the objects.
        phrase: String,
    },
    /// No object fits a phrase.
    #[error("no object in view matches {phrase:?}{}", if *colorless { "; the camera sees no color" } else { "" })]
    NoObject {
        /// The phrase.
        phrase: String,
        /// Whether it names a color where the camera sees none.
        colorless: bool,
    },
    /// The moved object is its own anchor.
    #[error("{phrase:?} is the object to be moved")]
    Itself {
        /// The anchor's phrase.
        phrase: String,
    },
    /// Nothing must hold.
    #[error("the sentence says only where the object must not be")]
    OnlyNegative,
    /// More than one goal fits the sentence.
    #[error("the sentence is ambiguous: {}", goals.join(" or "))]
    SeveralGoals {
        /// Each goal: the object to move and its terms.
        goals: Vec<String>,
    },
}

/// A sentence that is refused. Its text names the objects in question.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{reason}: {}", descriptions.join("; "))]
pub struct RefusedSentence {
    /// Why.
    pub reason: Reason,
    /// The objects that it may be about: those that fit the phrase, or all of the scene.
    pub candidates: Vec<u16>,
    /// A description of each candidate.
    pub descriptions: Vec<String>,
}

impl RefusedSentence {
    /// A refusal that names some objects, or all where none is in question more than another.
    pub(crate) fn about(reason: Reason, looks: &[ObjectAppearance], ids: &[u16]) -> Self {
        let named: Vec<&ObjectAppearance> = looks.iter().filter(|l| ids.is_empty() || ids.contains(&l.id)).collect();
        let mut descriptions: Vec<String> = named.iter().map(|l| l.describe()).collect();
        if descriptions.is_empty() {
            descriptions.push("no objects are in view".to_owned());
        }
        Self { reason, candidates: named.iter().map(|l| l.id).collect(), descriptions }
    }
}
