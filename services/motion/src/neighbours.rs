//! The other robots of the cell. Perception takes every robot out of the scene, so no picture shows them to motion: they are where they say.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use nalgebra::{Isometry3, Translation3, Vector3};
use repose_geometry::transform::from_row_major;
use repose_panda::{JOINT_COUNT, Joints, LinkFrames, base_from_tcp, visible_spheres_in_base};
use repose_proto::followed_robots::{MAX_ROBOTS, SAME_BASE_M, SILENT};
use repose_proto::motion::MotionPlan;
use repose_proto::robot::{RobotMode, RobotState};
use repose_proto::{CallError, Scene, keys};
use repose_runtime::{RuntimeError, Session, read_robot_mode};
use tokio::task::JoinSet;

use crate::execution::keep_out::{Zones, check_carried};
use crate::execution::{check_base, check_unmoved};
use crate::obstacles::ObstacleShape;

/// States that wait to be read: hundreds of milliseconds of a few robots that tell theirs a thousand times a second.
const WAITING: usize = 1024;
/// Bases farther apart than this are of robots that cannot meet, metres: twice an arm's reach with what it holds.
const FAR_M: f64 = 2.5;
/// Parts of another robot that are farther than this from a robot's base cannot be met, metres.
const BEYOND_M: f64 = 1.3;
/// Between two looks at the others while a robot moves: less than between two of their states.
const LOOK: Duration = Duration::from_millis(10);
/// A robot whose joints are all within this of where they were has not moved, radians: at the end of an arm that is a centimetre, less than what
/// planning keeps away from it.
const MOVED_RAD: f64 = 0.01;
/// What planning keeps away from another robot beside all that it keeps away from the scene, metres: bases are known to a centimetre or two.
const ROOM_M: f64 = 0.03;

/// How robots stand, by their names.
pub type Stances = BTreeMap<String, Joints>;

/// What a robot has told last, and when.
struct LastState {
    state: RobotState,
    heard: Instant,
}

/// A robot beside another.
struct Neighbour {
    name: String,
    state: RobotState,
    heard: Instant,
    world_from_base: Isometry3<f64>,
}

/// What the robots of a cell have told last.
pub struct Neighbours {
    world_from_base: Isometry3<f64>,
    told: Arc<Mutex<BTreeMap<String, LastState>>>,
    _following: JoinSet<()>,
}

impl Neighbours {
    /// Follows all robots of the cell; `world_from_base` is where the robot stands that motions are planned for.
    ///
    /// # Errors
    /// When the network refuses.
    pub async fn follow(session: &Session, world_from_base: Isometry3<f64>) -> Result<Self, RuntimeError> {
        let mut states = session.subscribe_queue(&session.cell().robot_states(), WAITING).await?;
        let told: Arc<Mutex<BTreeMap<String, LastState>>> = Arc::default();
        let mut following = JoinSet::new();
        let heard = told.clone();
        following.spawn(async move {
            while let Some(sample) = states.recv().await {
                // Also beside a number that no robot can have: without it this arm would count as standing where it was told last.
                let (Some(robot), Ok(state)) = (keys::worker_of(&sample.key), read_robot_mode(&sample)) else { continue };
                let last = LastState { state, heard: Instant::now() };
                keep(&mut heard.lock().unwrap_or_else(PoisonError::into_inner), robot, last, &world_from_base);
            }
        });
        Ok(Self { world_from_base, told, _following: following })
    }

    /// What the robots beside one fill, with room for errors of their bases.
    pub fn solids(&self, robot: &str) -> Vec<ObstacleShape> {
        self.beside(robot).iter().flat_map(|neighbour| neighbour.solids(&self.world_from_base, ROOM_M)).collect()
    }

    /// Checks that a robot that tells where its base stands has it where this worker plans for. A plan does not say for which base it was made, so a
    /// worker that plans for the robot's true base would carry it out.
    ///
    /// # Errors
    /// Those of [`check_base`].
    pub fn check_base_of(&self, robot: &str) -> Result<(), CallError> {
        let told = self.told.lock().unwrap_or_else(PoisonError::into_inner);
        told.get(robot).map_or(Ok(()), |last| check_base(&last.state, &self.world_from_base))
    }

