//! The vocabulary: phrases and what they mean.

use repose_proto::Relation::{self, Above, Aligned, Behind, Below, Centered, InFrontOf, LeftOf, Near, RightOf, Touching};

use crate::color::ColorTerm;
use crate::description::{Head, Measure, ShapeWord};
use crate::shape::ShapeKind;

/// Phrases of one or more words, each with its meaning.
pub type PhraseTable<T> = &'static [(&'static str, T)];

/// Before a verb.
pub const REQUESTS: PhraseTable<()> = &[
    ("could you", ()),
    ("can you", ()),
    ("would you", ()),
    ("will you", ()),
    ("i want you to", ()),
    ("i would like you to", ()),
    ("you should", ()),
    ("let us", ()),
    ("go and", ()),
];

/// Verbs that put.
pub const VERBS: PhraseTable<()> = &[
    ("put", ()),
    ("place", ()),
    ("set", ()),
    ("move", ()),
    ("stand", ()),
    ("position", ()),
    ("bring", ()),
    ("shift", ()),
    ("lay", ()),
    ("stack", ()),
    ("get", ()),
    ("keep", ()),
];

/// What a verb does to an object before "and put it".
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Taking {
    /// It only picks it up.
    Lifts,
    /// It picks it up, and where "away from" follows, takes it from there.
    Removes,
    /// It may as well move it to a place that follows.
    Moves,
}

/// Verbs that pick up what "and put it" puts.
pub const TAKES: PhraseTable<Taking> = &[
    ("pick up", Taking::Lifts),
    ("pick", Taking::Lifts),
    ("grab", Taking::Lifts),
    ("fetch", Taking::Lifts),
    ("take", Taking::Removes),
    ("get", Taking::Removes),
    ("bring", Taking::Removes),
    ("lift", Taking::Removes),
    ("lift up", Taking::Removes),
    ("move", Taking::Moves),
    ("shift", Taking::Moves),
];

/// After a verb that takes: from where.
pub const AWAY: PhraseTable<()> = &[("away from", ()), ("far away from", ())];

/// Wishes: "I want X (to be) …".
pub const WISHES: PhraseTable<()> =
    &[("i want", ()), ("we want", ()), ("i would like", ()), ("we would like", ()), ("i need", ()), ("let", ())];

/// Between a wish's object and its place.
pub const TO_BE: PhraseTable<()> = &[("to be", ()), ("be", ()), ("to stand", ()), ("to go", ()), ("put", ()), ("placed", ())];

/// Statements: "X goes …".
pub const GOES: PhraseTable<()> = &[
    ("goes", ()),
    ("belongs", ()),
    ("should be", ()),
    ("should go", ()),
    ("should stand", ()),
    ("should be put", ()),
    ("should be placed", ()),
    ("must be", ()),
    ("must go", ()),
    ("must stand", ()),
    ("has to be", ()),
    ("has to go", ()),
    ("needs to be", ()),
    ("needs to go", ()),
];

/// What may stand before a term, and whether what follows must hold.
pub const LEADS: PhraseTable<bool> = &[
    ("so that it is", true),
    ("so that it stands", true),
    ("so that it", true),
    ("so it is", true),
    ("so it stands", true),
    ("so it", true),
    ("to where it is", true),
    ("where it is", true),
    ("it should be", true),
    ("it should stand", true),
    ("it must be", true),
    ("keep it", true),
    ("keeping it", true),
    ("put it", true),
    ("place it", true),
    ("make sure it is", true),
    ("making sure it is", true),
    ("also", true),
    ("over", true),
    ("into position", true),
    ("it should not be", false),
    ("it should not", false),
    ("it must not be", false),
    ("it must not", false),
    ("make sure it is not", false),
    ("making sure it is not", false),
    ("do not put it", false),
    ("without", false),
    ("without it", false),
];

