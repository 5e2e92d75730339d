//! The convex outline of points seen from above, and how well it holds what stands on it.

use nalgebra::{Point2, Point3};

/// A convex polygon in the horizontal plane, counter-clockwise.
#[derive(Debug, Clone, PartialEq)]
pub struct Footprint {
    corners: Vec<Point2<f32>>,
    /// The length of the edge from each corner to the next, metres: margins are asked of many points.
    lengths_m: Vec<f32>,
}

impl Footprint {
    /// The convex hull of the points' (x, y) (Andrew's monotone chain); `None` with fewer than three corners.
    pub fn of<'a>(points: impl IntoIterator<Item = &'a Point3<f32>>) -> Option<Self> {
        Self::of_places(points.into_iter().map(Point3::xy))
    }

    /// The same of places seen from above.
    pub fn of_places(places: impl IntoIterator<Item = Point2<f32>>) -> Option<Self> {
        let mut xy: Vec<Point2<f32>> = places.into_iter().collect();
        drop_inner(&mut xy);
        Self::hull(&xy)
    }

    /// The common outline of two; `None` where rounding leaves none.
    pub fn around_both(&self, other: &Self) -> Option<Self> {
        Self::of_places(self.corners.iter().chain(&other.corners).copied())
    }

    /// The convex hull of some points.
    fn hull(points: &[Point2<f32>]) -> Option<Self> {
        // Keys of one number each sort several times faster than pairs of coordinates, in the same order.
        // Adding 0 makes one number of the two zeros, which are one place and two ordinals.
        let key = |p: &Point2<f32>| u64::from(ordinal(p.x + 0.0)) << 32 | u64::from(ordinal(p.y + 0.0));
        let mut keys: Vec<u64> = points.iter().map(key).collect();
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
        (corners.len() >= 3).then(|| Self { lengths_m: edges(&corners).map(|(a, b)| (b - a).norm()).collect(), corners })
    }

    /// The hull of a surface's outline as scenes carry it, world x and y, metres; `None` for a line.
    pub fn of_outline(outline_m: &[[f64; 2]]) -> Option<Self> {
        Self::of_places(outline_m.iter().map(|[x, y]| Point2::new(*x as f32, *y as f32)))
    }

    /// The corners, counter-clockwise.
    pub fn corners(&self) -> &[Point2<f32>] {
        &self.corners
    }

    /// The least and the greatest coordinates.
    pub fn bounds(&self) -> (Point2<f32>, Point2<f32>) {
        self.corners.iter().fold((self.corners[0], self.corners[0]), |(min, max), c| (min.inf(c), max.sup(c)))
    }

    /// The area, square metres.
    pub fn area(&self) -> f32 {
        // From a corner, not from the origin: far from that the area is a small difference of large numbers.
        edges(&self.corners).map(|(a, b)| cross(&self.corners[0], a, b)).sum::<f32>() / 2.0
    }

    /// How far inside the outline a point lies, metres: positive inside (distance to the nearest edge's line), negative outside.
    pub fn margin(&self, p: &Point2<f32>) -> f32 {
        edges(&self.corners).zip(&self.lengths_m).map(|((a, b), length_m)| cross(a, b, p) / length_m).fold(f32::INFINITY, f32::min)
    }

    /// Whether a point lies inside or on the outline: whether its margin is not negative.
    pub fn contains(&self, p: &Point2<f32>) -> bool {
        edges(&self.corners).all(|(a, b)| cross(a, b, p) >= 0.0)
    }
}

/// Each corner of a polygon with the next.
fn edges(corners: &[Point2<f32>]) -> impl Iterator<Item = (&Point2<f32>, &Point2<f32>)> {
    corners.iter().zip(corners.iter().skip(1).chain(corners.first()))
}

