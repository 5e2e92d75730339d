//! How a command ends when it does not succeed, and the exit code that says so.

use repose_evaluation::report::written::FileError;
use repose_proto::{CallError, ErrorCode};

/// Why a command did not succeed.
#[derive(Debug)]
pub enum Failure {
    /// What was asked cannot be: exit code 2, with the field or file at fault.
    BadInput(CallError),
    /// The search ended without a placement; its result has been printed: exit code 3.
    NoPlacement,
    /// A wish was carried out and did not come true; what came of each has been printed: exit code 1.
    NotAchieved,
    /// Anything else: exit code 1.
    Other(CallError),
}

/// The result of a command.
pub type CommandResult = Result<(), Failure>;

impl Failure {
    /// Something about the arguments or the files that they name.
    pub fn bad_input(field: &str, message: impl std::fmt::Display) -> Self {
        Self::BadInput(CallError::invalid(field, message.to_string()))
    }

    /// A failure that is not the user's.
    pub fn other(message: impl std::fmt::Display) -> Self {
        Self::Other(CallError::internal(message.to_string()))
    }

    /// The process's exit code.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::BadInput(_) => 2,
            Self::NoPlacement => 3,
            Self::NotAchieved | Self::Other(_) => 1,
        }
    }

    /// The error, for whoever takes no other failures.
    pub fn into_error(self) -> CallError {
        match self {
            Self::BadInput(error) | Self::Other(error) => error,
            Self::NoPlacement | Self::NotAchieved => CallError::internal("nothing was achieved"),
        }
    }

    /// The error to print, where there is one.
    pub fn error(&self) -> Option<&CallError> {
        match self {
            Self::BadInput(error) | Self::Other(error) => Some(error),
            Self::NoPlacement | Self::NotAchieved => None,
        }
    }
}

/// An error for people: the field at fault, where the message does not name it, and the message. The code is in the JSON.
pub fn sentence(error: &CallError) -> String {
    match &error.field {
        Some(field) if !is_named(field, &error.message) => format!("{field}: {}", error.message),
        _ => error.message.clone(),
    }
}

/// Whether a message names a field, and not only has its letters in another word, as `month` has those of `nth`.
fn is_named(field: &str, message: &str) -> bool {
    let goes_on = |c: Option<char>| c.is_some_and(|c| c.is_alphanumeric() || c == '_');
    message.match_indices(field).any(|(at, _)| {
        let (before, after) = (&message[..at], &message[at + field.len()..]);
        !goes_on(before.chars().next_back()) && !goes_on(after.chars().next())
    })
}

impl From<CallError> for Failure {
    fn from(error: CallError) -> Self {
        match error.code {
            ErrorCode::InvalidArgument | ErrorCode::NotFound | ErrorCode::FailedPrecondition => Self::BadInput(error),
            _ => Self::Other(error),
        }
    }
}

impl From<FileError> for Failure {
    fn from(error: FileError) -> Self {
        Self::bad_input(&error.path.display().to_string(), error.why)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_field_is_said_where_the_message_does_not_name_it() {
        let said = |field: &str, message: &str| sentence(&CallError::invalid(field, message));
        assert_eq!(said("nth", "frames/month has 3 frames"), "nth: frames/month has 3 frames");
        assert_eq!(said("rate", "expected a separate number"), "rate: expected a separate number");
        assert_eq!(said("connect", "--connect or REPOSE_CONNECT says it"), "--connect or REPOSE_CONNECT says it");
        assert_eq!(said("goals[0].object", "goals[0].object: the scene has no object 9"), "goals[0].object: the scene has no object 9");
    }
}
