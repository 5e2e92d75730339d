//! The two ends of a move: joint paths that carry the hand straight to a grasp and away with the object, and straight down to a placement.
//!
//! All postures are found where the hand has least freedom (at the grasp, at the release), for many angles of the redundant joint, and are
//! followed outwards in small steps on their branch with that angle kept. The posture nearest to where the arm comes from is tried first; the
//! next ones serve where it runs into a limit or an obstacle.

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use repose_panda::{InverseSettings, JOINT_COUNT, Joints, inverse_near, inverse_sweep};

use crate::collision::{CollisionChecker, Contact};
use crate::grasp::GraspCandidate;
use crate::path::joint_path::{between, distance};

/// Settings of the search for the two ends of a move.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EndSearchSettings {
    /// Inverse kinematics at the grasp and the release.
    pub inverse: InverseSettings,
    /// Postures tried at each end, nearest first. Default 24.
    pub postures: usize,
    /// Step of the hand along straight motions, metres. Default 0.01.
    pub step_m: f64,
    /// Largest change of a joint over one step, radians; more is a jump to another branch. Default 0.2.
    pub jump_rad: f64,
    /// How far back along its approach the hand comes to a grasp and leaves a placement, metres. Default 0.10.
    pub standoff_m: f64,
    /// How far the object is lifted straight up, metres. Default 0.10.
    pub lift_m: f64,
    /// How far into the lift the object may still touch what it stood on or beside, metres. Default 0.02.
    pub lift_contact_m: f64,
    /// How much further up the object goes at most where there is no room around it, metres. Default 0.25.
    pub clear_m: f64,
    /// Height above the placement from which it is lowered, metres. Default 0.10 (paper, section 3).
    pub above_m: f64,
    /// Height above the placement at which it is released, metres. Default 0.02 (paper, section 3).
    pub release_m: f64,
}

impl Default for EndSearchSettings {
    fn default() -> Self {
        Self {
            inverse: InverseSettings::default(),
            postures: 24,
            step_m: 0.01,
            jump_rad: 0.2,
            standoff_m: 0.10,
            lift_m: 0.10,
            lift_contact_m: 0.02,
            clear_m: 0.25,
            above_m: 0.10,
            release_m: 0.02,
        }
    }
}

/// Step between the openings at which moving fingers are checked, metres. Each finger goes half of it, no more than its spheres' radius, so that next
/// to nothing of its way is left out.
const OPENING_STEP_M: f64 = 0.024;

/// The openings between closed and open, without these two, at which moving fingers are checked, metres.
pub fn openings_between(closed_m: f64, open_m: f64) -> impl Iterator<Item = f64> {
    let steps = ((open_m - closed_m) / OPENING_STEP_M).ceil().max(1.0);
    (1..steps as usize).map(move |k| closed_m + (open_m - closed_m) * k as f64 / steps)
}

/// Why a grasp has no such end.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum EndFailure {
    /// No joint angles, or none along the straight motion.
    #[error("out of reach")]
    Unreachable,
    /// The arm or the object touches something there.
    #[error("{0}")]
    Blocked(Contact),
}

/// The way to a grasp and away from it.
#[derive(Debug, Clone, PartialEq)]
pub struct PickEnd {
    /// From the standoff down to the object and to its middle.
    pub approach: Vec<Joints>,
    /// From the grasp upwards.
    pub lift: Vec<Joints>,
}

/// The way to a release and away from it.
#[derive(Debug, Clone, PartialEq)]
pub struct PlaceEnd {
    /// From above the placement down to the release.
    pub lower: Vec<Joints>,
    /// From the release back along the approach.
    pub retreat: Vec<Joints>,
}

/// Searches for the pick's and the placement's end of a move with one grasp.
#[derive(Debug, Clone)]
pub struct EndSearch<'a> {
    /// Pose of the world in the robot's base frame.
    pub base_from_world: Isometry3<f64>,
    /// Judges the empty, open hand; what is to be grasped is no obstacle.
    pub open: CollisionChecker<'a>,
    /// Judges the closed hand with the object in it.
    pub holding: CollisionChecker<'a>,
    /// Judges the closed hand alone: where what it holds may still touch what it stood on.
    pub closed: CollisionChecker<'a>,
    /// Judge the hand at the [`openings_between`] closed and open: it goes through them where it closes and where it lets go.
    pub moving: Vec<CollisionChecker<'a>>,
    /// How.
    pub settings: &'a EndSearchSettings,
}

