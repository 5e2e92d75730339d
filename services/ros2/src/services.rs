//! What clients of ROS may ask for: a stop, a placement, a plan and, where the configuration allows it, its execution.

use std::sync::Arc;
use std::time::Duration;

use repose_proto::motion::{ExecuteReply, ExecutionOutcome, MotionPlan, MotionPlanRequest};
use repose_proto::robot::RobotState;
use repose_proto::{CallError, GoalTerm, Message, Payload, PlaceRequest, PlaceResult, Scene, Service};
use repose_ros_messages as ros;
use repose_runtime::{
    CallOptions, Caller, Moves, STATE_WITHIN, Session, UnderWay, emergency_stop, fetch_newest, reaching_robot, robot_state,
};

use crate::config::{RobotConfig, Ros2Config};
use crate::error::BridgeError;
use crate::node::{Node, RosPublisher};
use crate::robot::goal::trajectory;
use crate::show::link::whole;
use crate::show::messages;
use crate::wire::names::Qos;

/// Placements that motion may choose from.
const COUNT: u32 = 5;
/// How long a stop is repeated for a robot to show it.
const STOP: Duration = Duration::from_secs(3);
/// How long an execution may take.
const EXECUTION: Duration = Duration::from_secs(300);

/// What the services work with.
struct Desk {
    session: Session,
    config: Arc<Ros2Config>,
    moves: Moves,
    perception: Caller,
    planner: Caller,
    motion: Caller,
    placements: RosPublisher<ros::PoseArray>,
}

/// Serves until the session closes.
///
/// # Errors
/// When a network refuses.
pub async fn run(session: Session, node: Node, config: Arc<Ros2Config>, moves: Moves) -> Result<(), BridgeError> {
    let desk = Arc::new(Desk {
        perception: session.caller(Service::Perception).await?,
        planner: session.caller(Service::Planner).await?,
        motion: session.caller(Service::Motion).await?,
        placements: node.publisher(&node.own("placements"), "geometry_msgs/msg/PoseArray", Qos::DEFAULT).await?,
        config,
        moves,
        session,
    });
    let mut stops = node.serve::<ros::TriggerRequest, ros::TriggerResponse>(&node.own("stop"), "std_srvs/srv/Trigger").await?;
    let mut places = node.serve::<ros::PlaceRequest, ros::PlaceResponse>(&node.own("place"), "repose_msgs/srv/Place").await?;
    let mut plans = node.serve::<ros::PlanRequest, ros::PlanResponse>(&node.own("plan"), "repose_msgs/srv/Plan").await?;
    loop {
        let desk = desk.clone();
        // Each in a task of its own: a stop waits for nobody.
        tokio::select! {
            biased;
            asked = stops.next() => {
                let Some(asked) = asked else { return Ok(()) };
                tokio::spawn(async move { told(asked.answer(&desk.stop().await).await) });
            }
            asked = places.next() => {
                let Some(asked) = asked else { return Ok(()) };
                tokio::spawn(async move {
                    let response = desk.place(&asked.request).await;
                    told(asked.answer(&response).await);
                });
            }
            asked = plans.next() => {
                let Some(asked) = asked else { return Ok(()) };
                tokio::spawn(async move {
                    let (response, under_way) = desk.plan(&asked.request).await;
                    told(asked.answer(&response).await);
                    // Whoever asked has heard how it ended.
                    drop(under_way);
                });
            }
        }
    }
}

fn told(answered: Result<(), BridgeError>) {
    if let Err(error) = answered {
        tracing::warn!(%error, "an answer could not be sent");
    }
}

/// An error's code as the contract spells it.
fn code_of(error: &BridgeError) -> String {
    match error {
        BridgeError::Call(error) => serde_json::to_value(error.code).ok().and_then(|v| v.as_str().map(str::to_owned)).unwrap_or_default(),
        _ => "unavailable".to_owned(),
    }
}

/// What was planned on what.
struct Placed {
    scene: Scene,
    result: PlaceResult,
    robot: Option<(RobotConfig, RobotState)>,
}

