//! The in-view constraint of the paper (equation 5), with occlusion.

use crate::scene::candidate::CandidatePose;
use crate::scene::query::QueryObject;
use repose_belief::settings::ViewSettings;
use repose_belief::view::{ObservedView, Visibility};

/// How well a candidate would be seen, and by how much that is too little.
pub fn view_miss(
    view: &ObservedView,
    query: &QueryObject,
    candidate: &CandidatePose,
    settings: &ViewSettings,
) -> (Visibility, Option<f64>) {
    let placed_from_observed = candidate.placed_from_observed(&query.shape.centroid);
    let visibility = view.visibility(&query.view_points, &placed_from_observed, query.id, settings);
    let miss = (settings.min_in_picture - visibility.in_picture).max(0.0) + (settings.min_unhidden - visibility.unhidden).max(0.0);
    (visibility, (miss > 0.0).then_some(miss))
}
