//! One verb, tried by every user at every key.
//!
//! All keys are tried side by side. Users are, too, where it can be told whose attempt came through; where it cannot (who serves, who is alive),
//! one user tries after the other.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use bytes::Bytes;
use futures::future::{join_all, try_join_all};
use futures::{StreamExt, TryStreamExt, stream};
use repose_proto::Priority;
use tokio::time::{Instant, sleep};

use super::access::{Verb, may};
use super::files::FRAMES_PER_S;
use super::probes::Probe;
use super::report::{CheckReport, PermissionMismatch, TrialOutcome};
use super::roles::Roles;
use super::sessions::{PATIENCE, QueryEnd, TrialSessions, ask, note};
use crate::RuntimeError;
use crate::transport::{IncomingQueries, Subscription, Traffic, Transport};

/// Queries that are open at once.
const AT_ONCE: usize = 128;
/// Between two attempts at what is allowed and has not come through yet.
const PERIOD: Duration = Duration::from_millis(50);
/// The lowest priority, so that the query that settles is behind it.
const TRAFFIC: Traffic = Traffic::Call(Priority::Batch);

/// A key, who is at the other end of it, and who is expected to come through.
struct TrialCase<'a> {
    probe: &'a Probe,
    witness: &'a str,
    expected: BTreeSet<&'a str>,
}

/// A user at a case, by its index.
type Tried<'a> = (usize, &'a str);

/// One verb, tried by everyone.
pub(super) struct Attempts<'a> {
    ends: &'a TrialSessions,
    verb: Verb,
    users: Vec<&'a str>,
    witnesses: BTreeSet<&'a str>,
    cases: Vec<TrialCase<'a>>,
    came: BTreeSet<Tried<'a>>,
    /// What the router gave no answer to.
    silent: BTreeSet<Tried<'a>>,
}

impl<'a> Attempts<'a> {
    /// What is to be tried; what cannot be is counted.
    pub(super) fn new(roles: &'a Roles, ends: &'a TrialSessions, verb: Verb, probes: &'a [Probe], report: &mut CheckReport) -> Self {
        let users: Vec<&str> = roles.users.keys().map(String::as_str).collect();
        let allowed = |verb, key: &str| users.iter().copied().filter(|name| may(&roles.users[*name], verb, key)).collect::<BTreeSet<_>>();
        let mut cases = Vec::new();
        // Only what is put can be put to several keys at once.
        for probe in probes.iter().filter(|probe| verb == Verb::Put || !probe.is_broad()) {
            match allowed(verb.counterpart(), &probe.heard_at).first() {
                Some(witness) => cases.push(TrialCase { probe, witness, expected: allowed(verb, &probe.key) }),
                None => report.untried += users.len(),
            }
        }
        let witnesses = cases.iter().map(|case| case.witness).collect();
        Self { ends, verb, users, witnesses, cases, came: BTreeSet::new(), silent: BTreeSet::new() }
    }

    /// Tries everything and reports it.
    pub(super) async fn run(mut self, report: &mut CheckReport) -> Result<(), RuntimeError> {
        match self.verb {
            Verb::Put => self.put().await?,
            Verb::Subscribe => self.subscribe().await?,
            Verb::Query => self.query().await?,
            Verb::Serve => self.serve().await?,
            Verb::Token => self.token().await?,
            Verb::Watch => self.watch().await?,
        }
        for (index, case) in self.cases.iter().enumerate() {
            // Where those that may do not come through, it is not known whether anyone could.
            let is_deaf = !case.expected.is_empty() && !case.expected.iter().any(|user| self.came.contains(&(index, *user)));
            for user in &self.users {
                let expected = case.expected.contains(user);
                let outcome = match (self.came.contains(&(index, *user)), self.silent.contains(&(index, *user))) {
                    (true, _) => TrialOutcome::CameThrough,
                    (false, true) => TrialOutcome::None,
                    (false, false) if is_deaf && !expected => TrialOutcome::None,
                    (false, false) => TrialOutcome::Refused,
                };
                report.add(PermissionMismatch {
                    user: (*user).to_owned(),
                    verb: self.verb,
                    key: case.probe.key.clone(),
                    expected,
                    outcome,
                });
            }
        }
        Ok(())
    }

