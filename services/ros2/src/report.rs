//! What the bridge has to say of itself: counts and warnings by part, for the log and for `/diagnostics`.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use repose_proto::robot::RobotMode;
use repose_ros_messages::{DiagnosticArray, DiagnosticStatus, Header, KeyValue, Time};

const GOOD: u8 = 0;
const WARNING: u8 = 1;
const FAULT: u8 = 2;

#[derive(Debug, Clone, Default)]
struct Part {
    /// Why it is at fault, until it is no more.
    fault: Option<String>,
    /// What it does where all is well.
    doing: Option<&'static str>,
    /// What was warned of since the last report, and in that one.
    warned: Warnings,
    reported: Warnings,
    /// What is wrong for as long as it is said to be, by what it is about.
    standing: BTreeMap<String, String>,
    counts: BTreeMap<&'static str, u64>,
}

/// Warnings by what they are about, the newest last, of each the newest words.
#[derive(Debug, Clone, Default)]
struct Warnings(Vec<(&'static str, String)>);

impl Warnings {
    fn are_about(&self, what: &str) -> bool {
        self.0.iter().any(|(about, _)| *about == what)
    }

    fn put(&mut self, what: &'static str, words: String) {
        self.0.retain(|(about, _)| *about != what);
        self.0.push((what, words));
    }

    fn newest(&self) -> Option<&String> {
        self.0.last().map(|(_, words)| words)
    }
}

impl Part {
    /// Takes a warning; whether it is one that was not there before.
    fn warn(&mut self, what: &'static str, words: String) -> bool {
        let is_new = !self.warned.are_about(what) && !self.reported.are_about(what);
        self.warned.put(what, words);
        is_new
    }

    /// Level and words of a report, which takes what was warned of.
    fn report(&mut self) -> (u8, String) {
        self.reported = std::mem::take(&mut self.warned);
        // Of two about a topic, a type comes after silence in the alphabet and is why.
        let warning = self.reported.newest().or_else(|| self.standing.values().next_back());
        match (&self.fault, warning) {
            (Some(fault), _) => (FAULT, fault.clone()),
            (None, Some(warning)) => (WARNING, warning.clone()),
            (None, None) => (GOOD, self.doing.unwrap_or("good").to_owned()),
        }
    }
}

/// The reports of every part. Cheap to clone.
#[derive(Clone, Default)]
pub struct Reports {
    parts: Arc<Mutex<BTreeMap<String, Part>>>,
}

impl Reports {
    fn parts(&self) -> MutexGuard<'_, BTreeMap<String, Part>> {
        self.parts.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Warns of a part. Another warning about the same is not logged until a report without one: words tell how late a picture was, or which scene
    /// could not be had, and are others with every picture.
    pub fn warn(&self, part: &str, what: &'static str, words: String) {
        let mut parts = self.parts();
        let held = parts.entry(part.to_owned()).or_default();
        if held.warn(what, words.clone()) {
            tracing::warn!(part, "{words}");
        }
    }

    /// Warns of something about a part until it is told that it is well again.
    pub fn standing(&self, part: &str, about: &str, words: Option<String>) {
        let mut parts = self.parts();
        let held = parts.entry(part.to_owned()).or_default();
        let Some(words) = words else {
            held.standing.remove(about);
            return;
        };
        if held.standing.get(about) != Some(&words) {
            tracing::warn!(part, "{words}");
            held.standing.insert(about.to_owned(), words);
        }
    }

    /// How much of something there is so far.
    pub fn count(&self, part: &str, what: &'static str, so_far: u64) {
        self.parts().entry(part.to_owned()).or_default().counts.insert(what, so_far);
    }

    /// What a robot does.
    pub fn robot(&self, part: &str, mode: RobotMode, why: Option<String>) {
        let mut parts = self.parts();
        let held = parts.entry(part.to_owned()).or_default();
        held.doing = Some(match mode {
            RobotMode::Idle => "standing",
            RobotMode::Moving => "moving",
            RobotMode::Stopped => "stopped",
        });
        held.fault = (mode == RobotMode::Stopped).then(|| why.unwrap_or_else(|| "stopped".to_owned()));
    }

    /// Everything, as others read it; `node` is put before the names.
    pub fn array(&self, node: &str, now_ns: u64) -> DiagnosticArray {
        let mut parts = self.parts();
        let status = parts.iter_mut().map(|(name, part)| {
            let (level, message) = part.report();
            let values = part.counts.iter().map(|(key, count)| KeyValue { key: (*key).to_owned(), value: count.to_string() });
            DiagnosticStatus { level, name: format!("{node}: {name}"), message, hardware_id: name.clone(), values: values.collect() }
        });
        let status = status.collect();
        DiagnosticArray { header: Header { stamp: Time::from_ns(now_ns), frame_id: String::new() }, status }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_warning_is_there_until_a_report_without_it_and_a_stop_until_it_is_cleared() {
        let reports = Reports::default();
        reports.warn("front", "pose", "no pose".to_owned());
        reports.count("front", "frames", 3);
        let levels = || reports.array("repose", 0).status.iter().map(|s| (s.level, s.message.clone())).collect::<Vec<_>>();
        assert_eq!(levels(), [(WARNING, "no pose".to_owned())]);
        assert_eq!(levels(), [(GOOD, "good".to_owned())]);
        reports.robot("front", RobotMode::Stopped, Some("estop: me".to_owned()));
        reports.warn("front", "pose", "no pose".to_owned());
        assert_eq!(levels(), [(FAULT, "estop: me".to_owned())]);
        reports.robot("front", RobotMode::Idle, None);
        assert_eq!(levels(), [(GOOD, "standing".to_owned())]);
        reports.standing("front", "/depth", Some("another type".to_owned()));
        assert_eq!((levels(), levels()[0].0), (vec![(WARNING, "another type".to_owned())], WARNING));
        reports.standing("front", "/depth", None);
        assert_eq!(levels(), [(GOOD, "standing".to_owned())]);
    }

    #[test]
    fn what_is_wrong_with_every_picture_is_logged_as_it_begins_and_reported_as_it_is_now() {
        let (mut part, mut logged) = (Part::default(), Vec::new());
        for age_ms in 0..300 {
            logged.push(part.warn("late", format!("depth was {age_ms} ms old")));
            logged.push(part.warn("no_pose", format!("known up to {age_ms} ms before")));
            if age_ms % 100 == 99 {
                assert_eq!(part.report(), (WARNING, format!("known up to {age_ms} ms before")));
            }
        }
        assert!(logged[0] && logged[1] && !logged[2..].contains(&true));
        assert_eq!(part.report().0, GOOD);
        assert!(part.warn("late", "depth was 7 ms old".to_owned()), "it begins anew");
    }
}
