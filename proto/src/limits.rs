//! The limits that hold on every wire, whatever a deployment configures below them.

/// The version of the contract that every attachment and stand-alone message names.
pub const VERSION: u32 = 1;
/// The largest payload of a call, a reply or a put, bytes. Senders check it too, because a link drops what is larger in silence.
pub const MAX_MESSAGE_BYTES: usize = 32 * 1024 * 1024;
/// The longest deadline that a call may carry, milliseconds.
pub const MAX_REMAINING_MS: u64 = 600_000;
/// How long a cancel that came before its call is remembered, milliseconds.
pub const CANCEL_MEMORY_MS: u64 = 10_000;
/// The shortest horizon of set-points that a robot command carries, milliseconds.
pub const MIN_COMMAND_HORIZON_MS: u64 = 200;
/// The largest emergency stop that is looked into, bytes; a larger one latches unread.
pub const MAX_STOP_BYTES: usize = 64 * 1024;
/// The most candidates in one score request.
pub const MAX_CANDIDATES: usize = 4096;
/// The most goal terms in one placement request.
pub const MAX_GOAL_TERMS: usize = 16;
/// The most objects with goals in one request for an arrangement.
pub const MAX_ARRANGED: usize = 16;
/// The most placements asked for, or offered to motion, in one request.
pub const MAX_PLACEMENTS: usize = 64;
/// The largest clearance that a placement request may ask for, metres.
pub const MAX_CLEARANCE_M: f64 = 1.0;
/// The largest separation of answers that a placement request may ask for, metres.
pub const MAX_SEPARATION_M: f64 = 10.0;
/// The most grasps offered to motion in one request.
pub const MAX_GRASPS: usize = 256;
/// The most keep-out zones of a cell.
pub const MAX_KEEP_OUT_ZONES: usize = 64;
/// The longest name of a keep-out zone, characters.
pub const MAX_ZONE_NAME: usize = 64;
/// The highest epoch of a robot's owner: JSON readers that keep numbers as doubles tell it from its neighbours.
pub const MAX_EPOCH: u64 = (1 << 53) - 1;
/// The longest id of a robot's task, characters.
pub const MAX_TASK_ID: usize = 64;
/// The widest that a hand's fingers may be apart, metres: the hands of arms on tables open to less than half of it.
pub const MAX_GRIPPER_WIDTH_M: f64 = 0.5;
/// The most by which fingers may be told to be apart less than not at all, metres: encoders of fingers that press against each other do so by a millimetre.
pub const MAX_GRIPPER_OVERLAP_M: f64 = 0.02;
/// The farthest that a joint may be told to be turned, radians: sixteen turns, for there are arms whose joints turn on and on.
pub const MAX_JOINT_RAD: f64 = 100.0;
/// The most hints of one kind for a frame.
pub const MAX_HINTS: usize = 64;
/// The largest coordinate of a scene's points and of its surfaces, metres.
pub const MAX_COORDINATE_M: f32 = 1000.0;
/// The largest coordinate of a candidate's place, metres: beside a scene, and no farther than the networks' single precision can tell.
pub const MAX_CANDIDATE_COORDINATE_M: f32 = 2.0 * MAX_COORDINATE_M;
/// The most boxes that a placement request may ask to stay inside or out of: every candidate is checked against each.
pub const MAX_REGIONS: usize = 64;
/// The most objects of a scene: the work that a scene makes grows with their pairs.
pub const MAX_OBJECTS: usize = 1024;
/// The most support surfaces of a scene.
pub const MAX_SURFACES: usize = 1024;
/// The most corners of a surface's outline.
pub const MAX_CORNERS: usize = 512;
/// The most pixels of a frame on either side.
pub const MAX_IMAGE_SIDE: usize = 4096;