    /// Everything that is tried.
    fn everything(&self) -> BTreeSet<Tried<'a>> {
        (0..self.cases.len()).flat_map(|index| self.users.iter().map(move |user| (index, *user))).collect()
    }

    /// What is allowed and has not come through.
    fn missing(&self) -> BTreeSet<Tried<'a>> {
        let expected = self.cases.iter().enumerate().flat_map(|(index, case)| case.expected.iter().map(move |user| (index, *user)));
        expected.filter(|attempt| !self.came.contains(attempt)).collect()
    }

    /// Whether there is something to try again: waits a little then.
    async fn goes_on(&self, missing: &BTreeSet<Tried<'a>>, began: Instant) -> bool {
        let goes_on = !missing.is_empty() && began.elapsed() < PATIENCE;
        if goes_on {
            sleep(PERIOD).await;
        }
        goes_on
    }

    /// Waits until the router has dealt with what the witnesses sent, and they with what it sent them. Their users, where it does not answer.
    async fn settle_witnesses(&self) -> Result<BTreeSet<&'a str>, RuntimeError> {
        settle(self.ends, self.witnesses.iter().map(|user| (*user, self.ends.witness(user)))).await
    }

    /// The same of those who try.
    async fn settle_users(&self, users: &[&'a str]) -> Result<BTreeSet<&'a str>, RuntimeError> {
        settle(self.ends, users.iter().map(|user| (*user, self.ends.tries(user)))).await
    }

    /// Notes what cannot be told because the router answered neither these users nor these witnesses.
    fn keep_silent(&mut self, tried: &BTreeSet<Tried<'a>>, users: &BTreeSet<&str>, witnesses: &BTreeSet<&str>) {
        let silent = tried.iter().filter(|(index, user)| users.contains(user) || witnesses.contains(self.cases[*index].witness));
        self.silent.extend(silent.copied());
    }

    async fn put(&mut self) -> Result<(), RuntimeError> {
        let listen = self.cases.iter().map(|case| self.ends.witness(case.witness).subscribe(&case.probe.heard_at, 256));
        let mut heard: Vec<Subscription> = try_join_all(listen).await?;
        self.settle_witnesses().await?;
        let (began, mut tried) = (Instant::now(), self.everything());
        loop {
            let puts = self.users.iter().map(|user| {
                let probes = tried.iter().filter(move |(_, by)| by == user).map(|(index, _)| self.cases[*index].probe);
                put_all(self.ends, self.ends.tries(user), probes, user)
            });
            try_join_all(puts).await?;
            let (users, witnesses) = (self.settle_users(&self.users).await?, self.settle_witnesses().await?);
            for (index, heard) in heard.iter_mut().enumerate() {
                while let Some(sample) = heard.try_recv() {
                    let by = self.users.iter().find(|user| sample.payload.bytes == message(user, self.cases[index].probe).bytes);
                    self.came.extend(by.map(|user| (index, *user)));
                }
            }
            self.keep_silent(&tried, &users, &witnesses);
            tried = self.missing();
            if !self.goes_on(&tried, began).await {
                return Ok(());
            }
        }
    }

    async fn subscribe(&mut self) -> Result<(), RuntimeError> {
        let mut heard: BTreeMap<Tried<'a>, Subscription> = BTreeMap::new();
        for (index, user) in self.everything() {
            heard.insert((index, user), self.ends.tries(user).subscribe(&self.cases[index].probe.key, 16).await?);
        }
        self.settle_users(&self.users).await?;
        let (began, mut tried) = (Instant::now(), self.everything());
        loop {
            let indices: BTreeSet<usize> = tried.iter().map(|(index, _)| *index).collect();
            let puts = self.witnesses.iter().map(|witness| {
                let cases = indices.iter().map(|index| &self.cases[*index]);
                let probes = cases.filter(|case| case.witness == *witness).map(|case| case.probe);
                put_all(self.ends, self.ends.witness(witness), probes, WITNESS)
            });
            try_join_all(puts).await?;
            let (witnesses, users) = (self.settle_witnesses().await?, self.settle_users(&self.users).await?);
            for (attempt, heard) in &mut heard {
                while let Some(sample) = heard.try_recv() {
                    if sample.payload.bytes == message(WITNESS, self.cases[attempt.0].probe).bytes {
                        self.came.insert(*attempt);
                    }
                }
            }
            self.keep_silent(&tried, &users, &witnesses);
            tried = self.missing();
            if !self.goes_on(&tried, began).await {
                return Ok(());
            }
        }
    }

    async fn query(&mut self) -> Result<(), RuntimeError> {
        let serve = self.cases.iter().map(|case| self.ends.witness(case.witness).serve(&case.probe.key, 256));
        let answering = join_all(try_join_all(serve).await?.into_iter().map(|served| answer(WITNESS, served)));
        let asking = async {
            self.settle_witnesses().await?;
            let (began, mut tried) = (Instant::now(), self.everything());
            loop {
                let asked = tried.iter().map(|(index, user)| (*index, *user, self.ends.tries(user)));
                for (attempt, asked) in self.ask_all(asked.collect()).await? {
                    self.take(attempt, &asked, WITNESS);
                }
                tried = self.missing();
                if !self.goes_on(&tried, began).await {
                    return Ok(());
                }
            }
        };
        tokio::select! {
            asked = asking => asked,
            _ = answering => Err(RuntimeError::transport("serving a trial", "the session has closed")),
        }
    }

    async fn serve(&mut self) -> Result<(), RuntimeError> {
        for user in self.users.clone() {
            let serve = self.cases.iter().map(|case| self.ends.tries(user).serve(&case.probe.key, 256));
            let answering = join_all(try_join_all(serve).await?.into_iter().map(|served| answer(user, served)));
            let asking = async {
                let (began, mut tried) = (Instant::now(), self.everything());
                tried.retain(|(_, by)| *by == user);
                let silent = self.settle_users(&[user]).await?;
                self.keep_silent(&tried, &silent, &BTreeSet::new());
                loop {
                    let asked = tried.iter().map(|(index, user)| (*index, *user, self.ends.witness(self.cases[*index].witness)));
                    for (attempt, asked) in self.ask_all(asked.collect()).await? {
                        self.take(attempt, &asked, user);
                    }
                    tried = self.missing();
                    tried.retain(|(_, by)| *by == user);
                    if !self.goes_on(&tried, began).await {
                        return Ok::<_, RuntimeError>(());
                    }
                }
            };
            tokio::select! {
                asked = asking => asked?,
                _ = answering => return Err(RuntimeError::transport("serving a trial", "the session has closed")),
            }
            // The next must not be asked what this one answers.
            self.settle_users(&[user]).await?;
        }
        Ok(())
    }

    /// Asks side by side.
    async fn ask_all(&self, asked: Vec<(usize, &'a str, &dyn Transport)>) -> Result<Vec<(Tried<'a>, QueryEnd)>, RuntimeError> {
        let asked = asked.into_iter().map(|(index, user, session)| async move {
            Ok::<_, RuntimeError>(((index, user), ask(session, &self.cases[index].probe.key).await?))
        });
        stream::iter(asked).buffer_unordered(AT_ONCE).try_collect().await
    }

    /// Takes how a query ended that `by` was to reply to.
    fn take(&mut self, attempt: Tried<'a>, asked: &QueryEnd, by: &str) {
        match asked {
            QueryEnd::Replied(name) if name == by => drop(self.came.insert(attempt)),
            QueryEnd::TimedOut => drop(self.silent.insert(attempt)),
            QueryEnd::Replied(_) | QueryEnd::Ended => {}
        }
    }

    async fn token(&mut self) -> Result<(), RuntimeError> {
        let watch = self.cases.iter().map(|case| self.ends.witness(case.witness).watch_alive(&case.probe.key));
        let mut watched = try_join_all(watch).await?;
        for user in self.users.clone() {
            let tokens = try_join_all(self.cases.iter().map(|case| self.ends.tries(user).declare_alive(&case.probe.key))).await?;
            let began = Instant::now();
            let mut tried = self.everything();
            tried.retain(|(_, by)| *by == user);
            loop {
                let (users, witnesses) = (self.settle_users(&[user]).await?, self.settle_witnesses().await?);
                self.keep_silent(&tried, &users, &witnesses);
                for (index, watched) in watched.iter_mut().enumerate() {
                    if !watched.current().is_empty() {
                        self.came.insert((index, user));
                    }
                }
                let mut missing = self.missing();
                missing.retain(|(_, by)| *by == user);
                if !self.goes_on(&missing, began).await {
                    break;
                }
            }
            drop(tokens);
            let (dropped, mut left) = (Instant::now(), true);
            while left {
                self.settle_users(&[user]).await?;
                self.settle_witnesses().await?;
                left = watched.iter_mut().any(|watched| !watched.current().is_empty());
                if left && dropped.elapsed() > PATIENCE {
                    return Err(RuntimeError::transport("taking a token back", format!("{user}'s stays")));
                }
            }
        }
        Ok(())
    }

    async fn watch(&mut self) -> Result<(), RuntimeError> {
        let attempts: Vec<_> = self.everything().into_iter().collect();
        let watch = attempts.iter().map(|(index, user)| self.ends.tries(user).watch_alive(&self.cases[*index].probe.key));
        let mut watched = try_join_all(watch).await?;
        self.settle_users(&self.users).await?;
        let declare = self.cases.iter().map(|case| self.ends.witness(case.witness).declare_alive(&case.probe.key));
        let _tokens = try_join_all(declare).await?;
        let began = Instant::now();
        loop {
            let (witnesses, users) = (self.settle_witnesses().await?, self.settle_users(&self.users).await?);
            self.keep_silent(&self.everything(), &users, &witnesses);
            for (attempt, watched) in attempts.iter().zip(&mut watched) {
                if !watched.current().is_empty() {
                    self.came.insert(*attempt);
                }
            }
            if !self.goes_on(&self.missing(), began).await {
                return Ok(());
            }
        }
    }
}

/// Who a witness's messages are by. No user: their names are chunks of keys.
const WITNESS: &str = "the witness";

/// What `by` puts to a key. It tells the key, since one put may arrive at several, and the author, since several may put to one.
fn message(by: &str, probe: &Probe) -> repose_proto::Payload {
    note(&format!("{by} at {}", probe.key))
}

/// Puts one message to each key. The router drops frames that follow another too soon: those wait until it has dealt with the one before, and then
/// as long as it asks.
async fn put_all<'a>(
    ends: &TrialSessions,
    session: &dyn Transport,
    probes: impl Iterator<Item = &'a Probe>,
    by: &str,
) -> Result<(), RuntimeError> {
    for probe in probes {
        if probe.is_frame {
            ends.settle(session).await?;
            sleep(Duration::from_secs_f64(1.2 / FRAMES_PER_S)).await;
        }
        session.put(&probe.key, message(by, probe), TRAFFIC).await?;
    }
    Ok(())
}

/// Settles sessions side by side; the users of those whose router does not answer.
async fn settle<'a>(
    ends: &TrialSessions,
    sessions: impl Iterator<Item = (&'a str, &dyn Transport)>,
) -> Result<BTreeSet<&'a str>, RuntimeError> {
    let settled = sessions.map(|(user, session)| async move { Ok::<_, RuntimeError>((user, ends.settle(session).await?)) });
    Ok(try_join_all(settled).await?.into_iter().filter(|(_, is_settled)| !is_settled).map(|(user, _)| user).collect())
}

/// Answers every query with a name.
async fn answer(name: &str, mut served: IncomingQueries) {
    while let Some(query) = served.next().await {
        // Who is not let through sees no reply, which is what is tried.
        drop(query.replier.reply(note(name), Bytes::new()).await);
    }
}
