//! The ways of computing a network agree: candle list by list and with all pairs at once, candle with the fused operation, and serving's kernels.

use candle_core::{Device, Tensor, backprop::GradStore};
use nalgebra::Point3;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use repose_networks::{
    Candidate, InputError, Kernel, Models, Networks, NetworksConfig, SceneContext, Weights, WeightsInfo, crops,
    crops::Grouped,
    layers::Mode,
    pair_measures::{MeasuredCloud, PAIR_MEASURES, pair_measures},
    parameters::Parameters,
    points::{CloudConfig, ObjectCloud, Observer, SceneCloud},
    set_abstraction::Path,
    shared_scene::SharedScene,
};

/// Where the camera of all scenes is.
const OBSERVER: Observer = Observer { eye: Point3::new(-0.2, -0.8, 0.6), pixel_rad: 0.002 };

/// A table with a box (1) and a ball (2) on it: world points and labels.
fn scene(seed: u64) -> (Vec<Point3<f32>>, Vec<u16>) {
    let mut rng = Pcg64::seed_from_u64(seed);
    let mut points = Vec::new();
    let mut labels = Vec::new();
    for i in 0..30_000u32 {
        let (u, v): (f32, f32) = (rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0));
        let (p, label) = match i % 10 {
            0 => (Point3::new(0.04 * u, 0.03 * v, 0.08), 1),
            1 => (Point3::new(0.04 * u, -0.03, 0.04 + 0.04 * v), 1),
            2 => {
                let r = (1.0 - u * u).sqrt();
                (Point3::new(0.2 + 0.03 * r * (3.1 * v).cos(), 0.03 * r * (3.1 * v).sin(), 0.03 + 0.03 * u), 2)
            }
            _ => (Point3::new(0.6 * u, 0.5 * v, 0.0), 0),
        };
        points.push(p);
        labels.push(label);
    }
    (points, labels)
}

fn clouds() -> (SceneCloud, ObjectCloud) {
    let (points, labels) = scene(1);
    let config = CloudConfig::default();
    let object: Vec<_> = points.iter().zip(&labels).filter(|(_, l)| **l == 1).map(|(p, _)| *p).collect();
    (SceneCloud::new(&points, &labels, &[], &config).without(1), ObjectCloud::new(&object, &OBSERVER, &config).unwrap())
}

fn discriminator_batch(config: &NetworksConfig, kernel: Kernel) -> Vec<Grouped> {
    let (scene, object) = clouds();
    [[0.0, 0.1, 0.05], [0.1, -0.1, 0.06]].map(|at| crops::discriminator_input(kernel, config, &scene, &object, at)).to_vec()
}

