//! repose-networks
