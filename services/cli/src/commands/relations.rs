//! `repose relations`: every ordered pair's relations, learned and by rule.

use std::path::PathBuf;
use std::sync::Arc;

use clap::Args;
use repose_evaluation::report::text::table;
use repose_proto::Relation;

use crate::embedded::NetworkArgs;
use crate::failure::CommandResult;
use crate::frames;
use crate::output::Output;

/// Arguments of `relations`.
#[derive(Debug, Args)]
pub struct RelationsArgs {
    /// A frame folder, or any source that `play` accepts, whose first frame is used.
    pub frame: PathBuf,
    /// Which networks.
    #[command(flatten)]
    pub networks: NetworkArgs,
}

/// Runs the command.
pub fn run(args: &RelationsArgs, output: Output) -> CommandResult {
    let scene = repose_local::scene_of(&frames::read(&args.frame)?)?;
    let pairs = repose_local::relations(&Arc::new(scene), args.networks.models()?.as_ref())?;
    output.print(&serde_json::json!({"pairs": pairs}), || {
        let names = Relation::ALL.iter().map(|relation| relation.as_str().replace('_', "\n"));
        let mut table = table(["query", "anchor"].map(str::to_owned).into_iter().chain(names));
        for pair in &pairs {
            let cell = |(p, rule): (&f32, &bool)| format!("{p:.2}{}", if *rule { " *" } else { "" });
            let cells = pair.learned.iter().zip(&pair.rule).map(cell);
            table.add_row([pair.query, pair.anchor].map(|id| id.to_string()).into_iter().chain(cells));
        }
        format!("{table}\nprobability that the query stands in the relation to the anchor; *: it does by rule")
    })
}
