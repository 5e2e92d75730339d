//! The service's configuration, section `[planner]`.

use std::collections::BTreeMap;

use repose_proto::RigidTransform;
use repose_proto::keys::validate_chunk;
use repose_proto::place::ReachingRobot;
use repose_runtime::{RuntimeError, check_counts};
use serde::Deserialize;

/// Configuration of a planner worker. Unknown fields are refused.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PlannerConfig {
    /// Poses of robots' bases in the world frame by name, row-major: to tell which places a robot reaches that a request names without one.
    pub robots: BTreeMap<String, [f64; 16]>,
    /// The robot that requests are for which name none; with none, nothing is out of reach for them.
    pub robot: Option<String>,
    /// Threads that search; each has one request and waits while inference scores. Raising it keeps inference busier; results do not
    /// depend on it.
    pub threads: usize,
    /// Requests that may wait for a thread; the next is refused at once. Raising it lets callers wait longer instead.
    pub queue_capacity: usize,
    /// The most prepared scenes kept; the least recently used go first. Raising it saves preparing a scene again, at some 20 MB each.
    pub scenes: usize,
    /// The longest that perception may take to send a scene that is not here, milliseconds; half of what is left to the request, where that is
    /// less. Raising it bears slower links.
    pub scene_timeout_ms: u64,
    /// Time kept back from a request's deadline to send the answer, milliseconds. Raising it makes late searches end earlier, as
    /// `partial`; at 0 some end as `deadline_exceeded`.
    pub reply_reserve_ms: u64,
}

impl Default for PlannerConfig {
    fn default() -> Self {
        Self {
            robots: BTreeMap::new(),
            robot: None,
            threads: 4,
            queue_capacity: 64,
            scenes: 8,
            scene_timeout_ms: 20_000,
            reply_reserve_ms: 60,
        }
    }
}

impl PlannerConfig {
    /// Checks what the types cannot.
    ///
    /// # Errors
    /// [`RuntimeError::Config`] that names the field, as [`Robots::of`].
    pub fn validate(&self) -> Result<(), RuntimeError> {
        check_counts("planner", &[("threads", self.threads), ("queue_capacity", self.queue_capacity)])?;
        Robots::of(self).map(drop)
    }
}

/// Where the cell's robots stand, as the configuration says.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Robots {
    bases: BTreeMap<String, RigidTransform>,
    default: Option<String>,
}

impl Robots {
    /// Those of a configuration.
    ///
    /// # Errors
    /// [`RuntimeError::Config`] when a name is no chunk of a key, a pose is not rigid, or the default robot has none.
    pub fn of(config: &PlannerConfig) -> Result<Self, RuntimeError> {
        let bad = |message: String| RuntimeError::Config { section: "planner".to_owned(), file: None, message };
        for (name, pose) in &config.robots {
            let field = format!("robots.{name}");
            let valid = validate_chunk(&field, name).and_then(|()| RigidTransform(*pose).validate(&field));
            valid.map_err(|e| bad(e.to_string()))?;
        }
        if let Some(name) = config.robot.as_ref().filter(|name| !config.robots.contains_key(*name)) {
            return Err(bad(format!("robot: {name} is not among robots")));
        }
        let bases = config.robots.iter().map(|(name, pose)| (name.clone(), RigidTransform(*pose))).collect();
        Ok(Self { bases, default: config.robot.clone() })
    }

    /// Puts in what a request leaves to the cell: the robot, and where it stands.
    pub fn complete(&self, asked: &mut Option<ReachingRobot>) {
        if let (None, Some(name)) = (&asked, &self.default) {
            *asked = Some(ReachingRobot { name: name.clone(), world_from_base: None });
        }
        if let Some(robot) = asked
            && robot.world_from_base.is_none()
        {
            robot.world_from_base = self.bases.get(&robot.name).copied();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_left_out_have_their_defaults_and_unknown_ones_are_refused() {
        let config: PlannerConfig = serde_json::from_str(r#"{"threads": 2}"#).unwrap();
        assert_eq!(config, PlannerConfig { threads: 2, ..PlannerConfig::default() });
        assert!(serde_json::from_str::<PlannerConfig>(r#"{"thread": 2}"#).unwrap_err().to_string().contains("unknown field"));
    }

    #[test]
    fn a_queue_without_places_and_a_crew_of_nobody_are_refused_by_name() {
        assert!(PlannerConfig::default().validate().is_ok());
        let refused = PlannerConfig { queue_capacity: 0, ..PlannerConfig::default() }.validate().unwrap_err().to_string();
        assert!(refused.contains("queue_capacity"), "{refused}");
        assert!(PlannerConfig { threads: 0, ..PlannerConfig::default() }.validate().unwrap_err().to_string().contains("threads"));
    }

    #[test]
    fn robots_are_put_into_requests_that_leave_them_to_the_cell() {
        let pose = |x: f64| [1.0, 0.0, 0.0, x, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        let robots = BTreeMap::from([("left".to_owned(), pose(-0.5)), ("right".to_owned(), pose(0.5))]);
        let config = PlannerConfig { robot: Some("left".to_owned()), robots, ..PlannerConfig::default() };
        let of_request = |mut robot: Option<ReachingRobot>| {
            Robots::of(&config).unwrap().complete(&mut robot);
            robot.map(|robot| (robot.name, robot.world_from_base.map(|pose| pose.0[3])))
        };
        let named =
            |name: &str, pose: Option<[f64; 16]>| Some(ReachingRobot { name: name.to_owned(), world_from_base: pose.map(RigidTransform) });
        assert_eq!(of_request(None), Some(("left".to_owned(), Some(-0.5))));
        assert_eq!(of_request(named("right", None)), Some(("right".to_owned(), Some(0.5))));
        assert_eq!(of_request(named("right", Some(pose(2.0)))), Some(("right".to_owned(), Some(2.0))));
        assert_eq!(of_request(named("third", None)), Some(("third".to_owned(), None)), "the search refuses it");
        let refused = |config: &PlannerConfig| Robots::of(config).unwrap_err().to_string();
        assert!(refused(&PlannerConfig { robot: Some("third".to_owned()), ..config.clone() }).contains("third"));
        assert!(
            refused(&PlannerConfig { robots: BTreeMap::from([("left".to_owned(), [0.0; 16])]), ..config.clone() }).contains("robots.left")
        );
        // Whoever leaves the robot to the cell would be told that the name, which it did not give, is bad.
        let robots = BTreeMap::from([("Left arm".to_owned(), pose(0.0))]);
        assert!(refused(&PlannerConfig { robot: Some("Left arm".to_owned()), robots, ..config.clone() }).contains("robots.Left arm"));
    }
}
