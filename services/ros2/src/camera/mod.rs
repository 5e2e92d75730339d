//! From a camera's topics to frames: decoded, rectified, paired by stamp, with the camera's pose at that instant.

pub mod link;
pub mod packed;
pub mod pairing;
pub mod rvl;
pub mod source;
pub mod stream;
pub mod topics;
