//! `repose serve`: one service, or the router, as this process.

use repose_runtime::{Session, Shutdown, run_router};

use crate::args::{ServeArgs, Served};
use crate::client::{self, client_config, router_config};
use crate::failure::Outcome;
use crate::services::ServiceConfigs;

/// Runs until SIGTERM or SIGINT, then drains.
pub async fn run(args: &ServeArgs) -> Outcome {
    let shutdown = Shutdown::on_signals()?;
    match args.service {
        Served::Router => Ok(run_router(router_config(&args.system)?, shutdown).await?),
        Served::Service(service) => {
            let mut config = client_config(&args.system)?;
            if args.worker.is_some() {
                config.worker.name.clone_from(&args.worker);
            }
            let services = ServiceConfigs::load(args.system.config.as_deref())?;
            let cell = config.session.cell.clone();
            let session = Session::open(config).await?;
            tracing::info!(%service, cell, "serving");
            let served = services.run(service, session.clone(), shutdown).await;
            client::close(session).await;
            served
        }
    }
}