impl Desk {
    /// Stops every robot of the configuration.
    async fn stop(&self) -> ros::TriggerResponse {
        let robots = self.config.robots.iter().map(|robot| self.stop_robot(&robot.name));
        let stopped = futures::future::join_all(robots).await;
        let success = !stopped.is_empty() && stopped.iter().all(Result::is_ok);
        let words: Vec<String> = stopped.into_iter().map(|one| one.unwrap_or_else(|error| error.to_string())).collect();
        let message = if words.is_empty() { "the configuration names no robots".to_owned() } else { words.join("; ") };
        ros::TriggerResponse { success, message }
    }

    /// Stops a robot; in words, that it is stopped.
    async fn stop_robot(&self, robot: &str) -> Result<String, BridgeError> {
        let latched = emergency_stop(&self.session, robot, "ros2", "a client called the stop service");
        let silent = |_| CallError::precondition(format!("{robot} was told to stop and has not shown that it did")).at("robot");
        tokio::time::timeout(STOP, latched).await.map_err(silent)??;
        Ok(format!("{robot} is stopped"))
    }

    async fn place(&self, asked: &ros::PlaceRequest) -> ros::PlaceResponse {
        let placed = match self.placed(&asked.camera, (asked.object, &asked.goal), asked.count.max(1), asked.seed).await {
            Ok(placed) => placed,
            Err(error) => return ros::PlaceResponse { code: code_of(&error), message: error.to_string(), ..Default::default() },
        };
        let Placed { scene, result, .. } = placed;
        let header = messages::header(&messages::frame_of(&self.config.world_frame, &scene), scene.stamp_ns);
        let found = !result.placements.is_empty();
        let mut response = ros::PlaceResponse {
            success: found,
            code: if found { String::new() } else { "none".to_owned() },
            message: if found { String::new() } else { format!("no placement: {:?}", result.rejections) },
            header: header.clone(),
            scene_id: result.scene_id,
            ..Default::default()
        };
        for placement in &result.placements {
            let Some((motion, transform)) = messages::transform(&placement.placed_from_observed) else { continue };
            let Some(object) = scene.object(asked.object) else { continue };
            response.placed_from_observed.push(transform);
            response.poses.push(messages::moved(&motion, transform.rotation, object));
            response.success_probability.push(placement.success.unwrap_or(f64::NAN));
        }
        told(self.placements.publish(&ros::PoseArray { header, poses: response.poses.clone() }).await);
        response
    }

    /// A plan, and its execution where that is asked for, which is under way until it is answered.
    async fn plan(&self, asked: &ros::PlanRequest) -> (ros::PlanResponse, Option<UnderWay>) {
        let failed = |error: BridgeError| ros::PlanResponse { code: code_of(&error), message: error.to_string(), ..Default::default() };
        if !asked.execute {
            let planned = self.planned(asked).await;
            return (planned.map_or_else(failed, |(plan, robot)| described(&plan, &robot)), None);
        }
        match self.begin(asked) {
            Ok(under_way) => (self.executed(asked).await.unwrap_or_else(failed), Some(under_way)),
            Err(refusal) => (failed(refusal.into()), None),
        }
    }

    /// Begins an execution.
    fn begin(&self, asked: &ros::PlanRequest) -> Result<UnderWay, CallError> {
        if !self.config.allow_execute {
            return Err(CallError::precondition("this bridge's configuration does not allow it: [ros2] allow_execute").at("execute"));
        }
        self.moves.begin(format!("object {} to {}, for a client of ROS", asked.object, asked.goal.join(" and ")))
    }

    /// A plan that is carried out; an error where nothing has moved.
    async fn executed(&self, asked: &ros::PlanRequest) -> Result<ros::PlanResponse, BridgeError> {
        let (plan, robot) = tokio::select! {
            biased;
            refusal = self.moves.refused() => return Err(refusal.into()),
            planned = self.planned(asked) => planned?,
        };
        let (success, code, message) = match self.execute(&plan).await {
            Ok(ExecuteReply { outcome: ExecutionOutcome::Done, .. }) => (true, String::new(), String::new()),
            Ok(reply) => {
                let outcome = serde_json::to_value(reply.outcome).ok().and_then(|v| v.as_str().map(str::to_owned));
                (false, outcome.unwrap_or_default(), format!("{}: {}", reply.phase, reply.reason.unwrap_or_default()))
            }
            Err(error) => (false, code_of(&error), error.to_string()),
        };
        Ok(ros::PlanResponse { success, executed: success, code, message, ..described(&plan, &robot) })
    }

