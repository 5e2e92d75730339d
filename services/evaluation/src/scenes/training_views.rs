//! The training scenes, seen from many sides, that what is believed of objects is learned from.
//!
//! Whose camera it will be, and how well its depth and masks keep to borders, is not known: each view has one of several sizes of pictures and
//! of bands that are cleaned away around masks, and in some the masks are found.

use rand::RngExt;
use rand_pcg::Pcg64;
use repose_geometry::Isometry3;
use repose_perception::segment;
use repose_proto::{Frame, Scene};
use repose_simulator::scene::{KindWeights, SceneKind, SimulatedScene, scene_of_seed};

use crate::scenes::perturbation::{pierce, shorten, with_found_masks};
use crate::scenes::problem::{CameraView, ProblemSettings};

/// Bands that are cleaned away around masks, pixels.
const BORDERS_PX: [usize; 3] = [0, 2, 2];

/// Which views are learned from. One set of them is the same on every machine.
#[derive(Debug, Clone, Copy)]
pub struct TrainingViews {
    /// Tells the draws of one set from those of another.
    pub stream: u128,
    /// Views of each scene.
    pub views: usize,
    /// Sizes of pictures, drawn evenly.
    pub sizes: &'static [[usize; 2]],
    /// The share of views whose masks perception finds; none where that is not even drawn.
    pub found_masks: Option<f64>,
    /// The share of views by a camera of short reach, and as many of shiny things; none where that is not even drawn.
    pub faults: Option<f64>,
}

/// A scene as it was seen.
#[derive(Debug)]
pub struct TrainingView {
    /// What perception makes of it.
    pub observed: Scene,
    /// The camera's pose.
    pub world_from_camera: Isometry3<f64>,
}

/// Puts each of two faults on a share of the frames; whether any was.
fn put_faults(frame: &mut Frame, share: f64, rng: &mut Pcg64) -> bool {
    let is_put = [shorten, pierce].map(|put: fn(&mut Frame, &mut Pcg64)| {
        let is_put = rng.random_bool(share);
        if is_put {
            put(frame, rng);
        }
        is_put
    });
    is_put.contains(&true)
}

impl TrainingViews {
    /// Shows the scene of a seed, the `index`-th that is learned from, view by view; kinds of scenes take turns. Shows nothing where the seed gives no
    /// scene.
    pub fn show(&self, seed: u64, index: u64, mut look: impl FnMut(&SimulatedScene, TrainingView)) {
        let mut settings = ProblemSettings::default();
        settings.scene.kinds = KindWeights::only(SceneKind::ALL[index as usize % SceneKind::ALL.len()]);
        let Ok((truth, _)) = scene_of_seed(seed, &settings.scene) else { return };
        let mut rng = Pcg64::new(u128::from(seed), self.stream);
        for _ in 0..self.views {
            [settings.viewpoint.width, settings.viewpoint.height] = self.sizes[rng.random_range(0..self.sizes.len())];
            settings.perception.borders.radius_px = BORDERS_PX[rng.random_range(0..BORDERS_PX.len())];
            let finds_masks = self.found_masks.is_some_and(|share| rng.random_bool(share));
            let Some(CameraView { mut frame, observed, world_from_camera, .. }) = CameraView::at_random(&truth, &settings, &mut rng, seed)
            else {
                continue;
            };
            let is_faulty = self.faults.is_some_and(|share| put_faults(&mut frame, share, &mut rng));
            let observed = match (finds_masks, is_faulty) {
                (true, _) => with_found_masks(frame, &settings.perception),
                (false, true) => segment(&frame, &settings.perception),
                (false, false) => Ok(observed),
            };
            let Ok(observed) = observed else { continue };
            look(&truth, TrainingView { observed, world_from_camera });
        }
    }
}
