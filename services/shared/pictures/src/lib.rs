//! Pictures to look at: frames, scenes with numbered objects, places where an object can go. For the live page, recordings, commands, agents.
//!
//! [`scene`] draws a scene as its camera saw it; [`labels`] tells which object each pixel shows; [`drawing`] has text and numbers, [`colors`]
//! what stands for an object; [`encoded`] makes JPEG of it. Pure: no I/O, no async, no global state.

pub mod colors;
pub mod drawing;
pub mod encoded;
pub mod labels;
pub mod projection;
pub mod scene;

pub use encoded::{jpeg, jpeg_of};

/// Red, green, blue.
pub type Rgb = [u8; 3];
