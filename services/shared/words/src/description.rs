//! What a sentence says before anybody has looked at the scene: descriptions of objects, terms, readings.

use repose_proto::Relation;

use crate::color::ColorTerm;
use crate::shape::ShapeKind;

/// What a noun says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Head {
    /// "object", "thing".
    Any,
    /// "one": the noun said before it, or any object where no other has that noun.
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
    /// Its own height.
    Height,
    /// How high its top is: as its own height, unless it stands on something.
    Top,
    /// Longest horizontal edge.
    Length,
    /// The viewer's x.
    Right,
    /// The viewer's y.
    Away,
}

/// When words after a noun tell which object is meant, in a sentence that says a place, too. They may as well be a part of that place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Telling {
    /// Always: they have "that is" before them, or a verb after them ("and put it", "goes").
    Always,
    /// Where the object cannot be told without them: "put the mug left of the plate on the box", if there are two mugs.
    IfNeeded,
    /// There, and where they surely are true of the object: "put the ball on the plate on the box", if it lies on the plate.
    IfTrue,
    /// Never: "to the left" of "put the mug to the left near the bowl" says where to.
    Never,
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
    /// When it tells the object: "the mug on the left" may as well say where to put the mug.
    pub telling: Telling,
}

/// The object that is nearest to another, or farthest from it.
#[derive(Debug, Clone, PartialEq)]
pub struct Distance {
    /// Whether it is the nearest.
    pub nearest: bool,
    /// The other.
    pub to: Box<Description>,
    /// When it tells the object: "the mug closest to the bowl" may as well say where to put the mug.
    pub telling: Telling,
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
    /// "nearest to …" and "farthest from …".
    pub distance: Option<Distance>,
    /// "that is left of …".
    pub clauses: Vec<Clause>,
}

impl Description {
    /// Closes the phrase: the words after it ("and put it", "goes") show where it ends, so all of it describes the object, and must be true
    /// of it whether or not it is needed.
    pub fn close(&mut self) {
        for pick in &mut self.picks {
            pick.telling = Telling::Always;
        }
        for clause in &mut self.clauses {
            clause.telling = Telling::Always;
            clause.anchor.close();
        }
        if let Some(distance) = &mut self.distance {
            distance.telling = Telling::Always;
            distance.to.close();
        }
    }

    /// Whether words of it compare the object with others.
    pub fn compares(&self) -> bool {
        let is_compared = |word: &ShapeWord| matches!(word, ShapeWord::Tall | ShapeWord::Flat);
        !self.picks.is_empty() || self.distance.is_some() || self.shapes.iter().any(is_compared)
    }

    /// Has no clause describe the object that is not needed to tell it.
    pub fn say_only_what_is_needed(&mut self) {
        for clause in self.clauses.iter_mut().filter(|clause| clause.telling == Telling::IfTrue) {
            clause.telling = Telling::IfNeeded;
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
    /// When it tells the object: "the mug left of the plate" may as well say where to put the mug.
    pub telling: Telling,
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

impl RelationPhrase {
    /// Whether it only says what must not hold.
    pub fn is_negative(&self) -> bool {
        self.relations.iter().all(|(_, holds)| !holds)
    }
}

/// One reading of a sentence: the object to move, and its relations.
#[derive(Debug, Clone, PartialEq)]
pub struct SentenceReading {
    /// The object to move.
    pub query: Description,
    /// Where to.
    pub terms: Vec<RelationPhrase>,
}