impl EndSearch<'_> {
    /// The pick's end of the move. The posture nearest to `near` is preferred.
    ///
    /// # Errors
    /// The last posture's [`EndFailure`]; blocked ones go before unreachable ones.
    pub fn pick(&self, grasp: &GraspCandidate, near: &Joints) -> Result<PickEnd, EndFailure> {
        let base_from_tcp = self.base_from_world * grasp.world_from_tcp;
        self.over_postures(&base_from_tcp, near, &self.open, |joints| {
            let beside = base_from_tcp * Isometry3::translation(0.0, grasp.aside_m, 0.0);
            let standoff = beside * Isometry3::translation(0.0, 0.0, -self.settings.standoff_m);
            let mut approach = if grasp.aside_m == 0.0 { vec![*joints] } else { self.follow(joints, &base_from_tcp, &beside)? };
            let down = self.follow(&approach[approach.len() - 1], &beside, &standoff)?;
            approach.extend(down.into_iter().skip(1));
            check(&approach, &self.open)?;
            approach.reverse();
            self.check_fingers(joints)?;
            let lift = self.follow(joints, &base_from_tcp, &self.raised(&base_from_tcp, self.settings.lift_m))?;
            let in_contact = (self.settings.lift_contact_m / self.settings.step_m).ceil() as usize;
            check(&lift[..(in_contact + 1).min(lift.len())], &self.closed)?;
            check(&lift[in_contact.min(lift.len() - 1)..], &self.holding)?;
            Ok(PickEnd { approach, lift })
        })
    }

    /// The placement's end of the move, for the object carried by `placed_from_observed`.
    ///
    /// # Errors
    /// As [`Self::pick`].
    pub fn place(&self, grasp: &GraspCandidate, placed_from_observed: &Isometry3<f64>, near: &Joints) -> Result<PlaceEnd, EndFailure> {
        let placed = self.base_from_world * placed_from_observed * grasp.world_from_tcp;
        let release = self.raised(&placed, self.settings.release_m);
        self.over_postures(&release, near, &self.holding, |joints| {
            let mut lower = self.follow(joints, &release, &self.raised(&placed, self.settings.above_m))?;
            check(&lower, &self.holding)?;
            lower.reverse();
            let back = release * Isometry3::translation(0.0, 0.0, -self.settings.standoff_m);
            let retreat = self.follow(joints, &release, &back)?;
            check(&retreat, &self.open)?;
            self.check_fingers(joints)?;
            Ok(PlaceEnd { lower, retreat })
        })
    }

    /// The way straight up from a posture to the first one that `roomy` finds free, at most [`EndSearchSettings::clear_m`] higher, and that `plain`
    /// finds free all along. `None` when there is none.
    pub fn clear_of(&self, joints: &Joints, plain: &CollisionChecker<'_>, roomy: &CollisionChecker<'_>) -> Option<Vec<Joints>> {
        let mut way = vec![*joints];
        if roomy.is_free(joints) {
            return Some(way);
        }
        let base_from_tcp = repose_panda::base_from_tcp(joints);
        let steps = (self.settings.clear_m / self.settings.step_m).round() as usize;
        for k in 1..=steps {
            let higher = self.raised(&base_from_tcp, k as f64 * self.settings.step_m);
            let next = inverse_near(&higher, &way[way.len() - 1], &self.settings.inverse).ok()?;
            let jumps = (0..JOINT_COUNT).any(|i| (next[i] - way[way.len() - 1][i]).abs() > self.settings.jump_rad);
            if jumps || !plain.edge_is_free(&way[way.len() - 1], &next) {
                return None;
            }
            way.push(next);
            if roomy.is_free(&next) {
                return Some(way);
            }
        }
        None
    }

    /// Tries the postures at a pose that `checker` finds free, those near `near` first, until one gives a whole end.
    fn over_postures<End>(
        &self,
        base_from_tcp: &Isometry3<f64>,
        near: &Joints,
        checker: &CollisionChecker<'_>,
        end_from: impl Fn(&Joints) -> Result<End, EndFailure>,
    ) -> Result<End, EndFailure> {
        let mut postures = inverse_sweep(base_from_tcp, &self.settings.inverse);
        postures.sort_by(|a, b| distance(a, near).total_cmp(&distance(b, near)));
        postures.truncate(self.settings.postures);
        let free = checker.are_free(&postures);
        let mut failure = EndFailure::Unreachable;
        for (joints, _) in postures.iter().zip(&free).filter(|(_, free)| **free) {
            match end_from(joints) {
                Ok(end) => return Ok(end),
                Err(EndFailure::Unreachable) => {}
                Err(blocked) => failure = blocked,
            }
        }
        if failure == EndFailure::Unreachable {
            let blocked = postures.iter().zip(&free).find(|(_, free)| !**free).and_then(|(joints, _)| checker.contact(joints));
            failure = blocked.map_or(failure, EndFailure::Blocked);
        }
        Err(failure)
    }

    /// Checks the fingers' own way between closed and open in a posture in which both of these are free.
    fn check_fingers(&self, joints: &Joints) -> Result<(), EndFailure> {
        self.moving.iter().find_map(|hand| hand.contact(joints)).map_or(Ok(()), |contact| Err(EndFailure::Blocked(contact)))
    }

    /// Joint angles along the straight motion of the hand between two poses, from `joints` at the first.
    fn follow(&self, joints: &Joints, base_from_start: &Isometry3<f64>, base_from_end: &Isometry3<f64>) -> Result<Vec<Joints>, EndFailure> {
        let way = base_from_end.translation.vector - base_from_start.translation.vector;
        let steps = (way.norm() / self.settings.step_m).ceil().max(1.0) as usize;
        let mut path = vec![*joints];
        let mut last = *joints;
        for k in 1..=steps {
            let fraction = k as f64 / steps as f64;
            let rotation: UnitQuaternion<f64> = base_from_start.rotation.slerp(&base_from_end.rotation, fraction);
            let pose = Isometry3::from_parts(Translation3::from(base_from_start.translation.vector + way * fraction), rotation);
            let next = inverse_near(&pose, &last, &self.settings.inverse).map_err(|_| EndFailure::Unreachable)?;
            if (0..JOINT_COUNT).any(|i| (next[i] - last[i]).abs() > self.settings.jump_rad) {
                return Err(EndFailure::Unreachable);
            }
            path.push(next);
            last = next;
        }
        Ok(path)
    }

    /// A pose moved straight up in the world.
    fn raised(&self, base_from_tcp: &Isometry3<f64>, height_m: f64) -> Isometry3<f64> {
        Translation3::from(self.base_from_world.rotation * Vector3::z() * height_m) * base_from_tcp
    }
}

