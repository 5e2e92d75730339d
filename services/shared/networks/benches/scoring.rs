//! The networks on a scene of their full size: `cargo bench -p repose-networks`.
//!
//! Realism by size of the batch, relations of translations and of turned candidates, and the prior, on every core. The scene is drawn by
//! formula, so that the same points are scored whatever becomes of the simulator: a table of 2 m with three boxes, 5 mm between points.
//! Records are in `benches/record/`; `repose bench scoring` reports the same on a simulated scene, and the share of the machine's products.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use nalgebra::Point3;
use repose_networks::{Candidate, Models, SceneContext, points::Observer};

/// Batches of the discriminator.
const BATCHES: [usize; 3] = [1, 25, 100];
/// Candidates of a question about relations.
const CANDIDATES: usize = 1000;
/// The query, and the anchors.
const QUERY: u16 = 1;
const ANCHORS: [u16; 2] = [2, 3];

/// Points on the upper side of a table and on the sides of boxes of 8 × 8 × 10 cm that face the viewer.
fn scene(models: &Models) -> SceneContext {
    const SPACING_M: f32 = 0.005;
    let steps = |length_m: f32| (0..(length_m / SPACING_M) as i32).map(|i| i as f32 * SPACING_M);
    let mut points = Vec::new();
    let mut labels = Vec::new();
    let mut add = |x: f32, y: f32, z: f32, label: u16| {
        points.push(Point3::new(x, y, z));
        labels.push(label);
    };
    let corners = [(1, -0.3, 0.0), (2, 0.0, 0.05), (3, 0.1, -0.2)];
    let is_covered = |x: f32, y: f32| corners.iter().any(|(_, cx, cy)| (0.0..0.08).contains(&(x - cx)) && (0.0..0.08).contains(&(y - cy)));
    for x in steps(2.0).map(|x| x - 1.0) {
        steps(2.0).map(|y| y - 1.0).filter(|y| !is_covered(x, *y)).for_each(|y| add(x, y, 0.0, 0));
    }
    for (label, cx, cy) in corners {
        for u in steps(0.08) {
            steps(0.08).for_each(|v| add(cx + u, cy + v, 0.1, label));
            steps(0.1).for_each(|z| add(cx + u, cy, z, label));
        }
    }
    let observer = Observer { eye: Point3::new(0.0, -0.8, 0.6), pixel_rad: 0.002 };
    SceneContext::new(&points, &labels, 0.0, &observer, &models.config().cloud).expect("finite points, a label each")
}

fn candidates(yaw_rad: f32) -> Vec<Candidate> {
    let at = |i: usize| Candidate { position_in_world: [0.15 + 0.0001 * i as f32, 0.05, 0.07], yaw_rad };
    (0..CANDIDATES).map(at).collect()
}

fn threads() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

fn realism(criterion: &mut Criterion) {
    let models = Models::embedded().expect("embedded weights");
    let (scene, candidates) = (scene(&models), candidates(0.0));
    let mut group = criterion.benchmark_group("realism");
    group.sample_size(20);
    for batch in BATCHES {
        group.throughput(Throughput::Elements(batch as u64));
        group.bench_with_input(BenchmarkId::from_parameter(batch), &candidates[..batch], |bencher, batch| {
            bencher.iter(|| models.realism(&scene, QUERY, batch, threads()));
        });
    }
    group.finish();
}

fn relations(criterion: &mut Criterion) {
    let models = Models::embedded().expect("embedded weights");
    let scene = scene(&models);
    let mut group = criterion.benchmark_group("relations");
    group.sample_size(20);
    for (name, yaw_rad, count) in [("translations", 0.0, CANDIDATES), ("turned", 0.3, 100)] {
        let candidates = &candidates(yaw_rad)[..count];
        group.throughput(Throughput::Elements((count * ANCHORS.len()) as u64));
        group.bench_with_input(BenchmarkId::from_parameter(name), candidates, |bencher, candidates| {
            bencher.iter(|| models.relations(&scene, QUERY, &ANCHORS, candidates, threads()));
        });
    }
    group.finish();
}

fn prior(criterion: &mut Criterion) {
    let models = Models::embedded().expect("embedded weights");
    let scene = scene(&models);
    let mut group = criterion.benchmark_group("prior");
    group.throughput(Throughput::Elements(1));
    group.bench_function("one", |bencher| bencher.iter(|| models.prior(&scene, QUERY, ANCHORS[0], [1, 0, 0, 0, 0, 0, 0, 0, 0, 0])));
    group.finish();
}

criterion_group!(benches, realism, relations, prior);
criterion_main!(benches);
