//! `repose cells`: every cell of a system with the names in it, in one place: cameras, robots, and workers of each service.

use std::collections::BTreeMap;
use std::time::Duration;

use clap::Args;
use futures::future::try_join_all;
use repose_evaluation::report::text::table;
use repose_proto::{Service, keys};
use repose_runtime::Session;
use serde::Serialize;
use serde_json::json;

use crate::cell_survey::{CellListener, CellSurvey, listed};
use crate::client::{self, SystemArgs};
use crate::failure::{CommandResult, Failure};
use crate::output::Output;

/// Arguments of `cells`.
#[derive(Debug, Args)]
pub struct CellsArgs {
    /// The system.
    #[command(flatten)]
    pub system: SystemArgs,
}

/// How long cameras and robots are listened for: workers tell of cameras several times a second, those of earlier releases by a scene a second.
const WITHIN: Duration = Duration::from_millis(1500);

/// What there is in a cell.
#[derive(Debug, Serialize)]
struct CellNames {
    cell: String,
    cameras: Vec<String>,
    robots: Vec<String>,
    /// How many workers each service has.
    workers: BTreeMap<Service, usize>,
}

/// Runs the command.
pub async fn run(args: &CellsArgs, output: Output) -> CommandResult {
    // Each cell's own workers are asked for, and not its pool's a second time.
    let mut config = client::client_config(&args.system)?;
    config.caller.pool = None;
    let session = Session::open(config).await?;
    let alive = session.watch_lives().await?.current();
    let mut cells: Vec<&str> = alive.iter().filter_map(|key| Some(keys::of_live(key)?.0)).collect();
    // Where access control shows no other cell, the own one is still there.
    cells.push(session.cell().name());
    cells.sort_unstable();
    cells.dedup();
    let heard = try_join_all(cells.iter().map(|cell| names(&session, cell))).await;
    client::close(session.clone()).await;
    let cells: Vec<CellNames> = heard?.into_iter().filter(|cell| !cell.is_empty()).collect();
    output.print(&json!({"cells": cells}), || text(&cells))
}

async fn names(session: &Session, cell: &str) -> Result<CellNames, Failure> {
    let mut observer = CellListener::new(&session.in_cell(cell)?).await?;
    let heard = observer.listen(WITHIN, &CellSurvey::default()).await?;
    let mut workers = BTreeMap::new();
    for worker in heard.workers.into_keys() {
        *workers.entry(worker.service).or_default() += 1;
    }
    let (cameras, robots) = (heard.cameras.into_keys().collect(), heard.robots.into_keys().collect());
    Ok(CellNames { cell: cell.to_owned(), cameras, robots, workers })
}

impl CellNames {
    fn is_empty(&self) -> bool {
        self.cameras.is_empty() && self.robots.is_empty() && self.workers.is_empty()
    }
}

fn text(cells: &[CellNames]) -> String {
    if cells.is_empty() {
        return "no cell has a worker, a camera or a robot".to_owned();
    }
    let mut table = table(["cell", "cameras", "robots", "workers"]);
    for cell in cells {
        let workers: Vec<String> = cell.workers.iter().map(|(service, count)| format!("{service} {count}")).collect();
        table.add_row([cell.cell.clone(), listed(&cell.cameras), listed(&cell.robots), listed(&workers)]);
    }
    table.to_string()
}
