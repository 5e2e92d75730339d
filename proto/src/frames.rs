//! The glossary of coordinate frames, and the wire form of a rigid transform.
//!
//! | frame | axes and origin |
//! |---|---|
//! | `world` | right-handed, z up. With extrinsics: the cell's own. Without: gravity-aligned on the main support plane, origin below the camera, viewer at yaw 0 |
//! | `camera` | x right, y down, z forward (OpenCV); origin at the optical centre |
//! | `viewer` | the world turned by `view_yaw_rad` about z: x right, y away from the viewer, z up; level, same origin. A camera's: y is where it looks over the ground, or its picture's up where it looks steeply down |
//! | `observed`, `placed` | the world before and after the query object has moved: `placed_from_observed` carries observed points to placed ones |
//! | `base` | the robot's base link |
//! | `flange`, `tcp` | the robot's last link; the point between its fingertips, z along the approach, y along the opening |
//! | `object` | an object model's own frame, known to the simulator only |
//!
//! A rigid transform is named `to_from` and maps coordinates in `from` to coordinates in `to`.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::CallError;

/// A rigid transform: 16 numbers, row-major, last row `0 0 0 1`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(transparent)]
pub struct RigidTransform(pub [f64; 16]);

impl RigidTransform {
    /// The transform that moves nothing.
    pub const IDENTITY: Self = Self([1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1.]);

    /// Checks that the numbers are a right-handed rigid transform, within 1e-3 on the rotation.
    ///
    /// # Errors
    /// `invalid_argument` that names `field`.
    pub fn validate(&self, field: &str) -> Result<(), CallError> {
        let m = &self.0;
        if let Some(i) = m.iter().position(|v| !v.is_finite()) {
            return Err(CallError::invalid(field, format!("entry {i} is not a finite number")));
        }
        if m[12].abs().max(m[13].abs()).max(m[14].abs()).max((m[15] - 1.0).abs()) > 1e-6 {
            let is_transposed = [m[3], m[7], m[11]] == [0.0; 3] && m[15] == 1.0;
            let hint = if is_transposed { ", but the last column is: the matrix is transposed, and is written row by row" } else { "" };
            return Err(CallError::invalid(field, format!("the last row is not 0 0 0 1{hint}")));
        }
        let dot = |a: usize, b: usize| (0..3).map(|k| m[4 * a + k] * m[4 * b + k]).sum::<f64>();
        for a in 0..3 {
            for b in a..3 {
                let error = dot(a, b) - if a == b { 1.0 } else { 0.0 };
                if error.abs() > 1e-3 {
                    return Err(CallError::invalid(field, format!("the rotation's rows {a} and {b} are off by {error:.2e}")));
                }
            }
        }
        let determinant = m[0] * (m[5] * m[10] - m[6] * m[9]) - m[1] * (m[4] * m[10] - m[6] * m[8]) + m[2] * (m[4] * m[9] - m[5] * m[8]);
        if determinant < 0.0 {
            return Err(CallError::invalid(field, "the rotation is a mirror image (determinant -1)"));
        }
        Ok(())
    }
}