/// Directions that make a relation with "of": "to the left of", "on the right hand side of", "at the front left of".
pub const SIDES: PhraseTable<&[Relation]> = &[
    ("left", &[LeftOf]),
    ("right", &[RightOf]),
    ("front", &[InFrontOf]),
    ("back", &[Behind]),
    ("rear", &[Behind]),
    ("front left", &[InFrontOf, LeftOf]),
    ("front right", &[InFrontOf, RightOf]),
    ("left front", &[InFrontOf, LeftOf]),
    ("right front", &[InFrontOf, RightOf]),
    ("back left", &[Behind, LeftOf]),
    ("back right", &[Behind, RightOf]),
    ("rear left", &[Behind, LeftOf]),
    ("rear right", &[Behind, RightOf]),
];

/// The relations of directions on a level.
pub const LEVEL_SIDES: [Relation; 4] = [LeftOf, RightOf, InFrontOf, Behind];

/// Relations in which two objects seldom stand by chance. Where they do, saying so describes them; left and right hold of nearly every pair.
pub const SELDOM: [Relation; 4] = [Above, Below, Near, Touching];

/// Before a direction.
pub const TO_THE: PhraseTable<()> =
    &[("", ()), ("to the", ()), ("on the", ()), ("at the", ()), ("on", ()), ("to", ()), ("in", ()), ("over to the", ())];

/// After a direction.
pub const SIDE: PhraseTable<()> = &[("of", ()), ("side of", ()), ("hand side of", ())];

/// Other relations, and whether they must hold.
pub const RELATIONS: PhraseTable<(&[Relation], bool)> = &[
    ("before", (&[InFrontOf], true)),
    ("behind", (&[Behind], true)),
    ("on", (&[Above], true)),
    ("onto", (&[Above], true)),
    ("on top of", (&[Above], true)),
    ("atop", (&[Above], true)),
    ("upon", (&[Above], true)),
    ("above", (&[Above], true)),
    ("over", (&[Above], true)),
    ("under", (&[Below], true)),
    ("below", (&[Below], true)),
    ("beneath", (&[Below], true)),
    ("underneath", (&[Below], true)),
    ("near", (&[Near], true)),
    ("near to", (&[Near], true)),
    ("next to", (&[Near], true)),
    ("close to", (&[Near], true)),
    ("close by", (&[Near], true)),
    ("by", (&[Near], true)),
    ("beside", (&[Near], true)),
    ("alongside", (&[Near], true)),
    ("adjacent to", (&[Near], true)),
    ("touching", (&[Touching], true)),
    ("touches", (&[Touching], true)),
    ("touch", (&[Touching], true)),
    ("against", (&[Touching], true)),
    ("up against", (&[Touching], true)),
    ("in contact with", (&[Touching], true)),
    ("in the middle of", (&[Above, Centered], true)),
    ("in the center of", (&[Above, Centered], true)),
    ("on the middle of", (&[Above, Centered], true)),
    ("on the center of", (&[Above, Centered], true)),
    ("at the center of", (&[Above, Centered], true)),
    ("centered on", (&[Above, Centered], true)),
    ("centered on top of", (&[Above, Centered], true)),
    ("centered over", (&[Above, Centered], true)),
    ("centered above", (&[Above, Centered], true)),
    ("centered with", (&[Centered], true)),
    ("aligned with", (&[Aligned], true)),
    ("aligned to", (&[Aligned], true)),
    ("parallel to", (&[Aligned], true)),
    ("parallel with", (&[Aligned], true)),
    ("away from", (&[Near], false)),
    ("far from", (&[Near], false)),
    ("far away from", (&[Near], false)),
    ("clear of", (&[Near], false)),
];

/// Before a noun.
pub const ARTICLES: PhraseTable<()> = &[("the", ()), ("a", ()), ("an", ()), ("that", ()), ("this", ()), ("my", ()), ("our", ())];

