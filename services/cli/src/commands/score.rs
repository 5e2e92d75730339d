//! `repose score`: what the networks say of given placements, so that others can judge the networks alone.

use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;
use repose_evaluation::report::text::table;
use repose_proto::scoring::RealismBy;
use repose_proto::{CallError, Relation};

use crate::embedded::NetworkArgs;
use crate::failure::{CommandResult, Failure};
use crate::frames;
use crate::output::Output;

/// Arguments of `score`.
#[derive(Debug, Args)]
pub struct ScoreArgs {
    /// A frame folder, or any source that `play` accepts, whose first frame is used.
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
    /// The network that scores realism: discriminator (the paper's) or outcome (trained on simulated releases).
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

/// Runs the command.
pub fn run(args: &ScoreArgs, output: Output) -> CommandResult {
    let scene = repose_local::scene_of(&frames::read(&args.frame)?)?;
    let name = args.transforms.display().to_string();
    let text = std::fs::read(&args.transforms).map_err(|e| Failure::bad_input(&name, e))?;
    let transforms: Vec<[f64; 16]> = serde_json::from_slice(&text).map_err(|e| Failure::bad_input(&name, e))?;
    let models = args.networks.models()?;
    // The error names the file's entry.
    let of_file = |mut error: CallError| {
        error.field = error.field.map(|field| field.replacen("transforms", &name, 1));
        Failure::from(error)
    };
    let scene = Arc::new(scene);
    let reply = repose_local::score(&scene, (args.query, &[args.anchor]), &transforms, args.realism_by, &models).map_err(of_file)?;
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
