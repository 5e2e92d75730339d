//! A deployment with users: who they are ([`Roles`], from one short file), what each may do ([`access`]), the configuration of the router and of
//! every user made from that ([`write`](fn@write)), the [`Group`] that may read its secrets, and the trial of the whole matrix against a running
//! router ([`check`]).
//!
//! ```
//! use repose_runtime::deployment::{Roles, Verb, access};
//!
//! let roles = Roles::parse(
//!     r#"
//!     router = "router.example:7447"
//!     cells = ["lab"]
//!     [users.anna]
//!     role = "operator"
//!     [users.wall-display]
//!     role = "viewer"
//!     "#,
//! )
//! .unwrap();
//! let may = |user: &str, verb, key| access::may(&roles.users[user], verb, key);
//! assert!(may("anna", Verb::Query, "repose/v1/lab/service/motion/m-1/operate"));
//! assert!(!may("wall-display", Verb::Query, "repose/v1/lab/service/planner/p-1/call"));
//! assert!(may("wall-display", Verb::Put, "repose/v1/lab/robot/panda/@estop"));
//! ```

pub mod access;
mod attempts;
mod certificates;
mod check;
mod files;
mod groups;
mod probes;
mod report;
mod roles;
mod sessions;
mod settings;
mod writer;

pub use access::Verb;
pub use check::{TrialFiles, check};
pub use files::write;
pub use groups::Group;
pub use report::{CheckReport, PermissionMismatch, TrialOutcome};
pub use roles::{DeploymentRole, Login, Roles, User};
pub use writer::{Failed, WrittenFiles};
