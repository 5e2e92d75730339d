//! Axis-aligned and oriented boxes.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Point3, Vector3};

/// An axis-aligned box. `min <= max` in every coordinate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aabb {
    /// Lowest corner.
    pub min: Point3<f32>,
    /// Highest corner.
    pub max: Point3<f32>,
}

impl Aabb {
    /// The smallest box around points; `None` without any.
    pub fn of<'a>(points: impl IntoIterator<Item = &'a Point3<f32>>) -> Option<Self> {
        let mut points = points.into_iter();
        let first = *points.next()?;
        Some(points.fold(Self { min: first, max: first }, |b, p| Self { min: b.min.inf(p), max: b.max.sup(p) }))
    }

    /// The box around the points of each label, in one go over a labelled cloud. Label 0 is what belongs to no object, and has none.
    pub fn of_labels(points: &[[f32; 3]], labels: &[u16]) -> BTreeMap<u16, Self> {
        let mut boxes: BTreeMap<u16, Self> = BTreeMap::new();
        for (point, label) in points.iter().zip(labels).filter(|(_, label)| **label > 0) {
            let point = Point3::from(*point);
            let known = boxes.entry(*label).or_insert(Self { min: point, max: point });
            *known = Self { min: known.min.inf(&point), max: known.max.sup(&point) };
        }
        boxes
    }

    /// The middle of the box (not the centroid of what it was made from).
    pub fn center(&self) -> Point3<f32> {
        nalgebra::center(&self.min, &self.max)
    }

    /// Edge lengths.
    pub fn extent(&self) -> Vector3<f32> {
        self.max - self.min
    }

    /// Whether a point lies inside or on the border.
    pub fn contains(&self, p: &Point3<f32>) -> bool {
        (0..3).all(|k| self.min[k] <= p[k] && p[k] <= self.max[k])
    }

    /// The same box, larger by `margin` on every side.
    pub fn inflated(&self, margin: f32) -> Self {
        let m = Vector3::repeat(margin);
        Self { min: self.min - m, max: self.max + m }
    }

    /// Distance between two boxes; 0 when they touch or overlap.
    pub fn distance(&self, other: &Self) -> f32 {
        let gap = (self.min - other.max).sup(&(other.min - self.max)).sup(&Vector3::zeros());
        gap.norm()
    }

    /// As an oriented box with identity rotation.
    pub fn oriented(&self) -> OrientedBox {
        OrientedBox {
            world_from_box: Isometry3::translation(f64::from(self.center().x), f64::from(self.center().y), f64::from(self.center().z)),
            half_extents: self.extent().cast::<f64>() / 2.0,
        }
    }
}

/// A box with a pose: its frame's origin is its centre and its axes are its edges.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OrientedBox {
    /// Pose of the box's centre and axes.
    pub world_from_box: Isometry3<f64>,
    /// Half the edge lengths along the box's axes, metres.
    pub half_extents: Vector3<f64>,
}

impl OrientedBox {
    /// The centre, in the world.
    pub fn center(&self) -> Point3<f64> {
        Point3::from(self.world_from_box.translation.vector)
    }

    /// The eight corners, in the world; bit k of the index chooses the side along axis k.
    pub fn corners(&self) -> [Point3<f64>; 8] {
        std::array::from_fn(|i| {
            let sign = |k: usize| if i >> k & 1 == 1 { 1.0 } else { -1.0 };
            let h = &self.half_extents;
            self.world_from_box * Point3::new(sign(0) * h.x, sign(1) * h.y, sign(2) * h.z)
        })
    }

    /// The box moved by a rigid transform.
    pub fn transformed(&self, to_from: &Isometry3<f64>) -> Self {
        Self { world_from_box: to_from * self.world_from_box, half_extents: self.half_extents }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn corners_of_an_axis_aligned_box_are_its_extremes() {
        let aabb = Aabb { min: Point3::new(-1.0, 0.0, 2.0), max: Point3::new(1.0, 3.0, 2.5) };
        let corners = aabb.oriented().corners();
        let back = Aabb::of(&corners.map(|c| c.cast::<f32>())).unwrap();
        assert!((back.min - aabb.min).norm() < 1e-6 && (back.max - aabb.max).norm() < 1e-6);
    }

    #[test]
    fn each_label_of_a_cloud_has_the_box_around_its_own_points() {
        let points = [[9.0, 9.0, 9.0], [1.0, 2.0, 3.0], [-1.0, 4.0, 3.5], [0.5, 0.5, 0.5]];
        let boxes = Aabb::of_labels(&points, &[0, 7, 7, 2]);
        let around = |ids: &[usize]| Aabb::of(&ids.iter().map(|i| Point3::from(points[*i])).collect::<Vec<_>>()).unwrap();
        assert_eq!(boxes, BTreeMap::from([(2, around(&[3])), (7, around(&[1, 2]))]));
        assert_eq!(boxes[&7].center(), Point3::new(0.0, 3.0, 3.25));
    }

    #[test]
    fn distance_between_boxes_is_the_gap() {
        let a = Aabb { min: Point3::origin(), max: Point3::new(1.0, 1.0, 1.0) };
        let b = Aabb { min: Point3::new(1.3, 1.4, 0.2), max: Point3::new(2.0, 2.0, 0.8) };
        assert!((a.distance(&b) - 0.5).abs() < 1e-6);
        assert_eq!(a.distance(&a), 0.0);
    }
}
