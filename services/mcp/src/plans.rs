//! The plans that were made here: bounded, each good once, for the session that asked for it.

use std::collections::VecDeque;
use std::sync::Arc;

use repose_proto::place::Placement;
use repose_proto::{CallError, GoalTerm};

use crate::asker::Asker;
use crate::seen::ShownScene;

/// Plans that are kept; the oldest goes first.
const KEPT: usize = 32;

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
#[derive(Debug, Default)]
pub struct Plans {
    kept: VecDeque<Arc<Plan>>,
}

impl Plans {
    /// Keeps a plan.
    pub fn keep(&mut self, plan: Plan) {
        if self.kept.len() == KEPT {
            self.kept.pop_front();
        }
        self.kept.push_back(Arc::new(plan));
    }

    /// A plan of the asker's session.
    ///
    /// # Errors
    /// `not_found` on `plan`, of one that another session made, too: whether there is such a plan is none of the asker's business.
    pub fn get(&self, id: &str, asker: &Asker) -> Result<Arc<Plan>, CallError> {
        let own = self.kept.iter().find(|plan| plan.id == id && plan.session == asker.session);
        own.cloned().ok_or_else(|| {
            CallError::not_found("plan", format!("no plan {id:?} was made in this session, or it was carried out already: plan again"))
        })
    }

    /// Forgets a plan.
    pub fn remove(&mut self, id: &str) {
        self.kept.retain(|plan| plan.id != id);
    }

    /// How many there are of a session.
    pub fn count(&self, session: &str) -> usize {
        self.kept.iter().filter(|plan| plan.session == session).count()
    }
}
