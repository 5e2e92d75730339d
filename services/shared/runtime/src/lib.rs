//! repose-runtime
