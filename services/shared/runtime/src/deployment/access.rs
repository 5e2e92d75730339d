//! Who may do what: each role as the verbs and keys that it is allowed. Everything else is denied.
//!
//! Access control sees keys and not methods, which is why what moves a robot has a key of its own. `**` and `*` do not match chunks that begin
//! with `@`, so stops and cancels are always named.

use repose_proto::{Cell, Service};

use super::roles::{DeploymentRole, User};

/// What one can do at a key.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verb {
    /// Put a message there.
    Put,
    /// Hear what is put there.
    Subscribe,
    /// Call what is served there.
    Query,
    /// Serve calls there.
    Serve,
    /// Show oneself alive there.
    Token,
    /// See who is alive there.
    Watch,
}

impl Verb {
    /// All verbs.
    pub const ALL: [Self; 6] = [Self::Put, Self::Subscribe, Self::Query, Self::Serve, Self::Token, Self::Watch];

    /// The verb of the other end: what is put is heard by a subscriber, and so on.
    pub fn counterpart(self) -> Self {
        match self {
            Self::Put => Self::Subscribe,
            Self::Subscribe => Self::Put,
            Self::Query => Self::Serve,
            Self::Serve => Self::Query,
            Self::Token => Self::Watch,
            Self::Watch => Self::Token,
        }
    }
}

/// A verb and the keys that it is allowed at, with `*` for any one chunk.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Grant {
    /// What may be done.
    pub verb: Verb,
    /// Where.
    pub keys: String,
}

/// Everything that a user may do. A user whose cells are no chunks may do nothing.
pub fn grants(user: &User) -> Vec<Grant> {
    let cells = user.cells.iter().filter_map(|cell| Cell::new(cell).ok());
    cells.flat_map(|cell| Grants { grants: Vec::new(), pool: pool_of(user, &cell), cell }.of(user)).collect()
}

/// The pool of one of a user's cells.
fn pool_of(user: &User, cell: &Cell) -> Option<Cell> {
    user.pools.of_cell.get(cell.name()).and_then(|pool| Cell::new(pool).ok())
}

/// Whether a user may do something at a key.
pub fn may(user: &User, verb: Verb, key: &str) -> bool {
    grants(user).iter().any(|grant| grant.verb == verb && includes(&grant.keys, key))
}

/// Whether every key that `key` stands for is among `keys`. `*` stands for a chunk that does not begin with `@`.
fn includes(keys: &str, key: &str) -> bool {
    let (mut allowed, mut asked) = (keys.split('/'), key.split('/'));
    loop {
        match (allowed.next(), asked.next()) {
            (None, None) => return true,
            (Some("*"), Some(chunk)) if !chunk.starts_with('@') && chunk != "**" => {}
            (Some(expected), Some(chunk)) if expected == chunk => {}
            _ => return false,
        }
    }
}

/// The grants of one cell while they are put together.
struct Grants {
    cell: Cell,
    /// The pool that serves the cell.
    pool: Option<Cell>,
    grants: Vec<Grant>,
}

impl Grants {
    fn of(mut self, user: &User) -> Vec<Grant> {
        self.add(Verb::Put, self.cell.robot_estop("*"));
        if user.frames {
            self.add(Verb::Subscribe, self.cell.camera_frames());
            // Calls have pictures in them, too.
            self.add(Verb::Subscribe, self.cell.journals());
            self.add(Verb::Subscribe, self.cell.robot_estop("*"));
            self.add(Verb::Token, self.cell.live_recorder("*"));
        }
        match user.role {
            DeploymentRole::Viewer => self.look(),
            DeploymentRole::Planner | DeploymentRole::Operator => {
                self.look();
                self.call_pool(&Service::ALL);
                for service in Service::ALL {
                    self.call(service);
                    if user.role == DeploymentRole::Operator && service.has_operations() {
                        self.add(Verb::Query, self.cell.operate(service, "*"));
                    }
                }
                if user.role == DeploymentRole::Operator {
                    // Shows that whoever has a robot moved is still there.
                    self.add(Verb::Token, self.cell.live_client("*"));
                }
                // A bridge brings its system's robot and cameras in, and asks for its clients.
                self.drive(user);
            }
            DeploymentRole::Driver => self.drive(user),
            DeploymentRole::Service => self.serve(user),
        }
        self.grants
    }

