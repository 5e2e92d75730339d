//! The convex outline of points seen from above, and how well it holds what stands on it.

use nalgebra::{Point2, Point3};

/// A convex polygon in the horizontal plane, counter-clockwise.
#[derive(Debug, Clone, PartialEq)]
pub struct Footprint {
    corners: Vec<Point2<f32>>,
    /// From each corner to the next, metres.
    lengths_m: Vec<f32>,
}

impl Footprint {
    /// The convex hull of the points' (x, y) (Andrew's monotone chain); `None` with fewer than three corners.
    pub fn of<'a>(points: impl IntoIterator<Item = &'a Point3<f32>>) -> Option<Self> {
        // Keys of one number each sort several times faster than pairs of coordinates, in the same order.
        let mut keys: Vec<u64> = points.into_iter().map(|p| u64::from(ordinal(p.x)) << 32 | u64::from(ordinal(p.y))).collect();
        keys.sort_unstable();
        let mut xy: Vec<Point2<f32>> =
            keys.into_iter().map(|key| Point2::new(of_ordinal((key >> 32) as u32), of_ordinal(key as u32))).collect();
        xy.dedup();
        let half = |points: &mut dyn Iterator<Item = &Point2<f32>>| {
            let mut chain: Vec<Point2<f32>> = Vec::new();
            for p in points {
                while chain.len() >= 2 && cross(&chain[chain.len() - 2], &chain[chain.len() - 1], p) <= 0.0 {
                    chain.pop();
                }
                chain.push(*p);
            }
            chain.pop();
            chain
        };
        let mut corners = half(&mut xy.iter());
        corners.extend(half(&mut xy.iter().rev()));
        if corners.len() < 3 {
            return None;
        }
        let lengths_m = (0..corners.len()).map(|i| (corners[(i + 1) % corners.len()] - corners[i]).norm()).collect();
        Some(Self { corners, lengths_m })
    }

    /// The hull of a surface's outline as scenes carry it, world x and y, metres; `None` for a line.
    pub fn of_outline(outline_m: &[[f64; 2]]) -> Option<Self> {
        let corners: Vec<Point3<f32>> = outline_m.iter().map(|[x, y]| Point3::new(*x as f32, *y as f32, 0.0)).collect();
        Self::of(&corners)
    }

    /// The corners, counter-clockwise.
    pub fn corners(&self) -> &[Point2<f32>] {
        &self.corners
    }

    /// The area, square metres.
    pub fn area(&self) -> f32 {
        self.edges().map(|(a, b)| a.x * b.y - a.y * b.x).sum::<f32>() / 2.0
    }

    /// How far inside the outline a point lies, metres: positive inside (distance to the nearest edge's line), negative outside.
    pub fn margin(&self, p: &Point2<f32>) -> f32 {
        self.edges().zip(&self.lengths_m).map(|((a, b), length_m)| cross(&a, &b, p) / length_m).fold(f32::INFINITY, f32::min)
    }

    /// Whether a point lies inside or on the outline: whether its margin is not negative.
    pub fn contains(&self, p: &Point2<f32>) -> bool {
        self.edges().all(|(a, b)| cross(&a, &b, p) >= 0.0)
    }

    fn edges(&self) -> impl Iterator<Item = (Point2<f32>, Point2<f32>)> + '_ {
        let (first, rest) = self.corners.split_at(1);
        self.corners.iter().copied().zip(rest.iter().chain(first).copied())
    }
}

/// A number whose order is that of [`f32::total_cmp`].
#[inline]
fn ordinal(x: f32) -> u32 {
    let bits = x.to_bits();
    if bits >> 31 == 0 { bits | 1 << 31 } else { !bits }
}

/// The number that has this ordinal.
#[inline]
fn of_ordinal(ordinal: u32) -> f32 {
    f32::from_bits(if ordinal >> 31 == 1 { ordinal & !(1 << 31) } else { !ordinal })
}

/// Twice the signed area of the triangle; positive when `c` lies left of `a → b`.
#[inline]
fn cross(a: &Point2<f32>, b: &Point2<f32>, c: &Point2<f32>) -> f32 {
    (b - a).perp(&(c - a))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_square_has_its_area_and_margins() {
        let corners = [[0.0, 0.0, 1.0], [1.0, 0.0, 2.0], [1.0, 1.0, 3.0], [0.0, 1.0, 4.0], [0.5, 0.5, 5.0]].map(Point3::from);
        let square = Footprint::of(&corners).unwrap();
        assert_eq!(square.corners().len(), 4);
        assert!((square.area() - 1.0).abs() < 1e-6);
        assert!((square.margin(&Point2::new(0.5, 0.9)) - 0.1).abs() < 1e-6);
        assert!((square.margin(&Point2::new(1.2, 0.5)) + 0.2).abs() < 1e-6);
        for (p, inside) in [([0.5, 0.9], true), ([1.0, 0.2], true), ([1.0, 1.0], true), ([1.001, 0.2], false), ([0.5, -0.01], false)] {
            assert_eq!(square.contains(&Point2::from(p)), inside, "{p:?}");
        }
    }

    #[test]
    fn ordinals_are_in_the_order_of_the_numbers_and_give_them_back() {
        let numbers = [f32::NEG_INFINITY, -2.5, -1e-40, -0.0, 0.0, 1e-40, 0.1, 3.0, f32::INFINITY];
        assert!(numbers.windows(2).all(|pair| ordinal(pair[0]) < ordinal(pair[1])));
        assert!(numbers.iter().all(|x| of_ordinal(ordinal(*x)).to_bits() == x.to_bits()));
    }

    #[test]
    fn points_on_a_line_have_no_footprint() {
        assert_eq!(Footprint::of(&[[0.0, 0.0, 0.0], [1.0, 1.0, 0.0], [2.0, 2.0, 0.0]].map(Point3::from)), None);
    }
}
