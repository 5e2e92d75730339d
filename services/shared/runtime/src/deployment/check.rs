//! The trial of a deployment's access control: every user tries every verb at every key, through a running router, and somebody at the other end
//! tells whether it came through.
//!
//! The other end is a user that may do the counterpart, in a session of its own. Where nobody may, nothing can be harmed, and nothing is tried.
//! Nothing waits for something not to happen: `TrialSessions::settle` tells when the router has dealt with all that was tried.

use std::path::{Path, PathBuf};

use futures::future::try_join_all;
use repose_proto::{Cell, Service};

use super::access::{Verb, may};
use super::attempts::Attempts;
use super::certificates::check_host;
use super::files::{trial_file_of_router, write_trial};
use super::probes::probes;
use super::report::CheckReport;
use super::roles::Roles;
use super::sessions::TrialSessions;
use super::writer::Failed;
use crate::expiry::say;
use crate::{CertificateExpiry, RuntimeError};

/// What a trial's sessions read: the users' files with everything where it lies now, since a deployment's own name it where it will be installed.
/// They hold secrets, and go when this goes.
pub struct TrialFiles {
    folder: PathBuf,
    deployment: PathBuf,
    /// The name by which users reach the router.
    host: String,
}

impl TrialFiles {
    /// Writes them beside `deployment`, which [`super::write`] wrote.
    ///
    /// # Errors
    /// The file that is missing or cannot be written.
    pub fn write(roles: &Roles, deployment: &Path) -> Result<Self, RuntimeError> {
        let files = Self { folder: deployment.join(".check"), deployment: deployment.to_owned(), host: roles.host().to_owned() };
        write_trial(roles, deployment, &files.folder).map_err(|e| RuntimeError::transport("preparing the trial", e))?;
        Ok(files)
    }

    /// Zenoh's file for a router that is started for the trial alone. It must be a process of its own: sessions of one process share their
    /// threads, and a router waits on them for its own clients to take what it sends.
    ///
    /// # Errors
    /// The router's certificate, where users would refuse it: the trial reaches that router by an address of this machine, and would not see that.
    pub fn router(&self) -> Result<PathBuf, Failed> {
        let file = self.deployment.join("router").join("router.pem");
        let certificate = std::fs::read_to_string(&file).map_err(|e| Failed::new(&file, e))?;
        check_host(&file, &certificate, &self.host)?;
        Ok(trial_file_of_router(&self.folder))
    }
}

impl Drop for TrialFiles {
    fn drop(&mut self) {
        if let Err(error) = std::fs::remove_dir_all(&self.folder) {
            tracing::warn!(folder = %self.folder.display(), %error, "could not be removed");
        }
    }
}

/// Tries everything through the router at `endpoint`.
///
/// # Errors
/// When a user is not let in, or a cell is in operation: its robots would act on what is tried.
pub async fn check(roles: &Roles, files: &TrialFiles, endpoint: &str) -> Result<CheckReport, RuntimeError> {
    let expiring = expiring(roles, &files.deployment);
    // Where nobody is let in any more, this is why, and the report that would say so does not come.
    let ends = TrialSessions::open(roles, endpoint, &files.folder).await.inspect_err(|_| say(&expiring))?;
    let report = try_all(roles, &ends).await;
    ends.close().await;
    Ok(CheckReport { expiring, ..report? })
}

/// The certificates of a deployment that are warned of: the router's, every user's, and those of the authorities that either trusts.
fn expiring(roles: &Roles, deployment: &Path) -> Vec<CertificateExpiry> {
    let router = ["router.pem", "authority.pem"].map(|name| deployment.join("router").join(name));
    let of_user: &[&str] = if roles.login.has_certificates() { &["certificate.pem", "authority.pem"] } else { &["authority.pem"] };
    let users = roles.users.keys().flat_map(|user| of_user.iter().map(move |name| deployment.join("users").join(user).join(name)));
    let read = router.into_iter().chain(users).filter_map(|file| CertificateExpiry::read(&file).ok());
    read.filter(|expiry| expiry.warning().is_some()).collect()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn certificates_that_expire_within_a_month_are_found_wherever_they_lie() {
        let folder = tempfile::tempdir().expect("a folder");
        let text = "router = \"r:1\"\ncells = [\"lab\"]\nlogin = \"certificate\"\n[users.anna]\nrole = \"viewer\"\n";
        let roles = Roles::parse(text).expect("roles");
        crate::deployment::write(&roles, folder.path(), folder.path()).expect("written");
        assert!(expiring(&roles, folder.path()).is_empty());
        let mut params = rcgen::CertificateParams::new(Vec::new()).expect("no names");
        params.not_after = rcgen::date_time_ymd(2020, 1, 2);
        let old = params.self_signed(&rcgen::KeyPair::generate().expect("a key")).expect("signed").pem();
        let files = ["router/router.pem", "router/authority.pem", "users/anna/certificate.pem", "users/anna/authority.pem"];
        let files = files.map(|file| folder.path().join(file));
        for file in &files {
            std::fs::write(file, &old).expect("written");
        }
        let found = expiring(&roles, folder.path());
        assert!(found.iter().map(|expiry| &expiry.file).eq(&files), "{found:?}");
        assert!(found.iter().all(|expiry| expiry.expires_on == "2020-01-02"), "{found:?}");
    }
}
