//! Why a command is not taken.

/// Why a command was not taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Ignored {
    /// Its epoch is lower than the owner's, or another owner has the same.
    #[error("not the owner")]
    NotOwner,
    /// This command of this owner or a later one was taken already.
    #[error("sequence number passed")]
    Passed,
    /// Its time to live was over before it could be taken.
    #[error("expired")]
    Expired,
    /// Another's task is open, and no stop has ended it.
    #[error("another task is open")]
    OtherTask,
    /// A stop is latched.
    #[error("stopped")]
    Stopped,
    /// It clears a stop, and another one is latched.
    #[error("another stop is latched")]
    OtherStop,
    /// A new stream, while the arm still follows one or brakes.
    #[error("still moving")]
    Moving,
    /// More set-points than are kept.
    #[error("too many set-points")]
    TooMany,
}
