//! The stand-in world: objects, physics, a depth camera, and a simulated Panda.
//!
//! [`scene`] makes settled scenes from seeds, [`render`] and [`sensor`] show them as a depth camera would, [`generate`] writes training
//! data, [`release`] says what happens when an object is let go.

pub mod arrange;
pub mod contact;
pub mod cell;
pub mod cell_world;
pub mod convert;
pub mod generate;
pub mod objects;
pub mod physics;
pub mod release;
pub mod render;
pub mod robot;
pub mod scene;
pub mod sensor;
pub mod viewpoint;
pub mod views;
