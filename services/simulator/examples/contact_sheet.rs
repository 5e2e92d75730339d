//! Writes pictures of scenes to look at, and prints how scenes come out: `contact_sheet FIRST COUNT PNG`.

use std::time::Instant;

use image::{Rgb, RgbImage};
use rand::SeedableRng;
use rand_pcg::Pcg64;
use repose_simulator::render::picture;
use repose_simulator::scene::{SceneSettings, scene_of_seed};
use repose_simulator::viewpoint::{ViewpointSettings, random_viewpoint};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, first, count, path] = arguments.as_slice() else { return Err("usage: contact_sheet FIRST COUNT PNG".into()) };
    let (first, count): (u64, u64) = (first.parse()?, count.parse()?);
    let columns = 6u32;
    let viewpoint = ViewpointSettings::default();
    let (width, height) = (viewpoint.width as u32, viewpoint.height as u32);
    let mut sheet = RgbImage::new(columns * width, (count as u32).div_ceil(columns) * height);
    let (mut settle_s, mut render_s, mut rejections, mut deepest, mut creep) = (0.0, 0.0, Vec::new(), 0.0f32, 0.0f64);
    for (k, seed) in (first..first + count).enumerate() {
        let start = Instant::now();
        let (scene, rejected) = scene_of_seed(seed, &SceneSettings::default())?;
        settle_s += start.elapsed().as_secs_f64();
        rejections.extend(rejected);
        deepest = deepest.max(scene.penetration_m());
        let mut world = scene.world(SceneSettings::default().physics);
        for _ in 0..240 {
            world.step();
        }
        for (object, pose) in scene.objects.iter().zip(world.poses()) {
            let moved = repose_simulator::scene::displacement_m(&object.shape, &object.world_from_object, &pose);
            creep = creep.max(moved);
            if moved > 0.001 {
                println!("seed {seed}: object {} ({}) moved {:.2} mm in a further second", object.id, object.shape.name, moved * 1e3);
            }
        }
        let mut rng = Pcg64::seed_from_u64(seed);
        let (camera, world_from_camera) = random_viewpoint(&scene.focus(), &viewpoint, &mut rng);
        let start = Instant::now();
        let seen = picture(&camera, &world_from_camera, &scene.drawables());
        render_s += start.elapsed().as_secs_f64();
        let (left, top) = (k as u32 % columns * width, k as u32 / columns * height);
        for (i, color) in seen.color.pixels().iter().enumerate() {
            sheet.put_pixel(left + i as u32 % width, top + i as u32 / width, Rgb(*color));
        }
    }
    sheet.save(path)?;
    println!(
        "{count} scenes: {:.1} ms each to settle, {:.2} ms to draw, {} draws rejected",
        settle_s * 1e3 / count as f64,
        render_s * 1e3 / count as f64,
        rejections.len()
    );
    println!("deepest overlap {:.2} mm, farthest move in a further second {:.2} mm", deepest * 1e3, creep * 1e3);
    let mut reasons: Vec<String> = rejections.iter().map(ToString::to_string).collect();
    reasons.sort();
    for why in reasons {
        println!("  rejected: {why}");
    }
    Ok(())
}
