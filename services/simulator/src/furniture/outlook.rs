//! From where a camera sees what stands on a piece of furniture.

use nalgebra::Point3;

/// Directions and distances from which a camera sees into the furniture: a shelf only from its open front, a table not through a wall.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outlook {
    /// Least and greatest azimuth of the camera seen from the target, radians counter-clockwise from world x.
    pub azimuth_rad: [f64; 2],
    /// Least and greatest elevation over the horizontal, radians.
    pub elevation_rad: [f64; 2],
    /// Least and greatest distance from the target, metres.
    pub distance_m: [f64; 2],
}

impl Outlook {
    /// From all around, wherever a camera is held: what an open table allows.
    pub const AROUND: Self =
        Self { azimuth_rad: [-std::f64::consts::PI, std::f64::consts::PI], elevation_rad: [0.0, 1.48], distance_m: [0.3, 2.0] };

    /// From the front (−y) only, up to `aside_rad` to either side.
    pub fn front(aside_rad: f64, elevation_rad: [f64; 2], distance_m: [f64; 2]) -> Self {
        let front = -std::f64::consts::FRAC_PI_2;
        Self { azimuth_rad: [front - aside_rad, front + aside_rad], elevation_rad, distance_m }
    }

    /// Looking at a point.
    pub fn at(&self, target: Point3<f64>) -> Focus {
        Focus { target, azimuth_rad: self.azimuth_rad, elevation_rad: self.elevation_rad, distance_m: self.distance_m }
    }
}

/// What a camera should look at, and from where it sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Focus {
    /// The point to look at.
    pub target: Point3<f64>,
    /// Least and greatest azimuth of the camera seen from the target, radians counter-clockwise from world x; may pass ±π.
    pub azimuth_rad: [f64; 2],
    /// Least and greatest elevation over the horizontal, radians.
    pub elevation_rad: [f64; 2],
    /// Least and greatest distance from the target, metres.
    pub distance_m: [f64; 2],
}