    async fn planned(&self, asked: &ros::PlanRequest) -> Result<(MotionPlan, RobotConfig), BridgeError> {
        let placed = self.placed(&asked.camera, (asked.object, &asked.goal), COUNT, asked.seed).await?;
        let Some((robot, state)) = placed.robot else { return Err(CallError::precondition("the configuration names no robots").into()) };
        if placed.result.placements.is_empty() {
            let message = format!("no placement: {:?}", placed.result.rejections);
            return Err(CallError::precondition(message).at("goal").into());
        }
        let motions = placed.result.placements.iter().map(|p| p.placed_from_observed).collect();
        let mut request = MotionPlanRequest::new(placed.result.scene_id, robot.name.clone(), asked.object, motions, state.q_rad);
        request.seed = asked.seed;
        let payload = Payload::with_scene(&request, Some(&placed.scene))?;
        let answer = self.motion.call("plan", payload, CallOptions::within(self.deadline())).await?;
        Ok((answer.payload.decode_json()?, robot))
    }

    /// Has a plan carried out, until this bridge can wait no longer: then the arm comes to rest.
    async fn execute(&self, plan: &MotionPlan) -> Result<ExecuteReply, BridgeError> {
        let options = CallOptions::at_most_once(EXECUTION);
        let answer = self.moves.call(&self.session, &self.motion, "execute", Payload::json(plan)?, options).await?;
        Ok(answer.payload.decode_json()?)
    }

    /// A placement on the newest scene of a camera.
    async fn placed(&self, camera: &str, (object, goal): (u16, &[String]), count: u32, seed: u64) -> Result<Placed, BridgeError> {
        let goal = goal.iter().map(|term| term.parse::<GoalTerm>()).collect::<Result<Vec<_>, _>>()?;
        let camera = match (camera, self.config.cameras.first()) {
            ("", Some(first)) => &first.name,
            ("", None) => return Err(CallError::invalid("camera", "the configuration names no cameras").into()),
            (named, _) => named,
        };
        repose_proto::keys::validate_chunk("camera", camera)?;
        let summary = fetch_newest(&self.perception, camera, &CallOptions::within(self.deadline())).await?;
        let scene = whole(&self.perception, &summary.scene_id).await?;
        let robot = match self.config.robots.first() {
            Some(robot) => Some((robot.clone(), robot_state(&self.session, &robot.name, STATE_WITHIN.min(self.deadline())).await?)),
            None => None,
        };
        let reach = robot.as_ref().and_then(|(robot, state)| reaching_robot(&robot.name, state));
        let request = PlaceRequest { count, seed, robot: reach, ..PlaceRequest::new(summary.scene_id, object, goal) };
        request.validate()?;
        let (result, _) = self.planner.place(&request, Some(&scene), CallOptions::within(self.deadline())).await?;
        Ok(Placed { scene, result, robot })
    }

    fn deadline(&self) -> Duration {
        Duration::from_millis(self.config.request_deadline_ms)
    }
}

/// A plan as one trajectory, with when its phases begin.
fn described(plan: &MotionPlan, robot: &RobotConfig) -> ros::PlanResponse {
    let mut response = ros::PlanResponse {
        success: true,
        scene_id: plan.scene_id.clone(),
        placement: plan.placement as u32,
        trajectory: trajectory(&robot.joints, &[], 0.0),
        ..Default::default()
    };
    let mut start_ms = 0.0;
    for phase in &plan.phases {
        response.phases.push(phase.name.as_str().to_owned());
        response.phase_starts_s.push(start_ms * 1e-3);
        // A stretch begins where the one before ends, and the first where the arm stands.
        let points = trajectory(&robot.joints, &phase.set_points, -start_ms).points;
        response.trajectory.points.extend(points.into_iter().skip(1));
        start_ms += phase.set_points.last().map_or(0.0, |p| p.t_ms);
    }
    response
}
