//! Surface normals of a cloud: the direction of least spread among each point's neighbours, turned towards where it was seen from.

use nalgebra::{Matrix3, Point3, Vector3};
use repose_geometry::PointGrid;

/// A unit normal for each point, from the neighbours within `radius_m`. Too few neighbours (fewer than 3 others) give the line of sight.
pub fn estimated(points: &[Point3<f32>], radius_m: f32, seen_from: &Point3<f32>) -> Vec<Vector3<f32>> {
    let grid = PointGrid::new(points.to_vec(), radius_m);
    points
        .iter()
        .map(|point| {
            let sight = (seen_from - point).try_normalize(1e-6).unwrap_or_else(Vector3::z);
            let mut sum = Vector3::<f32>::zeros();
            let mut products = Matrix3::<f32>::zeros();
            let mut count = 0.0f32;
            grid.for_each_within(point, radius_m, |i, _| {
                // Relative to the point itself, so that single precision is enough.
                let d = points[i as usize] - point;
                sum += d;
                products += d * d.transpose();
                count += 1.0;
            });
            if count < 4.0 {
                return sight;
            }
            let mean = sum / count;
            let eigen = (products / count - mean * mean.transpose()).symmetric_eigen();
            let normal: Vector3<f32> = eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned();
            if normal.dot(&sight) < 0.0 { -normal } else { normal }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_normals_of_a_plane_are_the_planes() {
        let points: Vec<Point3<f32>> = (0..400).map(|i| Point3::new((i % 20) as f32 * 0.004, (i / 20) as f32 * 0.004, 0.1)).collect();
        for normal in estimated(&points, 0.012, &Point3::new(0.0, 0.0, 1.0)) {
            assert!((normal - Vector3::z()).norm() < 1e-3);
        }
    }
}
