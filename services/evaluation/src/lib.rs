//! repose-evaluation