    /// Checks that the robots beside one stand still, without a task.
    ///
    /// # Errors
    /// `failed_precondition` on `robot` at the first that does not.
    pub fn check_still(&self, robot: &str) -> Result<(), CallError> {
        let is_busy = |neighbour: &&Neighbour| neighbour.state.mode == RobotMode::Moving || neighbour.state.open_task().is_some();
        self.beside(robot).iter().find(is_busy).map_or(Ok(()), |busy| Err(CallError::precondition(busy.doing()).at("robot")))
    }

    /// Checks that no robot beside one has taken or put something since a scene was seen: what it then shows of the cell is not there any more, for any
    /// robot that can reach it.
    ///
    /// # Errors
    /// Those of [`check_unmoved`].
    pub fn check_unmoved(&self, robot: &str, scene_stamp_ns: u64) -> Result<(), CallError> {
        self.beside(robot)
            .iter()
            .try_for_each(|neighbour| check_unmoved(scene_stamp_ns, &format!("robot {}", neighbour.name), &neighbour.state))
    }

    /// How the robots beside one stand, by their names.
    pub fn stances(&self, robot: &str) -> Stances {
        self.beside(robot).into_iter().map(|neighbour| (neighbour.name, neighbour.state.q_rad)).collect()
    }

    /// Checks that the robots beside one stand still, where they stood when a way around them was planned or checked: while it waited for its turn,
    /// and was looked for, another may have moved and come to rest on it.
    ///
    /// # Errors
    /// As [`Neighbours::check_still`], and where one stands elsewhere.
    pub fn check_stances(&self, robot: &str, stood: &Stances) -> Result<(), CallError> {
        self.check_still(robot)?;
        let near = |a: &Joints, b: &Joints| (0..JOINT_COUNT).all(|i| (a[i] - b[i]).abs() <= MOVED_RAD);
        let has_moved = |neighbour: &&Neighbour| stood.get(&neighbour.name).is_none_or(|q_rad| !near(q_rad, &neighbour.state.q_rad));
        self.beside(robot).iter().find(has_moved).map_or(Ok(()), |moved| {
            let message = format!("robot {} has moved within reach since the way around it was planned or checked: ask again", moved.name);
            Err(CallError::precondition(message).at("robot"))
        })
    }

    /// Waits until a robot beside one does something, or stands elsewhere than where it stood when the way around it was checked: until
    /// [`Neighbours::check_stances`] fails, and how. Robots that begin at the same moment pass [`Neighbours::check_still`] both, for neither has told
    /// yet that it has begun; and whoever else moves one does not ask here: a person who guides it by hand has it neither move by its own word nor
    /// have a task.
    pub async fn begun_beside(&self, robot: &str, stood: &Stances) -> CallError {
        let mut looks = tokio::time::interval(LOOK);
        loop {
            looks.tick().await;
            if let Err(begun) = self.check_stances(robot, stood) {
                return begun;
            }
        }
    }

    /// Checks a plan against the robots beside its own, where they stand now.
    ///
    /// # Errors
    /// As [`Neighbours::check_still`] and [`Neighbours::check_unmoved`], and where the plan would touch one, or carries nobody knows what beside one;
    /// those of [`Zones::check`].
    pub fn check(&self, plan: &MotionPlan, scene: Option<&Scene>, go_on: &dyn Fn() -> Result<(), CallError>) -> Result<(), CallError> {
        self.check_still(&plan.robot)?;
        self.check_unmoved(&plan.robot, plan.scene_stamp_ns)?;
        self.beside(&plan.robot).iter().try_for_each(|neighbour| {
            check_carried(plan, scene)?;
            let solids = neighbour.solids(&self.world_from_base, 0.0);
            let of_robot = Some(neighbour.name.as_str());
            Zones { world_from_base: &self.world_from_base, solids: &solids, of_robot }.check(plan, scene, go_on)
        })
    }

    /// The robots that could meet one, by their names.
    fn beside(&self, robot: &str) -> Vec<Neighbour> {
        let told = self.told.lock().unwrap_or_else(PoisonError::into_inner);
        let near = |(name, LastState { state, heard }): (&String, &LastState)| {
            let world_from_base = base_within_reach(state, &self.world_from_base)?;
            Some(Neighbour { name: name.clone(), state: state.clone(), heard: *heard, world_from_base })
        };
        told.iter().filter(|(name, _)| *name != robot).filter_map(near).collect()
    }
}

