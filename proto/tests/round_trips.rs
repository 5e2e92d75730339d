//! Whatever is written is read back the same: any numbers, any sizes. A scene keeps its id on the way.

mod common;

use std::collections::BTreeMap;

use common::*;
use proptest::prelude::*;
use repose_proto::*;

/// Numbers of all magnitudes that JSON can carry.
fn number() -> impl Strategy<Value = f64> {
    prop_oneof![any::<f64>().prop_filter("JSON has no NaN and no infinity", |v| v.is_finite()), -10.0..10.0f64]
}

fn vector() -> impl Strategy<Value = [f64; 3]> {
    prop::array::uniform3(number())
}

proptest! {
    #[test]
    fn a_scene_keeps_its_content_and_its_id(
        points in prop::collection::vec(prop::array::uniform3(-1e3..1e3f32), 2..40),
        centroid_m in vector(),
        // As points are, surfaces are within a kilometre.
        height_m in -1e3..1e3f64,
        outline_m in prop::collection::vec(prop::array::uniform2(-1e3..1e3f64), 0..8),
        fx in 1e-3..1e6f64,
        view_yaw_rad in number(),
        share in number(),
    ) {
        let mut scene = scene();
        scene.labels = (0..points.len()).map(|i| (i % 3) as u16).collect();
        scene.labels[1] = 2;
        scene.colors = None;
        scene.points = points;
        scene.meta.objects = vec![ObjectSummary { id: 2, points: 1, centroid_m, extent_m: centroid_m, completeness: share, score: None }];
        scene.meta.surfaces = vec![Surface { height_m, outline_m, area_m2: share, object: None }];
        scene.meta.camera.fx = fx;
        scene.meta.view_yaw_rad = view_yaw_rad;
        scene.meta.unseen.share = share;
        let read = Scene::from_bulk(&Bulk::decode(&scene.to_bulk().encode()).unwrap()).unwrap();
        prop_assert_eq!(&read, &scene);
        prop_assert_eq!(read.id(), scene.id());
    }

    #[test]
    fn a_frame_of_any_size_keeps_its_pictures(width in 1usize..30, height in 1usize..30, stamp_ns: u64, color: bool, labels: bool) {
        let pixels = width * height;
        let count = |i: usize| (i * 7919 % 65536) as u16;
        let frame = Frame {
            stamp_ns,
            camera: CameraModel { width, height, ..camera() },
            depth: (0..pixels).map(count).collect(),
            color: color.then(|| (0..pixels).map(|i| [i as u8, (i / 3) as u8, 255]).collect()),
            labels: labels.then(|| (0..pixels).map(|i| count(i + 1)).collect()),
            ..frame()
        };
        frame.validate().unwrap();
        prop_assert_eq!(Frame::from_bulk(&Bulk::decode(&frame.to_bulk().encode()).unwrap()).unwrap(), frame);
    }

    #[test]
    fn any_tensors_and_metadata_survive_in_canonical_order(
        values in prop::collection::vec(any::<u8>(), 0..64),
        names in prop::collection::btree_set("[a-z][a-z0-9_]{0,12}", 1..5),
        text in ".{0,40}",
    ) {
        let tensors: BTreeMap<_, _> = names.iter().map(|n| (n.clone(), Tensor::u8(&[values.len()], &values))).collect();
        let bulk = Bulk { metadata: BTreeMap::from([("text".to_owned(), text)]), tensors };
        let bytes = bulk.encode();
        let read = Bulk::decode(&bytes).unwrap();
        prop_assert_eq!(&read, &bulk);
        prop_assert_eq!(read.encode(), bytes);
    }

    #[test]
    fn results_keep_every_bit_of_their_numbers(cost in number(), realism in number(), margin_m in number(), pose in prop::array::uniform16(number())) {
        let mut result = place_result();
        result.placements[0].cost = cost;
        result.placements[0].realism = Some(realism);
        result.placements[0].geometric[0].margin_m = margin_m;
        result.placements[0].placed_from_observed = RigidTransform(pose);
        let payload = Payload::json(&result).unwrap();
        let read = payload.decode_json::<PlaceResult>().unwrap();
        prop_assert_eq!(&read, &result);
        prop_assert_eq!(Payload::json(&read).unwrap().bytes, payload.bytes);
    }

    #[test]
    fn good_names_make_keys_that_name_them(cell in "[a-z0-9][a-z0-9_-]{0,63}", worker in "[a-z0-9][a-z0-9_-]{0,63}") {
        let keys = Cell::new(&cell).unwrap();
        keys::validate_chunk("worker", &worker).unwrap();
        for key in [keys.load(Service::Planner, &worker), keys.call(Service::Planner, &worker)] {
            prop_assert_eq!(keys::worker_of(&key), Some(worker.as_str()));
        }
        let (live, cancel) = (keys.live(Service::Planner, &worker), keys.cancel(Service::Planner, &worker, "r-1"));
        prop_assert_eq!((keys::last_chunk(&live), keys::last_chunk(&cancel)), (worker.as_str(), "r-1"));
    }

    #[test]
    fn names_outside_the_alphabet_are_refused(name in ".{0,70}") {
        let good = name.len() <= 64
            && name.chars().enumerate().all(|(i, c)| c.is_ascii_lowercase() || c.is_ascii_digit() || (i > 0 && (c == '_' || c == '-')))
            && !name.is_empty();
        prop_assert_eq!(Cell::new(&name).is_ok(), good);
    }
}

#[test]
fn a_variant_has_one_name_on_the_wire_and_on_the_command_line() {
    for variant in place::Variant::ALL {
        assert_eq!(serde_json::to_value(variant).unwrap(), variant.as_str());
        assert_eq!(serde_json::from_value::<place::Variant>(variant.as_str().into()).unwrap(), variant);
    }
}