/// Color adjectives.
pub const COLORS: PhraseTable<ColorTerm> = &[
    ("white", ColorTerm::White),
    ("grey", ColorTerm::Grey),
    ("silver", ColorTerm::Grey),
    ("black", ColorTerm::Black),
    ("red", ColorTerm::Red),
    ("orange", ColorTerm::Orange),
    ("brown", ColorTerm::Brown),
    ("yellow", ColorTerm::Yellow),
    ("green", ColorTerm::Green),
    ("blue", ColorTerm::Blue),
    ("purple", ColorTerm::Purple),
    ("violet", ColorTerm::Purple),
    ("pink", ColorTerm::Pink),
];

/// Adjectives of shape.
pub const SHAPES: PhraseTable<ShapeWord> = &[
    ("round", ShapeWord::Round),
    ("boxy", ShapeWord::Boxy),
    ("rectangular", ShapeWord::Boxy),
    ("square", ShapeWord::Boxy),
    ("tall", ShapeWord::Tall),
    ("flat", ShapeWord::Flat),
];

/// Adjectives that compare: by what, and whether they name the one with the least of it.
pub const PICKS: PhraseTable<(Measure, bool)> = &[
    ("large", (Measure::Size, false)),
    ("larger", (Measure::Size, false)),
    ("largest", (Measure::Size, false)),
    ("big", (Measure::Size, false)),
    ("bigger", (Measure::Size, false)),
    ("biggest", (Measure::Size, false)),
    ("small", (Measure::Size, true)),
    ("smaller", (Measure::Size, true)),
    ("smallest", (Measure::Size, true)),
    ("little", (Measure::Size, true)),
    ("taller", (Measure::Height, false)),
    ("tallest", (Measure::Height, false)),
    ("highest", (Measure::Top, false)),
    ("short", (Measure::Height, true)),
    ("shorter", (Measure::Height, true)),
    ("shortest", (Measure::Height, true)),
    ("low", (Measure::Top, true)),
    ("lower", (Measure::Top, true)),
    ("lowest", (Measure::Top, true)),
    ("flattest", (Measure::Height, true)),
    ("long", (Measure::Length, false)),
    ("longer", (Measure::Length, false)),
    ("longest", (Measure::Length, false)),
    ("left", (Measure::Right, true)),
    ("left hand", (Measure::Right, true)),
    ("left most", (Measure::Right, true)),
    ("right", (Measure::Right, false)),
    ("right hand", (Measure::Right, false)),
    ("right most", (Measure::Right, false)),
    ("far left", (Measure::Right, true)),
    ("farthest left", (Measure::Right, true)),
    ("furthest left", (Measure::Right, true)),
    ("far right", (Measure::Right, false)),
    ("farthest right", (Measure::Right, false)),
    ("furthest right", (Measure::Right, false)),
    ("front", (Measure::Away, true)),
    ("nearest", (Measure::Away, true)),
    ("closest", (Measure::Away, true)),
    ("nearer", (Measure::Away, true)),
    ("closer", (Measure::Away, true)),
    ("back", (Measure::Away, false)),
    ("rear", (Measure::Away, false)),
    ("farthest", (Measure::Away, false)),
    ("furthest", (Measure::Away, false)),
];

/// Adjectives for the one between the others.
pub const MIDDLES: PhraseTable<Measure> = &[("middle", Measure::Right), ("center", Measure::Right), ("medium", Measure::Size)];

/// Ordinals.
pub const ORDINALS: PhraseTable<usize> = &[("first", 1), ("second", 2), ("third", 3), ("fourth", 4), ("fifth", 5), ("sixth", 6)];

/// Where an object is, after its noun.
pub const PLACES: PhraseTable<(Measure, bool)> = &[
    ("on the left", (Measure::Right, true)),
    ("on the far left", (Measure::Right, true)),
    ("at the far left", (Measure::Right, true)),
    ("to the left", (Measure::Right, true)),
    ("at the left", (Measure::Right, true)),
    ("on the right", (Measure::Right, false)),
    ("on the far right", (Measure::Right, false)),
    ("at the far right", (Measure::Right, false)),
    ("to the right", (Measure::Right, false)),
    ("at the right", (Measure::Right, false)),
    ("in front", (Measure::Away, true)),
    ("in the front", (Measure::Away, true)),
    ("at the front", (Measure::Away, true)),
    ("in the back", (Measure::Away, false)),
    ("at the back", (Measure::Away, false)),
    ("at the rear", (Measure::Away, false)),
    ("nearest to me", (Measure::Away, true)),
    ("closest to me", (Measure::Away, true)),
    ("farthest from me", (Measure::Away, false)),
    ("furthest from me", (Measure::Away, false)),
];

