//! Where the edges of an object's picture meet what is seen right beyond them, under, above and beside it: what it touches there, it may stand on or
//! bear.
//!
//! Down is where the picture shows something fall, so that a camera may be held at any angle.

use nalgebra::{Point3, Vector2};

use crate::settings::MeetingSettings;

/// A direction in the picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Towards {
    /// Where something falls to.
    Down,
    /// Where it falls from.
    Up,
    /// To the left of that, and to the right.
    Left,
    /// See [`Self::Left`].
    Right,
}

impl Towards {
    /// The step in the picture in this direction, of a step downwards.
    pub fn of_down(self, down: &Vector2<f64>) -> Vector2<f64> {
        match self {
            Self::Down => *down,
            Self::Up => -down,
            Self::Left => Vector2::new(-down.y, down.x),
            Self::Right => Vector2::new(down.y, -down.x),
        }
    }
}

/// One place on the edge of an object's picture, and what is seen right beyond it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Meeting {
    /// Whose the thing beyond it is, 0 for furniture.
    pub object: u16,
    /// The object's own place, world frame, metres.
    pub own: Point3<f32>,
    /// The place of the thing beyond it.
    pub beyond: Point3<f32>,
}

impl Meeting {
    /// Whether the two places touch, of an object's lower edge: nothing but the band that cleaning has taken off is between them.
    pub fn is_contact(&self, settings: &MeetingSettings) -> bool {
        let apart = self.own - self.beyond;
        apart.xy().norm() <= settings.aside_m && (-settings.over_m..=settings.gap_m).contains(&apart.z)
    }

    /// Whether the thing beyond the edge goes on right beside the object, below its place there: as the top does that it lies on.
    pub fn is_beside(&self, settings: &MeetingSettings) -> bool {
        let apart = self.own - self.beyond;
        apart.xy().norm() <= settings.aside_m && apart.z >= -settings.over_m
    }

    /// The same as what is beyond it meets the object.
    pub fn reversed(&self) -> Self {
        Self { own: self.beyond, beyond: self.own, ..*self }
    }
}