/// Checks a whole path, its first corner first: there is most in the way.
fn check(path: &[Joints], checker: &CollisionChecker<'_>) -> Result<(), EndFailure> {
    if let Some(k) = checker.are_free(path).iter().position(|free| !free) {
        return Err(EndFailure::Blocked(checker.contact(&path[k]).unwrap_or(Contact::Itself)));
    }
    match path.windows(2).find(|w| !checker.edge_is_free(&w[0], &w[1])) {
        Some(w) => Err(EndFailure::Blocked(checker.contact(&between(&w[0], &w[1], 0.5)).unwrap_or(Contact::Itself))),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Point3;
    use repose_panda::{READY, base_from_tcp};

    use super::*;
    use crate::collision::ArmCollisionSettings;
    use crate::obstacles::{ObstacleShape, Obstacles};

    #[test]
    fn fingers_do_not_open_through_what_is_thin_and_between_where_they_close_and_open() {
        let (closed_m, open_m, settings) = (0.005, 0.08, EndSearchSettings::default());
        let grasp =
            GraspCandidate { world_from_tcp: base_from_tcp(&READY), aside_m: 0.0, opening_m: open_m, width_m: Some(closed_m), score: 1.0 };
        let release = Translation3::new(0.0, 0.0, settings.release_m) * grasp.world_from_tcp;
        let thin = Obstacles::solids(vec![ObstacleShape::ball(release * Point3::new(0.0, 0.0293, 0.0), 0.0005)]);
        let obstacles = [&thin];
        let hand = |finger_opening_m| {
            CollisionChecker::new(
                ArmCollisionSettings { finger_opening_m, padding_m: 0.005, ..ArmCollisionSettings::default() },
                &obstacles,
                None,
            )
        };
        let ends = |moving| EndSearch {
            base_from_world: Isometry3::identity(),
            open: hand(open_m),
            holding: hand(closed_m),
            closed: hand(closed_m),
            moving,
            settings: &settings,
        };
        let placed = |ends: EndSearch<'_>| ends.place(&grasp, &Isometry3::identity(), &READY);
        assert!(placed(ends(Vec::new())).is_ok(), "it is clear of the closed fingers and of the open ones");
        let moving = openings_between(closed_m, open_m).map(hand).collect();
        assert!(matches!(placed(ends(moving)), Err(EndFailure::Blocked(_))));
    }

    #[test]
    fn fingers_that_hardly_move_are_looked_at_where_they_begin_and_end() {
        assert_eq!(openings_between(0.05, 0.072).count() + openings_between(0.08, 0.08).count(), 0);
        assert_eq!(openings_between(0.0, 0.048).collect::<Vec<_>>(), [0.024]);
    }
}
