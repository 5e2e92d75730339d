//! x
use std::path::PathBuf;
use repose_perception::{Settings, frame_folder, segment_with_labels};
fn main() {
    let out = PathBuf::from("/tmp/perc");
    std::fs::create_dir_all(&out).unwrap();
    let mut times = [vec![], vec![]];
    for arg in std::env::args().skip(1) {
        let folder = PathBuf::from(&arg);
        let name = folder.file_name().unwrap().to_string_lossy().to_string();
        let mut frame = frame_folder::read(&folder).unwrap();
        for given in [true, false] {
            if !given { frame.labels = None; }
            let mut best = f64::INFINITY;
            let mut scene = None;
            for _ in 0..3 {
                let t = std::time::Instant::now();
                let s = segment_with_labels(&frame, &Settings::default());
                best = best.min(t.elapsed().as_secs_f64() * 1e3);
                scene = Some(s);
            }
            times[usize::from(given)].push(best);
            let scene = match scene.unwrap() { Ok(s) => s, Err(e) => { println!("{name} {given} {e}"); continue } };
            let full: Vec<u8> = scene.labels.pixels().iter().map(|l| *l as u8).collect(); let scene = scene.scene; let cam = &scene.meta.camera;
            let t = cam.world_from_camera.unwrap();
            let wfc = repose_geometry::transform::from_row_major(&t.0).unwrap();
            let pin = repose_geometry::Pinhole { width: cam.width, height: cam.height, fx: cam.fx, fy: cam.fy, cx: cam.cx, cy: cam.cy };
            let mut img = vec![0u8; cam.width * cam.height];
            for (p, l) in scene.points.iter().zip(&scene.labels) {
                let c = wfc.inverse() * nalgebra::Point3::from(*p).cast::<f64>();
                if let Some((u, v)) = pin.pixel_of(&c) { img[v * cam.width + u] = *l as u8 + 1; }
            }
            let tag = if given { "given" } else { "found" };
            image::save_buffer(out.join(format!("{name}_{tag}.png")), &img, cam.width as u32, cam.height as u32, image::ExtendedColorType::L8).unwrap();
            image::save_buffer(out.join(format!("{name}_{tag}_full.png")), &full, cam.width as u32, cam.height as u32, image::ExtendedColorType::L8).unwrap();
            std::fs::write(out.join(format!("{name}_{tag}.json")), serde_json::to_string(&scene.meta).unwrap()).unwrap();
        }
    }
    for t in &mut times { t.sort_by(f64::total_cmp); println!("ms p50 {:?} max {:?}", t[t.len()/2], t.last()); }
}
