//! From a camera's topics to frames: decoded, rectified, paired by stamp, with the camera's pose at that instant.

pub mod calibration;
pub mod link;
pub mod pairing;
pub mod pictures;
pub mod rectify;
pub mod stream;
