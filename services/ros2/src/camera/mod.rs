//! From a camera's topics to frames: decoded, rectified, paired by stamp, with the camera's pose at that instant.

pub mod calibration;
pub mod cloud;
pub mod link;
pub mod packed;
pub mod pairing;
pub mod pictures;
pub mod rectify;
pub mod rvl;
pub mod source;
pub mod stream;
pub mod topics;
pub mod view;
