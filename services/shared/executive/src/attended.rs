//! A robot at which nobody else has been meanwhile. Between two moves of a run seconds go by, in which a person may stop it, reach in and reset it: what
//! began before that does not go on by itself.

use std::time::Duration;

use repose_proto::motion::MotionPlan;
use repose_proto::robot::{Owner, RobotState};
use repose_proto::{CallError, Payload, Scene, SceneSummary};
use repose_runtime::{Answer, Caller};

use crate::site::{MoveStage, Site};

/// A site whose robot moves only as long as all that it was commanded was commanded from here.
pub(crate) struct Attended<S> {
    site: S,
    /// Who commanded the robot last, when this run knew it last; a reset, too, is a command, of a new owner. None where the robot did not say.
    known: Option<Option<Owner>>,
    /// Whether this run has commanded the robot. Then whatever it does not know of since may have been a person's doing.
    has_commanded: bool,
}

impl<S: Site> Attended<S> {
    /// From now on.
    pub(crate) async fn from_now(site: S) -> Self {
        let known = owner(&site).await;
        Self { site, known, has_commanded: false }
    }

    async fn check(&self) -> Result<(), CallError> {
        let why = match &self.known {
            None if !self.has_commanded => return Ok(()),
            None => {
                "the robot has told no state since the last move, and somebody else may have commanded it: a person decides how to go on"
            }
            Some(known) => {
                if self.site.state().await?.owner == *known {
                    return Ok(());
                }
                "somebody has stopped and reset the robot, or commanded it, since the last move: a person decides how to go on"
            }
        };
        Err(CallError::precondition(why).at("robot"))
    }
}

/// Who commanded a robot last, where it says.
async fn owner(site: &impl Site) -> Option<Option<Owner>> {
    site.state().await.ok().map(|state| state.owner)
}

impl<S: Site> Site for Attended<S> {
    fn robot(&self) -> &str {
        self.site.robot()
    }

    fn camera(&self) -> &str {
        self.site.camera()
    }

    fn planner(&self) -> &Caller {
        self.site.planner()
    }

    fn motion(&self) -> &Caller {
        self.site.motion()
    }

    fn deadline(&self) -> Duration {
        self.site.deadline()
    }

    async fn newest(&self) -> Result<SceneSummary, CallError> {
        self.site.newest().await
    }

    async fn scene(&self, scene_id: &str) -> Result<Scene, CallError> {
        self.site.scene(scene_id).await
    }

    async fn state(&self) -> Result<RobotState, CallError> {
        self.site.state().await
    }

    async fn moving(&mut self, method: &str, payload: Payload, plan: Option<&MotionPlan>) -> Result<Answer, CallError> {
        self.check().await?;
        let answer = self.site.moving(method, payload, plan).await;
        // Also after an error: the robot may have been commanded all the same.
        self.has_commanded = true;
        self.known = owner(&self.site).await;
        answer
    }

    fn begins(&self, stage: MoveStage) {
        self.site.begins(stage);
    }

    fn planned(&self, plan: &MotionPlan) {
        self.site.planned(plan);
    }

    fn goes_on(&self) -> bool {
        self.site.goes_on()
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::sync::{Arc, Mutex, PoisonError};

    use repose_proto::motion::RecoveryMove;
    use repose_proto::{ErrorCode, Service};
    use repose_runtime::Session;
    use serde_json::json;

    use super::*;
    use crate::site::AskedRecovery;

    /// A robot that only counts who commanded it how often.
    struct Counted {
        caller: Caller,
        commands: Arc<Mutex<u64>>,
        is_silent: Arc<AtomicBool>,
    }

    impl Counted {
        async fn new(session: &Session) -> Self {
            let caller = session.caller(Service::Motion).await.expect("a caller");
            Self { caller, commands: Arc::default(), is_silent: Arc::default() }
        }
    }

    impl Site for Counted {
        fn robot(&self) -> &str {
            "panda"
        }

        fn camera(&self) -> &str {
            "front"
        }

        fn planner(&self) -> &Caller {
            &self.caller
        }

        fn motion(&self) -> &Caller {
            &self.caller
        }

        fn deadline(&self) -> Duration {
            Duration::from_secs(1)
        }

        async fn newest(&self) -> Result<SceneSummary, CallError> {
            Err(CallError::not_found("scene", "nothing is seen here"))
        }

        async fn scene(&self, _: &str) -> Result<Scene, CallError> {
            Err(CallError::not_found("scene", "nothing is seen here"))
        }

        async fn state(&self) -> Result<RobotState, CallError> {
            if self.is_silent.load(Ordering::Relaxed) {
                return Err(CallError::new(ErrorCode::Unavailable, "the robot does not tell its state"));
            }
            let epoch = *self.commands.lock().unwrap_or_else(PoisonError::into_inner);
            let owner = (epoch > 0).then(|| json!({"id": "motion", "epoch": epoch}));
            let still = [0.0; 7];
            let state = json!({"v": 1, "seq": 1, "stamp_ns": 1, "robot_ms": 0.0, "q_rad": still, "dq_rad_s": still, "owner": owner,
                "gripper_width_m": 0.04, "gripper_settled": true, "gripper_holding": false, "mode": "idle"});
            serde_json::from_value(state).map_err(|e| CallError::internal(e.to_string()))
        }

        async fn moving(&mut self, method: &str, _: Payload, _: Option<&MotionPlan>) -> Result<Answer, CallError> {
            *self.commands.lock().unwrap_or_else(PoisonError::into_inner) += 1;
            Err(CallError::internal(format!("{method}: it has moved")))
        }
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_robot_that_a_person_has_reset_between_two_moves_is_not_moved_on() {
        let session = Session::embedded().await.expect("a session");
        let counted = Counted::new(&session).await;
        let commands = counted.commands.clone();
        let mut site = Attended::from_now(counted).await;
        let mut moving = async || {
            let payload = AskedRecovery::new("panda", RecoveryMove::Open, None).and_then(|open| open.by_id()).expect("a payload");
            site.moving("recover", payload, None).await.expect_err("it says that it has moved")
        };
        for _ in 0..2 {
            assert_eq!(moving().await.code, ErrorCode::Internal, "what this run itself has commanded is no reason");
        }
        // A person stops it, and clears the stop.
        *commands.lock().expect("the commands") += 1;
        let refused = moving().await;
        assert_eq!((refused.code, refused.field.as_deref()), (ErrorCode::FailedPrecondition, Some("robot")), "{refused}");
        assert_eq!(*commands.lock().expect("the commands"), 3, "nothing has moved");
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_robot_that_told_nothing_after_a_move_is_not_moved_on() {
        let session = Session::embedded().await.expect("a session");
        let counted = Counted::new(&session).await;
        let (commands, is_silent) = (counted.commands.clone(), counted.is_silent.clone());
        is_silent.store(true, Ordering::Relaxed);
        let mut site = Attended::from_now(counted).await;
        let mut moving = async || {
            let payload = AskedRecovery::new("panda", RecoveryMove::Open, None).and_then(|open| open.by_id()).expect("a payload");
            site.moving("recover", payload, None).await.expect_err("it says that it has moved")
        };
        assert_eq!(moving().await.code, ErrorCode::Internal, "before its first move there is nothing that went on");
        // Whoever was at it meanwhile, this run has not seen whether the robot was its own before.
        is_silent.store(false, Ordering::Relaxed);
        let refused = moving().await;
        assert_eq!((refused.code, refused.field.as_deref()), (ErrorCode::FailedPrecondition, Some("robot")), "{refused}");
        assert_eq!(*commands.lock().expect("the commands"), 1, "nothing has moved");
    }
}
