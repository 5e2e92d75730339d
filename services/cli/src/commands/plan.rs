//! `repose plan`: one placement on a frame folder, without a running system.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::Args;
use repose_evaluation::report::written::{FileError, can_write, write_picture};
use repose_local::picture::before_and_after;
use repose_local::{LocalModels, ModelFiles};
use repose_proto::motion::{Grasp, MotionPlan, MotionPlanRequest};
use repose_proto::place::ReachingRobot;
use repose_proto::{Frame, PlaceRequest, PlaceResult, RobotInView, Scene};
use repose_sentences::placement::center_of;

use crate::answer::print_result;
use crate::embedded::NetworkArgs;
use crate::failure::{CommandResult, Failure};
use crate::frames;
use crate::moving::of_motion;
use crate::output::Output;
use crate::values::parse_png;
use crate::wish::WishArgs;

/// Arguments of `plan`.
#[derive(Debug, Args)]
pub struct PlanArgs {
    /// A frame folder, or any source that `play` accepts, whose first frame is used.
    pub frame: PathBuf,
    /// What is wished for.
    #[command(flatten)]
    pub wish: WishArgs,
    /// Which networks.
    #[command(flatten)]
    pub networks: NetworkArgs,
    /// Segment the frame even if it has labels.
    #[arg(long)]
    pub ignore_labels: bool,
    /// Write a picture of the frame with object ids and the planned placement.
    #[arg(long, value_name = "PNG", value_parser = parse_png)]
    pub out: Option<PathBuf>,
    /// Also plan the pick-and-place motion, from the joints and the base of the robot in the frame's `robot.json` (of several, the one that --reach-of
    /// names, or else the first), and write it here as a `MotionPlan`. With --count, motion planning chooses among several placements.
    #[arg(long, value_name = "JSON")]
    pub motion: Option<PathBuf>,
    /// Grasps for --motion, tried in order instead of the built-in ones: a list of `{"world_from_tcp": [16 numbers], "width_m": 0.06,
    /// "score": 0.9}`. scripts/graspnet.py converts a grasp network's poses.
    #[arg(long, value_name = "JSON", requires = "motion")]
    pub grasps: Option<PathBuf>,
}

/// Runs the command.
pub fn run(args: &PlanArgs, output: Output) -> CommandResult {
    args.out.as_deref().map_or(Ok(()), can_write)?;
    args.motion.as_deref().map_or(Ok(()), can_write)?;
    let grasps = args.grasps.as_deref().map(grasps_of).transpose()?;
    let mut frame = frames::read(&args.frame)?;
    if args.ignore_labels {
        frame.labels = None;
    }
    let scene = Arc::new(repose_local::scene_of(&frame)?);
    let (wish, said) = args.wish.on(&scene)?;
    let in_frame = |name: &String| frame.robots.iter().find(|robot| robot.name == *name).map(|robot| robot.world_from_base);
    let reaching = args.wish.reach_of.as_ref().map(|name| ReachingRobot { name: name.clone(), world_from_base: in_frame(name) });
    let mut request = args.wish.request(scene.id(), &wish, reaching);
    repose_local::configured::robots()?.complete(&mut request.robot);
    if let Some(robot) = request.robot.as_ref().filter(|robot| robot.world_from_base.is_none()) {
        return Err(Failure::bad_input("reach-of", format!("the frame has no robot.json with robot {}", robot.name)));
    }
    let motion = args.motion.as_ref().map(|path| Ok::<_, Failure>((path, robot_of(&frame, &request)?))).transpose()?;
    let files = ModelFiles { weights: args.networks.weights.clone() };
    let result = repose_local::plan(&scene, &request, || LocalModels::load(&files).map(Arc::new), &|| false)?;
    if let Some(path) = &args.out {
        write_picture(path, &before_and_after(&scene, &result)?.into())?;
    }
    if let Some((path, robot)) = motion.filter(|_| !result.placements.is_empty()) {
        let motion = motion_of(robot, &scene, &request, &result, grasps)?;
        if let Some(ignored) = motion.ignored_in_words() {
            tracing::warn!("{ignored}");
        }
        let motion = serde_json::to_string(&motion).map_err(Failure::other)?;
        std::fs::write(path, motion).map_err(|e| FileError::new(path, e))?;
    }
    print_result(&result, center_of(&scene.meta.objects, result.query), said.as_ref(), output)
}

