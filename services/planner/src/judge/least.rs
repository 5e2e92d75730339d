//! The least that a candidate can cost, whatever the networks say of it.

use repose_proto::CallError;

use crate::judge::Judge;
use crate::judge::judged::JudgedCandidate;
use crate::judge::success::measures;
use crate::learned::{stability, success};

impl Judge<'_> {
    /// What a feasible candidate costs if the networks say the best of it that they can: certain relations, and the highest forecasts that its
    /// measures allow. Measures it on the way.
    ///
    /// # Errors
    /// As [`Judge::judge`].
    pub fn least_cost(&mut self, judged: &mut JudgedCandidate) -> Result<f64, CallError> {
        let forecasts = self.scorer_mut().forecasts()?;
        let standing = self.standing()?;
        self.scorer().measure(judged);
        let mut best = judged.clone();
        best.realism = judged.measures.as_ref().map(|m| forecasts.stability.most(&m[..], |i| i == stability::NETWORK) as f32);
        best.relations = Some(vec![1.0; self.problem().request.goal.len()]);
        let of_success = measures(&self.problem(), &standing, &best);
        best.success = forecasts.success.as_ref().zip(of_success).map(|(forecast, m)| forecast.most(&m, success::is_by_networks));
        Ok(self.cost(&best))
    }
}
