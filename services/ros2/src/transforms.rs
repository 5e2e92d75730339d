//! The tree of frames that `/tf` and `/tf_static` tell, and where one frame was in another at an instant.

use std::collections::{BTreeMap, VecDeque};

use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use repose_ros_messages::{Transform, TransformStamped};

/// How long transforms are kept, nanoseconds.
const KEPT_NS: u64 = 10_000_000_000;
/// A transform this far before the newest of its frame is of a clock that began anew, nanoseconds: on the way they overtake each other by less.
const OTHER_CLOCK_NS: u64 = 2_000_000_000;
/// Transforms of one frame that are kept at most.
const MOST: usize = 4096;
/// Frames that are known at most: of those that move, the one that was told of longest ago makes room for another.
const FRAMES: usize = 4096;
/// Frames between two at most; more is a circle.
const DEEPEST: usize = 64;

/// Why a transform cannot be told.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TransformError {
    /// Nobody has told of a frame.
    #[error("the pose of frame {frame:?} is unknown; known frames: {known}")]
    Unknown {
        /// The frame.
        frame: String,
        /// Others.
        known: String,
    },
    /// The frames have no common ancestor.
    #[error("frames {of:?} and {to:?} are in different trees")]
    Apart {
        /// One.
        of: String,
        /// The other.
        to: String,
    },
    /// The instant is not between two that were told.
    #[error("frame {frame:?} is known up to {ms} ms {direction} the asked instant")]
    Instant {
        /// The frame.
        frame: String,
        /// By how much.
        ms: u64,
        /// Before or after.
        direction: &'static str,
    },
}

impl TransformError {
    /// Whether it may be known a little later.
    pub fn may_come(&self) -> bool {
        match self {
            Self::Instant { direction, .. } => *direction == "before",
            Self::Unknown { .. } | Self::Apart { .. } => true,
        }
    }
}

#[derive(Debug, Clone)]
struct Branch {
    parent: String,
    is_static: bool,
    /// By stamp.
    parent_from_child: VecDeque<(u64, Isometry3<f64>)>,
    /// How many transforms had come when the last one of it did.
    told: u64,
}

/// The frames of a system.
#[derive(Debug, Clone, Default)]
pub struct Transforms {
    branches: BTreeMap<String, Branch>,
    /// Transforms that have come.
    told: u64,
}

impl Transforms {
    /// Takes a transform; whether it was one that can be used.
    pub fn take(&mut self, told: &TransformStamped, is_static: bool) -> bool {
        let (child, parent) = (plain(&told.child_frame_id), plain(&told.header.frame_id));
        let Some(pose) = isometry(&told.transform) else { return false };
        if child.is_empty() || child == parent || !self.has_room_for(child) {
            return false;
        }
        self.told += 1;
        let told_of = self.told;
        let fresh = || Branch { parent: parent.to_owned(), is_static, parent_from_child: VecDeque::new(), told: told_of };
        let branch = self.branches.entry(child.to_owned()).or_insert_with(fresh);
        if branch.parent != parent || branch.is_static != is_static {
            *branch = fresh();
        }
        branch.told = told_of;
        let stamp_ns = told.header.stamp.as_ns();
        let poses = &mut branch.parent_from_child;
        if is_static {
            poses.clear();
        }
        // Time that jumps back, as when a simulation or a recording begins anew: what was told of later instants is of another time.
        if poses.back().is_some_and(|(last_ns, _)| stamp_ns + OTHER_CLOCK_NS < *last_ns) {
            poses.truncate(poses.partition_point(|(ns, _)| *ns < stamp_ns));
        }
        let at = poses.partition_point(|(ns, _)| *ns < stamp_ns);
        match poses.get_mut(at) {
            Some((ns, same)) if *ns == stamp_ns => *same = pose,
            _ => poses.insert(at, (stamp_ns, pose)),
        }
        let newest_ns = poses.back().map_or(0, |(ns, _)| *ns);
        while poses.len() > MOST || poses.front().is_some_and(|(ns, _)| ns + KEPT_NS < newest_ns) {
            poses.pop_front();
        }
        true
    }

    /// Whether a frame is known or can be. Whoever follows things gives each a frame of its own, and within days there are as many as are known: those of
    /// things that have gone are told of no more.
    fn has_room_for(&mut self, child: &str) -> bool {
        if self.branches.len() < FRAMES || self.branches.contains_key(child) {
            return true;
        }
        let moving = self.branches.iter().filter(|(_, branch)| !branch.is_static);
        let oldest = moving.min_by_key(|(_, branch)| branch.told).map(|(frame, _)| frame.clone());
        oldest.is_some_and(|oldest| self.branches.remove(&oldest).is_some())
    }

