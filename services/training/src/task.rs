//! What the trainings share: preparing views, a loss on a micro-batch of them, figures on validation views.

use candle_core::{Result, Tensor};
use rand_pcg::Pcg64;
use repose_networks::{Networks, NetworksConfig, layers::Mode};

use crate::{settings::TrainedPart, views::QueryView};

/// A training task: how its examples are prepared, and its loss.
pub trait TrainingTask: Sync {
    /// A view prepared, with one of its objects as the query; kept for some steps.
    type Prepared: Send + Sync;

    /// Which part it fits.
    fn part(&self) -> TrainedPart;

    /// Whether a parameter is fitted by this task.
    fn fits(&self, parameter: &str) -> bool {
        self.part().fits(parameter)
    }

    /// Prepares a view; `None` when cleaning leaves too little of it. Only networks that are not fitted may be used, since
    /// the others change.
    ///
    /// # Errors
    /// Tensor errors.
    fn prepare(
        &self,
        networks: &Networks,
        config: &NetworksConfig,
        drawn: &QueryView<'_>,
        rng: &mut Pcg64,
    ) -> Result<Option<Self::Prepared>>;

    /// The loss of one micro-batch of `samples` drawn from prepared views (at least one).
    ///
    /// # Errors
    /// Tensor errors.
    fn loss(
        &self,
        networks: &Networks,
        config: &NetworksConfig,
        prepared: &[&Self::Prepared],
        samples: usize,
        mode: &Mode,
        rng: &mut Pcg64,
    ) -> Result<Tensor>;

    /// Figures on validation views, with running statistics, as JSON. `loss` falls as the networks get better.
    ///
    /// # Errors
    /// Tensor errors.
    fn measure(
        &self,
        networks: &Networks,
        config: &NetworksConfig,
        prepared: &[Self::Prepared],
        rng: &mut Pcg64,
    ) -> Result<serde_json::Value>;
}