/// Keeps what a robot has told. One that has fallen silent goes where another tells that it stands there: it is that arm under the name that it had
/// before, and as that it would stand in the way for as long as this process runs. Where there are as many as are followed, one that cannot be met makes
/// room: the robots of a large hall must not keep out the one that stands beside.
fn keep(told: &mut BTreeMap<String, LastState>, robot: &str, last: LastState, world_from_base: &Isometry3<f64>) {
    let base = base_of(&last.state);
    told.retain(|name, before| {
        let is_silent = last.heard.saturating_duration_since(before.heard) > SILENT;
        let stands_there = || {
            let apart_m = |(a, b): (Isometry3<f64>, Isometry3<f64>)| (a.translation.vector - b.translation.vector).norm();
            base.zip(base_of(&before.state)).map(apart_m).is_some_and(|apart_m| apart_m < SAME_BASE_M)
        };
        name == robot || !is_silent || !stands_there()
    });
    if told.len() >= MAX_ROBOTS && !told.contains_key(robot) {
        let cannot_be_met = |(_, last): &(&String, &LastState)| base_within_reach(&last.state, world_from_base).is_none();
        let Some(far) = told.iter().find(cannot_be_met).map(|(name, _)| name.clone()) else { return };
        told.remove(&far);
    }
    told.insert(robot.to_owned(), last);
}

/// Where a robot's base stands; none where it does not tell.
fn base_of(state: &RobotState) -> Option<Isometry3<f64>> {
    from_row_major(&state.world_from_base.as_ref()?.0).ok()
}

/// Where the base of a robot stands that one at another base could meet; none where it could not, and where it does not tell.
fn base_within_reach(state: &RobotState, from: &Isometry3<f64>) -> Option<Isometry3<f64>> {
    let world_from_base = base_of(state)?;
    let apart_m = (world_from_base.translation.vector - from.translation.vector).norm();
    (SAME_BASE_M..FAR_M).contains(&apart_m).then_some(world_from_base)
}

impl Neighbour {
    /// What is to be said of one that moves or has a task. One whose driver has died in the midst of that stays so, for nobody knows where it stands,
    /// and one that was stopped in the midst of its task has it until somebody clears the stop: then that is what a person has to know.
    fn doing(&self) -> String {
        let (name, silent) = (&self.name, self.heard.elapsed());
        if silent > SILENT {
            let silent_s = silent.as_secs();
            return format!(
                "robot {name} stands within reach and was doing something when it was last heard of, {silent_s} s ago: nothing moves beside it \
                 until its driver tells that it stands"
            );
        }
        if self.state.mode == RobotMode::Stopped {
            return format!(
                "robot {name} stands within reach and was stopped in the midst of a task: nothing moves beside it until its stop is cleared \
                 (`repose robot reset --robot {name}`)"
            );
        }
        format!("robot {name} stands within reach and is doing something: one of them moves at a time")
    }

    /// The arm, its hand and what it holds, as far as another can come to them, each larger by as much.
    fn solids(&self, other_base: &Isometry3<f64>, room_m: f64) -> Vec<ObstacleShape> {
        let spheres = visible_spheres_in_base(&LinkFrames::at(&self.state.q_rad), self.state.gripper_width_m);
        let balls = spheres.iter().map(|sphere| (self.world_from_base * sphere.center, sphere.radius_m));
        let met = balls.filter(|(center, radius_m)| (center.coords - other_base.translation.vector).norm() < BEYOND_M + radius_m);
        let arm = met.map(|(center, radius_m)| ObstacleShape::ball(center, radius_m + room_m));
        let held = self.state.held.as_ref().map(|held| {
            let (low, high) = (Vector3::from(held.low_m), Vector3::from(held.high_m));
            let world_from_middle = self.world_from_base * base_from_tcp(&self.state.q_rad) * Translation3::from((low + high) / 2.0);
            ObstacleShape::cuboid(world_from_middle, high - low + Vector3::repeat(2.0 * room_m))
        });
        arm.chain(held).collect()
    }
}

#[cfg(test)]
mod tests {
    use repose_panda::READY;
    use repose_proto::robot::TaskState;
    use repose_proto::{ErrorCode, Payload, RigidTransform};
    use repose_runtime::Traffic;
    use serde_json::json;

    use super::*;