/// Where an object in the middle is, after its noun.
pub const MIDDLE_PLACES: PhraseTable<Measure> = &[("in the middle", Measure::Right), ("in the center", Measure::Right)];

/// Ends that ordinals count from.
pub const FROM: PhraseTable<(Measure, bool)> = &[
    ("from the left", (Measure::Right, true)),
    ("from left", (Measure::Right, true)),
    ("from the right", (Measure::Right, false)),
    ("from right", (Measure::Right, false)),
    ("from the front", (Measure::Away, true)),
    ("from the back", (Measure::Away, false)),
];

/// Distance to another object: whether the least is meant.
pub const DISTANCES: PhraseTable<bool> = &[
    ("nearest to", true),
    ("nearest", true),
    ("closest to", true),
    ("farthest from", false),
    ("furthest from", false),
    ("farthest away from", false),
    ("furthest away from", false),
];

/// Before a clause that says which object is meant.
pub const THAT_IS: PhraseTable<()> =
    &[("that is", ()), ("which is", ()), ("that stands", ()), ("which stands", ()), ("standing", ()), ("that lies", ()), ("lying", ())];

/// Nouns with their plurals.
pub const NOUNS: PhraseTable<(Head, &str)> = &[
    ("object", (Head::Any, "objects")),
    ("thing", (Head::Any, "things")),
    ("item", (Head::Any, "items")),
    ("one", (Head::One, "ones")),
    ("box", (Head::Kind(ShapeKind::Box), "boxes")),
    ("carton", (Head::Kind(ShapeKind::Box), "cartons")),
    ("packet", (Head::Kind(ShapeKind::Box), "packets")),
    ("package", (Head::Kind(ShapeKind::Box), "packages")),
    ("parcel", (Head::Kind(ShapeKind::Box), "parcels")),
    ("block", (Head::Kind(ShapeKind::Box), "blocks")),
    ("brick", (Head::Kind(ShapeKind::Box), "bricks")),
    ("cube", (Head::Kind(ShapeKind::Cube), "cubes")),
    ("book", (Head::Kind(ShapeKind::Book), "books")),
    ("notebook", (Head::Kind(ShapeKind::Book), "notebooks")),
    ("ball", (Head::Kind(ShapeKind::Ball), "balls")),
    ("sphere", (Head::Kind(ShapeKind::Ball), "spheres")),
    ("can", (Head::Kind(ShapeKind::Can), "cans")),
    ("tin", (Head::Kind(ShapeKind::Can), "tins")),
    ("jar", (Head::Kind(ShapeKind::Can), "jars")),
    ("cylinder", (Head::Kind(ShapeKind::Can), "cylinders")),
    ("bottle", (Head::Kind(ShapeKind::Bottle), "bottles")),
    ("mug", (Head::Kind(ShapeKind::Mug), "mugs")),
    ("cup", (Head::Kind(ShapeKind::Mug), "cups")),
    ("glass", (Head::Kind(ShapeKind::Mug), "glasses")),
    ("bowl", (Head::Kind(ShapeKind::Bowl), "bowls")),
    ("plate", (Head::Kind(ShapeKind::Plate), "plates")),
    ("dish", (Head::Kind(ShapeKind::Plate), "dishes")),
    ("saucer", (Head::Kind(ShapeKind::Plate), "saucers")),
];

/// Words that the grammar itself names.
pub const OWN: &[&str] =
    &[",", "and", "then", "but", "or", "nor", "neither", "not", "it", "itself", "number", "other", "to", "of", "side", "hand", "up", "is"];
