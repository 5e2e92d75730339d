//! Opening a session: one attempt after another, and what is said when none succeeds.
//!
//! Zenoh's own retries end in "unable to connect", whatever the reason, and say it only when all the time is over. Each attempt here is a single
//! one of Zenoh's. The router refuses a login within a few round trips by closing the link; a busy machine or a router that is only just starting
//! makes an attempt slow instead. So an attempt counts against the user only when it *failed*, before its time was over, while our own handshake with
//! the same endpoint is good: slow is not refused.

use std::time::{Duration, Instant};

use zenoh::Wait;

use crate::diagnosis::{Credentials, Finding, look_at};

/// How many attempts in a row must be refused on a good link before the user is taken for refused: a router that is stopped during one attempt closes
/// links, too.
const REFUSALS: u32 = 3;
/// The pause after the first attempt that failed; each later one is half as long again.
const FIRST_PAUSE: Duration = Duration::from_millis(100);
/// The longest pause: a router that comes up is found as soon.
const LONGEST_PAUSE: Duration = Duration::from_millis(500);
/// The share of its time after which an attempt that failed may have failed for want of time.
const IN_TIME: f64 = 0.8;

/// A client's way into the network: its configuration, and the routers it tries.
pub(crate) struct RouterEntry {
    /// The configuration, in which every attempt is a single one.
    pub(crate) config: zenoh::Config,
    /// Where the router is looked for.
    pub(crate) endpoints: Vec<String>,
    /// Who the router is told this is.
    pub(crate) credentials: Credentials,
    /// How long an attempt may take.
    pub(crate) attempt: Duration,
    /// How long all of them may take.
    pub(crate) bound: Duration,
}

/// What the attempts have shown so far.
#[derive(Default)]
struct Seen {
    /// Attempts in a row that the router refused.
    refused_in_a_row: u32,
    /// Whether an attempt ended early on a good link at all.
    was_ever_refused: bool,
}

impl RouterEntry {
    /// Attempts until one succeeds, all endpoints refuse us for good, or the time is over.
    pub(crate) async fn run(self) -> Result<zenoh::Session, String> {
        let (began, mut seen, mut pause) = (Instant::now(), Seen::default(), FIRST_PAUSE);
        loop {
            let attempt_began = Instant::now();
            let left = self.bound.saturating_sub(began.elapsed());
            let Ok(opened) = tokio::time::timeout(left, open_apart(self.config.clone())).await else {
                return Err(self.out_of_time(&self.looks().await, &seen));
            };
            let Err(zenoh_says) = opened else { return opened };
            let is_early = attempt_began.elapsed() < self.attempt.mul_f64(IN_TIME);
            let looks = self.looks().await;
            if looks.iter().all(|finding| matches!(finding, Finding::Refused(_))) {
                return Err(self.said(&looks));
            }
            let is_refused = is_early && looks.contains(&Finding::Good);
            seen.refused_in_a_row = if is_refused { seen.refused_in_a_row + 1 } else { 0 };
            seen.was_ever_refused |= is_refused;
            if seen.refused_in_a_row >= REFUSALS {
                return Err(self.said(&looks));
            }
            if began.elapsed() + pause >= self.bound {
                let said = self.out_of_time(&looks, &seen);
                return Err(if said.is_empty() { zenoh_says } else { said });
            }
            tokio::time::sleep(pause).await;
            pause = pause.mul_f64(1.5).min(LONGEST_PAUSE);
        }
    }

    async fn looks(&self) -> Vec<Finding> {
        futures::future::join_all(self.endpoints.iter().map(|endpoint| look_at(endpoint, &self.credentials))).await
    }

    /// What is wrong with each endpoint, where a good link that is of no use means a user that is not let in.
    fn said(&self, looks: &[Finding]) -> String {
        let words = looks.iter().map(|finding| match finding {
            Finding::Absent(why) | Finding::Refused(why) => why.clone(),
            Finding::Good => self.credentials.not_let_in(),
        });
        words.collect::<Vec<_>>().join("; ")
    }

    /// The same at the end of the time: a good link that nobody refused is a router that was too slow.
    fn out_of_time(&self, looks: &[Finding], seen: &Seen) -> String {
        if seen.was_ever_refused || !looks.contains(&Finding::Good) {
            return self.said(looks);
        }
        let endpoints = self.endpoints.join(", ");
        format!(
            "{endpoints} answers, but did not let this session in within {} ms: is the router, or this machine, overloaded?",
            self.bound.as_millis()
        )
    }
}

/// Opens on a thread of its own: Zenoh blocks the one that asks until it is open, and a thread of the pool would be waited for at exit.
pub(crate) async fn open_apart(config: zenoh::Config) -> Result<zenoh::Session, String> {
    let (opened, opening) = tokio::sync::oneshot::channel();
    let open = move || {
        // Nobody waits any more when the time is over: what opens then closes again.
        drop(opened.send(open_blocking(config)));
    };
    std::thread::Builder::new().name("opening".to_owned()).spawn(open).map_err(|e| e.to_string())?;
    opening.await.unwrap_or_else(|_| Err("opening ended without an answer".to_owned()))
}

/// A plain function: the body of an `async fn` is compiled in every crate and test that awaits it, and this one takes most of Zenoh with it.
#[inline(never)]
fn open_blocking(config: zenoh::Config) -> Result<zenoh::Session, String> {
    zenoh::open(config).wait().map_err(|e| e.to_string())
}
