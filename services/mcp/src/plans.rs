//! The plans that were made here: bounded, each good once, for the session that asked for it.

use std::sync::Arc;

use repose_proto::place::Placement;
use repose_proto::{CallError, GoalTerm};

use crate::asker::Asker;
use crate::per_session::{Bounds, PerSession};
use crate::seen::ShownScene;

/// Plans that are kept.
const KEPT: Bounds = Bounds { per_session: 32, total: 512, bytes: 512 << 20 };

/// A placement that was shown, and what it was made for.
#[derive(Debug, Clone)]
pub struct Plan {
    /// What agents call it.
    pub id: String,
    /// The scene that it was made on.
    pub seen: Arc<ShownScene>,
    /// The object to move.
    pub query: u16,
    /// What must hold afterwards.
    pub goal: Vec<GoalTerm>,
    /// The viewer of the goal's directions.
    pub view_yaw_rad: f64,
    /// Where it goes: the one that was drawn.
    pub placement: Placement,
    /// The source of every random number.
    pub seed: u64,
    /// Whose it is.
    pub session: String,
}

/// Plans by id.
#[derive(Debug)]
pub struct Plans {
    kept: PerSession<Plan>,
}

impl Default for Plans {
    fn default() -> Self {
        Self { kept: PerSession::new(KEPT, |plan| &plan.seen) }
    }
}

impl Plans {
    /// Keeps a plan.
    pub fn keep(&mut self, plan: Plan) {
        let plan = Arc::new(plan);
        self.kept.keep(&plan.session, &plan.id, plan.clone());
    }

    /// A plan of the asker's session.
    ///
    /// # Errors
    /// `not_found` on `plan`, of one that another session made, too: whether there is such a plan is none of the asker's business.
    pub fn get(&self, id: &str, asker: &Asker) -> Result<Arc<Plan>, CallError> {
        self.kept.of(&asker.session, id).ok_or_else(|| {
            let why = "none was made under that id in this session, or it was carried out already, or it is no longer kept";
            CallError::not_found("plan", format!("there is no plan {id:?}: {why}; look and plan again"))
        })
    }

    /// Forgets a plan.
    pub fn remove(&mut self, id: &str) {
        self.kept.remove(id);
    }
}