    fn add(&mut self, verb: Verb, keys: String) {
        let grant = Grant { verb, keys };
        if !self.grants.contains(&grant) {
            self.grants.push(grant);
        }
    }

    fn look(&mut self) {
        if let Some(pool) = self.pool.clone() {
            for service in Service::ALL.into_iter().filter(|service| service.is_poolable()) {
                self.add(Verb::Subscribe, pool.loads(service));
                self.add(Verb::Watch, pool.lives(service));
            }
        }
        self.add(Verb::Subscribe, self.cell.scene("*"));
        self.add(Verb::Subscribe, self.cell.robot_state("*"));
        self.add(Verb::Subscribe, self.cell.all_loads());
        self.add(Verb::Watch, self.cell.all_lives());
    }

    fn call(&mut self, service: Service) {
        self.call_in(&self.cell.clone(), service);
    }

    /// Calls to the workers of a cell as one of its own.
    fn call_in(&mut self, cell: &Cell, service: Service) {
        self.add(Verb::Query, cell.call(service, "*"));
        self.call_workers(cell, service);
    }

    /// Calls for this cell, and for no other, to those of its pool that are among these services.
    fn call_pool(&mut self, services: &[Service]) {
        let Some(pool) = self.pool.clone() else { return };
        for service in services.iter().copied().filter(|service| service.is_poolable()) {
            self.add(Verb::Query, pool.call_for(service, "*", self.cell.name()));
            self.call_workers(&pool, service);
        }
    }

    /// What callers need besides the call: to find workers, and to cancel.
    fn call_workers(&mut self, cell: &Cell, service: Service) {
        self.add(Verb::Put, cell.cancels(service, "*"));
        self.add(Verb::Subscribe, cell.loads(service));
        self.add(Verb::Watch, cell.lives(service));
    }

    /// What a worker does for the cells that it serves as their pool's.
    fn serve_pool(&mut self, user: &User, service: Service, worker: &str) {
        if service.is_poolable() {
            // Every such worker offers it; who may ask is for others' grants to say.
            self.add(Verb::Serve, self.cell.calls_for_others(service, worker));
        }
        let Some(cells) = user.pools.cells.get(self.cell.name()) else { return };
        if service == Service::Planner {
            self.add(Verb::Query, self.cell.calls_for_others(Service::Inference, "*"));
            for cell in cells.iter().filter_map(|cell| Cell::new(cell).ok()) {
                // Scenes come from the cell that they are of.
                self.call_in(&cell, Service::Perception);
            }
        }
    }

    /// What a robot's and a camera's own program does; the simulator without names stands in for any.
    fn drive(&mut self, user: &User) {
        let is_any = user.role == DeploymentRole::Service && user.robot.is_none() && user.cameras.is_empty();
        if let Some(robot) = user.robot.as_deref().or(is_any.then_some("*")) {
            self.add(Verb::Put, self.cell.robot_state(robot));
            self.add(Verb::Subscribe, self.cell.robot_command(robot));
            self.add(Verb::Subscribe, self.cell.robot_estop(robot));
            // It looks whether another driver has the robot.
            self.add(Verb::Subscribe, self.cell.robot_state(robot));
        }
        for camera in user.cameras.iter().map(String::as_str).chain(is_any.then_some("*")) {
            self.add(Verb::Put, self.cell.camera_frame(camera));
        }
    }

