//! Where the edges of an object's picture meet what is seen right beyond them, under, above and beside it: what it touches there, it may stand on or
//! bear.
//!
//! Down is where the picture shows something fall, so that a camera may be held at any angle.

use nalgebra::Point3;

use crate::settings::MeetingSettings;

/// The edges of an object's picture.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Edges {
    /// Where it ends downwards: towards where something falls to.
    pub lower: Vec<Meeting>,
    /// Where it ends upwards.
    pub upper: Vec<Meeting>,
    /// Where it ends to the left and to the right.
    pub sides: Vec<Meeting>,
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
