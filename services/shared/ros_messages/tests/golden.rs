//! Messages as `rosbags` serializes them (`tests/ros2/write_golden.py`, every number and word another): read, and written the same.

use repose_ros_messages::{
    CameraInfo, CancelGoalRequest, CancelGoalResponse, CompressedImage, Detection3DArray, DiagnosticArray, FeedbackMessage,
    FollowJointTrajectoryGoal, FollowJointTrajectoryResult, GetResultResponse, GoalStatusArray, GripperCommandGoal, GripperCommandResult,
    JointState, MarkerArray, PlaceRequest, PlaceResponse, PlanRequest, PlanResponse, PointCloud2, PoseArray, RosImage, SendGoalRequest,
    SendGoalResponse, TfMessage, TriggerRequest, TriggerResponse, decode, encode,
};
use serde::Serialize;
use serde::de::DeserializeOwned;

fn read<T: DeserializeOwned>(name: &'static str) -> (T, Vec<u8>) {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(format!("{name}.cdr"));
    let bytes = std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    (decode(&bytes, name).unwrap_or_else(|e| panic!("{name}: {e}")), bytes)
}

fn same<T: Serialize + DeserializeOwned>(name: &'static str) {
    let (message, bytes) = read::<T>(name);
    let written = encode(&message, name).expect("written");
    // Others may fill the last word up.
    assert!(bytes.starts_with(&written) && bytes.len() < written.len() + 4, "{name}\n{bytes:02x?}\n{written:02x?}");
}

#[test]
fn every_message_is_read_and_written_as_others_do() {
    same::<GoalStatusArray>("GoalStatusArray");
    same::<CancelGoalRequest>("CancelGoal_Request");
    same::<CancelGoalResponse>("CancelGoal_Response");
    same::<GetResultResponse<FollowJointTrajectoryResult>>("FollowJointTrajectory_GetResult_Response");
    same::<SendGoalRequest<FollowJointTrajectoryGoal>>("FollowJointTrajectory_SendGoal_Request");
    same::<SendGoalResponse>("FollowJointTrajectory_SendGoal_Response");
    same::<FeedbackMessage<GripperCommandResult>>("GripperCommand_FeedbackMessage");
    same::<SendGoalRequest<GripperCommandGoal>>("GripperCommand_SendGoal_Request");
    same::<DiagnosticArray>("DiagnosticArray");
    same::<PoseArray>("PoseArray");
    same::<PlaceRequest>("Place_Request");
    same::<PlaceResponse>("Place_Response");
    same::<PlanRequest>("Plan_Request");
    same::<PlanResponse>("Plan_Response");
    same::<CameraInfo>("CameraInfo");
    same::<CompressedImage>("CompressedImage");
    same::<RosImage>("Image");
    same::<JointState>("JointState");
    same::<PointCloud2>("PointCloud2");
    same::<TriggerRequest>("Trigger_Request");
    same::<TriggerResponse>("Trigger_Response");
    same::<TfMessage>("TFMessage");
    same::<Detection3DArray>("Detection3DArray");
    same::<MarkerArray>("MarkerArray");
}

#[test]
fn numbers_are_where_they_belong() {
    let (joints, _) = read::<JointState>("JointState");
    assert_eq!((joints.header.stamp.sec, joints.header.frame_id.as_str()), (1, "word 3"));
    assert_eq!((joints.name, joints.position), (vec!["word 4".to_owned(), "word 5".to_owned()], vec![6.0, 7.0]));
    let (result, _) = read::<GetResultResponse<FollowJointTrajectoryResult>>("FollowJointTrajectory_GetResult_Response");
    assert_eq!((result.status, result.result.error_code, result.result.error_string.as_str()), (1, 2, "word 3"));
}
