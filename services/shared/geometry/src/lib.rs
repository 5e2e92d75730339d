//! Geometry that every part of Repose shares: rigid transforms, cameras, images, point clouds, meshes and spatial search.
//!
//! ```
//! use repose_geometry::transform::look_at;
//! use repose_geometry::{Pinhole, Point3, Vector3};
//!
//! let camera = Pinhole { width: 640, height: 480, fx: 525.0, fy: 525.0, cx: 319.5, cy: 239.5 };
//! let world_from_camera = look_at(&Point3::new(0.0, -1.0, 1.0), &Point3::origin(), &Vector3::z());
//! let point_in_world = world_from_camera * camera.unproject(400.0, 100.0, 1.2);
//! assert_eq!(camera.pixel_of(&(world_from_camera.inverse() * point_in_world)), Some((400, 100)));
//! ```
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
