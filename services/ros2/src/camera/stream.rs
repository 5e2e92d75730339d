//! One camera's frames: pictures go in as they come, frames come out when they are whole.
//!
//! A frame waits for the intrinsics, for its color, and for the transform at its instant. What cannot become a frame is counted by why, and the
//! newest reason is kept for those who look.

use std::collections::BTreeMap;
use std::time::Instant;

use nalgebra::Isometry3;
use repose_geometry::transform::to_row_major;
use repose_proto::{Frame, RigidTransform};
use repose_ros_messages::cloud::Sight;
use repose_ros_messages::pictures::Color;
use repose_ros_messages::view::View;
use repose_ros_messages::{CameraInfo, Header, MessageError};

use super::pairing::{Pairing, PairingCounts, PairingSettings};
use super::source::Taken;
use crate::config::CameraConfig;
use crate::error::BridgeError;
use crate::transforms::TransformError;

/// Why pictures are no frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Lost {
    /// They cannot be read: broken, of an encoding that is not read, or shorter than they say.
    Unreadable,
    /// They are older than they may be when they come.
    Late,
    /// No intrinsics of their size have come.
    NoIntrinsics,
    /// The lens's model, color of another size, or a cloud whose points are not on their pixels' rays.
    Unfit,
    /// Nobody says where the camera was.
    NoPose,
}

impl Lost {
    /// The same in words.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Unreadable => "unreadable",
            Self::Late => "late",
            Self::NoIntrinsics => "no_intrinsics",
            Self::Unfit => "unfit",
            Self::NoPose => "no_pose",
        }
    }
}

/// What has become of a camera's pictures.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct CameraCounts {
    /// Frames.
    pub frames: u64,
    /// Pictures that are none, by why.
    pub lost: BTreeMap<Lost, u64>,
    /// The newest reason, in words, too.
    pub why: Option<(Lost, String)>,
}

/// The present, by two clocks.
#[derive(Debug, Clone, Copy)]
pub struct Now {
    /// The receiver's own clock, milliseconds: for waiting.
    pub ms: u64,
    /// Nanoseconds since the Unix epoch: for stamps.
    pub ns: u64,
}

/// A frame, whole.
#[derive(Debug)]
pub struct Made {
    /// The frame.
    pub frame: Frame,
    /// When the last of its pictures came.
    pub complete: Instant,
}

/// A picture with its header and when it came.
struct Came<T> {
    header: Header,
    picture: T,
    arrived: Instant,
    /// The same, nanoseconds since the Unix epoch.
    arrived_ns: u64,
}

/// A whole picture that waits for its transform.
struct Waiting {
    made: Made,
    frame_id: String,
    /// When its depth came, nanoseconds since the Unix epoch.
    arrived_ns: u64,
    since_ms: u64,
}

/// A camera's pictures on their way to frames.
pub struct CameraStream {
    config: CameraConfig,
    world_frame: String,
    pairing: Pairing<Came<Sight>, Came<Color>>,
    info: Option<CameraInfo>,
    /// The camera by the newest intrinsics, or as a cloud shows it.
    view: Option<View>,
    waiting: Option<Waiting>,
    counts: CameraCounts,
}

impl CameraStream {
    /// Nothing so far.
    pub fn new(config: CameraConfig, world_frame: String) -> Self {
        let settings = PairingSettings {
            tolerance_ns: (config.tolerance_ms * 1e6) as u64,
            patience_ms: config.patience_ms,
            has_color: config.color.is_some(),
        };
        let pairing = Pairing::new(settings);
        Self { config, world_frame, pairing, info: None, view: None, waiting: None, counts: CameraCounts::default() }
    }

    /// What has become of the pictures so far.
    pub fn counts(&self) -> (&CameraCounts, PairingCounts) {
        (&self.counts, self.pairing.counts)
    }

    /// Why the newest picture that was lost since the last time was lost.
    pub fn take_why(&mut self) -> Option<(Lost, String)> {
        self.counts.why.take()
    }

    /// Takes intrinsics.
    pub fn info(&mut self, info: CameraInfo) {
        let same = self.info.as_ref().is_some_and(|held| CameraInfo { header: info.header.clone(), ..held.clone() } == info);
        if !same {
            self.view = None;
        }
        self.info = Some(info);
    }

    /// Counts a message that cannot be read.
    pub fn unreadable(&mut self, error: &BridgeError) {
        self.lose(Lost::Unreadable, error.to_string());
    }

    /// Takes depth.
    pub fn depth(&mut self, taken: Taken<Sight>, now: Now) {
        if let Some(came) = self.in_time("depth", taken, now) {
            self.pairing.depth(came.header.stamp.as_ns(), came, now.ms);
        }
    }

    /// Takes color.
    pub fn color(&mut self, taken: Taken<Color>, now: Now) {
        if let Some(came) = self.in_time("color", taken, now) {
            self.pairing.color(came.header.stamp.as_ns(), came, now.ms);
        }
    }

