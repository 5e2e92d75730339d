//! The neighbours of centroids: the first k points in sampling order within a radius.

use crate::kernel::{Kernel, PointColumns};
use crate::neighbours::Neighbours;

/// The first `most` of `points` (in the order given) within `radius_m` of each of the first `centroids` points.
pub fn ball_query(kernel: Kernel, points: &[[f32; 3]], centroids: usize, most: usize, radius_m: f32) -> Neighbours {
    let columns = PointColumns::new(points);
    let mut lists = Neighbours::new();
    let mut list = Vec::with_capacity(most);
    for center in points.iter().take(centroids) {
        list.clear();
        kernel.within(&columns, *center, radius_m, most, &mut list);
        lists.push(&list);
    }
    lists
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn lists_hold_the_first_points_within_the_radius_for_every_kernel(
            points in prop::collection::vec(prop::array::uniform3(-0.2..0.2f32), 1..120), most in 1usize..20,
        ) {
            for kernel in Kernel::available() {
                let lists = ball_query(kernel, &points, 10, most, 0.1);
                prop_assert_eq!(lists.centroids(), points.len().min(10));
                for i in 0..lists.centroids() {
                    let near = |p: &[f32; 3]| (0..3).map(|k| (p[k] - points[i][k]).powi(2)).sum::<f32>() <= 0.1f32 * 0.1;
                    let expected: Vec<u32> = (0..points.len() as u32).filter(|j| near(&points[*j as usize])).take(most).collect();
                    prop_assert_eq!(lists.of(i), &expected[..]);
                }
            }
        }
    }
}
