//! What the two trainings have in common: samples out of episodes, a loss of a micro-batch, measurements on validation episodes.

use candle_core::{Result, Tensor};
use rand_pcg::Pcg64;
use repose_networks::{Networks, NetworksConfig, layers::Mode};

use crate::{episode::Episode, settings::Part};

/// One of the trainings.
pub trait Task: Sync {
    /// Which.
    fn part(&self) -> Part;

    /// Whether a parameter is fitted by this task.
    fn fits(&self, parameter: &str) -> bool;

    /// The loss of one micro-batch drawn from prepared episodes (at least one).
    ///
    /// # Errors
    /// Tensor errors.
    fn loss(
        &self,
        networks: &Networks,
        config: &NetworksConfig,
        episodes: &[&Episode],
        samples: usize,
        mode: &Mode,
        rng: &mut Pcg64,
    ) -> Result<Tensor>;

    /// Figures on validation episodes, with running statistics, as JSON. The first, `loss`, falls as things get better.
    ///
    /// # Errors
    /// Tensor errors.
    fn measure(&self, networks: &Networks, config: &NetworksConfig, episodes: &[Episode], rng: &mut Pcg64) -> Result<serde_json::Value>;
}
