//! The newest states of a cell's robots, and where each robot was at the instant of a frame.

use std::collections::{BTreeMap, VecDeque};
use std::time::{Duration, Instant};

use repose_proto::followed_robots::{MAX_ROBOTS, SAME_BASE_M, SILENT};
use repose_proto::robot::RobotState;
use repose_proto::{RigidTransform, RobotInView, SceneWarning};

/// States of a robot are kept this far apart, nanoseconds: some tell a thousand a second, and a straight way between two is near enough.
const APART_NS: u64 = 5_000_000;
/// Most states of a robot that are kept, whatever their stamps are.
const MAX_STATES: usize = 4096;
/// Two states this near to each other say that a robot stood there between them, radians and metres.
const STILL_RAD: f64 = 0.01;
const STILL_M: f64 = 0.002;
/// A state says where a robot was for this long before and after it, nanoseconds: an arm that is stopped meanwhile is 10 cm off at most.
const HOLDS_NS: u64 = 100_000_000;

/// The states of the cell's robots.
#[derive(Debug)]
pub struct RobotStates {
    kept_ns: u64,
    by_robot: BTreeMap<String, ToldStates>,
}

/// What one robot told.
#[derive(Debug)]
struct ToldStates {
    /// The oldest first.
    states: VecDeque<RobotState>,
    /// When the last one was read.
    heard: Instant,
}

impl RobotStates {
    /// States are kept for as long as a frame may wait for its turn.
    pub fn new(kept: Duration) -> Self {
        let kept_ns = u64::try_from(kept.as_nanos()).unwrap_or(u64::MAX).saturating_add(HOLDS_NS);
        Self { kept_ns, by_robot: BTreeMap::new() }
    }

    /// A robot told its state.
    pub fn put(&mut self, robot: &str, state: RobotState) {
        self.put_at(robot, state, Instant::now());
    }

    fn put_at(&mut self, robot: &str, state: RobotState, now: Instant) {
        self.make_room(robot, &state, now);
        if !self.by_robot.contains_key(robot) && self.by_robot.len() >= MAX_ROBOTS {
            return;
        }
        let told = self.by_robot.entry(robot.to_owned()).or_insert_with(|| ToldStates { states: VecDeque::new(), heard: now });
        told.heard = now;
        let states = &mut told.states;
        let stamp_ns = state.stamp_ns;
        if states.back().is_some_and(|newest| newest.stamp_ns.abs_diff(stamp_ns) < APART_NS) {
            return;
        }
        states.push_back(state);
        // By the distance, not the order: a robot's clock may have been set back. One from before stays: it may have been the last word for a while.
        while states.len() > MAX_STATES || states.get(1).is_some_and(|older| older.stamp_ns.abs_diff(stamp_ns) > self.kept_ns) {
            states.pop_front();
        }
    }

    /// Makes room for a robot that tells its state. One that has fallen silent goes where this one tells that it stands there: it is that arm under the
    /// name that it had before, and would be taken out of all pictures to come where it stood then. Names come and go while a cell runs for weeks: where
    /// there are as many as are followed, the one that has been silent for the longest goes.
    fn make_room(&mut self, robot: &str, state: &RobotState, now: Instant) {
        let is_silent = |told: &ToldStates| now.saturating_duration_since(told.heard) > SILENT;
        let stands_there = |told: &ToldStates| told.states.back().is_some_and(|last| share_base(last, state));
        self.by_robot.retain(|name, told| name == robot || !is_silent(told) || !stands_there(told));
        if self.by_robot.contains_key(robot) || self.by_robot.len() < MAX_ROBOTS {
            return;
        }
        let silent = self.by_robot.iter().filter(|(_, told)| is_silent(told)).min_by_key(|(_, told)| told.heard);
        if let Some(gone) = silent.map(|(name, _)| name.clone()) {
            self.by_robot.remove(&gone);
        }
    }

    /// Whether no robot told anything yet.
    pub fn is_empty(&self) -> bool {
        self.by_robot.is_empty()
    }

    /// The robots at an instant, of those that say where their base stands and told a state near it.
    pub fn at(&self, stamp_ns: u64) -> Vec<RobotInView> {
        self.by_robot.iter().filter_map(|(name, told)| in_view(name, &told.states, stamp_ns)).collect()
    }

