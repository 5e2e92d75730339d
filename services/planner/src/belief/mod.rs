//! What is believed of a scene beyond what was seen: whole shapes, what stands on what, the space above the floor plan, the camera's picture.

pub mod columns;
pub mod crown;
pub mod outlines;
pub mod plane;
pub mod settings;
pub mod shape;
pub mod sides;
pub mod solid;
pub mod standing;
pub mod view;
