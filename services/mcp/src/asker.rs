//! Who asks.

/// An agent, as far as it says who it is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Asker {
    /// Name and version, as the client says them of itself.
    pub client: String,
    /// The session, where the transport has one; else the client again.
    pub session: String,
}
