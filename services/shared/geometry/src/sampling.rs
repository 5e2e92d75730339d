//! Few points for many: of a cloud, and of a sphere.
//!
//! Farthest point sampling has one fixed order, so that training and serving see the same points. The order starts at the point farthest from
//! the mean and breaks ties by the lowest index. It is computed once per cloud; a crop takes the first n of that order.

use nalgebra::{Point3, Vector3};

/// The indices of up to `count` points in farthest-point order: each next point is the one farthest from all before it.
///
/// O(count · n). Fewer points than `count` gives all of them, still in that order.
pub fn farthest_point_order(points: &[Point3<f32>], count: usize) -> Vec<u32> {
    let count = count.min(points.len());
    if count == 0 {
        return Vec::new();
    }
    let sum = points.iter().fold(Vector3::<f64>::zeros(), |s, p| s + p.coords.cast::<f64>());
    let mean = Point3::from((sum / points.len() as f64).cast::<f32>());
    let mut distance: Vec<f32> = points.iter().map(|p| (p - mean).norm_squared()).collect();
    let mut next = first_largest(&distance);
    distance.fill(f32::INFINITY);
    let mut order = Vec::with_capacity(count);
    while order.len() < count {
        order.push(next as u32);
        let chosen = points[next];
        for (d, p) in distance.iter_mut().zip(points) {
            *d = d.min((p - chosen).norm_squared());
        }
        // A chosen point is at distance 0; duplicates of it too, and still come out in index order.
        distance[next] = -1.0;
        next = first_largest(&distance);
    }
    order
}

/// `count` directions spread evenly over the sphere: a spiral that turns by the golden angle.
pub fn directions(count: usize) -> impl ExactSizeIterator<Item = Vector3<f64>> {
    let golden_rad = std::f64::consts::PI * (3.0 - 5.0_f64.sqrt());
    (0..count).map(move |k| {
        let z = 1.0 - (2 * k + 1) as f64 / count as f64;
        let (radius, (sin, cos)) = ((1.0 - z * z).sqrt(), (k as f64 * golden_rad).sin_cos());
        Vector3::new(radius * cos, radius * sin, z)
    })
}

fn first_largest(values: &[f32]) -> usize {
    let mut best = 0;
    for (i, v) in values.iter().enumerate() {
        if *v > values[best] {
            best = i;
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn an_order_is_a_permutation_and_a_prefix_of_any_longer_one(
            raw in prop::collection::vec(prop::array::uniform3(-1.0..1.0f32), 1..60), n in 1usize..60,
        ) {
            let points: Vec<_> = raw.into_iter().map(Point3::from).collect();
            let all = farthest_point_order(&points, points.len());
            let mut sorted = all.clone();
            sorted.sort_unstable();
            prop_assert_eq!(sorted, (0..points.len() as u32).collect::<Vec<_>>());
            let some = farthest_point_order(&points, n);
            prop_assert_eq!(&some[..], &all[..some.len()]);
        }
    }

    #[test]
    fn it_starts_farthest_from_the_mean_and_ties_go_to_the_lowest_index() {
        let points = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.1, 0.0]].map(Point3::from);
        assert_eq!(farthest_point_order(&points, 4)[..2], [1, 2]);
    }

    #[test]
    fn duplicates_each_come_once() {
        let points = [Point3::new(1.0, 2.0, 3.0); 4];
        assert_eq!(farthest_point_order(&points, 4), [0, 1, 2, 3]);
    }

    #[test]
    fn directions_are_unit_vectors_that_leave_no_large_gap() {
        let all: Vec<Vector3<f64>> = directions(120).collect();
        assert!(all.iter().all(|d| (d.norm() - 1.0).abs() < 1e-12));
        // As many circles of this radius would have to overlap to cover the sphere.
        let nearest = |a: &Vector3<f64>| all.iter().filter(|b| *b != a).map(|b| a.angle(b)).fold(f64::INFINITY, f64::min);
        let gaps: Vec<f64> = all.iter().map(nearest).collect();
        assert!(gaps.iter().all(|gap| (0.2..0.4).contains(gap)), "{gaps:?}");
    }
}
