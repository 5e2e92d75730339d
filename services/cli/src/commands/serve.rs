//! `repose serve`: one service, or the router, as this process.

use repose_runtime::{RuntimeConfig, Session, SessionMode, Shutdown, run_router};

use crate::args::{ServeArgs, Served};
use crate::failure::Outcome;
use crate::services::ServiceConfigs;

/// Runs until SIGTERM or SIGINT, then drains.
pub async fn run(args: &ServeArgs) -> Outcome {
    let shutdown = Shutdown::on_signals()?;
    let mut config = RuntimeConfig::load(args.config.as_deref())?;
    config.session.cell.clone_from(&args.cell);
    config.worker.name.clone_from(&args.worker);
    match args.service {
        Served::Router => {
            config.session.mode = SessionMode::Router;
            config.session.listen = vec![args.connect.clone()];
            Ok(run_router(config, shutdown).await?)
        }
        Served::Service(service) => {
            config.session.mode = SessionMode::Client;
            config.session.connect = vec![args.connect.clone()];
            let services = ServiceConfigs::load(args.config.as_deref())?;
            let session = Session::open(config).await?;
            tracing::info!(%service, cell = args.cell, "serving");
            let served = services.run(service, session.clone(), shutdown).await;
            session.close().await?;
            served
        }
    }
}
