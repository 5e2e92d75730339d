//! The one depth sensor of Repose: what a structured-light or an active-stereo camera reports of true depth.
//!
//! ```
//! use repose_geometry::Pinhole;
//! use repose_sensor::SensorModel;
//!
//! let camera = Pinhole { width: 64, height: 48, fx: 52.0, fy: 52.0, cx: 31.5, cy: 23.5 };
//! let mut wall_m = vec![1.0; 64 * 48];
//! SensorModel::structured_light().disturb(&mut wall_m, &camera, 7);
//! assert!(wall_m.iter().all(|z| *z == 0.0 || (z - 1.0).abs() < 0.02), "0 is a lost reading");
//! ```
//!
//! The simulator's camera and the augmentation in training use the same [`SensorModel`], so that networks see in training what they see in
//! service. Both kinds of camera measure *disparity*, the shift of a patch between two points of view, and their faults are simple there: steps
//! and noise of a share of a pixel, correlated as wide as the patch. Depth is `focal · baseline / disparity`, so that both grow with the square of
//! the distance. What only one of the two points of view sees has no reading ([`shadow`]).
//!
//! | figure | published | here |
//! |---|---|---|
//! | Kinect v1, standard deviation on a plane | 1.42 mm · z² (Khoshelham & Elberink, Sensors 12, 2012) to 1.2 + 1.9 (z − 0.4)² mm (Nguyen, Izadi & Lovell, 3DIMPVT 2012), z in metres | between the two |
//! | Kinect v1, step of depth | 2.85 mm · z² (the same; disparity in eighths of a pixel, 75 mm baseline) | the same |
//! | noise added by slant | 0.1 mm · (θ / (90° − θ))² / √z (Nguyen et al.) | the same |
//! | silhouettes wander | 0.8 px (Nguyen et al.) | the same, Gaussian |
//! | D400, standard deviation on a plane | z² · subpixel / (focal · baseline), subpixel 0.08 and better (Intel, "Tuning depth cameras for best performance") | subpixel 0.07 |
//! | D400, step of disparity | 1/32 px (Intel, "Subpixel linearity improvement") | the same |
//! | matching window | Kinect 9 px (Konolige & Mihelich, kinect_calibration); R200/D400 census 7 px (Keselman et al., CVPRW 2017) | the same |
//! | no overlap of the two imagers | focal · baseline / z columns at the left edge (Intel, D400 datasheet, "invalid depth band") | the same |
//!
//! That noise is made in disparity, correlated, then quantised, is how Barron & Malik (CVPR 2013) and Handa et al. (ICRA 2014) imitate a Kinect. How many readings are
//! lost or mixed at silhouettes, and at random, is not published as a figure: those shares are ours.

mod model;
mod noise;
mod sensing;
pub mod shadow;
mod surface;

pub use model::SensorModel;
