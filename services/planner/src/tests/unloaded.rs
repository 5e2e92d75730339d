//! What is believed of carriers once what they carried is gone.

use std::sync::Arc;

use nalgebra::{Isometry3, Point2, Point3, Vector2, Vector3};
use repose_belief::shape::{Shape, Slab};
use repose_geometry::{Footprint, cloud};
use repose_proto::place::Variant;

use crate::checks::footing::Ground;
use crate::checks::prisms::PlacedPrisms;
use crate::scene::candidate::CandidatePose;
use crate::scene::moved::{table_after, table_without};
use crate::scene::prepared::PreparedScene;
use crate::settings::Fixed;
use crate::tests::synthetic::{SceneBuilder, standing_at};

/// An upright box: its id, its middle seen from above, its bottom, and its size.
type KnownBox = (u16, [f64; 2], f64, [f64; 3]);

/// A table of boxes whose shapes are known.
fn known(boxes: &[KnownBox]) -> PreparedScene {
    let scene = boxes.iter().fold(SceneBuilder::table(), |table, (id, at, bottom_m, size)| table.object_at(*id, *at, *bottom_m, *size));
    let scene = scene.scene();
    let shape = |(id, [x, y], bottom_m, [dx, dy, dz]): &KnownBox| {
        let corners: [[f64; 2]; 4] = [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]];
        let outline = Footprint::of_places(corners.map(|[i, j]| Point2::new(x + i * dx, y + j * dy).cast::<f32>())).unwrap();
        let points: Vec<Point3<f32>> = scene.points_of(*id).map(Point3::from).collect();
        let (axis, bottom_m, top_m) = (Point2::new(*x, *y).cast::<f32>(), *bottom_m as f32, (bottom_m + dz) as f32);
        let shape = Shape {
            centroid: cloud::centroid(&points).unwrap(),
            axis,
            turn_axis: axis,
            turn_base: outline.clone(),
            bottom_m,
            top_m,
            slabs: vec![Slab::of(bottom_m, top_m, outline.clone())],
            base: outline,
            doubt: Vector2::zeros(),
            ends: Vec::new(),
            foot_probability: 1.0,
            foot_doubt_m: 0.0,
            landing_probability: 1.0,
        };
        (*id, shape)
    };
    let shapes = boxes.iter().map(shape).collect();
    PreparedScene::with_shapes(Arc::new(scene), shapes)
}

#[test]
fn all_that_is_believed_of_a_carrier_is_about_one_centroid() {
    let block = [0.1, 0.1, 0.05];
    let table = known(&[(1, [0.0, 0.0], 0.0, block), (2, [0.0, 0.01], 0.05, [0.08, 0.08, 0.1]), (3, [0.3, -0.2], 0.0, [0.05; 3])]);
    assert_eq!(table.belief.carried(1), [2]);
    let upside_down = Isometry3::new(Vector3::new(-0.3, -0.2, 0.15), Vector3::x() * std::f64::consts::PI);
    let moved = [Isometry3::translation(-0.3, -0.2, -0.05), upside_down].map(|motion| table_after(&table, 2, &motion, Variant::Full));
    for after in moved.iter().chain([&table_without(&table, 2)]) {
        for (id, object) in &after.belief.objects {
            let shape = object.shape.as_ref().unwrap();
            assert!((object.centroid - shape.centroid).norm() < 1e-6, "{id}: {} and {}", object.centroid, shape.centroid);
        }
        let fixed = Fixed::default();
        let query = after.query(1, 0.0, &fixed).unwrap();
        let candidate = CandidatePose { yaw_rad: 0.7, ..standing_at(&query, 0.2, 0.1, fixed.support.release_m) };
        let (placed, inside_m) = (PlacedPrisms::new(&query.shape, &candidate), query.bottom_of(candidate.centroid_m[2]) + 0.01);
        let places = query.base.iter().map(|offset| candidate.carry(&offset));
        let off_m = places.map(|place| placed.to_point_m(&Point3::new(place.x, place.y, inside_m))).fold(0.0, f32::max);
        assert!(query.base.len() > 300 && off_m < 1e-4, "cells of its base are up to {off_m} m beside its prisms");
    }
}

#[test]
fn what_lay_across_two_objects_leaves_a_top_on_each_and_nothing_between_them() {
    let (wide, board) = ([0.12, 0.2, 0.05], [0.3, 0.12, 0.02]);
    let cup = (4, [0.35, -0.25], 0.0, [0.05, 0.05, 0.08]);
    let table = known(&[(1, [-0.09, 0.0], 0.0, wide), (2, [0.0, 0.0], 0.05, board), (3, [0.09, 0.0], 0.0, wide), cup]);
    assert_eq!([table.belief.carried(1), table.belief.carried(3)], [[2], [2]]);
    let moved = table_after(&table, 2, &Isometry3::translation(0.0, 0.27, -0.05), Variant::Full);
    for after in [moved, table_without(&table, 2)] {
        let shapes = [1u16, 3].map(|id| after.belief.objects[&id].shape.clone().unwrap());
        let is_over_the_gap = |shape: &Shape| shape.slabs.iter().any(|slab| slab.outline.contains(&Point2::origin()));
        assert!(shapes[0].gap_m(&shapes[1]) > 0.055 && !shapes.iter().any(is_over_the_gap), "{shapes:?}");
        let at_the_top = |id: u16, x: f32, half_m: f32| {
            let is_there = |p: &[f32; 3]| (p[0] - x).abs() < half_m && p[1].abs() < 0.05 && (p[2] - 0.05).abs() < 0.006;
            after.scene.points_of(id).filter(is_there).count()
        };
        assert_eq!([1, 3].map(|id| at_the_top(id, 0.0, 0.025)), [0, 0]);
        assert!(at_the_top(1, -0.09, 0.05) > 100 && at_the_top(3, 0.09, 0.05) > 100, "where the board lay");
        let fixed = Fixed::default();
        let query = after.query(4, 0.0, &fixed).unwrap();
        let ground = Ground { prepared: &after, query: &query, settings: &fixed.support };
        let standing = |x: f32| standing_at(&query, x, 0.0, 0.05 + fixed.support.release_m);
        assert_eq!((ground.objects_under(&standing(0.0)), ground.footing(&standing(0.0)).carrier), (Vec::new(), None));
        assert_eq!([-0.09, 0.09].map(|x| ground.footing(&standing(x)).carrier), [Some(1), Some(3)]);
    }
}
