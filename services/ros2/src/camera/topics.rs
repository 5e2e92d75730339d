//! The topics of one camera: its intrinsics, its depth and its color, whichever comes next.

use std::time::{Duration, Instant};

use repose_proto::CallError;
use repose_ros_messages::CameraInfo;
use repose_ros_messages::cloud::Sight;
use repose_ros_messages::pictures::Color;
use tokio::task::JoinSet;

use super::source::{self, Source, Taken};
use crate::config::CameraConfig;
use crate::error::BridgeError;
use crate::node::{Node, RosSubscription};
use crate::report::Reports;
use crate::wire::names::Qos;

/// How long a topic of pictures may be silent before that is told.
pub(super) const SILENCE: Duration = Duration::from_secs(3);

/// What came.
pub enum Event {
    /// Intrinsics, or why they cannot be read.
    Info(Result<Box<CameraInfo>, BridgeError>),
    /// Depth.
    Depth(Taken<Sight>),
    /// Color.
    Color(Taken<Color>),
}

/// The topics of one camera.
pub struct Topics {
    infos: Option<RosSubscription<CameraInfo>>,
    depths: Source<Sight>,
    colors: Option<Source<Color>>,
    /// The tasks that read pictures, which end with this.
    readers: JoinSet<()>,
    /// The topics of pictures, and when something came on them last.
    heard: Vec<(String, Instant)>,
}

impl Topics {
    /// Subscribes to them.
    ///
    /// # Errors
    /// When the network refuses.
    pub async fn of(node: &Node, camera: &CameraConfig) -> Result<Self, BridgeError> {
        let mut readers = JoinSet::new();
        let infos = match &camera.info {
            Some(info) => Some(node.subscribe(info, "sensor_msgs/msg/CameraInfo", Qos::SENSOR).await?),
            None => None,
        };
        let depths = source::depths(node, camera, &mut readers).await?;
        let colors = match &camera.color {
            Some(color) => Some(source::colors(node, color, &mut readers).await?),
            None => None,
        };
        let topics = [Some(camera.depth_source().topic()), camera.color.as_deref()];
        let heard = topics.into_iter().flatten().map(|topic| (topic.to_owned(), Instant::now())).collect();
        Ok(Self { infos, depths, colors, readers, heard })
    }

    /// What comes next; none when the session has closed. Cancel safe.
    ///
    /// # Errors
    /// When a task that reads pictures has failed: without it half a camera would be left.
    pub async fn next(&mut self) -> Result<Option<Event>, BridgeError> {
        let event = tokio::select! {
            info = next_info(&mut self.infos) => info.map(|info| Event::Info(info.map(Box::new))),
            depth = self.depths.recv() => depth.map(Event::Depth),
            color = next_color(&mut self.colors) => color.map(Event::Color),
        };
        match &event {
            Some(Event::Depth(taken)) => self.heard[0].1 = taken.arrived,
            Some(Event::Color(taken)) => self.heard[1].1 = taken.arrived,
            Some(Event::Info(_)) => {}
            None => self.check_readers().await?,
        }
        Ok(event)
    }

    async fn check_readers(&mut self) -> Result<(), BridgeError> {
        match self.readers.join_next().await {
            Some(Err(failure)) => Err(CallError::internal(format!("reading pictures: {failure}")).into()),
            Some(Ok(())) | None => Ok(()),
        }
    }

    /// How many pictures were dropped because they were not read in time.
    pub fn dropped(&self) -> u64 {
        self.depths.dropped() + self.colors.as_ref().map_or(0, Source::dropped)
    }

    /// Tells of topics on which nothing comes, for as long as that is so.
    pub fn tell_silence(&self, camera: &str, reports: &Reports) {
        for (topic, last) in &self.heard {
            let is_silent = last.elapsed() > SILENCE;
            reports.standing(camera, topic, is_silent.then(|| format!("nothing comes on {topic}")));
        }
    }
}

async fn next_info(infos: &mut Option<RosSubscription<CameraInfo>>) -> Option<Result<CameraInfo, BridgeError>> {
    match infos {
        Some(infos) => infos.recv().await,
        None => std::future::pending().await,
    }
}

async fn next_color(colors: &mut Option<Source<Color>>) -> Option<Taken<Color>> {
    match colors {
        Some(colors) => colors.recv().await,
        None => std::future::pending().await,
    }
}