/// The pick and place of the best placement that the robot in the frame can serve.
fn motion_of(
    robot: &RobotInView,
    scene: &Scene,
    request: &PlaceRequest,
    result: &PlaceResult,
    grasps: Option<Vec<Grasp>>,
) -> Result<MotionPlan, Failure> {
    let placements = result.placements.iter().map(|p| p.placed_from_observed).collect();
    let wanted = MotionPlanRequest::new(scene.id(), robot.name.clone(), request.query, placements, robot.joints_rad);
    let wanted = MotionPlanRequest { grasps, seed: request.seed, ..wanted };
    repose_local::plan_motion(scene, &wanted, Some(&robot.world_from_base), &|| false).map_err(of_motion)
}

/// The robot in the frame that is to move: the one within whose reach the placements are, or where they are not for any, the first.
fn robot_of<'f>(frame: &'f Frame, request: &PlaceRequest) -> Result<&'f RobotInView, Failure> {
    let name = request.robot.as_ref().map(|robot| &robot.name);
    let missing = || match name {
        Some(name) => format!("the frame has no robot.json with robot {name}, which the placement is for"),
        None => "the frame has no robot.json with the robot's pose".to_owned(),
    };
    let robot = frame.robots.iter().find(|robot| name.is_none_or(|name| robot.name == *name));
    robot.ok_or_else(|| Failure::bad_input("motion", missing()))
}

/// The grasps of a file.
fn grasps_of(path: &Path) -> Result<Vec<Grasp>, Failure> {
    let text = std::fs::read(path).map_err(|e| FileError::new(path, e))?;
    serde_json::from_slice(&text).map_err(|e| Failure::bad_input("grasps", format!("{}: {e}", path.display())))
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use repose_perception::frame_folder;
    use repose_proto::{CameraModel, RigidTransform};

    use super::*;

    type Line = crate::testing::Line<PlanArgs>;

    #[test]
    fn a_motion_without_a_robot_is_refused_before_a_placement_is_searched_for() {
        let (width, height) = (160, 120);
        let above = RigidTransform([1., 0., 0., 0., 0., -1., 0., 0., 0., 0., -1., 0.8, 0., 0., 0., 1.]);
        let (cx, cy, world_from_camera) = (79.5, 59.5, Some(above));
        let camera = CameraModel { width, height, fx: 130.0, fy: 130.0, cx, cy, depth_unit_m: 0.001, world_from_camera };
        let labels: Vec<u16> = (0..width * height)
            .map(|i| match (i % width, i / width) {
                (45..=60, 50..=68) => 1,
                (95..=112, 52..=70) => 2,
                _ => 0,
            })
            .collect();
        let depth = labels.iter().map(|label| if *label == 0 { 800 } else { 700 }).collect();
        let folder = tempfile::tempdir().expect("a folder");
        let frame = Frame { labels: Some(labels), ..Frame::new("above".to_owned(), 0, camera, depth) };
        frame_folder::write(folder.path(), &frame).expect("the frame is written");
        let (source, motion) = (folder.path().display().to_string(), folder.path().join("motion.json").display().to_string());
        // Goals that no place can meet: a search would find that out first.
        let wish = ["--move", "1", "--goal", "left_of:2", "--goal", "right_of:2", "--variant", "geometric"];
        let line = [&["x", &source, "--motion", &motion], &wish[..]].concat();
        let refused = run(&Line::parse_from(line).args, Output { json: true }).expect_err("the frame tells of no robot");
        assert_eq!((refused.exit_code(), refused.error().and_then(|e| e.field.as_deref())), (2, Some("motion")));
    }
}
