//! Where the time and the bytes of a generated view go: `view_cost [SCENES]`, on one thread.

use std::time::Instant;

use rand_pcg::Pcg64;
use repose_dataset::codec::{Packer, unpack_u16};
use repose_dataset::{Layer, Split, ViewRecord};
use repose_simulator::render::DepthCanvas;
use repose_simulator::scene::{SceneSettings, scene_of_seed};
use repose_simulator::viewpoint::ViewpointSettings;
use repose_simulator::views::view_of_scene;

const VIEWS: u32 = 5;

fn layers(view: &ViewRecord) -> impl Iterator<Item = &Layer> {
    let of_objects = view.objects.iter().flat_map(|o| std::iter::once(&o.alone).chain(o.elsewhere.as_ref().map(|e| &e.layer)));
    std::iter::once(&view.background).chain(of_objects)
}

fn main() {
    let scenes: u64 = std::env::args().nth(1).and_then(|n| n.parse().ok()).unwrap_or(20);
    let (settings, mut settle_s) = (ViewpointSettings::default(), 0.0);
    let mut seen = Vec::new();
    for seed in Split::Validation.seeds().start..Split::Validation.seeds().start + scenes {
        let start = Instant::now();
        seen.extend(scene_of_seed(seed, &SceneSettings::default()).map(|(scene, _)| scene));
        settle_s += start.elapsed().as_secs_f64();
    }
    println!("{:.1} ms a scene", settle_s * 1e3 / scenes as f64);
    let mut canvas = DepthCanvas::new(settings.width, settings.height);
    for color in [false, true] {
        let start = Instant::now();
        let views: Vec<ViewRecord> = seen
            .iter()
            .flat_map(|scene| (0..VIEWS).map(move |view| (scene, view)))
            .filter_map(|(scene, view)| {
                let mut rng = Pcg64::new(u128::from(scene.seed), u128::from(view));
                view_of_scene(scene, view, &settings, color, &mut canvas, &mut rng)
            })
            .collect();
        let n = views.len() as f64;
        println!("color {color}: {:.2} ms to draw a view", start.elapsed().as_secs_f64() * 1e3 / n);
        for effort in [1, 3, 4, 6, 9] {
            let mut packer = Packer::with_effort(effort);
            let start = Instant::now();
            let packed: Vec<(Vec<u8>, usize)> =
                views.iter().flat_map(layers).map(|l| (packer.pack_u16(&l.inverse_depth), l.area())).collect();
            let depth_ms = start.elapsed().as_secs_f64() * 1e3 / n;
            let start = Instant::now();
            let unpacked = packed.iter().filter(|(bytes, area)| unpack_u16(bytes, *area).is_ok()).count();
            let unpack_ms = start.elapsed().as_secs_f64() * 1e3 / n;
            let start = Instant::now();
            let color: usize = views.iter().flat_map(layers).map(|l| packer.pack_color(&l.color).len()).sum();
            println!(
                "  effort {effort}: depth {:.1} kB in {depth_ms:.2} ms, {unpacked} layers unpacked in {unpack_ms:.2} ms a view, color {:.1} kB in {:.2} ms",
                packed.iter().map(|(bytes, _)| bytes.len()).sum::<usize>() as f64 / 1e3 / n,
                color as f64 / 1e3 / n,
                start.elapsed().as_secs_f64() * 1e3 / n,
            );
        }
    }
}
