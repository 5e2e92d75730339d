//! Writes pictures of scenes of one kind to look at, and prints how they come out: `scene_kinds KIND|mix FIRST COUNT PNG`.

use std::collections::BTreeMap;
use std::time::Instant;

use image::{Rgb, RgbImage};
use rand::SeedableRng;
use rand_pcg::Pcg64;
use repose_simulator::render::picture;
use repose_simulator::scene::{SceneKind, SceneSettings, scene_of_seed};
use repose_simulator::viewpoint::{ViewpointSettings, random_viewpoint};

const COLUMNS: u32 = 5;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, kind, first, count, path] = arguments.as_slice() else { return Err("usage: scene_kinds KIND|mix FIRST COUNT PNG".into()) };
    let settings = SceneKind::parse(kind).map_or_else(SceneSettings::default, SceneSettings::only);
    let (first, count): (u64, u64) = (first.parse()?, count.parse()?);
    let viewpoint = ViewpointSettings { width: 384, height: 288, ..ViewpointSettings::default() };
    let (width, height) = (viewpoint.width as u32, viewpoint.height as u32);
    let mut sheet = RgbImage::new(COLUMNS * width, (count as u32).div_ceil(COLUMNS) * height);
    let (mut settle_s, mut objects) = (0.0, 0);
    let mut reasons: BTreeMap<&str, usize> = BTreeMap::new();
    for (k, seed) in (first..first + count).enumerate() {
        let start = Instant::now();
        let (scene, rejected) = scene_of_seed(seed, &settings)?;
        settle_s += start.elapsed().as_secs_f64();
        objects += scene.objects.len();
        for why in rejected {
            *reasons.entry(why.reason()).or_default() += 1;
        }
        let (camera, world_from_camera) = random_viewpoint(&scene.focus(), &viewpoint, &mut Pcg64::seed_from_u64(seed));
        let seen = picture(&camera, &world_from_camera, &scene.drawables());
        let (left, top) = (k as u32 % COLUMNS * width, k as u32 / COLUMNS * height);
        for (i, color) in seen.color.pixels().iter().enumerate() {
            sheet.put_pixel(left + i as u32 % width, top + i as u32 / width, Rgb(*color));
        }
    }
    sheet.save(path)?;
    println!("{kind}: {:.1} ms each, {:.1} objects, rejected {reasons:?}", settle_s * 1e3 / count as f64, objects as f64 / count as f64);
    Ok(())
}
