//! repose-inference
