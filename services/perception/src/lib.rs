//! repose-perception
