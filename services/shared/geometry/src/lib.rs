//! Geometry that every part of Repose shares: rigid transforms, cameras, images, point clouds, meshes and spatial search.
//!
//! Pure: no I/O, no async, no global state. Poses are `f64`, clouds are `f32` (what a depth camera can tell).
//! Frames are spelled in names (`world_from_camera * point_in_camera`); `repose-proto`'s `frames` module is their glossary.

pub mod boxes;
pub mod camera;
pub mod cloud;
pub mod footprint;
pub mod grid;
pub mod image;
pub mod mesh;
pub mod plane;
pub mod sampling;
pub mod transform;
pub mod viewer;

pub use boxes::{Aabb, OrientedBox};
pub use camera::Pinhole;
pub use footprint::Footprint;
pub use grid::PointGrid;
pub use image::Image;
pub use mesh::TriMesh;
pub use plane::Plane;
pub use viewer::ViewerFrame;

pub use nalgebra::{Isometry3, Matrix3, Point2, Point3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3};
