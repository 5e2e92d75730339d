//! Starting services: one in this process, from its section of the configuration.

use std::path::Path;

use repose_console::ConsoleConfig;
use repose_inference::InferenceConfig;
use repose_motion::MotionConfig;
use repose_perception::PerceptionConfig;
use repose_planner::PlannerConfig;
use repose_proto::Service;
use repose_runtime::{Session, Shutdown, load_config};
use repose_simulator::{SimulatorConfig, SimulatorError};

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
    /// Section `[console]`.
    pub console: ConsoleConfig,
}

impl ServiceConfigs {
    /// Reads the sections of a file, where one is given, and the environment over them.
    pub fn load(file: Option<&Path>) -> Result<Self, Failure> {
        let configs = Self::read(file)?;
        configs.validate()?;
        Ok(configs)
    }

    /// The same, unchecked but for fields that there are not, and values that their fields cannot have.
    pub fn read(file: Option<&Path>) -> Result<Self, Failure> {
        Ok(Self {
            perception: load_config("perception", file)?,
            inference: load_config("inference", file)?,
            planner: load_config("planner", file)?,
            motion: load_config("motion", file)?,
            simulator: load_config("simulator", file)?,
            console: load_config("console", file)?,
        })
    }

    /// Checks what the types cannot and what needs no network to be checked.
    fn validate(&self) -> Result<(), Failure> {
        self.perception.validate()?;
        self.inference.validate()?;
        self.planner.validate()?;
        self.motion.validate().map_err(|e| Failure::bad_input(&format!("motion.{}", e.field), e.message))
    }

