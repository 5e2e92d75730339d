//! A motion plan at a viewer's hand, and the look after it was carried out.

use std::sync::Arc;

use nalgebra::Isometry3;
use repose_executive::Site;
use repose_proto::motion::MotionPlan;
use repose_proto::{CallError, Scene};
use repose_sentences::fate::describe;
use repose_tracking::Followed;

use super::site::PageSite;

/// A plan that the page displays.
pub struct DisplayedPlan {
    /// Its id.
    pub id: String,
    /// The plan.
    pub plan: Arc<MotionPlan>,
    /// What it was made on.
    pub scene: Arc<Scene>,
    /// Where it takes the object: placed from observed.
    pub moved: Isometry3<f64>,
}

impl DisplayedPlan {
    /// Says of every object on a fresh view what has become of it, beside how the execution ended.
    ///
    /// # Errors
    /// Where nothing is seen.
    pub async fn look_after(&self, site: &PageSite, is_done: bool) -> Result<(), CallError> {
        let (_, seen) = site.fresh_view().await?;
        let mut followed = Followed::of(&self.scene);
        followed.look_after_moving(self.plan.query, is_done.then_some(&self.moved), &seen);
        let said = describe(Some(self.plan.query), &followed.disturbed());
        // Another may be shown by now.
        site.cell().update(|activity| activity.execution.iter_mut().filter(|e| e.id == self.id).for_each(|e| e.said.clone_from(&said)));
        Ok(())
    }
}