fn largest_difference(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

/// Of the parameters under `part`; close as vectors: a near tie, or a ReLU at zero, that rounding decides the other way moves one whole gradient.
fn assert_same_gradients(parameters: &Parameters, part: &str, other: &GradStore, plain: &GradStore) {
    let norm = |v: &mut dyn Iterator<Item = f32>| v.map(|x| x * x).sum::<f32>().sqrt();
    for (name, var) in parameters.trainable.iter().filter(|(name, _)| name.starts_with(part)) {
        let [other, plain] = [other, plain].map(|grads| grads.get(var).unwrap().flatten_all().unwrap().to_vec1::<f32>().unwrap());
        let difference = norm(&mut other.iter().zip(&plain).map(|(a, b)| a - b));
        let size = norm(&mut plain.iter().copied());
        assert!(difference < 0.05 * size + 1e-3, "{name}: {difference} of {size}");
    }
}

#[test]
fn the_fused_operation_equals_candle_forward_and_backward() {
    let config = NetworksConfig::default();
    let (networks, parameters) = Networks::seeded(&config, &mut Pcg64::seed_from_u64(3), &Device::Cpu).unwrap();
    let batch = Grouped::concat(&discriminator_batch(&config, Kernel::detect()));
    let target = Tensor::new(&[0.3f32, -0.7], &Device::Cpu).unwrap();
    let run = |path| {
        let mode = Mode::Training(Default::default());
        let logits = networks.discriminator.logits(&batch, &mode, path).unwrap();
        let loss = (&logits - &target).unwrap().sqr().unwrap().sum_all().unwrap();
        (logits.to_vec1::<f32>().unwrap(), loss.backward().unwrap())
    };
    let (plain, plain_grads) = run(Path::Plain);
    for path in [Path::Fused, Path::Gathered] {
        let (other, grads) = run(path);
        assert!(largest_difference(&other, &plain) < 1e-4, "{path:?}: {other:?} {plain:?}");
        assert_same_gradients(&parameters, "discriminator", &grads, &plain_grads);
    }
}

#[test]
fn three_layer_set_abstractions_have_the_same_gradient_too() {
    let config = NetworksConfig::default();
    let (networks, parameters) = Networks::seeded(&config, &mut Pcg64::seed_from_u64(4), &Device::Cpu).unwrap();
    let (_, object) = clouds();
    let kernel = Kernel::detect();
    let batch =
        Grouped::concat(&[crops::object_input(kernel, &config, &object), crops::object_input(kernel, &config, &object.turned(0.8))]);
    let run = |path| {
        let shapes = networks.object.shapes(&batch, &Mode::Training(Default::default()), path).unwrap();
        let loss = shapes.sqr().unwrap().sum_all().unwrap();
        (shapes.flatten_all().unwrap().to_vec1::<f32>().unwrap(), loss.backward().unwrap())
    };
    let (plain, plain_grads) = run(Path::Plain);
    for path in [Path::Fused, Path::Gathered] {
        let (other, grads) = run(path);
        assert!(largest_difference(&other, &plain) < 1e-3, "{path:?}: {other:?} {plain:?}");
        assert_same_gradients(&parameters, "object/sa", &grads, &plain_grads);
    }
}

#[test]
fn serving_equals_candle_on_every_kernel() {
    let config = NetworksConfig::default();
    let (networks, parameters) = Networks::seeded(&config, &mut Pcg64::seed_from_u64(5), &Device::Cpu).unwrap();
    let bytes = Weights::to_bytes(&parameters.to_map().unwrap(), &WeightsInfo::default()).unwrap();
    let (points, labels) = scene(1);
    let candidates =
        [Candidate { position_in_world: [0.0, 0.1, 0.05], yaw_rad: 0.0 }, Candidate { position_in_world: [0.1, -0.1, 0.06], yaw_rad: 1.1 }];
    for kernel in Kernel::available() {
        let models = Models::load_for(&bytes, kernel).unwrap();
        let context = SceneContext::new(&points, &labels, 0.0, &OBSERVER, &config.cloud).unwrap();
        let realism = models.realism(&context, 1, &candidates, 2).unwrap();
        let (scene, object) = {
            let centers: Vec<_> = context.objects().map(|l| context.centroid_in_world(l).unwrap()).collect();
            let object: Vec<_> = points.iter().zip(&labels).filter(|(_, l)| **l == 1).map(|(p, _)| *p).collect();
            (
                SceneCloud::new(&points, &labels, &centers, &config.cloud).without(1),
                ObjectCloud::new(&object, &OBSERVER, &config.cloud).unwrap(),
            )
        };
        let crops = candidates.map(|c| crops::discriminator_input(kernel, &config, &scene, &object.turned(c.yaw_rad), c.position_in_world));
        let logits = networks.discriminator.logits(&Grouped::concat(&crops), &Mode::Serving, Path::Plain).unwrap();
        let plain = candle_sigmoid(&logits);
        assert!(largest_difference(&realism, &plain) < 1e-4, "{}: {realism:?} {plain:?}", kernel.id());

        let shared = SharedScene::new(kernel, &config, &scene);
        let placed = candidates.map(|c| shared.placed(kernel, &config, &object.turned(c.yaw_rad), c.position_in_world));
        let logits = networks.outcome.as_ref().unwrap().logits(&shared.grouped(&placed), &Mode::Serving, Path::Plain).unwrap();
        let (outcome, plain) = (models.outcome(&context, 1, &candidates, 2).unwrap(), candle_sigmoid(&logits));
        assert!(largest_difference(&outcome, &plain) < 1e-4, "{}: {outcome:?} {plain:?}", kernel.id());

        let anchor: Vec<_> = points.iter().zip(&labels).filter(|(_, l)| **l == 2).map(|(p, _)| *p).collect();
        let anchor = ObjectCloud::new(&anchor, &OBSERVER, &config.cloud).unwrap();
        let inputs = candidates.map(|c| crops::object_input(kernel, &config, &object.turned(c.yaw_rad)));
        let queries = networks.object.shapes(&Grouped::concat(&inputs), &Mode::Serving, Path::Plain).unwrap();
        let centers: Vec<f32> =
            candidates.iter().flat_map(|c| (0..3).map(|k| c.position_in_world[k] - anchor.centroid_in_viewer[k])).collect();
        let centers = Tensor::from_vec(centers, (2, 3), &Device::Cpu).unwrap();
        let anchors = networks.object.shapes(&crops::object_input(kernel, &config, &anchor), &Mode::Serving, Path::Plain).unwrap();
        let anchors = networks.object.codes(&anchors, &Tensor::zeros((1, 3), candle_core::DType::F32, &Device::Cpu).unwrap()).unwrap();
        let anchors = anchors.repeat((2, 1)).unwrap();
        let measured = MeasuredCloud::new(&anchor);
        let measures: Vec<f32> = candidates
            .iter()
            .flat_map(|c| {
                let offset = std::array::from_fn(|k| c.position_in_world[k] - anchor.centroid_in_viewer[k]);
                pair_measures(&MeasuredCloud::new(&object.turned(c.yaw_rad)), &measured, offset)
            })
            .collect();
        let measures = Tensor::from_vec(measures, (2, PAIR_MEASURES), &Device::Cpu).unwrap();
        let logits = networks.relations.logits(&networks.object.codes(&queries, &centers).unwrap(), &anchors, &measures).unwrap();
        let relations: Vec<f32> = models.relations(&context, 1, &[2], &candidates, 1).unwrap().concat().concat();
        assert!(largest_difference(&relations, &candle_sigmoid(&logits.flatten_all().unwrap())) < 1e-4, "{}", kernel.id());
    }
}

fn candle_sigmoid(logits: &Tensor) -> Vec<f32> {
    logits.to_vec1::<f32>().unwrap().iter().map(|x| 1.0 / (1.0 + (-x).exp())).collect()
}

#[test]
fn the_prior_does_not_see_where_the_query_stood() {
    let models = Models::load(&Weights::initial(&NetworksConfig::default(), 6).unwrap()).unwrap();
    let (points, labels) = scene(2);
    let moved: Vec<_> =
        points.iter().zip(&labels).map(|(p, l)| if *l == 1 { p + nalgebra::Vector3::new(0.128, 0.064, 0.0) } else { *p }).collect();
    let goal = [0, 1, 0, 0, 0, 0, 0, 0, 0, 0];
    let mixture = |points: &[Point3<f32>]| {
        let context =
            SceneContext::new(points, &labels, 0.0, &OBSERVER, &CloudConfig { scene_reach_m: 5.0, ..CloudConfig::default() }).unwrap();
        models.prior(&context, 1, 2, goal).unwrap()
    };
    let (a, b) = (mixture(&points), mixture(&moved));
    assert!(largest_difference(&a.weights, &b.weights) < 0.05);
    // The scene is sampled anew around the moved query, which shows a little; a centre of 14 cm would show as decimetres.
    let difference = largest_difference(a.means_in_viewer_m.as_flattened(), b.means_in_viewer_m.as_flattened());
    assert!(difference < 0.03, "{difference}");
}

#[test]
fn a_candidates_bytes_do_not_depend_on_its_batch_or_the_threads() {
    let models = Models::load(&Weights::initial(&NetworksConfig::default(), 7).unwrap()).unwrap();
    let (points, labels) = scene(3);
    let context = SceneContext::new(&points, &labels, 0.4, &OBSERVER, &models.config().cloud).unwrap();
    let candidates: Vec<_> = (0..9)
        .map(|i| Candidate {
            position_in_world: [0.02 * i as f32 - 0.1, 0.1, 0.05],
            yaw_rad: if i % 2 == 0 { 0.0 } else { 0.3 * i as f32 },
        })
        .collect();
    let together = models.realism(&context, 1, &candidates, 3).unwrap();
    let outcome = models.outcome(&context, 1, &candidates, 3).unwrap();
    let relations = models.relations(&context, 1, &[2], &candidates, 2).unwrap();
    for (i, candidate) in candidates.iter().enumerate() {
        assert_eq!(models.realism(&context, 1, &[*candidate], 1).unwrap()[0].to_bits(), together[i].to_bits());
        assert_eq!(models.outcome(&context, 1, &[*candidate], 1).unwrap()[0].to_bits(), outcome[i].to_bits());
        assert_eq!(models.relations(&context, 1, &[2], &[*candidate], 1).unwrap()[0], relations[i]);
    }
}

#[test]
fn weights_of_the_papers_networks_alone_are_served_without_ours() {
    let config = NetworksConfig::paper();
    let models = Models::load(&Weights::initial(&config, 8).unwrap()).unwrap();
    assert_eq!(models.config(), &config);
    let (points, labels) = scene(4);
    let context = SceneContext::new(&points, &labels, 0.0, &OBSERVER, &config.cloud).unwrap();
    let candidates = [Candidate { position_in_world: [0.0, 0.1, 0.05], yaw_rad: 0.2 }];
    assert_eq!(models.outcome(&context, 1, &candidates, 1).unwrap_err(), InputError::NoOutcomeNetwork);
    assert!(models.realism(&context, 1, &candidates, 1).unwrap()[0].is_finite());
    let relations = models.relations(&context, 1, &[2], &candidates, 1).unwrap();
    assert!(relations[0][0].iter().all(|p| (0.0..=1.0).contains(p)));
}

#[test]
fn norms_that_give_no_numbers_are_refused_by_name() {
    let weights = Weights::from_bytes(&Weights::initial(&NetworksConfig::default(), 8).unwrap()).unwrap();
    let refused = |changes: &[(&str, f32)]| {
        let mut values = weights.values.clone();
        for (name, value) in changes {
            values.get_mut(*name).unwrap().1[2] = *value;
        }
        Models::load(&Weights::to_bytes(&values, &weights.info).unwrap()).unwrap_err().to_string()
    };
    let error = refused(&[("discriminator/sa2/norm/variance", -0.5)]);
    assert!(error.contains("discriminator/sa2/norm/variance") && error.contains("entry 2 is negative: -0.5"), "{error}");
    let error = refused(&[("prior/norm/scale", f32::MAX), ("prior/norm/variance", 0.0)]);
    assert!(error.contains("prior/norm: entry 2"), "{error}");
    let error = refused(&[("outcome/sa1/norm/mean", f32::MAX), ("outcome/sa1/norm/scale", 100.0)]);
    assert!(error.contains("outcome/sa1/norm: entry 2"), "{error}");
}

#[test]
fn training_goes_on_from_weights_that_lack_a_part() {
    let small = Weights::from_bytes(&Weights::initial(&NetworksConfig::paper(), 9).unwrap()).unwrap();
    let (networks, parameters) =
        Networks::started(&NetworksConfig::default(), &small.values, &mut Pcg64::seed_from_u64(1), &Device::Cpu).unwrap();
    assert!(networks.outcome.is_some());
    let values = parameters.to_map().unwrap();
    assert_eq!(values["discriminator/sa1/linear1/weight"], small.values["discriminator/sa1/linear1/weight"]);
    assert_ne!(values["relations/hidden/weight"].0, small.values["relations/hidden/weight"].0);
}

#[test]
fn the_outcome_network_has_the_same_gradient_fused_and_plain() {
    let config = NetworksConfig::default();
    let (networks, parameters) = Networks::seeded(&config, &mut Pcg64::seed_from_u64(12), &Device::Cpu).unwrap();
    let (scene, object) = clouds();
    let kernel = Kernel::detect();
    let shared = SharedScene::new(kernel, &config, &scene);
    let placed = [[0.0, 0.1, 0.05], [0.1, -0.1, 0.06]].map(|at| shared.placed(kernel, &config, &object, at));
    let batch = shared.grouped(&placed);
    let run = |path, mode| {
        let logits = networks.outcome.as_ref().unwrap().logits(&batch, &mode, path).unwrap();
        let loss = logits.sqr().unwrap().sum_all().unwrap();
        (logits.to_vec1::<f32>().unwrap(), loss.backward().unwrap())
    };
    let served = run(Path::Plain, Mode::Serving).0;
    let (plain, plain_grads) = run(Path::Plain, Mode::Training(Default::default()));
    for path in [Path::Fused, Path::Gathered] {
        let other = run(path, Mode::Serving).0;
        assert!(largest_difference(&other, &served) < 1e-4, "{path:?}: {other:?} {served:?}");
        // Batch statistics of untrained features are so small that dividing by them shows the rounding of coordinates that are not yet relative.
        let (other, grads) = run(path, Mode::Training(Default::default()));
        assert!(largest_difference(&other, &plain) < 5e-3, "{path:?}: {other:?} {plain:?}");
        assert_same_gradients(&parameters, "outcome/", &grads, &plain_grads);
    }
}

#[test]
fn the_readme_counts_the_parameters_that_there_are() {
    let (_, parameters) = Networks::seeded(&NetworksConfig::default(), &mut Pcg64::seed_from_u64(1), &Device::Cpu).unwrap();
    let readme = include_str!("../README.md");
    for part in ["object", "scene", "relations", "prior", "discriminator", "outcome"] {
        let own = parameters.trainable.iter().filter(|(name, _)| name.starts_with(&format!("{part}/")));
        let count: usize = own.map(|(_, var)| var.elem_count()).sum();
        let row = format!("| `{part}` | {},{:03} |", count / 1000, count % 1000);
        assert!(readme.contains(&row), "README.md lacks {row}");
    }
}