    /// Where frame `of` is in frame `to` at an instant: `to` from `of`.
    ///
    /// # Errors
    /// [`TransformError`] that names the frame.
    pub fn lookup(&self, to: &str, of: &str, stamp_ns: u64) -> Result<Isometry3<f64>, TransformError> {
        let (to, of) = (plain(to), plain(of));
        let (up_of, up_to) = (self.ancestors(of), self.ancestors(to));
        let Some(common) = up_of.iter().find(|frame| up_to.contains(frame)) else {
            let unknown = [of, to].into_iter().find(|frame| !self.is_known(frame));
            return Err(match unknown {
                Some(frame) => TransformError::Unknown { frame: frame.to_owned(), known: self.listing() },
                None => TransformError::Apart { of: of.to_owned(), to: to.to_owned() },
            });
        };
        let common_from = |frame: &str, way: &[&str]| {
            let steps = way.iter().take_while(|step| *step != common);
            let pose = steps.map(|step| self.in_parent(step, stamp_ns)).try_fold(Isometry3::identity(), |pose, step| Ok(step? * pose));
            debug_assert!(way.first() == Some(&frame));
            pose
        };
        Ok(common_from(to, &up_to)?.inverse() * common_from(of, &up_of)?)
    }

    /// A frame and everything that it hangs on, up to the root.
    fn ancestors<'a>(&'a self, frame: &'a str) -> Vec<&'a str> {
        let mut way = vec![frame];
        while let Some(branch) = way.last().and_then(|last| self.branches.get(*last)) {
            if way.len() > DEEPEST {
                break;
            }
            way.push(&branch.parent);
        }
        way
    }

    fn is_known(&self, frame: &str) -> bool {
        self.branches.contains_key(frame) || self.branches.values().any(|branch| branch.parent == frame)
    }

    fn in_parent(&self, frame: &str, stamp_ns: u64) -> Result<Isometry3<f64>, TransformError> {
        let none = || TransformError::Unknown { frame: frame.to_owned(), known: self.listing() };
        let branch = self.branches.get(frame).ok_or_else(none)?;
        let poses = &branch.parent_from_child;
        if branch.is_static {
            return poses.back().map(|(_, pose)| *pose).ok_or_else(none);
        }
        let off = |ns: u64, direction| TransformError::Instant { frame: frame.to_owned(), ms: ns.div_ceil(1_000_000), direction };
        let next = poses.partition_point(|(ns, _)| *ns < stamp_ns);
        match (next.checked_sub(1).and_then(|before| poses.get(before)), poses.get(next)) {
            (_, Some((ns, pose))) if *ns == stamp_ns => Ok(*pose),
            (Some((a_ns, a)), Some((b_ns, b))) => {
                let share = (stamp_ns - a_ns) as f64 / (b_ns - a_ns) as f64;
                // Opposite turns have no way between them.
                Ok(a.try_lerp_slerp(b, share, 1e-9).unwrap_or(*b))
            }
            (Some((ns, _)), None) => Err(off(stamp_ns - ns, "before")),
            (None, Some((ns, _))) => Err(off(ns - stamp_ns, "after")),
            (None, None) => Err(none()),
        }
    }

    fn listing(&self) -> String {
        let mut known: Vec<&str> = self.branches.iter().flat_map(|(child, branch)| [child.as_str(), branch.parent.as_str()]).collect();
        known.sort_unstable();
        known.dedup();
        let more = known.len().saturating_sub(12);
        known.truncate(12);
        let listed = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
        if more > 0 { format!("{listed} and {more} more") } else { listed }
    }
}

/// A frame's name without the slash that the first ROS put before it.
fn plain(frame: &str) -> &str {
    frame.trim_start_matches('/')
}

/// A transform; none of one whose numbers are no rigid motion.
fn isometry(transform: &Transform) -> Option<Isometry3<f64>> {
    let (t, r) = (&transform.translation, &transform.rotation);
    let turn = Quaternion::new(r.w, r.x, r.y, r.z);
    let good = [t.x, t.y, t.z].iter().all(|v| v.is_finite()) && (turn.norm() - 1.0).abs() < 1e-2;
    good.then(|| Isometry3::from_parts(Translation3::new(t.x, t.y, t.z), UnitQuaternion::from_quaternion(turn)))
}

#[cfg(test)]
mod tests {
    use repose_ros_messages::{Header, Quaternion as RosQuaternion, Time, Vector3};

    use super::*;

    const SECOND: u64 = 1_000_000_000;

    fn told(parent: &str, child: &str, stamp_ns: u64, x: f64, yaw_rad: f64) -> TransformStamped {
        let (z, w) = (yaw_rad / 2.0).sin_cos();
        TransformStamped {
            header: Header { stamp: Time::from_ns(stamp_ns), frame_id: parent.to_owned() },
            child_frame_id: child.to_owned(),
            transform: Transform { translation: Vector3 { x, ..Vector3::default() }, rotation: RosQuaternion { x: 0.0, y: 0.0, z, w } },
        }
    }

