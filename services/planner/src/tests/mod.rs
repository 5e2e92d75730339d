//! What the planner answers on synthetic scenes, with and without networks.

mod arrange;
pub(crate) mod fake;
mod learned;
mod plan;
mod sides;
mod stops;
pub(crate) mod synthetic;
mod unloaded;

use std::sync::{Arc, OnceLock};

use crate::learned::forecast::Forecasts;

/// The forecasts of the weights that come with the program.
pub fn forecasts() -> &'static Arc<Forecasts> {
    static FORECASTS: OnceLock<Arc<Forecasts>> = OnceLock::new();
    FORECASTS.get_or_init(|| {
        let weights = repose_networks::Weights::embedded().expect("the program's weights");
        Arc::new(Forecasts::read(&weights.info.forecasts).expect("forecasts of this program"))
    })
}
