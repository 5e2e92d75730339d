//! repose-planner
