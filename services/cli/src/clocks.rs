//! What the stamps of messages say of their hosts' clocks.
//!
//! Nothing that matters goes by a clock of another host: a robot's states and its cameras' frames are compared with each other, and those two have to share
//! one. So a clock that is off is said, and why it matters where it does.

use std::fmt;

/// A message that seems to come from so far in the future is from a clock that is ahead, milliseconds.
const AHEAD_MS: f64 = 500.0;
/// One that took longer is from a clock that is behind, or was late: on a busy machine, over a slow network.
const BEHIND_MS: f64 = 1000.0;
/// Lags that differ by less may be of one clock.
const ALIKE_MS: f64 = 500.0;

/// Whose stamps they are.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Source {
    /// A robot's side.
    Robot(String),
    /// A camera's.
    Camera(String),
    /// A worker's.
    Worker(String),
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Robot(name) => write!(f, "robot {name}"),
            Self::Camera(name) => write!(f, "camera {name}"),
            Self::Worker(name) => f.write_str(name),
        }
    }
}

/// A clock, by the least time from a stamp of it to when its message came by this host's clock.
#[derive(Debug, Clone)]
pub struct Clock {
    /// Whose.
    pub of: Source,
    /// Milliseconds; negative where the stamp is in the future.
    pub lag_ms: f64,
}

/// Whether a lag says that a clock is off.
fn is_off(lag_ms: f64) -> bool {
    !(-AHEAD_MS..=BEHIND_MS).contains(&lag_ms)
}

/// What is wrong with the clocks, a sentence each.
pub fn wrong_with(clocks: &[Clock]) -> Vec<String> {
    let mut wrong = apart_in_the_cell(clocks);
    let middle_ms = middle(clocks.iter().map(|clock| clock.lag_ms).collect());
    let alike = clocks.iter().filter(|clock| (clock.lag_ms - middle_ms).abs() < ALIKE_MS).count();
    // Where most agree that it is off, it is this host's that is.
    let is_ours = is_off(middle_ms) && alike > 1 && alike * 2 > clocks.len();
    if is_ours {
        let (seconds, which) = off(-middle_ms);
        wrong.push(format!(
            "this host's clock is {seconds:.1} s {which} the others': ages told here are off by as much, and nothing else is"
        ));
    }
    let (right_ms, whose) = if is_ours { (middle_ms, "the others'") } else { (0.0, "this host's") };
    for clock in clocks.iter().filter(|clock| is_off(clock.lag_ms - right_ms)) {
        let (seconds, which) = off(clock.lag_ms - right_ms);
        let or_late = if clock.lag_ms > right_ms { ", or it is late" } else { "" };
        wrong.push(format!("the clock of {} is {seconds:.1} s {which} {whose}{or_late}", clock.of));
    }
    wrong
}

/// Cameras whose clocks are not their robots'.
fn apart_in_the_cell(clocks: &[Clock]) -> Vec<String> {
    let robots = clocks.iter().filter(|clock| matches!(clock.of, Source::Robot(_)));
    let pairs =
        robots.flat_map(|robot| clocks.iter().filter(|clock| matches!(clock.of, Source::Camera(_))).map(move |camera| (robot, camera)));
    let apart = pairs.filter_map(|(robot, camera)| {
        // A scene comes later than a state by what perception takes.
        let behind_ms = camera.lag_ms - robot.lag_ms;
        if behind_ms > -AHEAD_MS && behind_ms < BEHIND_MS {
            return None;
        }
        let (seconds, which) = off(behind_ms);
        let matters = "the arm in its pictures is taken for an object, and what is seen before a move may pass for what is seen after it";
        Some(format!("the clock of {} is {seconds:.1} s {which} that of {}: {matters}", camera.of, robot.of))
    });
    apart.collect()
}

/// How far, and to which side, a clock of that lag is.
fn off(lag_ms: f64) -> (f64, &'static str) {
    (lag_ms.abs() / 1e3, if lag_ms > 0.0 { "behind" } else { "ahead of" })
}

fn middle(mut lags_ms: Vec<f64>) -> f64 {
    lags_ms.sort_by(f64::total_cmp);
    lags_ms.get(lags_ms.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn clocks(robot_ms: f64, camera_ms: f64, planner_ms: f64) -> Vec<Clock> {
        let named = |of: fn(String) -> Source, name: &str, lag_ms| Clock { of: of(name.to_owned()), lag_ms };
        vec![
            named(Source::Robot, "panda", robot_ms),
            named(Source::Camera, "front", camera_ms),
            named(Source::Worker, "planner planner-1", planner_ms),
        ]
    }

    #[test]
    fn what_messages_take_is_no_skew() {
        assert!(wrong_with(&clocks(1.0, 200.0, 0.5)).is_empty());
        assert!(wrong_with(&clocks(160.0, 900.0, 160.0)).is_empty());
        assert!(wrong_with(&[]).is_empty());
    }

    #[test]
    fn each_clock_that_is_off_is_named_and_this_hosts_own_once() {
        let planner = wrong_with(&clocks(1.0, 100.0, -2000.0));
        assert_eq!(planner, ["the clock of planner planner-1 is 2.0 s ahead of this host's"]);
        let ours = wrong_with(&clocks(-2000.0, -1800.0, -2000.0));
        assert_eq!(ours, ["this host's clock is 2.0 s behind the others': ages told here are off by as much, and nothing else is"]);
        let ours = wrong_with(&clocks(2000.0, 2200.0, 2000.0));
        assert!(ours.len() == 1 && ours[0].contains("2.0 s ahead of the others'"), "{ours:?}");
        let both = wrong_with(&clocks(-2000.0, -1800.0, -4000.0));
        assert!(both.len() == 2 && both[1] == "the clock of planner planner-1 is 2.0 s ahead of the others'", "{both:?}");
    }

    #[test]
    fn a_camera_whose_clock_is_not_its_robots_is_said_to_matter() {
        let wrong = wrong_with(&clocks(1.0, -1900.0, 1.0));
        assert!(wrong[0].starts_with("the clock of camera front is 1.9 s ahead of that of robot panda: the arm"), "{wrong:?}");
        assert_eq!(wrong[1..], ["the clock of camera front is 1.9 s ahead of this host's"]);
        let wrong = wrong_with(&clocks(1.0, 2100.0, 1.0));
        assert!(wrong[0].contains("2.1 s behind that of robot panda") && wrong[1].ends_with("or it is late"), "{wrong:?}");
    }
}
