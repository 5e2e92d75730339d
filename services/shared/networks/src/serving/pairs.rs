//! What the networks read of a query and its anchors, kept with the scene that it is of.

use nalgebra::Point3;

use crate::pair_measures::MeasuredCloud;
use crate::points::ObjectCloud;

/// A query and its anchors, prepared for the relation predictor once for any number of candidates ([`super::Models::pairs`]).
#[derive(Debug, Clone)]
pub struct Pairs {
    pub(super) query: ObjectCloud,
    /// The query without a turn, for candidates that only move it.
    pub(super) observed: Oriented,
    pub(super) anchors: Vec<Anchor>,
}

/// The codes of the scene around an anchor, of a query and of the anchor, one after another.
#[derive(Debug)]
pub(super) struct PriorCodes(pub(super) Vec<f32>);

/// An anchor as the relation predictor reads it.
#[derive(Debug, Clone)]
pub(super) struct Anchor {
    pub(super) code: Vec<f32>,
    pub(super) measured: Option<MeasuredCloud>,
    pub(super) centroid_in_viewer: Point3<f32>,
}

/// What the predictor reads of a query in one orientation: its shape's features, and its cloud prepared for measuring.
pub(super) type Oriented = (Vec<f32>, Option<MeasuredCloud>);
