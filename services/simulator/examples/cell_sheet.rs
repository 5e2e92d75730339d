//! Writes pictures of the robot's cell to look at: `cell_sheet FIRST COUNT PNG`.

use std::time::Instant;

use image::{Rgb, RgbImage};
use repose_simulator::cell::CellSettings;
use repose_simulator::cell_world::CellWorld;
use repose_simulator::robot::{ArmSettings, HandSettings};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, first, count, path] = arguments.as_slice() else { return Err("usage: cell_sheet FIRST COUNT PNG".into()) };
    let (first, count): (u64, u64) = (first.parse()?, count.parse()?);
    let (columns, width, height) = (3u32, 640u32, 480u32);
    let mut sheet = RgbImage::new(columns * width, (count as u32).div_ceil(columns) * height);
    for (k, seed) in (first..first + count).enumerate() {
        let mut cell = CellWorld::new(seed, CellSettings::default(), ArmSettings::default(), HandSettings::default())?;
        let start = Instant::now();
        for _ in 0..500 {
            cell.step(0.0);
        }
        let stepping = start.elapsed().as_secs_f64();
        let start = Instant::now();
        let seen = cell.true_picture(true);
        println!("seed {seed}: {:.0} µs a step, {:.1} ms to draw 640 x 480", stepping * 2e3, start.elapsed().as_secs_f64() * 1e3);
        let (left, top) = (k as u32 % columns * width, k as u32 / columns * height);
        for (i, color) in seen.color.pixels().iter().enumerate() {
            sheet.put_pixel(left + i as u32 % width, top + i as u32 / width, Rgb(*color));
        }
    }
    sheet.save(path)?;
    Ok(())
}
