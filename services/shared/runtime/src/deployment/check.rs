//! The trial of a deployment's access control: every user tries every verb at every key, through a running router, and somebody at the other end
//! tells whether it came through.
//!
//! The other end is a user that may do the counterpart, in a session of its own. Where nobody may, nothing can be harmed, and nothing is tried.
//! Nothing waits for something not to happen: `TrialSessions::settle` tells when the router has dealt with all that was tried.

use std::path::Path;

use futures::future::try_join_all;
use repose_proto::{Cell, Service};

use super::access::{Verb, may};
use super::attempts::Attempts;
use super::probes::probes;
use super::report::CheckReport;
use super::roles::Roles;
use super::sessions::{TrialSessions, close, open};
use crate::{RuntimeError, SessionMode};

/// Which router is tried.
#[derive(Debug, Clone, Default)]
pub struct TrialOptions {
    /// Its endpoint; the roles file's where absent.
    pub connect: Option<String>,
    /// A router of our own with the same configuration, on a loopback port.
    pub apart: bool,
}

/// Tries everything, with the users' files in `deployment`, which [`super::write`] wrote.
///
/// # Errors
/// When a user is not let in, or a cell is in operation: its robots would act on what is tried.
pub async fn check(roles: &Roles, deployment: &Path, options: &TrialOptions) -> Result<CheckReport, RuntimeError> {
    // Sessions read their configuration from files, and the users' name files by where they will be installed.
    let files = deployment.join(".check");
    let _removed = RemoveOnDrop(&files);
    super::files::write_trial(roles, deployment, &files).map_err(|e| RuntimeError::transport("preparing the trial", e))?;
    let mut endpoint = options.connect.clone().unwrap_or_else(|| roles.endpoint());
    let mut router = None;
    if options.apart {
        let apart = open(SessionMode::Router, "quic/127.0.0.1:0", files.join("router.json5")).await?;
        endpoint = apart.locators().await.into_iter().next().ok_or_else(|| RuntimeError::transport("starting a router", "no port"))?;
        router = Some(apart);
    }
    let report = match TrialSessions::open(roles, &endpoint, &files).await {
        Ok(ends) => {
            let report = try_all(roles, &ends).await;
            ends.close().await;
            report
        }
        Err(error) => Err(error),
    };
    if let Some(router) = router {
        close(&router).await;
    }
    report
}

async fn try_all(roles: &Roles, ends: &TrialSessions) -> Result<CheckReport, RuntimeError> {
    refuse_cells_in_operation(roles, ends).await?;
    let probes = probes(roles);
    let mut report = CheckReport::default();
    for verb in Verb::ALL {
        Attempts::new(roles, ends, verb, &probes, &mut report).run(&mut report).await?;
    }
    for list in [&mut report.wrong, &mut report.unanswered] {
        list.sort_by(|a, b| (&a.user, a.verb, &a.key).cmp(&(&b.user, b.verb, &b.key)));
    }
    Ok(report)
}

/// Takes a folder with secrets away.
struct RemoveOnDrop<'a>(&'a Path);

impl Drop for RemoveOnDrop<'_> {
    fn drop(&mut self) {
        if let Err(error) = std::fs::remove_dir_all(self.0) {
            tracing::warn!(folder = %self.0.display(), %error, "could not be removed");
        }
    }
}

async fn refuse_cells_in_operation(roles: &Roles, ends: &TrialSessions) -> Result<(), RuntimeError> {
    let looks = roles.users.iter().flat_map(|(name, user)| {
        let cells = user.cells.iter().filter_map(|cell| Cell::new(cell).ok());
        let lives = cells.flat_map(|cell| Service::ALL.map(|service| cell.lives(service)));
        lives.filter(|lives| may(user, Verb::Watch, lives)).map(move |lives| (name, lives)).collect::<Vec<_>>()
    });
    let looks = looks.map(|(name, lives)| async move { Ok::<_, RuntimeError>(ends.tries(name).watch_alive(&lives).await?.current()) });
    for alive in try_join_all(looks).await? {
        if let Some(alive) = alive.first() {
            let message = format!("{alive} is alive: robots there would act on what is tried; stop it, or try on a router apart");
            return Err(RuntimeError::transport("checking a cell in operation", message));
        }
    }
    Ok(())
}
