//! One camera's frames: pictures go in as they come, frames come out when they are whole.
//!
//! A frame waits for the intrinsics, for its color, and for the transform at its instant. What cannot become a frame is counted by why, and the
//! newest reason is kept for those who look.

use std::collections::BTreeMap;

use nalgebra::Isometry3;
use repose_geometry::transform::to_row_major;
use repose_proto::{CameraModel, Frame, RigidTransform};
use repose_ros_messages::frames::model_of;
use repose_ros_messages::{CameraInfo, Header, MessageError};

use super::calibration::Lens;
use super::pairing::{Pairing, PairingCounts, PairingSettings};
use super::pictures::{Color, Depth};
use super::rectify::Rectifier;
use crate::config::CameraConfig;
use crate::transforms::{TransformError, Transforms};

/// Why pictures are no frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Lost {
    /// They cannot be read.
    Unreadable,
    /// They are older than they may be when they come.
    Late,
    /// No intrinsics of their size have come.
    NoIntrinsics,
    /// The lens's model, or color of another size.
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
    /// The newest reason, in words.
    pub why: Option<String>,
}

/// A camera's pictures on their way to frames.
pub struct CameraStream {
    config: CameraConfig,
    world_frame: String,
    pairing: Pairing<(Header, Depth), Color>,
    info: Option<CameraInfo>,
    /// The lens of the newest intrinsics, with the map that takes it out.
    rectifier: Option<(CameraModel, Option<Rectifier>)>,
    /// A whole picture that waits for its transform, and since when.
    waiting: Option<(Frame, String, u64)>,
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
        Self { config, world_frame, pairing, info: None, rectifier: None, waiting: None, counts: CameraCounts::default() }
    }

    /// What has become of the pictures so far.
    pub fn counts(&self) -> (&CameraCounts, PairingCounts) {
        (&self.counts, self.pairing.counts)
    }

    /// Why the newest picture that was lost since the last time was lost.
    pub fn take_why(&mut self) -> Option<String> {
        self.counts.why.take()
    }

    /// Takes intrinsics.
    pub fn info(&mut self, info: CameraInfo) {
        let same = self.info.as_ref().is_some_and(|held| CameraInfo { header: info.header.clone(), ..held.clone() } == info);
        if !same {
            self.rectifier = None;
        }
        self.info = Some(info);
    }

    /// Takes depth that came at `now_ms` of the receiver's clock, `now_ns` of the wall's.
    pub fn depth(&mut self, header: Header, picture: Result<Depth, MessageError>, now_ms: u64, now_ns: u64) {
        let stamp_ns = header.stamp.as_ns();
        match picture {
            Err(error) => self.lose(Lost::Unreadable, format!("depth: {error}")),
            Ok(_) if self.is_late(stamp_ns, now_ns) => self.lose(Lost::Late, self.late_words("depth", stamp_ns, now_ns)),
            Ok(picture) => self.pairing.depth(stamp_ns, (header, picture), now_ms),
        }
    }

    /// Takes color.
    pub fn color(&mut self, header: &Header, picture: Result<Color, MessageError>, now_ms: u64, now_ns: u64) {
        let stamp_ns = header.stamp.as_ns();
        match picture {
            Err(error) => self.lose(Lost::Unreadable, format!("color: {error}")),
            Ok(_) if self.is_late(stamp_ns, now_ns) => self.lose(Lost::Late, self.late_words("color", stamp_ns, now_ns)),
            Ok(picture) => self.pairing.color(stamp_ns, picture, now_ms),
        }
    }

    /// The next frame that is whole.
    pub fn next(&mut self, transforms: &Transforms, now_ms: u64, now_ns: u64) -> Option<Frame> {
        loop {
            if self.waiting.is_none() {
                let (stamp_ns, (header, depth), color) = self.pairing.next(now_ms)?;
                let frame_id = self.config.frame.clone().unwrap_or(header.frame_id);
                match self.frame(stamp_ns, depth, color) {
                    Ok(frame) => self.waiting = Some((frame, frame_id, now_ms)),
                    Err((why, words)) => self.lose(why, words),
                }
                continue;
            }
            let (frame, frame_id, since_ms) = self.waiting.as_ref()?;
            let waited_ms = now_ms.saturating_sub(*since_ms);
            match self.pose(transforms, frame_id, frame.stamp_ns) {
                Ok(pose) => {
                    let (mut frame, ..) = self.waiting.take()?;
                    frame.camera.world_from_camera = Some(pose);
                    if self.config.stamp_on_arrival {
                        frame.stamp_ns = now_ns;
                    }
                    self.counts.frames += 1;
                    return Some(frame);
                }
                Err(error) if error.may_come() && waited_ms < self.config.patience_ms => return None,
                Err(error) => {
                    self.waiting = None;
                    self.lose(Lost::NoPose, error.to_string());
                }
            }
        }
    }

    /// When it should be looked again though nothing comes.
    pub fn due_ms(&self) -> Option<u64> {
        let waiting = self.waiting.as_ref().map(|(_, _, since_ms)| since_ms + self.config.patience_ms);
        [waiting, self.pairing.due_ms()].into_iter().flatten().min()
    }

    fn pose(&self, transforms: &Transforms, frame_id: &str, stamp_ns: u64) -> Result<RigidTransform, TransformError> {
        if let Some(pose) = self.config.world_from_camera {
            return Ok(pose);
        }
        let world_from_camera: Isometry3<f64> = transforms.lookup(&self.world_frame, frame_id, stamp_ns)?;
        Ok(RigidTransform(to_row_major(&world_from_camera)))
    }

    fn frame(&mut self, stamp_ns: u64, depth: Depth, color: Option<Color>) -> Result<Frame, (Lost, String)> {
        let size = (depth.width, depth.height);
        let Some(info) = &self.info else { return Err((Lost::NoIntrinsics, format!("nothing has come on {}", self.config.info))) };
        let unfit = |error: MessageError| (Lost::Unfit, error.to_string());
        if let Some(color) = &color
            && (color.width, color.height) != size
        {
            let words = format!(
                "color of {} x {} and depth of {} x {}: color registered to depth is needed",
                color.width, color.height, size.0, size.1
            );
            return Err((Lost::Unfit, words));
        }
        if self.rectifier.as_ref().is_none_or(|(camera, _)| (camera.width, camera.height) != size) {
            let lens = if self.config.is_rectified() { None } else { Lens::of(info).map_err(unfit)? };
            // Pictures that the lens has bent have the intrinsics of K; those of P are of rectified ones.
            let as_bent = CameraInfo { p: [0.0; 12], ..info.clone() };
            let camera = model_of(if lens.is_some() { &as_bent } else { info }, size, depth.unit_m).ok_or_else(|| {
                (
                    Lost::NoIntrinsics,
                    format!("{} is of {} x {}, depth of {} x {}", self.config.info, info.width, info.height, size.0, size.1),
                )
            })?;
            let rectifier = lens.map(|lens| Rectifier::new(&camera, &lens));
            self.rectifier = Some((camera, rectifier));
        }
        let Some((camera, rectifier)) = &self.rectifier else { return Err((Lost::NoIntrinsics, String::new())) };
        let camera = CameraModel { depth_unit_m: depth.unit_m, ..camera.clone() };
        let (depth, color) = match rectifier {
            Some(rectifier) => (rectifier.depth(&depth), color.map(|color| rectifier.color(&color))),
            None => (depth, color),
        };
        let frame = Frame::new(self.config.name.clone(), stamp_ns, camera, depth.counts);
        Ok(Frame { color: color.map(|color| color.pixels), ..frame })
    }

    fn is_late(&self, stamp_ns: u64, now_ns: u64) -> bool {
        !self.config.stamp_on_arrival && now_ns.saturating_sub(stamp_ns) > self.config.max_age_ms * 1_000_000
    }

    fn late_words(&self, what: &str, stamp_ns: u64, now_ns: u64) -> String {
        let age_ms = now_ns.saturating_sub(stamp_ns) / 1_000_000;
        let most = self.config.max_age_ms;
        format!(
            "{what} was {age_ms} ms old when it came, at most {most} ms are allowed; `stamp_on_arrival` where ROS has a clock of its own"
        )
    }

    fn lose(&mut self, why: Lost, words: String) {
        *self.counts.lost.entry(why).or_default() += 1;
        self.counts.why = Some(words);
    }
}