    #[test]
    fn a_moving_camera_is_where_it_was_at_the_pictures_instant() {
        let mut tree = Transforms::default();
        assert!(tree.take(&told("world", "base", 0, 1.0, std::f64::consts::FRAC_PI_2), true));
        tree.take(&told("base", "hand", SECOND, 0.0, 0.0), false);
        tree.take(&told("base", "hand", 2 * SECOND, 1.0, 0.0), false);
        tree.take(&told("/hand", "camera", 0, 0.5, 0.0), true);
        let pose = tree.lookup("world", "camera", SECOND + SECOND / 4).expect("a transform");
        // A quarter of the way, and turned a quarter turn with the base.
        assert!((pose.translation.vector - nalgebra::Vector3::new(1.0, 0.75, 0.0)).norm() < 1e-9, "{pose}");
        let back = tree.lookup("camera", "world", SECOND + SECOND / 4).expect("a transform");
        assert!(((back * pose).translation.vector).norm() < 1e-9);
        assert_eq!(tree.lookup("hand", "hand", 5).map(|p| p.translation.vector.norm()), Ok(0.0));
    }

    #[test]
    fn what_is_not_known_is_said_and_nothing_is_guessed() {
        let mut tree = Transforms::default();
        tree.take(&told("world", "camera", SECOND, 0.0, 0.0), false);
        let late = tree.lookup("world", "camera", 3 * SECOND).unwrap_err();
        assert_eq!(late, TransformError::Instant { frame: "camera".to_owned(), ms: 2000, direction: "before" });
        assert!(late.may_come());
        let early = tree.lookup("world", "camera", SECOND / 2).unwrap_err();
        assert!(!early.may_come() && early.to_string().contains("500 ms after"), "{early}");
        assert!(tree.lookup("map", "camera", SECOND).unwrap_err().to_string().contains("\"map\""));
        tree.take(&told("odom", "wheel", SECOND, 0.0, 0.0), false);
        assert!(matches!(tree.lookup("world", "wheel", SECOND), Err(TransformError::Apart { .. })));
        let mut broken = told("world", "camera", 2 * SECOND, 0.0, 0.0);
        broken.transform.rotation.w = f64::NAN;
        assert!(!tree.take(&broken, false));
        // A circle ends.
        tree.take(&told("camera", "world", SECOND, 0.0, 0.0), false);
        let _ = tree.lookup("map", "camera", SECOND);
    }

    #[test]
    fn time_that_begins_anew_begins_frames_anew_and_memory_is_bounded() {
        let mut tree = Transforms::default();
        for second in 0..100 {
            tree.take(&told("world", "camera", second * SECOND, second as f64, 0.0), false);
        }
        assert!(tree.branches["camera"].parent_from_child.len() <= 11);
        tree.take(&told("world", "camera", SECOND, 0.5, 0.0), false);
        assert_eq!(tree.lookup("world", "camera", SECOND).map(|p| p.translation.x), Ok(0.5));
    }

    #[test]
    fn where_a_camera_was_before_its_time_began_anew_is_not_where_it_is() {
        let mut tree = Transforms::default();
        let mut tell = |ms: u64, x: f64| tree.take(&told("world", "camera", ms * SECOND / 1000, x, 0.0), false);
        // A simulation of six seconds, then half a second of the next one.
        assert!((0..60).all(|k| tell(100 * k, 1.0)) && (0..6).all(|k| tell(100 * k, 2.0)));
        assert_eq!(tree.lookup("world", "camera", SECOND / 4).map(|p| p.translation.x), Ok(2.0));
        let yet_to_come = tree.lookup("world", "camera", SECOND).unwrap_err();
        assert!(yet_to_come.may_come(), "{yet_to_come}");
        // One that was overtaken on its way is still of this time.
        tree.take(&told("world", "camera", SECOND, 2.0, 0.0), false);
        tree.take(&told("world", "camera", 3 * SECOND / 4, 2.5, 0.0), false);
        assert_eq!(tree.lookup("world", "camera", 3 * SECOND / 4).map(|p| p.translation.x), Ok(2.5));
        assert!(tree.lookup("world", "camera", SECOND).is_ok());
    }

    #[test]
    fn frames_of_things_that_have_gone_make_room_for_others_and_those_that_are_told_of_stay() {
        let mut tree = Transforms::default();
        tree.take(&told("world", "base", 0, 1.0, 0.0), true);
        let last = FRAMES as u64 + 9;
        for k in 0..=last {
            tree.take(&told("base", "hand", k * SECOND, 0.5, 0.0), false);
            assert!(tree.take(&told("world", &format!("thing_{k}"), k * SECOND, 0.0, 0.0), false), "{k}");
        }
        assert_eq!(tree.branches.len(), FRAMES);
        assert!(tree.lookup("world", "hand", last * SECOND).is_ok() && !tree.is_known("thing_0"));
        assert!(tree.lookup("world", &format!("thing_{last}"), last * SECOND).is_ok());
    }
}
