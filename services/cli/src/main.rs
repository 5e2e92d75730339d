//! The `repose` command.
fn main() {}
