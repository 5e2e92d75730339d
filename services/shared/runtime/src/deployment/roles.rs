//! The roles file: the one place that says who takes part in a deployment, and as what.

use std::collections::BTreeMap;
use std::net::Ipv6Addr;

use repose_proto::keys::validate_chunk;
use repose_proto::{CallError, Service};
use serde::Deserialize;

use crate::endpoint::is_host_and_port;

/// The role of a deployment's user: what it may read and call.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DeploymentRole {
    /// Looks: scenes, states, loads.
    Viewer,
    /// Also asks for scenes, placements and motions.
    Planner,
    /// Also moves robots, and resets robots and worlds.
    Operator,
    /// A robot's or camera's own program.
    Driver,
    /// One of our processes.
    Service,
}

/// How users prove who they are.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Login {
    /// By a password, over a link that the router's certificate protects.
    #[default]
    Password,
    /// By a certificate of their own (mutual TLS).
    Certificate,
    /// By both: a stolen password alone lets nobody in.
    Both,
}

impl Login {
    /// Whether users have passwords.
    pub fn has_passwords(self) -> bool {
        self != Self::Certificate
    }

    /// Whether users have certificates.
    pub fn has_certificates(self) -> bool {
        self != Self::Password
    }
}

/// One user.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct User {
    /// What the user is for.
    pub role: DeploymentRole,
    /// The cells that the user is bound to; those of the file where absent.
    #[serde(default)]
    pub cells: Vec<String>,
    /// A driver's robot, or the simulator's; that of a planner or operator that drives one as well, as a bridge to another system does.
    #[serde(default)]
    pub robot: Option<String>,
    /// The cameras of whoever may have a robot.
    #[serde(default)]
    pub cameras: Vec<String>,
    /// Which service a process is.
    #[serde(default)]
    pub service: Option<Service>,
    /// The only name under which that process may serve; any where absent.
    #[serde(default)]
    pub worker: Option<String>,
    /// Whether the user may also see the cameras' pictures, and record the cell.
    #[serde(default)]
    pub frames: bool,
    /// The pools of those of the user's cells that have one, by cell; and the cells of those that are pools, by pool. The file's `pools` say.
    #[serde(skip)]
    pub pools: Pools,
}

/// Who is served by a pool, and whom a pool serves, as far as a user's cells go.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Pools {
    /// The pool of a cell.
    pub of_cell: BTreeMap<String, String>,
    /// The cells of a pool.
    pub cells: BTreeMap<String, Vec<String>>,
}

/// The roles file.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Roles {
    /// Where users reach the router, `router.example:7447`. The name, or address, is in the router's certificate.
    pub router: String,
    /// Where the router listens; every interface where absent.
    #[serde(default)]
    pub listen: Option<String>,
    /// The cells of users that name none.
    #[serde(default)]
    pub cells: Vec<String>,
    /// Cells whose planners and inference workers serve other cells, too, and which.
    #[serde(default)]
    pub pools: BTreeMap<String, Vec<String>>,
    /// How users prove who they are.
    #[serde(default)]
    pub login: Login,
    /// The users by name.
    pub users: BTreeMap<String, User>,
}

impl Roles {
    /// Reads and checks a roles file, and gives every user its cells.
    ///
    /// # Errors
    /// `invalid_argument` that names the field.
    pub fn parse(text: &str) -> Result<Self, CallError> {
        let mut roles: Self = toml::from_str(text).map_err(|e| CallError::invalid("roles", e.to_string().trim().to_owned()))?;
        if !is_host_and_port(&roles.router) {
            return Err(CallError::invalid("router", format!("expected name:port, got {:?}", roles.router)));
        }
        if let Some(listen) = roles.listen.as_ref().filter(|listen| !is_host_and_port(listen)) {
            return Err(CallError::invalid("listen", format!("expected address:port, got {listen:?}")));
        }
        if roles.users.is_empty() {
            return Err(CallError::invalid("users", "at least one user is needed"));
        }
        let pool_of = pool_of(&roles.pools)?;
        for (name, user) in &mut roles.users {
            if user.cells.is_empty() {
                user.cells.clone_from(&roles.cells);
            }
            user.check(name)?;
            let (cells, pools) = (&user.cells, &roles.pools);
            let of_cell = cells.iter().filter_map(|cell| Some((cell.clone(), pool_of.get(cell)?.clone())));
            let served = cells.iter().filter_map(|cell| Some((cell.clone(), pools.get(cell)?.clone())));
            user.pools = Pools { of_cell: of_cell.collect(), cells: served.collect() };
        }
        Ok(roles)
    }

