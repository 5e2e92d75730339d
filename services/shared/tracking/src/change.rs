//! What is different between two views of a scene.

use nalgebra::Point3;
use repose_proto::ObjectSummary;

use crate::known::Known;

/// What has become of an object between two views.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Change {
    /// It stands elsewhere.
    Moved {
        /// Its id in the first view.
        id: u16,
        /// How far its centroid has moved, metres.
        by_m: f64,
    },
    /// It is not found near where it was.
    Gone {
        /// Its id in the first view.
        id: u16,
    },
    /// Something is there that was not.
    New {
        /// Its id in the second view.
        id: u16,
    },
}

impl std::fmt::Display for Change {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Moved { id, by_m } => write!(f, "object {id} has moved by {:.0} mm", by_m * 1e3),
            Self::Gone { id } => write!(f, "object {id} is not where it was"),
            Self::New { id } => write!(f, "there is an object (now {id}) that was not there"),
        }
    }
}

/// What is different in a second view of a scene that nobody should have touched; centroids up to `still_m` apart are the same place.
pub fn changes(before: &[ObjectSummary], after: &[ObjectSummary], still_m: f64) -> Vec<Change> {
    let mut known = Known::of(before);
    known.look_again(after);
    let mut changes = Vec::new();
    for object in before {
        let found = known.now.get(&object.id).and_then(|(now, centroid)| now.map(|_| centroid));
        match found.map(|now| (now - Point3::from(object.centroid_m)).norm()) {
            Some(by_m) if by_m > still_m => changes.push(Change::Moved { id: object.id, by_m }),
            Some(_) => {}
            None => changes.push(Change::Gone { id: object.id }),
        }
    }
    let found: Vec<u16> = known.now.values().filter_map(|(now, _)| *now).collect();
    changes.extend(after.iter().filter(|o| !found.contains(&o.id)).map(|o| Change::New { id: o.id }));
    changes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(id: u16, centroid_m: [f64; 3]) -> ObjectSummary {
        ObjectSummary { id, points: 100, centroid_m, extent_m: [0.1; 3], completeness: 1.0, score: None }
    }

    #[test]
    fn what_somebody_touched_between_two_views_is_told() {
        let before = [seen(1, [0.0, 0.0, 0.0]), seen(2, [0.3, 0.0, 0.0]), seen(3, [0.0, 0.4, 0.0])];
        let same = [seen(2, [0.002, 0.0, 0.0]), seen(1, [0.3, 0.001, 0.0]), seen(3, [0.0, 0.4, 0.003])];
        assert_eq!(changes(&before, &same, 0.01), [], "other numbers and a camera's noise are no change");
        let touched = [seen(1, [0.0, 0.0, 0.0]), seen(2, [0.3, 0.05, 0.0]), seen(4, [0.9, 0.4, 0.0])];
        let told = changes(&before, &touched, 0.01);
        assert!(
            matches!(told[..], [Change::Moved { id: 2, by_m }, Change::Gone { id: 3 }, Change::New { id: 4 }] if (by_m - 0.05).abs() < 1e-9),
            "{told:?}"
        );
    }
}