    /// Runs a service until `shutdown`.
    pub async fn run(self, service: Service, session: Session, shutdown: Shutdown) -> Result<(), Failure> {
        match service {
            Service::Perception => Ok(repose_perception::run(session, self.perception, shutdown).await?),
            Service::Inference => repose_inference::run(session, self.inference, shutdown).await.map_err(Failure::other),
            Service::Planner => Ok(repose_planner::run(session, self.planner, shutdown).await?),
            Service::Motion => Ok(repose_motion::run(session, self.motion, shutdown).await?),
            Service::Simulator => repose_simulator::run(session, self.simulator, shutdown).await.map_err(|e| match e {
                SimulatorError::Config { field, message } => Failure::bad_input(&format!("simulator.{field}"), message),
                SimulatorError::Runtime(e) => e.into(),
                other => Failure::other(other),
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use repose_runtime::{CallerConfig, SessionConfig, TelemetryConfig, WorkerConfig};
    use serde::de::DeserializeOwned;

    use super::*;

    fn example() -> std::path::PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/repose.toml")
    }

    #[test]
    fn the_example_configuration_says_the_defaults() {
        let said = ServiceConfigs::load(Some(&example())).unwrap_or_else(|failure| panic!("{failure:?}"));
        assert_eq!(said, ServiceConfigs::default());
    }

    #[test]
    fn the_example_configuration_says_every_setting() {
        let text = std::fs::read_to_string(example()).unwrap();
        // Settings without a default value stand there commented out.
        let is_setting =
            |line: &str| line.split_once(" = ").is_some_and(|(name, _)| name.bytes().all(|b| b == b'_' || b.is_ascii_lowercase()));
        let lines = text.lines().map(|line| line.strip_prefix("# ").filter(|rest| is_setting(rest)).unwrap_or(line));
        let said: toml::Table = toml::from_str(&lines.collect::<Vec<_>>().join("\n")).unwrap();
        let sections = [
            ("session", fields_of::<SessionConfig> as fn(&str) -> BTreeSet<String>),
            ("caller", fields_of::<CallerConfig>),
            ("worker", fields_of::<WorkerConfig>),
            ("telemetry", fields_of::<TelemetryConfig>),
            ("perception", fields_of::<PerceptionConfig>),
            ("inference", fields_of::<InferenceConfig>),
            ("planner", fields_of::<PlannerConfig>),
            ("motion", fields_of::<MotionConfig>),
            ("simulator", fields_of::<SimulatorConfig>),
            ("console", fields_of::<ConsoleConfig>),
        ];
        assert_eq!(said.keys().map(String::as_str).collect::<BTreeSet<_>>(), sections.iter().map(|(name, _)| *name).collect());
        for (name, fields) in sections {
            same_settings(name, "", said[name].as_table().unwrap(), fields);
        }
    }

    #[test]
    fn a_worker_takes_more_calls_than_its_queue_and_threads_so_that_interactive_ones_come_to_displace_batch_ones() {
        let (open, configs) = (WorkerConfig::default().max_open_calls, ServiceConfigs::default());
        let ServiceConfigs { perception, inference, planner, motion, simulator, .. } = configs;
        let taken = [
            (Service::Perception, perception.queue_capacity + perception.threads),
            (Service::Inference, inference.queue_capacity + inference.max_batch),
            (Service::Planner, planner.queue_capacity + planner.threads),
            (Service::Motion, motion.queue + motion.threads),
            (Service::Simulator, simulator.queue),
        ];
        for (service, taken) in taken {
            assert!(taken < open, "{service}: {taken} of {open}");
        }
    }

    #[test]
    fn a_zone_that_is_turned_inside_out_is_refused_by_its_field() {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(&file, "[motion]\nkeep_out = [{name = \"shelf\", min_m = [1, 0, 0], max_m = [0, 1, 1]}]\n").unwrap();
        let failure = ServiceConfigs::load(Some(file.path())).unwrap_err();
        let field = failure.error().and_then(|e| e.field.clone());
        assert_eq!((failure.exit_code(), field.as_deref()), (2, Some("motion.keep_out")));
    }

    #[test]
    fn no_number_of_segmentation_may_be_nan() {
        let text = std::fs::read_to_string(example()).unwrap();
        let said: toml::Table = toml::from_str(&text).unwrap();
        let names = names_of_numbers(said["perception"]["segmentation"].as_table().unwrap());
        assert!(names.len() > 60, "{names:?}");
        for name in names {
            let (table, field) =
                name.rsplit_once('.').map_or((String::new(), name.as_str()), |(table, field)| (format!(".{table}"), field));
            let config: PerceptionConfig = toml::from_str(&format!("[segmentation{table}]\n{field} = nan")).unwrap();
            let refusal = config.validate().map_err(|e| e.field);
            assert_eq!(refusal, Err(Some(format!("perception.segmentation.{name}"))));
        }
    }

    /// The paths of the numbers with a fraction in a table and the tables below it.
    fn names_of_numbers(table: &toml::Table) -> Vec<String> {
        let below = |(name, value): (&String, &toml::Value)| match value {
            toml::Value::Float(_) => vec![name.clone()],
            toml::Value::Table(table) => names_of_numbers(table).iter().map(|below| format!("{name}.{below}")).collect(),
            _ => Vec::new(),
        };
        table.iter().flat_map(below).collect()
    }

    /// Compares a table with the fields of its type, and the tables below it.
    fn same_settings(section: &str, below: &str, said: &toml::Table, fields: fn(&str) -> BTreeSet<String>) {
        assert_eq!(said.keys().cloned().collect::<BTreeSet<_>>(), fields(below), "[{section}] {below}");
        for (name, value) in said {
            // Poses by robots' names, shares by cells': a name is no setting.
            if name == "robots" || name == "shares" {
                continue;
            }
            let below = if below.is_empty() { name.clone() } else { format!("{below}.{name}") };
            value.as_table().into_iter().for_each(|table| same_settings(section, &below, table, fields));
        }
    }

    /// The fields of the type of a table below `T`, which its refusal of an unknown one names.
    fn fields_of<T: DeserializeOwned>(below: &str) -> BTreeSet<String> {
        let table = if below.is_empty() { String::new() } else { format!("[{below}]\n") };
        let refusal = toml::from_str::<T>(&format!("{table}no_such_setting = 0")).map(drop).unwrap_err();
        let names = refusal.message().split('`').skip(1).step_by(2).filter(|name| *name != "no_such_setting");
        names.map(str::to_owned).collect()
    }
}
