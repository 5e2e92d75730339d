//! Faults that a run causes in the system that it started itself, so that what users notice of them can be measured.

use std::collections::BTreeMap;
use std::str::FromStr;
use std::time::Duration;

use repose_proto::Service;

/// What happens, again and again while the run lasts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// A process of a service is killed, another one each time, and started again.
    Kill(Service, Duration),
    /// A process of a service is stopped, as a machine that hangs is, and goes on after the second time.
    Stop(Service, Duration, Duration),
    /// A router is killed, another one each time where there are several, and started again after the second time.
    Router(Duration, Duration),
    /// Every message between the run's own clients and the router takes so much longer, each way.
    Delay(Duration),
}

/// How long a process hangs, or the router is away, where it is not said.
const FOR: Duration = Duration::from_secs(1);

impl FromStr for Fault {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || {
            format!(
                "expected kill:SERVICE:PERIOD, stop:SERVICE:PERIOD[:FOR], router:PERIOD[:FOR] or delay:TIME, such as kill:inference:2s or delay:20ms, \
                 got {text:?}"
            )
        };
        let parts: Vec<&str> = text.split(':').collect();
        let service = |name: &str| {
            Service::parse(name).ok_or_else(|| format!("{name:?} is no service: {}", Service::ALL.map(Service::as_str).join(", ")))
        };
        match parts.as_slice() {
            ["kill", name, period] => Ok(Self::Kill(service(name)?, time(period)?)),
            ["stop", name, period] => Ok(Self::Stop(service(name)?, time(period)?, FOR)),
            ["stop", name, period, within] => Ok(Self::Stop(service(name)?, time(period)?, time(within)?)),
            ["router", period] => Ok(Self::Router(time(period)?, FOR)),
            ["router", period, within] => Ok(Self::Router(time(period)?, time(within)?)),
            ["delay", delay] => Ok(Self::Delay(time(delay)?)),
            _ => Err(wrong()),
        }
    }
}

/// A time with its unit, `2s` or `20ms`; above 0.
fn time(text: &str) -> Result<Duration, String> {
    let wrong = || format!("expected a time above 0 with its unit, such as 2s or 500ms, got {text:?}");
    let (number, unit_s) = match (text.strip_suffix("ms"), text.strip_suffix('s')) {
        (Some(number), _) => (number, 1e-3),
        (None, Some(number)) => (number, 1.0),
        (None, None) => return Err(wrong()),
    };
    let seconds = number.trim().parse::<f64>().map_err(|_| wrong())? * unit_s;
    if (1e-3..=86_400.0).contains(&seconds) { Ok(Duration::from_secs_f64(seconds)) } else { Err(wrong()) }
}

/// One thing to do to a process.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Deed {
    /// Kill a process of a service and start it again.
    Restart(Service),
    /// Stop a process of a service.
    Halt(Service),
    /// Let the process go on that was stopped longest.
    Resume,
    /// Kill the router.
    KillRouter,
    /// Start it again.
    StartRouter,
}

/// What is to be done when: a fault's deeds follow each other at its period.
#[derive(Debug, Default)]
pub struct Schedule {
    /// With a fault's first deed the fault, whose next time follows.
    due: BTreeMap<(Duration, usize), (Deed, Option<Fault>)>,
    made: usize,
}

impl Schedule {
    /// The schedule of some faults; the first of each comes after its period.
    pub fn new(faults: &[Fault]) -> Self {
        let mut schedule = Self::default();
        for fault in faults {
            schedule.add(*fault, Duration::ZERO);
        }
        schedule
    }

    fn put(&mut self, at: Duration, deed: Deed, follows: Option<Fault>) {
        self.made += 1;
        self.due.insert((at, self.made), (deed, follows));
    }

    fn add(&mut self, fault: Fault, after: Duration) {
        match fault {
            Fault::Kill(service, period) => self.put(after + period, Deed::Restart(service), Some(fault)),
            Fault::Stop(service, period, within) => {
                self.put(after + period, Deed::Halt(service), Some(fault));
                self.put(after + period + within, Deed::Resume, None);
            }
            Fault::Router(period, within) => {
                self.put(after + period, Deed::KillRouter, Some(fault));
                self.put(after + period + within, Deed::StartRouter, None);
            }
            Fault::Delay(_) => {}
        }
    }

    /// The next deed, and when it is due from the start of the run. None without faults.
    pub fn next(&mut self) -> Option<(Duration, Deed)> {
        let ((at, _), (deed, follows)) = self.due.pop_first()?;
        if let Some(fault) = follows {
            self.add(fault, at);
        }
        Some((at, deed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_are_read_with_their_times_and_what_is_wrong_is_said() {
        let (two, half) = (Duration::from_secs(2), Duration::from_millis(500));
        assert_eq!("kill:inference:2s".parse(), Ok(Fault::Kill(Service::Inference, two)));
        assert_eq!("stop:planner:2s:500ms".parse(), Ok(Fault::Stop(Service::Planner, two, half)));
        assert_eq!("router:2s".parse(), Ok(Fault::Router(two, FOR)));
        assert_eq!("delay:500ms".parse(), Ok(Fault::Delay(half)));
        for (wrong, named) in [
            ("kill:inference", "PERIOD"),
            ("kill:arm:2s", "perception"),
            ("delay:2", "unit"),
            ("router:0s", "above 0"),
            ("burn", "delay:TIME"),
        ] {
            assert!(wrong.parse::<Fault>().is_err_and(|error| error.contains(named)), "{wrong}");
        }
    }

    #[test]
    fn a_fault_comes_again_each_period_and_its_end_follows_it() {
        let faults = ["kill:inference:3s", "router:4s:500ms"].map(|text| text.parse().expect("a fault"));
        let mut schedule = Schedule::new(&faults);
        let deeds: Vec<(f64, Deed)> = std::iter::from_fn(|| schedule.next()).take(6).map(|(at, deed)| (at.as_secs_f64(), deed)).collect();
        let kill = Deed::Restart(Service::Inference);
        assert_eq!(
            deeds,
            [
                (3.0, kill),
                (4.0, Deed::KillRouter),
                (4.5, Deed::StartRouter),
                (6.0, kill),
                (8.0, Deed::KillRouter),
                (8.5, Deed::StartRouter)
            ]
        );
        assert_eq!(Schedule::new(&["delay:1s".parse().expect("a fault")]).next(), None);
    }

    #[test]
    fn two_faults_of_a_kind_keep_their_own_periods() {
        let mut schedule = Schedule::new(&["kill:planner:2s", "kill:planner:5s"].map(|text| text.parse().expect("a fault")));
        let at: Vec<u64> = std::iter::from_fn(|| schedule.next()).take(7).map(|(at, _)| at.as_secs()).collect();
        assert_eq!(at, [2, 4, 5, 6, 8, 10, 10]);
    }
}
