//! `repose score`: what the networks say of given placements, so that others can judge the networks alone.

use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;
use nalgebra::Point3;
use repose_evaluation::report::text::table;
use repose_geometry::transform::{from_row_major, yaw_of};
use repose_inference::HeldScene;
use repose_proto::scoring::{RealismBy, ScoreRequest};
use repose_proto::{CallError, Relation, SceneRef, limits};

use crate::embedded::NetworkArgs;
use crate::failure::{Failure, Outcome};
use crate::frames;
use crate::output::Output;

/// Arguments of `score`.
#[derive(Debug, Args)]
pub struct ScoreArgs {
    /// The frame folder.
    pub frame: PathBuf,
    /// The object to move, by id.
    #[arg(long = "move", value_name = "ID")]
    pub query: u16,
    /// The anchor, by id.
    #[arg(long, value_name = "ID")]
    pub anchor: u16,
    /// JSON: a list of rigid transforms `placed_from_observed`, 16 numbers each, row by row.
    #[arg(long, value_name = "FILE")]
    pub transforms: PathBuf,
    /// Which network says how realistic a placement is: discriminator (the paper's) or outcome (trained on simulated releases).
    #[arg(long, default_value = "discriminator", value_parser = parse_realism_by)]
    pub realism_by: RealismBy,
    /// Which networks.
    #[command(flatten)]
    pub networks: NetworkArgs,
}

fn parse_realism_by(name: &str) -> Result<RealismBy, String> {
    match name {
        "discriminator" => Ok(RealismBy::Discriminator),
        "outcome" => Ok(RealismBy::Outcome),
        _ => Err("expected discriminator or outcome".to_owned()),
    }
}

/// How far from upright a transform's rotation may be: candidates turn about world z only.
const UPRIGHT_RAD: f64 = 1e-3;

/// Runs the command.
pub fn run(args: &ScoreArgs, output: Output) -> Outcome {
    let scene = frames::scene_of(&frames::read(&args.frame)?)?;
    let name = args.transforms.display().to_string();
    let text = std::fs::read(&args.transforms).map_err(|e| Failure::bad_input(&name, e))?;
    let transforms: Vec<[f64; 16]> = serde_json::from_slice(&text).map_err(|e| Failure::bad_input(&name, e))?;
    if transforms.len() > limits::MAX_CANDIDATES {
        return Err(Failure::bad_input(&name, format!("at most {} transforms, got {}", limits::MAX_CANDIDATES, transforms.len())));
    }
    let object = scene.object(args.query);
    let object = object.ok_or_else(|| CallError::not_found("query", format!("the frame has no object {}", args.query)))?;
    let centroid = Point3::from(object.centroid_m);
    let candidates = transforms.iter().enumerate().map(|(i, entries)| {
        let placed_from_observed = from_row_major(entries).map_err(|e| Failure::bad_input(&format!("{name}[{i}]"), e))?;
        let up = placed_from_observed.rotation * nalgebra::Vector3::z();
        if up.angle(&nalgebra::Vector3::z()) > UPRIGHT_RAD {
            return Err(Failure::bad_input(&format!("{name}[{i}]"), "only turns about world z can be scored"));
        }
        let position = (placed_from_observed * centroid).cast::<f32>();
        Ok([position.x, position.y, position.z, yaw_of(&placed_from_observed) as f32])
    });
    let candidates = candidates.collect::<Result<Vec<_>, Failure>>()?;
    let view_yaw_rad = scene.meta.view_yaw_rad;
    let held = HeldScene::new(scene.id(), Arc::new(scene));
    let request = ScoreRequest {
        scene: SceneRef { scene_id: held.scene_id().to_owned() },
        query: args.query,
        anchors: vec![args.anchor],
        view_yaw_rad,
        realism: true,
        realism_by: args.realism_by,
        relations: true,
        candidates,
    };
    let reply = args.networks.models()?.engine().score(&request, &held)?;
    output.print(&serde_json::json!({"realism": reply.realism, "relations": reply.relations}), || {
        let names = Relation::ALL.iter().map(|relation| relation.as_str().replace('_', "\n"));
        let mut table = table(["placement".to_owned(), "realism".to_owned()].into_iter().chain(names));
        for (i, (realism, relations)) in reply.realism.iter().zip(&reply.relations).enumerate() {
            let probabilities = std::iter::once(realism).chain(relations).map(|p| format!("{p:.2}"));
            table.add_row(std::iter::once(i.to_string()).chain(probabilities));
        }
        let (query, anchor) = (args.query, args.anchor);
        format!("{table}\nprobabilities: of realism, and that object {query} stands in each relation to object {anchor}; placements count from 0")
    })
}