    /// A robot that stands there, at a height above the floor that it shares with another.
    fn standing(at_m: [f64; 2], mode: &str) -> RobotState {
        let still = [0.0; 7];
        let base = RigidTransform([1.0, 0.0, 0.0, at_m[0], 0.0, 1.0, 0.0, at_m[1], 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]);
        serde_json::from_value(json!({"v": 1, "seq": 1, "stamp_ns": 1, "robot_ms": 0.0, "q_rad": READY, "dq_rad_s": still,
            "gripper_width_m": 0.04, "gripper_settled": true, "gripper_holding": false, "mode": mode, "world_from_base": base}))
        .expect("a state")
    }

    async fn beside(states: &[(&str, RobotState)]) -> Neighbours {
        let session = Session::embedded().await.expect("a session");
        let neighbours = Neighbours::follow(&session, Isometry3::identity()).await.expect("followed");
        for (robot, state) in states {
            let told = session.publisher(session.cell().robot_state(robot), Traffic::RobotState);
            told.put(Payload::json(state).expect("a payload")).await.expect("put");
        }
        let all_told = || neighbours.told.lock().expect("what was told").len() == states.len();
        tokio::time::timeout(Duration::from_secs(10), async {
            while !all_told() {
                tokio::time::sleep(Duration::from_millis(5)).await;
            }
        })
        .await
        .expect("they are heard");
        neighbours
    }

    #[test]
    fn the_robots_of_a_large_hall_do_not_keep_out_the_one_that_stands_beside() {
        let (mut told, base) = (BTreeMap::new(), Isometry3::identity());
        let mut tell = |robot: String, at_m: [f64; 2]| {
            keep(&mut told, &robot, LastState { state: standing(at_m, "idle"), heard: Instant::now() }, &base);
            (told.len(), told.contains_key(&robot))
        };
        for k in 1..=MAX_ROBOTS {
            assert_eq!(tell(format!("far-{k}"), [3.0 * k as f64, 0.0]), (k, true));
        }
        for k in 0..MAX_ROBOTS {
            assert_eq!(tell(format!("beside-{k}"), [0.0, 0.9]), (MAX_ROBOTS, true));
        }
        assert_eq!(tell("far-99".to_owned(), [99.0, 0.0]), (MAX_ROBOTS, false), "it cannot be met, and all the others can");
        assert_eq!(tell("beside-3".to_owned(), [0.0, 1.0]), (MAX_ROBOTS, true));
    }

