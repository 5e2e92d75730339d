//! `repose segment`: the objects and surfaces of a frame folder.

use image::{DynamicImage, ImageBuffer, Luma};
use repose_perception::{Settings, segment_with_labels};
use repose_proto::CallError;

use crate::args::SegmentArgs;
use crate::failure::{Failure, Outcome};
use crate::output::Output;
use crate::picture::{Coloring, draw_ids, scene_picture, side_by_side};
use crate::{frames, picture};

/// Runs the command.
pub fn run(args: &SegmentArgs, output: Output) -> Outcome {
    let mut frame = frames::read(&args.frame)?;
    if args.ignore_labels {
        frame.labels = None;
    }
    let segmented = segment_with_labels(&frame, &Settings::default()).map_err(|e| Failure::from(CallError::from(e)))?;
    let scene = &segmented.scene;
    if let Some(path) = &args.labels_out {
        let (width, height) = (segmented.labels.width() as u32, segmented.labels.height() as u32);
        let labels: ImageBuffer<Luma<u16>, Vec<u16>> = ImageBuffer::from_raw(width, height, segmented.labels.pixels().to_vec())
            .ok_or_else(|| Failure::other("the labels do not fill their picture"))?;
        frames::write_picture(path, &DynamicImage::ImageLuma16(labels))?;
    }
    if let Some(path) = &args.out {
        let mut objects = scene_picture(scene, Coloring::Objects, None);
        draw_ids(&mut objects, scene);
        let seen = match &frame.color {
            Some(color) => picture::color_picture(frame.camera.width, frame.camera.height, color),
            None => scene_picture(scene, Coloring::Seen, None),
        };
        frames::write_picture(path, &side_by_side(&[seen, objects]).into())?;
    }
    let document = serde_json::json!({"objects": scene.meta.objects, "surfaces": scene.meta.surfaces});
    output.print(&document, || {
        let mut text = format!("{} objects, {} surfaces", scene.meta.objects.len(), scene.meta.surfaces.len());
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
        for s in &scene.meta.surfaces {
            let on = s.object.map_or(String::new(), |id| format!(", the top of object {id}"));
            text += &format!("\n  surface at {:.3} m, {:.3} m²{on}", s.height_m, s.area_m2);
        }
        text
    })
}
