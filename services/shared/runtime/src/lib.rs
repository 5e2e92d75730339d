//! What every service does alike: configuration, the network session, calls and their workers, bounded compute, logs, shutdown.
//!
//! The only crate that imports Zenoh. A service's `endpoints.rs` implements [`Handler`]; its `worker.rs` owns a [`ComputeQueue`] or a
//! [`BatchQueue`]; its `lib.rs` has `run(session, config, shutdown)`. Sessions need a multi-threaded Tokio runtime.
//!
//! ```no_run
//! use std::{sync::Arc, time::Duration};
//! use repose_proto::{CallError, Payload, Service, load::WorkerLoad};
//! use repose_proto::perception::{LatestRequest, SceneRequest};
//! use repose_runtime::{Call, CallOptions, ComputeQueue, Handler, QueueSettings, RuntimeConfig, RuntimeError, Session, Shutdown, Traffic};
//!
//! struct Endpoints { queue: ComputeQueue }
//!
//! #[async_trait::async_trait]
//! impl Handler for Endpoints {
//!     async fn call(&self, call: Call) -> Result<Payload, CallError> {
//!         match call.method.as_str() {
//!             "latest" => {
//!                 let request: LatestRequest = call.payload.decode_json()?;
//!                 let reporting = call.clone(); // progress and stages also work from compute threads
//!                 let answer = self.queue.run(call.context(), move |context| {
//!                     context.check()?; // between the steps of a long computation
//!                     reporting.progress(Payload::json(&request)?);
//!                     reporting.timed("lookup", || Payload::json(&request))
//!                 });
//!                 answer.await
//!             }
//!             _ => Err(call.unknown_method()),
//!         }
//!     }
//!
//!     fn load(&self) -> WorkerLoad {
//!         repose_runtime::load_of(&self.queue.gauge(), self.queue.capacity())
//!     }
//! }
//!
//! pub async fn run(session: Session, shutdown: Shutdown) -> Result<(), RuntimeError> {
//!     let queue = ComputeQueue::start(QueueSettings { name: "perception".into(), capacity: 8, threads: 2, ..Default::default() })?;
//!     session.serve(Service::Perception, Arc::new(Endpoints { queue }), shutdown).await
//! }
//!
//! async fn call() -> Result<(), Box<dyn std::error::Error>> {
//!     let session = Session::open(RuntimeConfig::load(None)?).await?;
//!     let perception = session.caller(Service::Perception).await?;
//!     let request = Payload::json(&LatestRequest { camera: "front".into() })?;
//!     let (progress, mut _progressed) = tokio::sync::mpsc::channel(16);
//!     let options = CallOptions { progress: Some(progress), ..CallOptions::within(Duration::from_secs(2)) };
//!     let answer = perception.call("latest", request, options).await?;
//!     let _reply: LatestRequest = answer.payload.decode_json()?;
//!     let by_id = Payload::json(&SceneRequest { scene_id: "0".repeat(64) })?;
//!     let _scene = perception.call_any("scene", &by_id, &CallOptions::default()).await?; // asks every worker
//!     let mut frames = session.subscribe_latest(&session.cell().camera_frames()).await?;
//!     let states = session.publisher(session.cell().robot_state("arm"), Traffic::RobotState);
//!     while let Some(frame) = frames.recv().await { states.put(frame.payload).await?; }
//!     Ok(())
//! }
//! ```

mod attempt;
mod call;
mod caller;
mod config;
mod directory;
mod error;
pub mod fake;
mod gauge;
pub mod mailbox;
mod queue;
mod registry;
mod server;
mod session;
mod shutdown;
mod telemetry;
pub mod transport;
mod zenoh_transport;

pub use call::{Call, Handler};
pub use caller::{Answer, CallOptions, Caller};
pub use config::{CallerConfig, RuntimeConfig, SECTIONS, SessionConfig, SessionMode, WorkerConfig, list_or_commas, load_config};
pub use directory::{Accept, WorkerView};
pub use error::RuntimeError;
pub use gauge::{LoadGauge, load_of};
pub use queue::{BatchQueue, ComputeQueue, Job, JobContext, JobReply, Pending, QueueSettings};
pub use server::Server;
pub use session::{Publisher, Session, run_router};
pub use shutdown::Shutdown;
pub use telemetry::{FORMAT_VARIABLE, LOG_VARIABLE, start_logging};
pub use tokio_util::sync::CancellationToken;
pub use transport::{AliveWatch, Sample, Subscription, Traffic};