    #[test]
    fn an_arm_that_has_another_name_since_does_not_stand_in_the_way_of_itself() {
        let (mut told, own, start) = (BTreeMap::new(), Isometry3::identity(), Instant::now());
        let mut tell = |robot: &str, at_m: [f64; 2], since: Duration| {
            keep(&mut told, robot, LastState { state: standing(at_m, "moving"), heard: start + since }, &own);
            told.keys().cloned().collect::<Vec<_>>()
        };
        tell("other", [0.0, 0.9], Duration::ZERO);
        tell("panda", [0.9, 0.0], Duration::ZERO);
        // Two drivers that both live may have one of the bases wrong.
        assert_eq!(tell("right", [0.91, 0.0], SILENT / 2), ["other", "panda", "right"]);
        assert_eq!(tell("right", [0.91, 0.0], 2 * SILENT), ["other", "right"], "the other's driver has died, and its arm is still there");
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn robots_within_reach_are_in_the_way_and_others_are_not() {
        let far = standing([3.0, 0.0], "moving");
        let same = standing([0.05, 0.0], "moving");
        let neighbours = beside(&[("own", standing([0.0, 0.0], "idle")), ("far", far), ("same", same)]).await;
        assert!(neighbours.solids("own").is_empty() && neighbours.check_still("own").is_ok());

        let across = standing([0.9, 0.0], "idle");
        let neighbours = beside(&[("own", standing([0.0, 0.0], "idle")), ("across", across.clone())]).await;
        let solids = neighbours.solids("own");
        // It faces away: its foot is the nearest, 90 cm off less its own size.
        let nearest_m = solids.iter().map(|solid| solid.distance_m(&nalgebra::Point3::origin())).fold(f64::INFINITY, f64::min);
        assert!((0.6..0.9).contains(&nearest_m), "{nearest_m}");
        assert!(neighbours.check_still("own").is_ok());

        let task = TaskState { id: Some("t".to_owned()) };
        let stood = neighbours.stances("own");
        assert_eq!(neighbours.check_stances("own", &stood), Ok(()));
        let mut elsewhere = across.clone();
        elsewhere.q_rad[0] += 1.0;
        for (meanwhile, stood) in [(elsewhere, &stood), (across.clone(), &Stances::new())] {
            let refused = beside(&[("across", meanwhile)]).await.check_stances("own", stood).expect_err("it has moved, or come");
            assert!(refused.field.as_deref() == Some("robot") && refused.message.contains("across has moved"), "{refused}");
        }

        for busy in [standing([0.9, 0.0], "moving"), RobotState { task: Some(task), ..across }] {
            let neighbours = beside(&[("across", busy)]).await;
            let refused = neighbours.check_still("own").expect_err("it is doing something");
            assert!(refused.field.as_deref() == Some("robot") && refused.message.contains("across"), "{refused}");
            assert!(!refused.message.contains("last heard"), "{refused}");
            for last in neighbours.told.lock().expect("what was told").values_mut() {
                last.heard = last.heard.checked_sub(7 * SILENT).expect("this machine has run for longer");
            }
            let refused = neighbours.check_still("own").expect_err("nobody knows where it stands");
            assert!(refused.message.contains("was doing something when it was last heard of, 14 s ago"), "{refused}");
        }
        let stopped = RobotState { task: Some(TaskState { id: Some("t".to_owned()) }), ..standing([0.9, 0.0], "stopped") };
        let refused = beside(&[("across", stopped)]).await.check_still("own").expect_err("its task is open");
        assert!(refused.message.contains("stopped in the midst of a task"), "{refused}");
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn what_a_robot_beside_has_taken_or_put_is_not_where_a_scene_of_before_shows_it() {
        const SECOND_NS: u64 = 1_000_000_000;
        let handled = |at_m| RobotState { stamp_ns: 100 * SECOND_NS, since_handling_ms: Some(5_000), ..standing(at_m, "idle") };
        let own = standing([0.0, 0.0], "idle");
        let neighbours = beside(&[("own", own.clone()), ("across", handled([0.9, 0.0]))]).await;
        let refused = neighbours.check_unmoved("own", 80 * SECOND_NS).expect_err("it was seen before that");
        assert_eq!((refused.code, refused.field.as_deref()), (ErrorCode::FailedPrecondition, Some("scene_stamp_ns")));
        assert!(refused.message.contains("robot across has taken or put something 15000 ms after"), "{refused}");
        assert_eq!(neighbours.check_unmoved("own", 96 * SECOND_NS), Ok(()), "it was seen after that");
        assert_eq!(neighbours.check_unmoved("across", 80 * SECOND_NS), Ok(()), "its own is judged where it is told");
        let far = beside(&[("own", own), ("far", handled([3.0, 0.0]))]).await;
        assert_eq!(far.check_unmoved("own", 80 * SECOND_NS), Ok(()));
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_robot_that_stands_elsewhere_is_not_planned_for() {
        let neighbours = beside(&[("own", standing([0.0, 0.0], "idle")), ("across", standing([0.9, 0.0], "idle"))]).await;
        assert_eq!((neighbours.check_base_of("own"), neighbours.check_base_of("unknown")), (Ok(()), Ok(())));
        let refused = neighbours.check_base_of("across").expect_err("it is another worker's");
        assert!(refused.field.as_deref() == Some("robot") && refused.message.contains("900.0 mm"), "{refused}");
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn an_arm_that_moves_is_noticed_though_its_hand_tells_a_width_that_none_has() {
        let moving = RobotState { gripper_width_m: -1.0, ..standing([0.9, 0.0], "moving") };
        let refused = beside(&[("across", moving)]).await.check_still("own").expect_err("it moves");
        assert!(refused.message.contains("across"), "{refused}");
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn an_arm_that_somebody_guides_by_hand_has_begun_to_do_something() {
        let neighbours = beside(&[("across", standing([0.9, 0.0], "stopped"))]).await;
        let stood = neighbours.stances("own");
        let begun = neighbours.begun_beside("own", &stood);
        let guided = async {
            for last in neighbours.told.lock().expect("what was told").values_mut() {
                last.state.q_rad[0] += 0.1;
            }
        };
        let watched = async { tokio::join!(begun, guided).0 };
        let begun = tokio::time::timeout(Duration::from_secs(10), watched).await.expect("it is noticed");
        assert!(begun.message.contains("across has moved"), "{begun}");
    }
}
