//! Starting services: one in this process, from its section of the configuration.

use std::path::Path;

use repose_inference::InferenceConfig;
use repose_motion::MotionConfig;
use repose_perception::PerceptionConfig;
use repose_planner::PlannerConfig;
use repose_proto::Service;
use repose_runtime::{Session, Shutdown, load_config};
use repose_simulator::SimulatorConfig;

use crate::failure::Failure;

/// The configuration of every service.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct ServiceConfigs {
    /// Section `[perception]`.
    pub perception: PerceptionConfig,
    /// Section `[inference]`.
    pub inference: InferenceConfig,
    /// Section `[planner]`.
    pub planner: PlannerConfig,
    /// Section `[motion]`.
    pub motion: MotionConfig,
    /// Section `[simulator]`.
    pub simulator: SimulatorConfig,
}

impl ServiceConfigs {
    /// Reads the sections of a file, where one is given, and the environment over them.
    pub fn load(file: Option<&Path>) -> Result<Self, Failure> {
        Ok(Self {
            perception: load_config("perception", file)?,
            inference: load_config("inference", file)?,
            planner: load_config("planner", file)?,
            motion: load_config("motion", file)?,
            simulator: load_config("simulator", file)?,
        })
    }

    /// Runs a service until `shutdown`.
    pub async fn run(self, service: Service, session: Session, shutdown: Shutdown) -> Result<(), Failure> {
        match service {
            Service::Perception => repose_perception::run(session, self.perception, shutdown).await.map_err(Failure::other),
            Service::Inference => repose_inference::run(session, self.inference, shutdown).await.map_err(Failure::other),
            Service::Planner => repose_planner::run(session, self.planner, shutdown).await.map_err(Failure::other),
            Service::Motion => repose_motion::run(session, self.motion, shutdown).await.map_err(Failure::other),
            Service::Simulator => repose_simulator::run(session, self.simulator, shutdown).await.map_err(Failure::other),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_example_configuration_says_the_defaults() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/repose.toml");
        let said = ServiceConfigs::load(Some(&file)).unwrap_or_else(|failure| panic!("{failure:?}"));
        assert_eq!(said, ServiceConfigs::default());
    }
}