/// Drops points that are clearly inside of those farthest out in eight directions (Akl and Toussaint): no corner is among them, and fewer are sorted.
fn drop_inner(xy: &mut Vec<Point2<f32>>) {
    /// So few points are sorted as quickly.
    const FEW: usize = 64;
    /// As a share of the points' extent: far above what rounding moves.
    const CLEARLY: f32 = 1e-3;
    if xy.len() < FEW {
        return;
    }
    let towards = [[1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [-1.0, 1.0], [-1.0, 0.0], [-1.0, -1.0], [0.0, -1.0], [1.0, -1.0f32]];
    let mut farthest = [(f32::NEG_INFINITY, xy[0]); 8];
    for p in xy.iter() {
        for ([x, y], farthest) in towards.iter().zip(&mut farthest) {
            let along = x * p.x + y * p.y;
            if along > farthest.0 {
                *farthest = (along, *p);
            }
        }
    }
    let mut octagon: Vec<Point2<f32>> = farthest.iter().map(|(_, p)| *p).collect();
    octagon.dedup();
    let extent = (farthest[0].0 + farthest[4].0).max(farthest[2].0 + farthest[6].0);
    let lines: Vec<[f32; 3]> = edges(&octagon)
        .filter(|(a, b)| a != b)
        .map(|(a, b)| (a, (b - a).normalize()))
        .map(|(a, along)| [-along.y, along.x, along.y * a.x - along.x * a.y])
        .collect();
    // True where a coordinate is no number: such points are sorted as before.
    xy.retain(|p| lines.len() < 3 || !lines.iter().all(|[nx, ny, d]| nx * p.x + ny * p.y + d > CLEARLY * extent));
}

/// A number whose order is that of [`f32::total_cmp`].
#[inline]
pub fn ordinal(x: f32) -> u32 {
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
        assert_eq!(square.bounds(), (Point2::new(0.0, 0.0), Point2::new(1.0, 1.0)));
        assert!((square.area() - 1.0).abs() < 1e-6);
        assert!((square.margin(&Point2::new(0.5, 0.9)) - 0.1).abs() < 1e-6);
        assert!((square.margin(&Point2::new(1.2, 0.5)) + 0.2).abs() < 1e-6);
        for (p, inside) in [([0.5, 0.9], true), ([1.0, 0.2], true), ([1.0, 1.0], true), ([1.001, 0.2], false), ([0.5, -0.01], false)] {
            assert_eq!(square.contains(&Point2::from(p)), inside, "{p:?}");
        }
    }

    #[test]
    fn an_area_is_as_exact_far_from_the_origin() {
        // Of coordinates that are exact in either place.
        let area_m2 = |x: f32, y: f32| {
            let (wide, deep) = (100.0 / 1024.0, 60.0 / 1024.0);
            let corners = [[x, y, 0.0], [x + wide, y, 0.0], [x + wide, y + deep, 0.0], [x, y + deep, 0.0]].map(Point3::from);
            Footprint::of(&corners).unwrap().area()
        };
        assert_eq!(area_m2(800.0, -500.0), area_m2(0.0, 0.0));
    }

    #[test]
    fn ordinals_are_in_the_order_of_the_numbers_and_give_them_back() {
        let numbers = [f32::NEG_INFINITY, -2.5, -1e-40, -0.0, 0.0, 1e-40, 0.1, 3.0, f32::INFINITY];
        assert!(numbers.windows(2).all(|pair| ordinal(pair[0]) < ordinal(pair[1])));
        assert!(numbers.iter().all(|x| of_ordinal(ordinal(*x)).to_bits() == x.to_bits()));
    }

    #[test]
    fn inner_points_change_no_corner() {
        // A disc of a sunflower's seeds.
        let seed = |k: usize| ((k as f32 + 0.5) / 2000.0).sqrt() * 0.3;
        let at = |k: usize, r: f32| Point3::new(0.4 + r * (k as f32 * 2.399_963).cos(), r * (k as f32 * 2.399_963).sin(), 0.0);
        let disc: Vec<Point3<f32>> = (0..2000).map(|k| at(k, seed(k))).collect();
        let all: Vec<Point2<f32>> = disc.iter().map(Point3::xy).collect();
        let mut outer = all.clone();
        drop_inner(&mut outer);
        assert!(outer.len() < 400, "{}", outer.len());
        assert_eq!(Footprint::of(&disc), Footprint::hull(&all));
        let line: Vec<Point3<f32>> = (0..200).map(|k| Point3::new(k as f32, 0.0, 0.0)).collect();
        assert_eq!(Footprint::of(&line), None);
    }

    #[test]
    fn zeros_of_either_sign_are_the_same_place() {
        let corners = [[-0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [0.0, 2.0, 0.0], [1.0, -0.0, 0.0], [1.0, 2.0, 0.0]].map(Point3::from);
        let rectangle = Footprint::of(&corners).unwrap();
        let whole: [Point2<f32>; 4] = [[0.0, 0.0], [1.0, 0.0], [1.0, 2.0], [0.0, 2.0]].map(Point2::from);
        assert_eq!(rectangle.corners(), whole);
    }

    #[test]
    fn points_on_a_line_have_no_footprint() {
        assert_eq!(Footprint::of(&[[0.0, 0.0, 0.0], [1.0, 1.0, 0.0], [2.0, 2.0, 0.0]].map(Point3::from)), None);
    }
}