    /// The router's name without its port.
    pub fn host(&self) -> &str {
        self.router.rsplit_once(':').map_or(self.router.as_str(), |(host, _)| host).trim_matches(['[', ']'])
    }

    /// The endpoint that users connect to.
    pub fn endpoint(&self) -> String {
        format!("quic/{}", self.router)
    }

    /// The endpoint that the router listens at.
    pub fn listening(&self) -> String {
        let port = self.router.rsplit_once(':').map_or("7447", |(_, port)| port);
        // Whoever comes by an address of version 6 is not heard at those of version 4.
        let every = if self.host().parse::<Ipv6Addr>().is_ok() { "[::]" } else { "0.0.0.0" };
        format!("quic/{}", self.listen.clone().unwrap_or_else(|| format!("{every}:{port}")))
    }
}

/// The pool of every cell that has one. A cell has one pool, and a pool none.
fn pool_of(pools: &BTreeMap<String, Vec<String>>) -> Result<BTreeMap<String, String>, CallError> {
    let mut of_cell = BTreeMap::new();
    for (pool, cells) in pools {
        let field = format!("pools.{pool}");
        for chunk in cells.iter().chain([pool]) {
            validate_chunk(&field, chunk)?;
        }
        for cell in cells {
            if pools.contains_key(cell) {
                return Err(CallError::invalid(field, format!("{cell} is a pool itself")));
            }
            if let Some(other) = of_cell.insert(cell.clone(), pool.clone()) {
                return Err(CallError::invalid(field, format!("{cell} has the pool {other} already")));
            }
        }
    }
    Ok(of_cell)
}

