//! Labelled frame folders of generated scenes, as a depth camera would see them: what `evaluate segmentation` can be run on.

use std::path::Path;

use rayon::prelude::*;
use repose_evaluation::scenes::problem::frame_of;
use repose_perception::frame_folder;
use repose_proto::Frame;
use repose_sensor::SensorModel;
use repose_simulator::generate::{GenerateSettings, view_rng};
use repose_simulator::render::DepthCanvas;
use repose_simulator::scene::scene_of_seed;
use repose_simulator::viewpoint::ViewpointSettings;
use repose_simulator::views::view_of_scene;

use crate::failure::Failure;
use crate::progress::Progress;

/// Columns and rows of the frames: what depth cameras deliver most.
const SIZE: [usize; 2] = [640, 480];
/// An object with fewer pixels than this has no label: nobody could say what it is.
const LEAST_PX: usize = 100;

/// Writes a folder for each view of each scene, named after its place in the order; how many there are. Seeds without a scene are left out.
pub fn write_frames(folder: &Path, settings: &GenerateSettings) -> Result<usize, Failure> {
    let seeds = settings.split.seeds();
    let first = seeds.start + settings.first_scene;
    let viewpoint = ViewpointSettings { width: SIZE[0], height: SIZE[1], ..settings.viewpoint.clone() };
    let bar = Progress::new(settings.scenes, "scenes");
    let written: Result<Vec<usize>, Failure> = (first..(first + settings.scenes).min(seeds.end))
        .into_par_iter()
        .map(|seed| {
            let number = (seed - seeds.start) * u64::from(settings.views);
            let frames = frames_of_seed(seed, settings, &viewpoint);
            for (view, frame) in &frames {
                let path = folder.join(format!("frame{:05}", number + u64::from(*view)));
                frame_folder::write(&path, frame).map_err(|e| Failure::bad_input("frames", e))?;
            }
            bar.add(1);
            Ok(frames.len())
        })
        .collect();
    bar.finish();
    Ok(written?.into_iter().sum())
}

/// The frames of a seed's scene, each with a camera of its own near the two that are known by name.
fn frames_of_seed(seed: u64, settings: &GenerateSettings, viewpoint: &ViewpointSettings) -> Vec<(u32, Frame)> {
    let Ok((scene, _)) = scene_of_seed(seed, &settings.scene) else { return Vec::new() };
    let mut canvas = DepthCanvas::new(viewpoint.width, viewpoint.height);
    let frame = |view: u32| {
        let mut rng = view_rng(seed, view);
        let seen = view_of_scene(&scene, view, viewpoint, false, &mut canvas, &mut rng)?;
        let sensor = SensorModel::jittered(&mut rng);
        let mut frame = frame_of(&scene, &seen.camera, &seen.world_from_camera, &sensor, seed ^ u64::from(view));
        frame.labels.iter_mut().for_each(|labels| leave_out_slivers(labels));
        Some((view, frame))
    };
    (0..settings.views).filter_map(frame).collect()
}

fn leave_out_slivers(labels: &mut [u16]) {
    let mut counts = vec![0; usize::from(u16::MAX) + 1];
    labels.iter().for_each(|id| counts[usize::from(*id)] += 1);
    labels.iter_mut().filter(|id| counts[usize::from(**id)] < LEAST_PX).for_each(|id| *id = 0);
}
