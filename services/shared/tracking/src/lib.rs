//! Which object is which from view to view, what became of each, and whether what was asked holds in a view.
//!
//! A camera that finds its objects anew numbers them anew. Goals that are carried out one after another name objects as in the first view;
//! [`Known`] tells them by where they are: the moved one where it was put, every other where it was. [`Followed`] says beside it what became
//! of each: whether it stands, was moved, fell, is gone, or only hidden. [`changes`] says what is different in a
//! second view, [`holds`] judges goal terms by rule.

mod change;
mod fate;
mod followed;
mod known;
mod picture;
mod size;
#[cfg(test)]
mod tests;

use nalgebra::Point3;
use repose_geometry::ViewerFrame;
use repose_proto::{GoalTerm, Scene};
use repose_relations::{ObservedObject, observed};

pub use change::{Change, changes};
pub use fate::Fate;
pub use followed::Followed;
pub use known::Known;

/// Each term by rule on what is seen, for a viewer who looks along `view_yaw_rad`. A term about an object that is not seen does not hold.
pub fn holds(scene: &Scene, view_yaw_rad: f64, query: u16, terms: &[GoalTerm]) -> Vec<bool> {
    let viewer = ViewerFrame::from_yaw(view_yaw_rad);
    let object = |id: u16| ObservedObject::new(&scene.points_of(id).map(Point3::from).collect::<Vec<_>>(), &viewer);
    let moved = object(query);
    let term = |t: &GoalTerm| match (&moved, object(t.anchor)) {
        (Some(moved), Some(anchor)) => observed(moved, &anchor)[t.relation.index()] == t.holds,
        _ => false,
    };
    terms.iter().map(term).collect()
}