impl User {
    fn check(&self, name: &str) -> Result<(), CallError> {
        let field = |what: &str| format!("users.{name}.{what}");
        // Names become file names, lines of the password file and common names of certificates.
        validate_chunk(&format!("users.{name}"), name)?;
        if self.service.is_some() && name == "router" {
            let taken = "the unit repose-router.service is the router's: a service needs another name";
            return Err(CallError::invalid(format!("users.{name}"), taken));
        }
        if self.cells.is_empty() {
            return Err(CallError::invalid(field("cells"), "which cells? Name them here, or once for all users at the top"));
        }
        let chunks = [("cells", &self.cells), ("cameras", &self.cameras)];
        for (what, chunk) in chunks.into_iter().flat_map(|(what, list)| list.iter().map(move |chunk| (what, chunk))) {
            validate_chunk(&field(what), chunk)?;
        }
        for (what, chunk) in [("robot", &self.robot), ("worker", &self.worker)] {
            chunk.as_ref().map_or(Ok(()), |chunk| validate_chunk(&field(what), chunk))?;
        }
        let may_drive = match self.role {
            DeploymentRole::Driver | DeploymentRole::Planner | DeploymentRole::Operator => true,
            DeploymentRole::Service => self.service == Some(Service::Simulator),
            DeploymentRole::Viewer => false,
        };
        let faults = [
            (self.role == DeploymentRole::Service && self.service.is_none(), "service", "which service?"),
            (self.role != DeploymentRole::Service && self.service.is_some(), "service", "only users with the role \"service\" have one"),
            (self.role != DeploymentRole::Service && self.worker.is_some(), "worker", "only users with the role \"service\" have one"),
            (
                self.role == DeploymentRole::Driver && self.robot.is_none() && self.cameras.is_empty(),
                "robot",
                "a driver has a robot or cameras",
            ),
            (!may_drive && self.robot.is_some(), "robot", "only drivers, planners, operators and the simulator have one"),
            (!may_drive && !self.cameras.is_empty(), "cameras", "only drivers, planners, operators and the simulator have some"),
        ];
        match faults.into_iter().find(|(is_fault, ..)| *is_fault) {
            Some((_, what, why)) => Err(CallError::invalid(field(what), why)),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault(users: &str) -> String {
        let error = Roles::parse(&format!("router = \"r:1\"\n{users}")).expect_err("a fault");
        error.field.unwrap_or(error.message)
    }

    #[test]
    fn what_a_role_lacks_or_has_too_much_is_named() {
        assert_eq!(fault("[users.a]\nrole = \"viewer\""), "users.a.cells");
        assert_eq!(fault("cells = [\"*\"]\n[users.a]\nrole = \"viewer\""), "users.a.cells");
        assert_eq!(fault("cells = [\"lab\"]\n[users.a]\nrole = \"driver\""), "users.a.robot");
        assert_eq!(fault("cells = [\"lab\"]\n[users.a]\nrole = \"service\""), "users.a.service");
        assert_eq!(fault("cells = [\"lab\"]\n[users.a]\nrole = \"viewer\"\nrobot = \"panda\""), "users.a.robot");
        assert_eq!(
            fault("cells = [\"lab\"]\n[users.a]\nrole = \"service\"\nservice = \"motion\"\ncameras = [\"wrist\"]"),
            "users.a.cameras"
        );
        assert_eq!(fault("cells = [\"lab\"]\n[users.\"a b\"]\nrole = \"viewer\""), "users.a b");
        assert_eq!(fault("cells = [\"lab\"]\n[users]"), "users");
        // Its unit would be overwritten by the router's.
        assert_eq!(fault("cells = [\"lab\"]\n[users.router]\nrole = \"service\"\nservice = \"planner\""), "users.router");
        let misspelt = Roles::parse("router = \"r:1\"\ncels = [\"lab\"]\n[users.a]\nrole = \"viewer\"").expect_err("misspelt");
        assert!(misspelt.message.contains("cels"), "{misspelt}");
        for router in ["here", "tcp/router.example:7447", "quic/router.example:7447"] {
            let refused = Roles::parse(&format!("router = \"{router}\"\n[users]")).expect_err("no name and port");
            assert!(refused.field.as_deref() == Some("router") && refused.message.contains("expected name:port"), "{refused}");
        }
    }

    #[test]
    fn a_cell_has_one_pool_and_a_pool_none() {
        let users = "[users.a]\nrole = \"viewer\"\ncells = [\"line-1\", \"rack\"]\n";
        assert_eq!(fault(&format!("[pools]\nrack = [\"line 1\"]\n{users}")), "pools.rack");
        assert_eq!(fault(&format!("[pools]\nrack = [\"line-1\"]\nshelf = [\"line-1\"]\n{users}")), "pools.shelf");
        assert_eq!(fault(&format!("[pools]\nrack = [\"shelf\"]\nshelf = [\"line-1\"]\n{users}")), "pools.rack");
        let roles = Roles::parse(&format!("router = \"r:1\"\n[pools]\nrack = [\"line-1\", \"line-2\"]\n{users}")).expect("roles");
        let pools = &roles.users["a"].pools;
        assert_eq!((pools.of_cell["line-1"].as_str(), pools.cells["rack"].len(), pools.of_cell.len()), ("rack", 2, 1));
    }

    #[test]
    fn endpoints_are_the_routers() {
        let roles = Roles::parse("router = \"router.example:7447\"\ncells = [\"lab\"]\n[users.a]\nrole = \"viewer\"").expect("roles");
        assert_eq!((roles.host(), roles.endpoint().as_str()), ("router.example", "quic/router.example:7447"));
        assert_eq!(roles.listening(), "quic/0.0.0.0:7447");
        let users = "cells = [\"lab\"]\n[users.a]\nrole = \"viewer\"";
        let by_address = Roles::parse(&format!("router = \"[fd00::1]:7447\"\n{users}")).expect("roles");
        assert_eq!((by_address.host(), by_address.listening().as_str()), ("fd00::1", "quic/[::]:7447"));
        let elsewhere = Roles::parse(&format!("router = \"r:1\"\nlisten = \"10.0.0.1:7448\"\n{users}")).expect("roles");
        assert_eq!(elsewhere.listening(), "quic/10.0.0.1:7448");
        for listen in ["7447", "quic/0.0.0.0:7447", ""] {
            assert_eq!(fault(&format!("listen = \"{listen}\"\n{users}")), "listen");
        }
        assert_eq!(roles.users["a"].cells, ["lab"]);
    }
}
