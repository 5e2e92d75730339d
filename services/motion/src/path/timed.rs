//! Corners of a path, timed and still free: rounding a corner leaves the path that was checked.

use repose_panda::Joints;

use crate::collision::CollisionChecker;
use crate::path::timing::{TimingSettings, Trajectory};

/// How often a path that was rounded into an obstacle is rounded less.
const ROUNDINGS: usize = 4;
/// Time between the checks of a timed path, seconds. Straight edges between its places there leave it by at most an eighth of the acceleration
/// times the square of this: less than a twentieth of the default padding.
const CHECK_PERIOD_S: f64 = 0.01;

/// The fastest timing of a path that stays free when its corners are rounded.
pub fn timed(corners: &[Joints], settings: &TimingSettings, checker: &CollisionChecker<'_>) -> Option<Trajectory> {
    let mut settings = *settings;
    for _ in 0..ROUNDINGS {
        let trajectory = Trajectory::new(corners, &settings)?;
        let points: Vec<Joints> = trajectory.sampled(CHECK_PERIOD_S).map(|(_, point)| point.position_rad).collect();
        if checker.path_is_free(&points) {
            return Some(trajectory);
        }
        settings.deviation_rad *= 0.2;
    }
    None
}
