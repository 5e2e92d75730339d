//! A scene prepared once for any number of questions: clouds in the viewer's axes, in sampling order.

use std::collections::BTreeMap;
use std::convert::Infallible;
use std::sync::Arc;

use nalgebra::{Point3, Rotation3};
use repose_geometry::ViewerFrame;

use crate::config::SharedConfig;
use crate::points::{CloudConfig, ObjectCloud, Observer, SceneCloud};

use super::kept::Kept;
use super::pairs::{Pairs, PriorCodes};
use super::shared::SceneFeatures;

/// A placement of the query: where the centroid of its observed cloud goes, in the world, and how far it is turned about world z
/// (counter-clockwise, radians) from how it was observed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Candidate {
    /// World position of the moved centroid, metres.
    pub position_in_world: [f32; 3],
    /// Turn about world z, radians.
    pub yaw_rad: f32,
}

/// Why a question about a scene cannot be answered.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum InputError {
    /// One label per point.
    #[error("labels: expected {points} (one per point), got {labels}")]
    LabelCount {
        /// Points given.
        points: usize,
        /// Labels given.
        labels: usize,
    },
    /// A coordinate or an angle is NaN or infinite.
    #[error("{field}[{index}] is not finite")]
    NotFinite {
        /// The array.
        field: &'static str,
        /// The entry.
        index: usize,
    },
    /// No object with points has this label.
    #[error("{field}: the scene has no object {label}")]
    UnknownObject {
        /// `query` or `anchors`.
        field: &'static str,
        /// The label.
        label: u16,
    },
    /// The weights have no outcome network: they are those of the paper's networks alone.
    #[error("the weights have no outcome network; score with the discriminator, or serve weights that were trained with one")]
    NoOutcomeNetwork,
    /// The query was named as its own anchor.
    #[error("anchors: object {label} is the query")]
    AnchorIsQuery {
        /// The label.
        label: u16,
    },
}

/// One observed scene. Independent of any weights; cheap to share between threads.
#[derive(Debug, Clone)]
pub struct SceneContext {
    pub(super) scene: SceneCloud,
    objects: BTreeMap<u16, ObjectCloud>,
    viewer_from_world: Rotation3<f32>,
    viewer: ViewerFrame,
    /// The scene's features without a query, by weights hash and query.
    features: Kept<(String, u16), SceneFeatures, KEPT>,
    /// What the relation predictor reads, by weights hash, query and anchors.
    pub(super) pairs: Kept<(String, u16, Vec<u16>), Pairs, KEPT>,
    /// What the prior reads, by weights hash, query and anchor.
    pub(super) prior_codes: Kept<(String, u16, u16), PriorCodes, KEPT>,
}

/// Queries of which the networks' shared work is kept: requests on a scene come in bursts. Features are about 2 MB each.
const KEPT: usize = 4;
/// What those take for each centroid of the scene: its features at both levels, and the lists of its neighbours.
const BYTES_PER_CENTROID: usize = 1 << 10;

impl SceneContext {
    /// Prepares world points `[n]` with labels `[n]` (0 = not an object) that a camera (`observer`, world axes) observed, for a viewer at
    /// `view_yaw_rad` (see [`repose_geometry::ViewerFrame`]). Takes tens of milliseconds: prepare a scene once.
    ///
    /// # Errors
    /// [`InputError`] when the lengths differ or a coordinate is not finite.
    pub fn new(
        points_in_world: &[Point3<f32>],
        labels: &[u16],
        view_yaw_rad: f64,
        observer: &Observer,
        config: &CloudConfig,
    ) -> Result<Self, InputError> {
        if points_in_world.len() != labels.len() {
            return Err(InputError::LabelCount { points: points_in_world.len(), labels: labels.len() });
        }
        if let Some(index) = points_in_world.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
            return Err(InputError::NotFinite { field: "points", index });
        }
        if !view_yaw_rad.is_finite() {
            return Err(InputError::NotFinite { field: "view_yaw_rad", index: 0 });
        }
        if !(observer.eye.iter().all(|x| x.is_finite()) && observer.pixel_rad.is_finite()) {
            return Err(InputError::NotFinite { field: "observer", index: 0 });
        }
        let viewer = ViewerFrame::from_yaw(view_yaw_rad);
        let viewer_from_world = viewer.viewer_from_world().cast();
        let observer = observer.turned(&viewer_from_world);
        let points = viewer.points_in_viewer(points_in_world);
        let mut by_label: BTreeMap<u16, Vec<Point3<f32>>> = BTreeMap::new();
        for (p, label) in points.iter().zip(labels).filter(|(_, label)| **label != 0) {
            by_label.entry(*label).or_default().push(*p);
        }
        let objects: BTreeMap<u16, ObjectCloud> =
            by_label.iter().filter_map(|(label, points)| Some((*label, ObjectCloud::new(points, &observer, config)?))).collect();
        let centers: Vec<Point3<f32>> = objects.values().map(|o| o.centroid_in_viewer).collect();
        let scene = SceneCloud::new(&points, labels, &centers, config);
        let (features, pairs, prior_codes) = (Kept::default(), Kept::default(), Kept::default());
        Ok(Self { scene, objects, viewer_from_world, viewer, features, pairs, prior_codes })
    }

    /// The same scene with nothing kept of earlier questions: to ask what it costs to be asked for the first time.
    #[must_use]
    pub fn with_nothing_kept(&self) -> Self {
        Self { features: Kept::default(), pairs: Kept::default(), prior_codes: Kept::default(), ..self.clone() }
    }

    /// About how many bytes are kept at most of what is asked about a scene of so many points, beside the scene itself.
    pub fn kept_bytes(points: usize) -> usize {
        KEPT * SharedConfig::default().scene_centroids[0].min(points) * BYTES_PER_CENTROID
    }

    /// The labels of the objects that have points, ascending.
    pub fn objects(&self) -> impl Iterator<Item = u16> + '_ {
        self.objects.keys().copied()
    }

    /// The world position of an object's observed centroid.
    pub fn centroid_in_world(&self, label: u16) -> Option<Point3<f32>> {
        Some(self.viewer_from_world.inverse() * self.objects.get(&label)?.centroid_in_viewer)
    }

    /// The viewer's frame: its rotation carries the prior's offsets into the world.
    pub fn viewer(&self) -> ViewerFrame {
        self.viewer
    }

    pub(super) fn object(&self, field: &'static str, label: u16) -> Result<&ObjectCloud, InputError> {
        self.objects.get(&label).ok_or(InputError::UnknownObject { field, label })
    }

    /// The scene's features without a query under some weights: computed at the first call, and kept for the last few queries.
    pub(super) fn features_without(&self, query: u16, weights: &str, make: impl FnOnce() -> SceneFeatures) -> Arc<SceneFeatures> {
        let made: Result<_, Infallible> = self.features.of((weights.to_owned(), query), || Ok(make()));
        match made {
            Ok(features) => features,
        }
    }

    /// Candidates' positions in the viewer's axes with their yaws.
    pub(super) fn in_viewer(&self, candidates: &[Candidate]) -> Result<Vec<([f32; 3], f32)>, InputError> {
        let place = |(index, c): (usize, &Candidate)| {
            if c.position_in_world.iter().all(|x| x.is_finite()) && c.yaw_rad.is_finite() {
                Ok(((self.viewer_from_world * Point3::from(c.position_in_world)).into(), c.yaw_rad))
            } else {
                Err(InputError::NotFinite { field: "candidates", index })
            }
        };
        candidates.iter().enumerate().map(place).collect()
    }
}
