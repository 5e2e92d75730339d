//! What a sentence says before anybody has looked at the scene: descriptions of objects, terms, readings.

use repose_proto::Relation;

use crate::color::ColorTerm;
use crate::shape::ShapeKind;

/// What a noun says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Head {
    /// "object", "thing".
    Any,
    /// "one": the noun said before it, if that fits anything.
    One,
    /// A noun that claims a shape.
    Kind(ShapeKind),
}

/// An adjective of shape. Tall and flat are said of the one that is so by itself, or else of the one that is more so than the others.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ShapeWord {
    /// Round.
    Round,
    /// Rectangular, square.
    Boxy,
    /// Tall.
    Tall,
    /// Flat.
    Flat,
}

/// What several objects are compared by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Measure {
    /// Volume.
    Size,
    /// Height.
    Height,
    /// Longest horizontal edge.
    Length,
    /// The viewer's x.
    Right,
    /// The viewer's y.
    Away,
}

/// One of several, by comparison.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Pick {
    /// By what.
    pub measure: Measure,
    /// Whether it has the least of it.
    pub least: bool,
    /// Which in that order, from 1; none is the one in the middle.
    pub rank: Option<usize>,
    /// As for a clause: "the mug on the left" has no "that is", and may as well say where to put the mug.
    pub only_if_needed: bool,
}

/// A noun phrase.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Description {
    /// The words of the phrase: from, to.
    pub span: (usize, usize),
    /// The object's number.
    pub number: Option<u16>,
    /// The noun; none in "the green and the blue mug".
    pub head: Option<Head>,
    /// Whether the noun is a plural: all that fit.
    pub plural: bool,
    /// "the other".
    pub other: bool,
    /// Colors; all must fit.
    pub colors: Vec<ColorTerm>,
    /// Adjectives of shape.
    pub shapes: Vec<ShapeWord>,
    /// An ordinal that has not been told yet what it counts by.
    pub ordinal: Option<usize>,
    /// Comparisons, in the order of the phrase.
    pub picks: Vec<Pick>,
    /// "nearest to …" (least) and "farthest from …".
    pub distance: Option<(bool, Box<Self>)>,
    /// "that is left of …".
    pub clauses: Vec<Clause>,
}

impl Description {
    /// Closes the phrase: the words after it ("and put it", "goes") show where it ends, so all of it describes the object, and must be true
    /// of it whether or not it is needed.
    pub fn close(&mut self) {
        for pick in &mut self.picks {
            pick.only_if_needed = false;
        }
        for clause in &mut self.clauses {
            clause.only_if_needed = false;
            clause.anchor.close();
        }
        if let Some((_, to)) = &mut self.distance {
            to.close();
        }
    }
}

/// A relation that tells an object from others.
#[derive(Debug, Clone, PartialEq)]
pub struct Clause {
    /// What holds of it.
    pub relations: &'static [Relation],
    /// To which object.
    pub anchor: Box<Description>,
    /// Whether the clause may, in a sentence that goes on to say a place, only be read so where the object could not be told without it: "the
    /// mug left of the plate" has no "that is".
    pub only_if_needed: bool,
}

/// The phrase for a relation's anchor.
#[derive(Debug, Clone, PartialEq)]
pub enum AnchorPhrase {
    /// A phrase.
    Described(Description),
    /// "it": an anchor that was named before.
    It,
}

/// A phrase of relations to anchors that must hold, or must not.
#[derive(Debug, Clone, PartialEq)]
pub struct RelationPhrase {
    /// The relations and whether each must hold; "near but not touching" has two.
    pub relations: Vec<(&'static [Relation], bool)>,
    /// Whether it is negated by a word of its own ("not") rather than by its relation ("away from").
    pub said_not: bool,
    /// The anchors; each relation is asked of each.
    pub anchors: Vec<AnchorPhrase>,
    /// Whether "and" joins anchors that are whole phrases: "left of the box and the mug".
    pub joined: bool,
    /// Whether it may as well say where to put the anchor before it: "left of the box and the mug right of the plate".
    pub of_anchor: bool,
}

/// One reading of a sentence: the object to move, and its relations.
#[derive(Debug, Clone, PartialEq)]
pub struct SentenceReading {
    /// The object to move.
    pub query: Description,
    /// Where to.
    pub terms: Vec<RelationPhrase>,
}
