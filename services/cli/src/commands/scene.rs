//! `repose scene`: the newest scene of a camera: which objects there are, by which ids.

use std::path::PathBuf;
use std::time::Duration;

use clap::Args;
use image::Rgb;
use repose_evaluation::report::written::can_write;
use repose_evaluation::report::written::write_picture;
use repose_local::picture::{Coloring, captioned, draw_ids, scene_picture};
use repose_local::wireframe::draw_box;
use repose_proto::SceneSummary;

use crate::client::{self, ConnectArgs};
use crate::failure::{CommandResult, Failure};
use crate::output::Output;
use crate::values::parse_png;

const KEEP_OUT: Rgb<u8> = Rgb([220, 40, 40]);

/// Arguments of `scene`.
#[derive(Debug, Args)]
pub struct SceneArgs {
    /// Where to ask.
    #[command(flatten)]
    pub connect: ConnectArgs,
    /// Write a picture of the scene with object ids and the cell's keep-out zones.
    #[arg(long, value_name = "PNG", value_parser = parse_png)]
    pub out: Option<PathBuf>,
}

/// Runs the command.
pub async fn run(args: &SceneArgs, output: Output) -> CommandResult {
    args.out.as_deref().map_or(Ok(()), can_write)?;
    let session = client::connect(&args.connect.system).await?;
    let within = Duration::from_millis(args.connect.deadline_ms);
    let asked = async {
        let summary = client::newest_scene(&session, &args.connect.camera, within, client::PATIENCE).await?;
        let whole = match &args.out {
            Some(path) => {
                let scene = client::whole_scene(&session, &summary.scene_id, within).await?;
                Some((path, scene, client::keep_out_zones(&session).await?))
            }
            None => None,
        };
        Ok::<_, Failure>((summary, whole))
    };
    let asked = asked.await;
    client::close(session).await;
    let (summary, whole) = asked?;
    if let Some((path, scene, keep_out)) = whole {
        let mut picture = scene_picture(&scene, Coloring::Seen, None);
        for zone in &keep_out {
            draw_box(&mut picture, &scene, zone.min_m, zone.max_m, KEEP_OUT);
        }
        draw_ids(&mut picture, &scene);
        let zones = if keep_out.is_empty() { "" } else { "; red: keep-out zones" };
        let caption = format!("camera {}, object ids{zones}", summary.camera);
        write_picture(path, &captioned(&picture, &caption).into())?;
    }
    output.print(&summary, || text_of(&summary))
}

fn text_of(summary: &SceneSummary) -> String {
    let age_s = repose_runtime::now_ns().saturating_sub(summary.stamp_ns) as f64 / 1e9;
    let mut lines = vec![format!("camera {}, scene {}, taken {age_s:.1} s ago", summary.camera, summary.scene_id)];
    for object in &summary.objects {
        let ([x, y, z], [width, depth, height]) = (object.centroid_m, object.extent_m.map(|m| m * 1e3));
        lines.push(format!(
            "  object {:>3}: at ({x:+.3}, {y:+.3}, {z:+.3}) m, {width:.0} x {depth:.0} x {height:.0} mm, {} points",
            object.id, object.points
        ));
    }
    for surface in &summary.surfaces {
        let what = surface.object.map_or_else(|| "surface".to_owned(), |id| format!("top of object {id}"));
        lines.push(format!("  {what} at {:.3} m, {:.3} m²", surface.height_m, surface.area_m2));
    }
    lines.join("\n")
}