    /// All robots at an instant: one that told nothing near it is taken to stand where it told last (or first) that it stood, which is said unless it
    /// told before and after that it stands there. An arm whose driver has died is still there. One that does not say where its base stands is left
    /// out, and that is said.
    pub fn at_or_nearest(&self, stamp_ns: u64) -> (Vec<RobotInView>, Vec<SceneWarning>) {
        let (mut robots, mut warnings) = (Vec::new(), Vec::new());
        for (name, ToldStates { states, .. }) in &self.by_robot {
            if let Some(robot) = in_view(name, states, stamp_ns) {
                robots.push(robot);
                continue;
            }
            let Some(nearest) = states.iter().min_by_key(|state| state.stamp_ns.abs_diff(stamp_ns)) else { continue };
            let Some(robot) = standing(name, nearest, nearest.q_rad, nearest.gripper_width_m) else {
                let message =
                    format!("robot {name} does not say where its base stands (world_from_base): it cannot be taken out of the picture");
                warnings.push(SceneWarning { field: "robots".to_owned(), message });
                continue;
            };
            if stood(states, stamp_ns) {
                robots.push(robot);
                continue;
            }
            let apart_s = nearest.stamp_ns.abs_diff(stamp_ns) as f64 * 1e-9;
            let side = if nearest.stamp_ns < stamp_ns { "before" } else { "after" };
            let message = format!(
                "robot {name} told nothing within {} ms of this picture, the nearest {apart_s:.1} s {side} it: it is taken to stand where it stood then",
                HOLDS_NS / 1_000_000
            );
            warnings.push(SceneWarning { field: "robots".to_owned(), message });
            robots.push(robot);
        }
        (robots, warnings)
    }
}

