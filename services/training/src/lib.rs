//! repose-training
