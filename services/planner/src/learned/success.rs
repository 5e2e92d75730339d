//! How likely a placement succeeds: the object stays and does not tip, the goal holds by the true shapes, nothing else is moved or pressed.
//!
//! One forecast over everything that is known of a place ([`stability`]'s measures and its word), of the goal there, and of the object
//! where it was seen: one that leans on something tips when it is set down by itself. The judge measures it. It is fitted on the planner's own answers in
//! training scenes that no network was fitted on, because an optimiser picks lucky candidates (`repose train --network success`).

use crate::learned::stability::{self, COUNT as OF_PLACE};

/// The measures beside those of [`stability`], in their order.
const BESIDE: [&str; 46] = [
    // The probability that it stays.
    "stays",
    // The least probability of a goal term, and the least margin by rule, metres.
    "goal",
    "goal_margin",
    // The probabilities that it stands by itself, and that all neighbours stay when it is taken away.
    "stands",
    "neighbour_stays",
    // Share of small errors of its pose that break a constraint.
    "fragile",
    // How far the shapes of its neighbours are from it, as they are believed to be and with all that their backs may be, metres; capped.
    "shape_gap",
    "doubted_gap",
    // The same at the place where it was seen: what it may lean on.
    "seen_gap",
    // What may lean on it there: its largest oblique face, and how far it reaches over it, metres.
    "leaner_share",
    "leaner_rad",
    "leaner_over",
    // Whether it stood on an object there.
    "seen_on_object",
    // How far below its lowest points its foot is believed to be, metres; how likely its foot is that high, and the main anchor's.
    "hidden_foot",
    "foot",
    "anchor_foot",
    // The largest share of its points that one oblique face explains, and how far that is from upright or level, radians.
    "oblique_share",
    "oblique_rad",
    // Share of its points on level faces.
    "level_share",
    // How far its mean point is from its believed axis, metres; how wide it is along and across.
    "off_axis",
    "length",
    "width",
    // What was seen to carry it: shares of its base over the anchors of goals of being above, and over other objects; on how many things it
    // stands; how far its axis is inside the outline of the tops that are level with it, and how much the heights of all vary, metres.
    "on_anchor",
    "on_others",
    "carriers",
    "level_margin",
    "top_spread",
    // What its outline and that of the main anchor end at where they were seen: shares cut off by the picture's edge, and hidden by something
    // nearer. The shares of their visible surface that were read.
    "cut_off",
    "hidden",
    "anchor_cut_off",
    "anchor_hidden",
    "observed",
    "anchor_observed",
    // How far inside the outline of the main anchor's top its axis is; the anchor's height and spans, and how far its unseen back may reach,
    // metres; the anchor's points.
    "in_anchor",
    "anchor_height",
    "anchor_length",
    "anchor_width",
    "anchor_back_unknown",
    "anchor_points",
    // The probability that it stood by itself where it was seen; by which angle it was turned over there, radians, and how much of what it stands
    // on since was seen. As it lies both are 0.
    "stood",
    "turned",
    "seen_base",
    // How likely an end of it that may be farther out than believed reaches something. Its volume in directions in which nothing was read, near or far:
    // what is looked at flatly gives no reading either.
    "farther",
    "unread",
    // How likely an end of it or of an anchor that may be farther out makes a goal of a direction fail; how likely its foot is so near that it lands well.
    "goal_farther",
    "landing",
];

/// The number of measures.
pub const COUNT: usize = OF_PLACE + BESIDE.len();

/// Whether a measure depends on what the networks say of a candidate: those of the place and of the goal; all others are geometry's.
pub fn is_by_networks(measure: usize) -> bool {
    // Of those beside it, the first two.
    measure == stability::NETWORK || (OF_PLACE..OF_PLACE + 2).contains(&measure)
}

/// The names of the measures, in the order that the trees read.
pub fn names() -> Vec<&'static str> {
    stability::names().into_iter().chain(BESIDE).collect()
}
