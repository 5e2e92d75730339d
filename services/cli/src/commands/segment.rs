//! `repose segment`: the objects and surfaces of a frame.

use std::path::PathBuf;

use clap::Args;
use image::{DynamicImage, ImageBuffer, Luma};
use repose_evaluation::report::written::write_picture;
use repose_perception::segment_with_labels;
use repose_proto::scene::WorldFrame;
use repose_proto::{CallError, SegmentHints};

use crate::failure::{CommandResult, Failure};
use crate::frames::{self, TopicArgs};
use crate::output::Output;
use crate::segment_view::segment_view;
use crate::values::parse_png;

/// Arguments of `segment`.
#[derive(Debug, Args)]
pub struct SegmentArgs {
    /// A frame folder, or any source that `play` accepts.
    pub frame: PathBuf,
    /// Index of the frame in the source, from 0.
    #[arg(long, default_value_t = 0)]
    pub nth: usize,
    /// Which topics of a recording.
    #[command(flatten)]
    pub topics: TopicArgs,
    /// Segment the frame even if it has labels.
    #[arg(long)]
    pub ignore_labels: bool,
    /// A pixel (column, row) on an object that was missed, which is added there. Repeat for more.
    #[arg(long, value_name = "U,V", value_parser = parse_numbers::<2>)]
    pub click: Vec<[usize; 2]>,
    /// A bounding box of one object in pixels: left, top, right, bottom. Repeat for more.
    #[arg(long = "box", value_name = "L,T,R,B", value_parser = parse_numbers::<4>)]
    pub around: Vec<[usize; 4]>,
    /// Ids to merge into one object, as printed without hints. Repeat for more.
    #[arg(long, value_name = "IDS", value_parser = parse_ids)]
    pub merge: Vec<Ids>,
    /// An id to split into two objects, as printed without hints. Repeat for more.
    #[arg(long, value_name = "ID")]
    pub split: Vec<u16>,
    /// Write the labels as a 16-bit picture.
    #[arg(long, value_name = "PNG", value_parser = parse_png)]
    pub labels_out: Option<PathBuf>,
    /// Write a picture: color, depth, objects with ids and boxes, and the surfaces from above.
    #[arg(long, value_name = "PNG", value_parser = parse_png)]
    pub out: Option<PathBuf>,
}

/// Ids that are one object.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Ids(Vec<u16>);

fn parse_ids(text: &str) -> Result<Ids, String> {
    let ids: Result<Vec<u16>, _> = text.split(',').map(|id| id.trim().parse()).collect();
    ids.ok().filter(|ids| ids.len() > 1).map(Ids).ok_or_else(|| "expected two ids or more with commas between them".to_owned())
}

fn parse_numbers<const N: usize>(text: &str) -> Result<[usize; N], String> {
    let numbers: Result<Vec<usize>, _> = text.split(',').map(|number| number.trim().parse()).collect();
    let numbers = numbers.ok().and_then(|numbers| <[usize; N]>::try_from(numbers).ok());
    numbers.ok_or_else(|| format!("expected {N} whole numbers with commas between them"))
}

impl SegmentArgs {
    fn hints(&self) -> SegmentHints {
        SegmentHints {
            clicks_px: self.click.clone(),
            boxes_px: self.around.clone(),
            merge: self.merge.iter().map(|ids| ids.0.clone()).collect(),
            split: self.split.clone(),
        }
    }
}

/// Runs the command.
pub fn run(args: &SegmentArgs, output: Output) -> CommandResult {
    args.topics.check(&args.frame)?;
    let mut frame = frames::read_nth(&args.frame, args.nth, &args.topics.topics())?;
    if args.ignore_labels {
        frame.labels = None;
    }
    frame.hints = args.hints();
    let segmented = segment_with_labels(&frame, &repose_local::segmentation()?).map_err(|e| Failure::from(CallError::from(e)))?;
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
            text += &o.score.map_or(String::new(), |score| format!(", score {score:.2}"));
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
