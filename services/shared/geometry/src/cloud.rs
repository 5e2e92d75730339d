//! Measures of a point cloud. A cloud is a slice of points; what frame it is in, its name says.

use foldhash::{HashMap, HashMapExt};
use nalgebra::{Isometry3, Point3, Vector3};

use crate::Aabb;
use crate::grid::cell_of;

/// The mean of the points (an object's *observed* centroid, not its geometric centre); `None` without any.
///
/// Summed in `f64` in the given order, so that the same cloud gives the same bytes.
pub fn centroid(points: &[Point3<f32>]) -> Option<Point3<f64>> {
    if points.is_empty() {
        return None;
    }
    let sum = points.iter().fold(Vector3::zeros(), |s: Vector3<f64>, p| s + p.coords.cast::<f64>());
    Some(Point3::from(sum / points.len() as f64))
}

/// The box between two percentiles of each coordinate, which stray points do not stretch; `None` without points.
///
/// `low` and `high` are fractions, 0.01 and 0.99 for the rule-based baseline of the paper's Table 2.
pub fn percentile_box(points: &[Point3<f32>], low: f64, high: f64) -> Option<Aabb> {
    if points.is_empty() {
        return None;
    }
    let mut bounds = [[0.0f32; 2]; 3];
    let mut values = vec![0.0f32; points.len()];
    for (k, bound) in bounds.iter_mut().enumerate() {
        for (v, p) in values.iter_mut().zip(points) {
            *v = p[k];
        }
        let last = (points.len() - 1) as f64;
        for (b, fraction) in bound.iter_mut().zip([low, high]) {
            let index = (fraction * last).round() as usize;
            *b = *values.select_nth_unstable_by(index, f32::total_cmp).1;
        }
    }
    let [x, y, z] = bounds;
    Some(Aabb { min: Point3::new(x[0], y[0], z[0]), max: Point3::new(x[1], y[1], z[1]) })
}

/// The points moved by a rigid transform.
pub fn transformed(points: &[Point3<f32>], to_from: &Isometry3<f64>) -> Vec<Point3<f32>> {
    let to_from = to_from.cast::<f32>();
    points.iter().map(|p| to_from * p).collect()
}

/// The mean of places in single precision, however far they are from the origin; `None` without any.
pub fn mean_of<const D: usize>(places: impl IntoIterator<Item = [f32; D]>) -> Option<[f32; D]> {
    let mut places = places.into_iter().peekable();
    let mut sum = Sum::near(places.peek()?);
    places.for_each(|place| sum.add(place));
    Some(sum.mean())
}

/// One point (the mean) per occupied voxel of edge `voxel_m`, in order of first occupation.
pub fn voxel_downsampled(points: &[Point3<f32>], voxel_m: f32) -> Vec<Point3<f32>> {
    let mut index = HashMap::with_capacity(points.len() / 4);
    let mut sums: Vec<Sum<3>> = Vec::new();
    for p in points {
        let place: [f32; 3] = (*p).into();
        let slot = *index.entry(cell_of(p, voxel_m)).or_insert_with(|| {
            sums.push(Sum::near(&place));
            sums.len() - 1
        });
        sums[slot].add(place);
    }
    sums.into_iter().map(|sum| Point3::from(sum.mean())).collect()
}

/// Places summed up in single precision, about one of them where that is far from the origin: sums of thousands of large numbers, as places have in the
/// frame of a hall, are off by centimetres.
#[derive(Debug, Clone, Copy)]
struct Sum<const D: usize> {
    about: [f32; D],
    sum: [f32; D],
    count: f32,
}

impl<const D: usize> Sum<D> {
    /// What is nearer to the origin is summed as it is, metres: as far as a camera sees from its own place.
    const NEAR_M: f32 = 4.0;

    /// The empty sum of places near one.
    fn near(place: &[f32; D]) -> Self {
        let is_far = place.iter().any(|along| along.abs() > Self::NEAR_M);
        Self { about: if is_far { *place } else { [0.0; D] }, sum: [0.0; D], count: 0.0 }
    }

    fn add(&mut self, place: [f32; D]) {
        for ((sum, along), about) in self.sum.iter_mut().zip(place).zip(self.about) {
            *sum += along - about;
        }
        self.count += 1.0;
    }

    fn mean(&self) -> [f32; D] {
        std::array::from_fn(|k| self.about[k] + self.sum[k] / self.count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percentiles_ignore_strays() {
        let mut points: Vec<_> = (0..1000).map(|i| Point3::new(i as f32 / 999.0, 0.0, 1.0)).collect();
        points.push(Point3::new(50.0, -50.0, 50.0));
        let b = percentile_box(&points, 0.01, 0.99).unwrap();
        assert!(b.min.x > 0.005 && b.max.x < 1.0 && b.min.y == 0.0 && b.max.z == 1.0);
        assert_eq!(percentile_box(&[], 0.0, 1.0), None);
    }

    #[test]
    fn a_voxel_keeps_the_mean_of_its_points() {
        let points = [Point3::new(0.001, 0.0, 0.0), Point3::new(0.003, 0.0, 0.0), Point3::new(0.012, 0.0, 0.0)];
        let down = voxel_downsampled(&points, 0.005);
        assert_eq!(down.len(), 2);
        assert!((down[0].x - 0.002).abs() < 1e-7);
    }

    #[test]
    fn means_are_as_exact_far_from_the_origin() {
        // In steps of what single precision can tell there.
        let step = |k: usize| (k % 100) as f32 / 32_768.0;
        let places = |[x, y, z]: [f32; 3]| -> Vec<[f32; 3]> { (0..20_000).map(|k| [x + step(k), y - step(k), z + step(k)]).collect() };
        let (middle_m, far) = (49.5 / 32_768.0, [300.0, -200.0, 0.5]);
        let [x, y, z] = mean_of(places(far)).unwrap();
        let off = [x - far[0] - middle_m, y - far[1] + middle_m, z - far[2] - middle_m];
        assert!(off.iter().all(|off| off.abs() < 5e-5), "{off:?}");
        let cloud: Vec<Point3<f32>> = places(far).into_iter().map(Point3::from).collect();
        let down = voxel_downsampled(&cloud, 1.0);
        assert!(down.iter().any(|p| (p.x - x).abs() < 5e-5), "{down:?}");
        // Near the origin it is the plain sum over the count, to the bit.
        let near = places([0.3, -0.2, 0.5]);
        let plain = near.iter().fold([0.0f32; 3], |sum, p| std::array::from_fn(|k| sum[k] + p[k])).map(|sum| sum / 20_000.0);
        assert_eq!(mean_of(near), Some(plain));
        assert_eq!(mean_of::<2>([]), None);
    }
}
