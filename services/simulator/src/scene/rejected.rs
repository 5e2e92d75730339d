//! Why a draw is not a scene.

use std::sync::Arc;

use crate::furniture::SceneKind;

/// Why a draw gave no scene.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Rejected {
    /// There was no room for enough objects.
    #[error("room for {placed} objects, wanted {wanted}")]
    NoRoom {
        /// Objects that found a place.
        placed: usize,
        /// Objects asked for.
        wanted: usize,
    },
    /// An object came to be where nothing of the furniture carries it.
    #[error("object {id} fell off")]
    FellOff {
        /// Which.
        id: u16,
    },
    /// Something kept moving.
    #[error("object {id} ({name}) still moving after {steps} steps")]
    Moving {
        /// One that moves.
        id: u16,
        /// What it is.
        name: Arc<str>,
        /// Steps waited.
        steps: usize,
    },
    /// Something stood by luck only.
    #[error("object {id} moved {moved_m} m when the table was knocked")]
    Topples {
        /// Which.
        id: u16,
        /// How far.
        moved_m: f64,
    },
    /// Two things overlap.
    #[error("{depth_m} m of overlap, at most {limit_m} m allowed")]
    Penetrates {
        /// How deep.
        depth_m: f32,
        /// The limit.
        limit_m: f32,
    },
}

impl Rejected {
    /// The reason in snake case, without its particulars.
    pub fn reason(&self) -> &'static str {
        match self {
            Self::NoRoom { .. } => "no_room",
            Self::FellOff { .. } => "fell_off",
            Self::Moving { .. } => "moving",
            Self::Topples { .. } => "topples",
            Self::Penetrates { .. } => "penetrates",
        }
    }

    /// All reasons.
    pub const REASONS: [&'static str; 5] = ["no_room", "fell_off", "moving", "topples", "penetrates"];
}

/// A seed that gave no scene.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("seed {seed} ({kind}) gave no scene in {} draws{}", rejections.len(), last_of(rejections), kind = kind.name())]
pub struct NoScene {
    /// The seed.
    pub seed: u64,
    /// The kind that it got.
    pub kind: SceneKind,
    /// Why each draw was rejected, in order.
    pub rejections: Vec<Rejected>,
}

fn last_of(rejections: &[Rejected]) -> String {
    rejections.last().map_or_else(String::new, |why| format!("; the last: {why}"))
}
