//! Messages of ROS 2 from their bytes and to them, and frames from the messages of cameras.
//!
//! A serialized message is a four-byte header that names the byte order, then plain CDR (OMG; ROS 2's default encoding). Field names and
//! order are those of the packages' definitions; what is not needed here is still read, because CDR has no field lengths to skip by.
//! Recordings and the live bridge read the same messages, and make the same pictures of them. Pure: no I/O, no async.

mod action;
pub mod calibration;
mod cdr;
pub mod cloud;
mod common;
mod control;
pub mod frames;
mod own;
pub mod pictures;
pub mod rectify;
mod seen;
mod sensor;
pub mod synthetic;
pub mod view;

pub use action::{
    CancelGoalRequest, CancelGoalResponse, FeedbackMessage, GetResultRequest, GetResultResponse, GoalInfo, GoalStatus, GoalStatusArray,
    SendGoalRequest, SendGoalResponse, Uuid, status,
};
pub use cdr::{MessageError, decode, encode};
pub use common::{
    ColorRgba, Duration, Header, Point, Pose, PoseArray, PoseWithCovariance, Quaternion, TfMessage, Time, Transform, TransformStamped,
    Vector3,
};
pub use control::{
    FollowJointTrajectoryFeedback, FollowJointTrajectoryGoal, FollowJointTrajectoryResult, GripperCommandGoal, GripperCommandResult,
    JointTolerance, JointTrajectory, JointTrajectoryPoint,
};
pub use own::{PlaceRequest, PlaceResponse, PlanRequest, PlanResponse, TriggerRequest, TriggerResponse};
pub use seen::{
    BoundingBox3D, Detection3D, Detection3DArray, DiagnosticArray, DiagnosticStatus, KeyValue, Marker, MarkerArray, MeshFile,
    ObjectHypothesis, ObjectHypothesisWithPose, UvCoordinate, marker,
};
pub use sensor::{CameraInfo, ColoredPoint, CompressedImage, JointState, PointCloud2, PointField, RegionOfInterest, RosImage, datatype};
