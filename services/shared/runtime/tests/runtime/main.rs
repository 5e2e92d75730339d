//! The runtime among several sessions and processes of its own. One program: what the network's futures are compiled to is the same for all.

mod asking_all;
mod calls;
mod common;
mod deploy;
mod deployment;
mod journal;
mod left_attempts;
mod outage;
mod pool;
mod pubsub;
mod scenes;
mod schedules;
mod silent_link;
