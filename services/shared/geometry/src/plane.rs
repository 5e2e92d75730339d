//! Planes, and the least-squares plane through points.

use nalgebra::{Matrix3, Point3, Unit, Vector3};

/// The points `p` with `normal · p = offset_m`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    /// Unit normal.
    pub normal: Unit<Vector3<f64>>,
    /// Distance of the plane from the origin along the normal, metres.
    pub offset_m: f64,
}

impl Plane {
    /// The plane through three points, normal by the right-hand rule; `None` when they are nearly on a line.
    pub fn through(a: &Point3<f64>, b: &Point3<f64>, c: &Point3<f64>) -> Option<Self> {
        let normal = Unit::try_new((b - a).cross(&(c - a)), 1e-9)?;
        Some(Self { normal, offset_m: normal.dot(&a.coords) })
    }

    /// The least-squares plane through points (smallest principal component of their scatter); `None` with fewer than three.
    pub fn fit<'a>(points: impl Iterator<Item = &'a Point3<f32>> + Clone) -> Option<Self> {
        let (mut n, mut sum) = (0usize, Vector3::<f64>::zeros());
        for p in points.clone() {
            n += 1;
            sum += p.coords.cast::<f64>();
        }
        if n < 3 {
            return None;
        }
        let mean = sum / n as f64;
        let mut scatter = Matrix3::<f64>::zeros();
        for p in points {
            let d = p.coords.cast::<f64>() - mean;
            scatter += d * d.transpose();
        }
        let eigen = scatter.symmetric_eigen();
        let normal = Unit::try_new(eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned(), 1e-12)?;
        Some(Self { normal, offset_m: normal.dot(&mean) })
    }

    /// Signed distance of a point, positive on the normal's side, metres.
    pub fn signed_distance(&self, p: &Point3<f64>) -> f64 {
        self.normal.dot(&p.coords) - self.offset_m
    }

    /// The same plane with the normal turned over.
    pub fn flipped(&self) -> Self {
        Self { normal: -self.normal, offset_m: -self.offset_m }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fit_finds_the_plane_that_points_were_drawn_from() {
        let points: Vec<Point3<f32>> =
            (0..400).map(|i| (i % 20, i / 20)).map(|(x, y)| Point3::new(x as f32, y as f32, 0.3 * x as f32 + 1.0)).collect();
        let plane = Plane::fit(points.iter()).unwrap();
        assert!(points.iter().all(|p| plane.signed_distance(&p.cast::<f64>()).abs() < 1e-5));
        assert_eq!(Plane::fit(points[..2].iter()), None);
    }
}