    fn serve(&mut self, user: &User) {
        let (Some(service), worker) = (user.service, user.worker.as_deref().unwrap_or("*")) else { return };
        self.add(Verb::Serve, self.cell.call(service, worker));
        if service.has_operations() {
            self.add(Verb::Serve, self.cell.operate(service, worker));
        }
        self.add(Verb::Subscribe, self.cell.cancels(service, worker));
        self.add(Verb::Put, self.cell.load(service, worker));
        self.add(Verb::Put, self.cell.journal(service, worker));
        self.add(Verb::Watch, self.cell.live_recorder("*"));
        self.add(Verb::Token, self.cell.live(service, worker));
        // A worker looks whether its name is free, and stays so.
        self.add(Verb::Watch, self.cell.live(service, worker));
        self.add(Verb::Subscribe, self.cell.load(service, worker));
        self.serve_pool(user, service, worker);
        match service {
            Service::Perception => {
                self.add(Verb::Subscribe, self.cell.camera_frames());
                self.add(Verb::Subscribe, self.cell.robot_state("*"));
                self.add(Verb::Put, self.cell.scene("*"));
            }
            Service::Inference => {}
            Service::Planner => {
                self.call_pool(&[Service::Inference]);
                self.add(Verb::Subscribe, self.cell.robot_state("*"));
                self.call(Service::Perception);
                self.call(Service::Inference);
            }
            Service::Motion => {
                self.add(Verb::Put, self.cell.robot_command("*"));
                self.add(Verb::Subscribe, self.cell.robot_state("*"));
                self.add(Verb::Subscribe, self.cell.robot_estop("*"));
                self.add(Verb::Watch, self.cell.live_client("*"));
                self.call(Service::Perception);
            }
            Service::Simulator => self.drive(user),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::Roles;
    use super::*;

    #[test]
    fn a_star_is_one_chunk_and_never_one_that_begins_with_an_at_sign() {
        assert!(includes("a/*/c", "a/b/c") && includes("a/*", "a/*"));
        assert!(!includes("a/*", "a/@b") && !includes("a/*", "a/**") && !includes("a/*", "a/b/c") && !includes("a/b", "a/*"));
        assert!(includes("a/@b/*", "a/@b/c"));
    }

    /// The users that may, their names of one letter put together.
    fn who(roles: &Roles, verb: Verb, key: &str) -> String {
        let may = |name: &&String| may(&roles.users[name.as_str()], verb, key);
        roles.users.keys().filter(may).map(String::as_str).collect()
    }

    #[test]
    fn roles_hold_what_they_are_for_in_their_cells_only() {
        let roles = Roles::parse(
            "router = \"r:1\"\ncells = [\"lab\"]\n[users.v]\nrole = \"viewer\"\n[users.p]\nrole = \"planner\"\n[users.o]\nrole = \"operator\"\n\
             [users.d]\nrole = \"driver\"\nrobot = \"panda\"\ncameras = [\"wrist\"]\n[users.m]\nrole = \"service\"\nservice = \"motion\"\n",
        )
        .expect("roles");
        let who = |verb, key: &str| who(&roles, verb, key);
        assert_eq!(who(Verb::Query, "repose/v1/lab/service/motion/m/operate"), "o");
        assert_eq!(who(Verb::Query, "repose/v1/lab/service/motion/m/call"), "op");
        assert_eq!(who(Verb::Serve, "repose/v1/lab/service/motion/m/operate"), "m");
        assert_eq!(who(Verb::Serve, "repose/v1/lab/service/planner/m/call"), "");
        assert_eq!(who(Verb::Put, "repose/v1/lab/robot/panda/command"), "m");
        assert_eq!(who(Verb::Put, "repose/v1/lab/robot/panda/@estop"), "dmopv");
        assert_eq!(who(Verb::Put, "repose/v1/*/robot/panda/@estop"), "");
        assert_eq!(who(Verb::Put, "repose/v1/hall/robot/panda/@estop"), "");
        assert_eq!(who(Verb::Put, "repose/v1/lab/robot/panda/state"), "d");
        assert_eq!(who(Verb::Put, "repose/v1/lab/robot/other/state"), "");
        assert_eq!(who(Verb::Put, "repose/v1/lab/camera/wrist/frame"), "d");
        assert_eq!(who(Verb::Put, "repose/v1/lab/camera/front/frame"), "");
        assert_eq!(who(Verb::Subscribe, "repose/v1/lab/robot/panda/state"), "dmopv", "a driver looks whether there is another");
        assert_eq!(who(Verb::Subscribe, "repose/v1/lab/robot/other/state"), "mopv");
        assert_eq!(who(Verb::Subscribe, "repose/v1/lab/camera/wrist/frame"), "");
        assert_eq!(who(Verb::Token, "repose/v1/lab/live/motion/x"), "m");
        assert_eq!(who(Verb::Token, "repose/v1/lab/live/client/x"), "o");
        assert_eq!(who(Verb::Watch, "repose/v1/lab/live/client/x"), "mopv");
    }

    #[test]
    fn who_asks_may_have_a_robot_and_cameras_as_well_and_no_others() {
        let roles = Roles::parse(
            "router = \"r:1\"\ncells = [\"lab\"]\n[users.b]\nrole = \"planner\"\nrobot = \"panda\"\ncameras = [\"wrist\"]\n\
             [users.p]\nrole = \"planner\"\n[users.o]\nrole = \"operator\"\n",
        )
        .expect("roles");
        let who = |verb, key: &str| who(&roles, verb, key);
        assert_eq!(who(Verb::Put, "repose/v1/lab/robot/panda/state"), "b");
        assert_eq!(who(Verb::Subscribe, "repose/v1/lab/robot/panda/command"), "b");
        assert_eq!(who(Verb::Put, "repose/v1/lab/camera/wrist/frame"), "b");
        assert_eq!(who(Verb::Query, "repose/v1/lab/service/planner/p/call"), "bop");
        assert_eq!(who(Verb::Query, "repose/v1/lab/service/motion/m/operate"), "o");
        for (verb, key) in [(Verb::Put, "robot/other/state"), (Verb::Put, "robot/panda/command"), (Verb::Put, "camera/front/frame")] {
            assert_eq!(who(verb, &format!("repose/v1/lab/{key}")), "", "{key}");
        }
    }

    #[test]
    fn a_cells_users_call_its_pool_for_their_own_cell_and_do_nothing_else_there() {
        let roles = Roles::parse(
            "router = \"r:1\"\ncells = [\"line-1\"]\n[pools]\nrack = [\"line-1\", \"line-2\"]\n[users.v]\nrole = \"viewer\"\n\
             [users.o]\nrole = \"operator\"\n[users.m]\nrole = \"service\"\nservice = \"motion\"\n[users.x]\nrole = \"operator\"\ncells = [\"line-3\"]\n\
             [users.p]\nrole = \"service\"\nservice = \"planner\"\ncells = [\"rack\"]\n[users.i]\nrole = \"service\"\nservice = \"inference\"\ncells = [\"rack\"]\n",
        )
        .expect("roles");
        let who = |verb, key: &str| who(&roles, verb, key);
        assert_eq!(who(Verb::Query, "repose/v1/rack/service/planner/w/call/line-1"), "o");
        assert_eq!(who(Verb::Query, "repose/v1/rack/service/planner/w/call/line-2"), "", "a cell calls for itself only");
        assert_eq!(who(Verb::Query, "repose/v1/rack/service/planner/w/call/*"), "");
        assert_eq!(who(Verb::Query, "repose/v1/rack/service/planner/w/call"), "");
        assert_eq!(
            who(Verb::Query, "repose/v1/rack/service/inference/w/call/line-1"),
            "op",
            "the pool's planner calls for any of its cells"
        );
        assert_eq!(who(Verb::Serve, "repose/v1/rack/service/planner/w/call/line-1"), "p");
        assert_eq!(who(Verb::Serve, "repose/v1/rack/service/inference/w/call/line-2"), "i");
        assert_eq!(who(Verb::Put, "repose/v1/rack/service/planner/w/@cancel/x"), "o");
        assert_eq!(who(Verb::Watch, "repose/v1/rack/live/planner/w"), "opv");
        assert_eq!(who(Verb::Query, "repose/v1/line-2/service/perception/w/call"), "p", "it fetches their scenes");
        assert_eq!(who(Verb::Query, "repose/v1/line-1/service/motion/w/call"), "o");
        assert_eq!(who(Verb::Subscribe, "repose/v1/line-1/robot/panda/state"), "mov");
        assert_eq!(who(Verb::Put, "repose/v1/rack/robot/panda/@estop"), "ip");
    }
}
