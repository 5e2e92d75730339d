//! repose-simulator
