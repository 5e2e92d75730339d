//! repose-motion