/// Whether two states tell of one base.
fn share_base(a: &RobotState, b: &RobotState) -> bool {
    let place = |state: &RobotState| state.world_from_base.map(|RigidTransform(pose)| [pose[3], pose[7], pose[11]]);
    let apart_m = |(a, b): ([f64; 3], [f64; 3])| (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt();
    place(a).zip(place(b)).map(apart_m).is_some_and(|apart_m| apart_m < SAME_BASE_M)
}

/// Whether a robot stood where the states before and after an instant have it.
fn stood(states: &VecDeque<RobotState>, stamp_ns: u64) -> bool {
    let before = states.iter().filter(|state| state.stamp_ns <= stamp_ns).max_by_key(|state| state.stamp_ns);
    let after = states.iter().filter(|state| state.stamp_ns > stamp_ns).min_by_key(|state| state.stamp_ns);
    before.zip(after).is_some_and(|(a, b)| {
        let joints = a.q_rad.iter().zip(&b.q_rad).all(|(a, b)| (a - b).abs() < STILL_RAD);
        joints && (a.gripper_width_m - b.gripper_width_m).abs() < STILL_M && a.gripper_holding == b.gripper_holding
    })
}

/// A robot at an instant: between the states before and after it, or as the only near one says that it moved.
fn in_view(name: &str, states: &VecDeque<RobotState>, stamp_ns: u64) -> Option<RobotInView> {
    let holds = |state: &&RobotState| state.stamp_ns.abs_diff(stamp_ns) <= HOLDS_NS;
    let before = states.iter().filter(holds).filter(|state| state.stamp_ns <= stamp_ns).max_by_key(|state| state.stamp_ns);
    let after = states.iter().filter(holds).filter(|state| state.stamp_ns > stamp_ns).min_by_key(|state| state.stamp_ns);
    let (nearest, joints_rad, width_m) = match (before, after) {
        (Some(a), Some(b)) => {
            let (since_ns, to_ns) = (stamp_ns - a.stamp_ns, b.stamp_ns - stamp_ns);
            let share = since_ns as f64 / (since_ns + to_ns) as f64;
            let between = |a: f64, b: f64| a + (b - a) * share;
            let joints_rad = std::array::from_fn(|i| between(a.q_rad[i], b.q_rad[i]));
            (if since_ns <= to_ns { a } else { b }, joints_rad, between(a.gripper_width_m, b.gripper_width_m))
        }
        (Some(only), None) | (None, Some(only)) => {
            let since_s = (stamp_ns as f64 - only.stamp_ns as f64) * 1e-9;
            (only, std::array::from_fn(|i| only.q_rad[i] + only.dq_rad_s[i] * since_s), only.gripper_width_m)
        }
        (None, None) => return None,
    };
    standing(name, nearest, joints_rad, width_m)
}

/// A robot as a state has it, at given joints; `None` when it does not say where its base stands.
fn standing(name: &str, state: &RobotState, joints_rad: [f64; 7], width_m: f64) -> Option<RobotInView> {
    Some(RobotInView {
        name: name.to_owned(),
        model: state.model.clone().unwrap_or_else(|| "panda".to_owned()),
        joints_rad,
        gripper_width_m: width_m.clamp(0.0, 0.08),
        holding: Some(state.gripper_holding),
        world_from_base: state.world_from_base?,
    })
}

#[cfg(test)]
mod tests {
    use repose_proto::robot::RobotMode;

    use super::*;

    /// A state in which the first joint turns at 0.2 rad/s.
    fn state(stamp_ns: u64, first_rad: f64, world_from_base: Option<RigidTransform>) -> RobotState {
        let json = serde_json::json!({
            "v": 1, "seq": 1, "stamp_ns": stamp_ns, "robot_ms": 0.0, "q_rad": [first_rad, 0.0, 0.0, -2.0, 0.0, 2.0, 0.0],
            "dq_rad_s": [0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0], "gripper_width_m": 0.04, "gripper_settled": true, "gripper_holding": true, "mode": RobotMode::Idle,
            "stop": null, "owner": null, "last_command": null, "stream_ms": null, "world_from_base": world_from_base,
        });
        serde_json::from_value(json).unwrap()
    }

    #[test]
    fn a_robot_is_between_its_states_or_on_its_way_from_the_last_and_nowhere_without_one_in_time() {
        let mut states = RobotStates::new(Duration::from_secs(1));
        // Another robot's side may put them late.
        for (k, first_rad) in [(1, 0.2), (0, 0.1), (2, 0.3)] {
            states.put("left", state(1_000_000_000 + k as u64 * 50_000_000, first_rad, Some(RigidTransform::IDENTITY)));
        }
        states.put("unplaced", state(1_000_000_000, 0.0, None));
        let at = |stamp_ns| states.at(stamp_ns).into_iter().map(|robot| (robot.name, robot.joints_rad[0])).collect::<Vec<_>>();
        for (stamp_ns, first_rad) in [(1_000_000_000, 0.1), (1_060_000_000, 0.22), (1_190_000_000, 0.3 + 0.09 * 0.2), (990_000_000, 0.098)]
        {
            let seen = at(stamp_ns);
            assert!(seen.len() == 1 && seen[0].0 == "left" && (seen[0].1 - first_rad).abs() < 1e-9, "{stamp_ns}: {seen:?}");
        }
        assert!(at(2_000_000_000).is_empty());
    }

    #[test]
    fn a_robot_that_does_not_say_where_it_stands_is_left_out_and_that_is_said() {
        let mut states = RobotStates::new(Duration::from_secs(1));
        states.put("unplaced", state(1_000_000_000, 0.0, None));
        for stamp_ns in [1_010_000_000, 9_000_000_000] {
            let (robots, warnings) = states.at_or_nearest(stamp_ns);
            assert!(robots.is_empty() && warnings.len() == 1, "{robots:?} {warnings:?}");
            assert!(warnings[0].field == "robots" && warnings[0].message.contains("unplaced"), "{warnings:?}");
        }
    }

    #[test]
    fn a_robot_that_fell_silent_stands_where_it_stood_and_that_is_said() {
        let mut states = RobotStates::new(Duration::from_secs(1));
        states.put("left", state(10_000_000_000, 0.1, Some(RigidTransform::IDENTITY)));
        states.put("left", state(10_500_000_000, 0.2, Some(RigidTransform::IDENTITY)));
        for (stamp_ns, first_rad, said) in [
            (10_510_000_000, 0.202, None),
            (13_500_000_000, 0.2, Some("the nearest 3.0 s before it")),
            (9_000_000_000, 0.1, Some("the nearest 1.0 s after it")),
        ] {
            let (robots, warnings) = states.at_or_nearest(stamp_ns);
            assert!((robots[0].joints_rad[0] - first_rad).abs() < 1e-9, "{stamp_ns}: {robots:?}");
            assert_eq!(warnings.len(), usize::from(said.is_some()));
            assert!(warnings.iter().all(|warning| warning.field == "robots" && warning.message.contains(said.unwrap())), "{warnings:?}");
        }
    }

    #[test]
    fn a_robot_that_stands_where_it_stood_before_and_after_a_picture_stood_there_in_it() {
        let mut states = RobotStates::new(Duration::from_secs(11));
        for (stamp_ns, first_rad) in [(10_000_000_000, 0.1), (19_000_000_000, 0.1), (28_000_000_000, 0.5)] {
            states.put("left", state(stamp_ns, first_rad, Some(RigidTransform::IDENTITY)));
        }
        let (robots, warnings) = states.at_or_nearest(18_500_000_000);
        assert!(warnings.is_empty() && (robots[0].joints_rad[0] - 0.1).abs() < 1e-9, "{robots:?} {warnings:?}");
        assert_eq!(states.at_or_nearest(25_000_000_000).1.len(), 1, "it moved meanwhile");
    }

    /// A base so far along x, metres.
    fn base_at(x_m: f64) -> Option<RigidTransform> {
        let mut pose = RigidTransform::IDENTITY;
        pose.0[3] = x_m;
        Some(pose)
    }

    #[test]
    fn an_arm_that_has_another_name_since_is_not_where_it_was_under_the_old_one() {
        let (mut states, start) = (RobotStates::new(Duration::from_secs(1)), Instant::now());
        let mut tell = |robot: &str, base_m: f64, since: Duration| {
            states.put_at(robot, state(1_000_000_000 + since.as_nanos() as u64, 0.1, base_at(base_m)), start + since);
            states.at_or_nearest(20_000_000_000).0.into_iter().map(|robot| robot.name).collect::<Vec<_>>()
        };
        tell("other", 1.0, Duration::ZERO);
        tell("panda", 0.0, Duration::ZERO);
        assert_eq!(tell("left", 0.01, SILENT / 2), ["left", "other", "panda"], "two drivers that both live");
        assert_eq!(tell("left", 0.01, 2 * SILENT), ["left", "other"], "an arm whose driver has died is still there");
    }

    #[test]
    fn names_that_come_and_go_do_not_keep_out_the_robot_that_is_there() {
        let (mut states, start) = (RobotStates::new(Duration::from_secs(1)), Instant::now());
        let mut tell = |k: usize, since: Duration| {
            states.put_at(&format!("robot-{k}"), state(since.as_nanos() as u64, 0.1, base_at(k as f64)), start + since);
            (states.by_robot.len(), states.by_robot.contains_key(&format!("robot-{k}")))
        };
        for k in 0..MAX_ROBOTS {
            assert_eq!(tell(k, Duration::from_millis(k as u64)), (k + 1, true));
        }
        assert_eq!(tell(99, SILENT / 2), (MAX_ROBOTS, false), "all the others live");
        assert_eq!(tell(0, SILENT), (MAX_ROBOTS, true));
        assert_eq!(tell(99, 2 * SILENT), (MAX_ROBOTS, true));
        assert!(
            states.by_robot.contains_key("robot-0") && !states.by_robot.contains_key("robot-1"),
            "the one that is silent for the longest"
        );
    }

    #[test]
    fn states_are_kept_for_as_long_as_a_frame_may_wait_however_many_a_robot_tells() {
        let mut states = RobotStates::new(Duration::from_secs(1));
        for ms in 0..3000 {
            states.put("left", state(1_000_000_000 + ms * 1_000_000, 1e-3 * ms as f64, Some(RigidTransform::IDENTITY)));
        }
        for ms in [1995, 2500, 2999] {
            let robots = states.at(1_000_000_000 + ms * 1_000_000);
            assert!((robots[0].joints_rad[0] - 1e-3 * ms as f64).abs() < 5e-3, "{ms}: {robots:?}");
        }
        assert!(states.at(2_000_000_000).is_empty());
        let kept = states.by_robot["left"].states.len();
        assert!(kept <= 222, "{kept}");
        // A clock that was set back.
        states.put("left", state(5, 0.5, Some(RigidTransform::IDENTITY)));
        assert_eq!((states.at(0).len(), states.by_robot["left"].states.len()), (1, 2));
    }
}
