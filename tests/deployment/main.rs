//! A deployment as an operator has it: real processes of the program, with users, certificates, health, metrics and faults.

#[path = "../common/mod.rs"]
mod common;

mod load;
mod observability;
mod package;
mod processes;
mod roles;
mod two_routers;
