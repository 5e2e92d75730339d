//! Corners of a path, timed and still free: rounding a corner leaves the path that was checked.

use repose_panda::Joints;
use repose_proto::limits::MAX_REMAINING_MS;

use crate::collision::CollisionChecker;
use crate::path::timing::{TimingSettings, Trajectory};

/// How often a path that was rounded into an obstacle is rounded less.
const ROUNDINGS: usize = 4;
/// Time between the checks of a timed path, seconds. Straight edges between its places there leave it by at most an eighth of the acceleration
/// times the square of this: less than a twentieth of the default padding.
const CHECK_PERIOD_S: f64 = 0.01;
/// A motion that takes longer than any call may last cannot be carried out, seconds; and looking at all of it would take as long as it is slow.
const LONGEST_S: f64 = MAX_REMAINING_MS as f64 * 1e-3;

/// The fastest timing of a path that stays free when its corners are rounded; none where there is none, or where it takes too long.
pub fn timed(corners: &[Joints], settings: &TimingSettings, checker: &CollisionChecker<'_>) -> Option<Trajectory> {
    let mut settings = *settings;
    for _ in 0..ROUNDINGS {
        let trajectory = Trajectory::new(corners, &settings).filter(|trajectory| trajectory.duration_s() <= LONGEST_S)?;
        let points: Vec<Joints> = trajectory.sampled(CHECK_PERIOD_S).map(|(_, point)| point.position_rad).collect();
        if checker.path_is_free(&points) {
            return Some(trajectory);
        }
        settings.deviation_rad *= 0.2;
    }
    None
}

#[cfg(test)]
mod tests {
    use repose_panda::READY;

    use super::*;
    use crate::collision::ArmCollisionSettings;

    #[test]
    fn what_nobody_would_wait_for_is_not_looked_at() {
        let checker = CollisionChecker::new(ArmCollisionSettings::default(), &[], None);
        let mut end = READY;
        end[0] = 1.0;
        let usual = TimingSettings::default();
        assert!(timed(&[READY, end], &usual, &checker).is_some());
        assert_eq!(timed(&[READY, end], &usual.slowed(1e-9), &checker), None);
    }
}