    /// A picture that could be read and is young enough.
    fn in_time<T>(&mut self, what: &str, taken: Taken<T>, now: Now) -> Option<Came<T>> {
        let (header, picture) = match taken.read {
            Ok(read) => read,
            Err(error) => {
                self.lose(Lost::Unreadable, format!("{what}: {error}"));
                return None;
            }
        };
        let age_ms = now.ns.saturating_sub(header.stamp.as_ns()) / 1_000_000;
        let most = self.config.max_age_ms;
        if !self.config.stamp_on_arrival && age_ms > most {
            let hint = "`stamp_on_arrival` where ROS has a clock of its own";
            self.lose(Lost::Late, format!("{what} was {age_ms} ms old when it came, at most {most} ms are allowed; {hint}"));
            return None;
        }
        let waited_ns = taken.arrived.elapsed().as_nanos() as u64;
        Some(Came { header, picture, arrived: taken.arrived, arrived_ns: now.ns.saturating_sub(waited_ns) })
    }

    /// The next frame that is whole; `place` tells where one frame of the transforms is in another at an instant.
    pub fn next(&mut self, place: impl Fn(&str, &str, u64) -> Result<Isometry3<f64>, TransformError>, now: Now) -> Option<Made> {
        loop {
            let Some(waiting) = &self.waiting else {
                let (stamp_ns, depth, color) = self.pairing.next(now.ms)?;
                let complete = color.as_ref().map_or(depth.arrived, |color| color.arrived.max(depth.arrived));
                let (frame_id, arrived_ns) = (self.config.frame.clone().unwrap_or(depth.header.frame_id), depth.arrived_ns);
                match self.frame(stamp_ns, depth.picture, color.map(|color| color.picture)) {
                    Ok(frame) => self.waiting = Some(Waiting { made: Made { frame, complete }, frame_id, arrived_ns, since_ms: now.ms }),
                    Err((why, words)) => self.lose(why, words),
                }
                continue;
            };
            let waited_ms = now.ms.saturating_sub(waiting.since_ms);
            match self.pose(&place, &waiting.frame_id, waiting.made.frame.stamp_ns) {
                Ok(pose) => {
                    let Waiting { mut made, arrived_ns, .. } = self.waiting.take()?;
                    made.frame.camera.world_from_camera = Some(pose);
                    if self.config.stamp_on_arrival {
                        made.frame.stamp_ns = arrived_ns;
                    }
                    self.counts.frames += 1;
                    return Some(made);
                }
                Err(error) if error.may_come() && waited_ms < self.config.patience_ms => return None,
                Err(error) => {
                    self.waiting = None;
                    self.lose(Lost::NoPose, error.to_string());
                }
            }
        }
    }

    /// Whether there is a picture that only lacks the transform at its stamp.
    pub fn waits_for_pose(&self) -> bool {
        self.waiting.is_some()
    }

    /// When it should be looked again though nothing comes.
    pub fn due_ms(&self) -> Option<u64> {
        let waiting = self.waiting.as_ref().map(|waiting| waiting.since_ms + self.config.patience_ms);
        [waiting, self.pairing.due_ms()].into_iter().flatten().min()
    }

    fn pose(
        &self,
        place: impl Fn(&str, &str, u64) -> Result<Isometry3<f64>, TransformError>,
        frame_id: &str,
        stamp_ns: u64,
    ) -> Result<RigidTransform, TransformError> {
        if let Some(pose) = self.config.world_from_camera {
            return Ok(pose);
        }
        Ok(RigidTransform(to_row_major(&place(&self.world_frame, frame_id, stamp_ns)?)))
    }

    fn frame(&mut self, stamp_ns: u64, mut sight: Sight, color: Option<Color>) -> Result<Frame, (Lost, String)> {
        let size = (sight.depth.width, sight.depth.height);
        let own = sight.color.take();
        // Color with a topic of its own goes before a cloud's.
        let color = color.or(own);
        if let Some(color) = &color
            && (color.width, color.height) != size
        {
            let words = format!(
                "color of {} x {} and depth of {} x {}: color registered to depth is needed",
                color.width, color.height, size.0, size.1
            );
            return Err((Lost::Unfit, words));
        }
        let unfit = |error: MessageError| (Lost::Unfit, error.to_string());
        let held = self.view.take().filter(|view| view.has_size(size));
        let view = match (held, &self.info) {
            (Some(view), Some(_)) => view,
            // Nobody tells the intrinsics: a cloud that shows another camera than the one before is looked at anew.
            (Some(view), None) if view.check(&sight.sample).is_ok() => view,
            (_, None) if self.config.info.is_none() => View::of_points(&sight).map_err(unfit)?,
            (_, None) => return Err((Lost::NoIntrinsics, format!("nothing has come on {}", self.info_topic()))),
            (None, Some(info)) => View::of(info, &sight.depth, self.config.is_rectified()).map_err(unfit)?.ok_or_else(|| {
                let (topic, width, height) = (self.info_topic(), info.width, info.height);
                (Lost::NoIntrinsics, format!("{topic} is of {width} x {height}, depth of {} x {}", size.0, size.1))
            })?,
        };
        let view = self.view.insert(view);
        view.check(&sight.sample).map_err(unfit)?;
        let (camera, depth, color) = view.straight(sight.depth, color);
        let frame = Frame::new(self.config.name.clone(), stamp_ns, camera, depth.counts);
        Ok(Frame { color: color.map(|color| color.pixels), ..frame })
    }

    fn info_topic(&self) -> &str {
        self.config.info.as_deref().unwrap_or_default()
    }

    fn lose(&mut self, why: Lost, words: String) {
        *self.counts.lost.entry(why).or_default() += 1;
        self.counts.why = Some((why, words));
    }
}

#[cfg(test)]
mod tests;
