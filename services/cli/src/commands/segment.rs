//! `repose segment`: the objects and surfaces of a frame.

use std::path::PathBuf;

use clap::Args;
use image::{DynamicImage, ImageBuffer, Luma};
use repose_evaluation::report::written::write_picture;
use repose_perception::{Settings, segment_with_labels};
use repose_proto::CallError;
use repose_proto::scene::WorldFrame;

use crate::failure::{Failure, Outcome};
use crate::frames::{self, TopicArgs};
use crate::output::Output;
use crate::segment_view::segment_view;
use crate::values::parse_png;

/// Arguments of `segment`.
#[derive(Debug, Args)]
pub struct SegmentArgs {
    /// A frame folder, or anything that `play` plays.
    pub frame: PathBuf,
    /// Which of the source's frames, counted from 0.
    #[arg(long, default_value_t = 0)]
    pub nth: usize,
    /// Which topics of a recording.
    #[command(flatten)]
    pub topics: TopicArgs,
    /// Find the objects even where labels are given.
    #[arg(long)]
    pub ignore_labels: bool,
    /// The found labels as a 16-bit picture.
    #[arg(long, value_name = "PNG", value_parser = parse_png)]
    pub labels_out: Option<PathBuf>,
    /// A picture of color, depth, objects with ids and boxes, and the surfaces from above.
    #[arg(long, value_name = "PNG", value_parser = parse_png)]
    pub out: Option<PathBuf>,
}

/// Runs the command.
pub fn run(args: &SegmentArgs, output: Output) -> Outcome {
    let mut frame = frames::read_nth(&args.frame, args.nth, &args.topics.topics())?;
    if args.ignore_labels {
        frame.labels = None;
    }
    let segmented = segment_with_labels(&frame, &Settings::default()).map_err(|e| Failure::from(CallError::from(e)))?;
    let scene = &segmented.scene;
    if let Some(path) = &args.labels_out {
        let (width, height) = (segmented.labels.width() as u32, segmented.labels.height() as u32);
        let labels: ImageBuffer<Luma<u16>, Vec<u16>> = ImageBuffer::from_raw(width, height, segmented.labels.pixels().to_vec())
            .ok_or_else(|| Failure::other("the labels do not fill their picture"))?;
        write_picture(path, &DynamicImage::ImageLuma16(labels))?;
    }
    if let Some(path) = &args.out {
        write_picture(path, &segment_view(&frame, &segmented).into())?;
    }
    let estimated = scene.meta.world_frame == WorldFrame::SupportPlane;
    let document = serde_json::json!({
        "objects": scene.meta.objects,
        "surfaces": scene.meta.surfaces,
        "left_out": scene.meta.left_out,
        "warnings": scene.meta.warnings,
        "world_from_camera": scene.meta.camera.world_from_camera,
        "world_from_camera_estimated": estimated,
    });
    output.print(&document, || {
        let mut text = format!("{} objects, {} surfaces", scene.meta.objects.len(), scene.meta.surfaces.len());
        if estimated {
            text += "; no camera pose came with the frame: heights are above the main support plane, the origin is below the camera";
        }
        for o in &scene.meta.objects {
            let ([x, y, z], [w, d, h]) = (o.centroid_m, o.extent_m);
            text += &format!(
                "\n  object {:>3}: {:>6} points, at ({x:.3}, {y:.3}, {z:.3}) m, {:.0} x {:.0} x {:.0} mm, {:.0} % complete",
                o.id,
                o.points,
                w * 1e3,
                d * 1e3,
                h * 1e3,
                o.completeness * 100.0
            );
        }
        for l in &scene.meta.left_out {
            let [x, y, z] = l.centroid_m;
            let label = l.label.map_or(String::new(), |id| format!(" label {id}:"));
            text += &format!(
                "\n  left out, an obstacle:{label} {:>6} points, at ({x:.3}, {y:.3}, {z:.3}) m, {}",
                l.points,
                l.reason.in_words()
            );
        }
        for s in &scene.meta.surfaces {
            let on = s.object.map_or(String::new(), |id| format!(", the top of object {id}"));
            text += &format!("\n  surface at {:.3} m, {:.3} m²{on}", s.height_m, s.area_m2);
        }
        for warning in &scene.meta.warnings {
            text += &format!("\n  warning: {}: {}", warning.field, warning.message);
        }
        text
    })
}
