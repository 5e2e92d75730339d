//! What viewers are told: encoded once, whoever gets it, and about what.

use std::sync::Arc;
use std::time::Duration;

use bytes::Bytes;
use repose_proto::Bulk;

use crate::parts::Form;
use crate::view::SceneView;

/// What a message is about. A viewer wants the newest of each.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub enum Topic {
    /// Who serves, and what the viewer may do.
    Welcome,
    /// The cells there are.
    Cells,
    /// The cell that the viewer looks at.
    Watching,
    /// A cell's workers, cameras and robots.
    System,
    /// A camera's picture.
    Picture,
    /// A camera's scene.
    Scene,
    /// A scene with an object that the viewer asked for.
    Segmented,
    /// A robot's state.
    Robot(String),
    /// What is being carried out.
    Activity,
    /// The motion planned last.
    Plan,
    /// How far a request of the viewer's is.
    Progress(u64),
    /// The answer to a request of the viewer's.
    Answer(u64),
}

/// An encoded message, shared by all who get it.
#[derive(Clone)]
pub enum ViewerMessage {
    /// JSON.
    Text(Arc<str>),
    /// The bulk form.
    Binary(Bytes),
    /// A scene.
    View(Arc<SceneView>),
}

impl ViewerMessage {
    pub(super) fn form(&self) -> Form {
        match self {
            Self::Text(_) => Form::Text,
            Self::Binary(_) | Self::View(_) => Form::Bulk,
        }
    }

    pub(super) fn length(&self) -> usize {
        match self {
            Self::Text(text) => text.len(),
            Self::Binary(bytes) => bytes.len(),
            Self::View(view) => view.bytes.len(),
        }
    }

    pub(super) fn bytes(&self) -> Bytes {
        match self {
            Self::Text(text) => Bytes::copy_from_slice(text.as_bytes()),
            Self::Binary(bytes) => bytes.clone(),
            Self::View(view) => view.bytes.clone(),
        }
    }

    /// The same as it is told this much later: with its age, without which it would pass for what was just seen.
    pub(super) fn told_late(&self, age: Duration) -> Self {
        let age_ms = age.as_millis();
        match self {
            Self::Text(text) => {
                let rest = text.strip_prefix('{');
                rest.map_or_else(|| self.clone(), |rest| Self::Text(format!(r#"{{"age_ms":{age_ms},{rest}"#).into()))
            }
            Self::Binary(bytes) => {
                let Ok(mut bulk) = Bulk::decode(bytes) else { return self.clone() };
                bulk.metadata.insert("age_ms".to_owned(), age_ms.to_string());
                Self::Binary(bulk.encode().into())
            }
            Self::View(_) => self.clone(),
        }
    }
}

/// What goes to a viewer next.
pub enum Outgoing {
    /// A message.
    Whole(ViewerMessage),
    /// A part of a message.
    Part {
        /// The bulk form.
        bytes: Bytes,
        /// The scene that it is the first part of.
        begins: Option<Arc<SceneView>>,
    },
}

impl Topic {
    /// Its name: what a part is said to be of.
    pub(super) fn name(&self) -> String {
        match self {
            Self::Welcome => "welcome".to_owned(),
            Self::Cells => "cells".to_owned(),
            Self::Watching => "watching".to_owned(),
            Self::System => "system".to_owned(),
            Self::Picture => "picture".to_owned(),
            Self::Scene => "scene".to_owned(),
            Self::Segmented => "segmented".to_owned(),
            Self::Robot(robot) => format!("robot {robot}"),
            Self::Activity => "activity".to_owned(),
            Self::Plan => "plan".to_owned(),
            Self::Progress(id) => format!("progress {id}"),
            Self::Answer(id) => format!("answer {id}"),
        }
    }

    /// Whether viewers take its messages for what is so now.
    pub(super) fn is_live(&self) -> bool {
        matches!(self, Self::Picture | Self::Robot(_))
    }

    /// Whether its messages are of the cell that the viewer looks at.
    pub fn is_of_cell(&self) -> bool {
        match self {
            Self::System | Self::Picture | Self::Scene | Self::Segmented | Self::Robot(_) | Self::Activity | Self::Plan => true,
            Self::Welcome | Self::Cells | Self::Watching | Self::Progress(_) | Self::Answer(_) => false,
        }
    }

    /// Whether its messages are large: the next is sent when the viewer has said that it has seen the last, so that none wait in buffers on the
    /// way, where they would grow old.
    pub(super) fn waits_for_viewer(&self) -> bool {
        matches!(self, Self::Picture | Self::Scene)
    }
}
