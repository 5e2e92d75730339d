//! What a trial of a deployment found.

use super::access::Verb;
use crate::CertificateExpiry;

/// The outcome of one attempted operation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum TrialOutcome {
    /// The other end has it.
    CameThrough,
    /// The router has dealt with it, and the other end does not have it.
    Refused,
    /// Nobody can tell: the router does not answer, or nothing at all reaches the other end.
    None,
}

/// A permission that differs from what the roles say, or that could not be tested.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct PermissionMismatch {
    /// Who tried.
    pub user: String,
    /// What.
    pub verb: Verb,
    /// Where.
    pub key: String,
    /// Whether the roles allow it.
    pub expected: bool,
    /// Its outcome.
    pub outcome: TrialOutcome,
}

impl std::fmt::Display for PermissionMismatch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { user, verb, key, expected, outcome } = self;
        let verb = format!("{verb:?}").to_lowercase();
        let may = if *expected { "may" } else { "may not" };
        let became = match outcome {
            TrialOutcome::CameThrough => "it came through",
            TrialOutcome::Refused => "it was refused",
            TrialOutcome::None => "there was no answer either way",
        };
        write!(f, "{user} {may} {verb} at {key}, and {became}")
    }
}

/// What the trial found.
#[derive(Debug, Default, serde::Serialize)]
pub struct CheckReport {
    /// Combinations of user, verb and key that were tried.
    pub tried: usize,
    /// Those of them that are allowed.
    pub allowed: usize,
    /// Combinations that nobody is at the other end of.
    pub untried: usize,
    /// What differs from the roles.
    pub wrong: Vec<PermissionMismatch>,
    /// What nobody can tell of.
    pub unanswered: Vec<PermissionMismatch>,
    /// Certificates that have expired, or will within 30 days.
    pub expiring: Vec<CertificateExpiry>,
}

impl CheckReport {
    pub(super) fn add(&mut self, trial: PermissionMismatch) {
        self.tried += 1;
        self.allowed += usize::from(trial.expected);
        match (trial.outcome, trial.expected) {
            (TrialOutcome::CameThrough, true) | (TrialOutcome::Refused, false) => {}
            (TrialOutcome::None, _) => self.unanswered.push(trial),
            _ => self.wrong.push(trial),
        }
    }

    /// Whether every user may do what the roles say, and nothing else.
    pub fn is_right(&self) -> bool {
        self.wrong.is_empty() && self.unanswered.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_answered_is_neither_right_nor_wrong() {
        let trial =
            |expected, outcome| PermissionMismatch { user: "u".to_owned(), verb: Verb::Put, key: "k".to_owned(), expected, outcome };
        let mut report = CheckReport::default();
        report.add(trial(true, TrialOutcome::CameThrough));
        report.add(trial(false, TrialOutcome::Refused));
        assert!(report.is_right());
        report.add(trial(true, TrialOutcome::Refused));
        report.add(trial(false, TrialOutcome::CameThrough));
        report.add(trial(false, TrialOutcome::None));
        assert_eq!((report.tried, report.allowed, report.wrong.len(), report.unanswered.len()), (5, 2, 2, 1));
        assert_eq!(report.unanswered[0].to_string(), "u may not put at k, and there was no answer either way");
    }
}
