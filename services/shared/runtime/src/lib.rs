//! What every service does alike: configuration, the network session, calls and their workers, scenes by id, bounded compute, logs, metrics,
//! health, shutdown; and [`deployment`], who may do what.
//!
//! The only crate that imports Zenoh. A service's `endpoints.rs` implements [`Handler`]; its `worker.rs` owns a [`ComputeQueue`] or a
//! [`BatchQueue`]; its `lib.rs` has `run(session, config, shutdown)`. Sessions need a multi-threaded Tokio runtime.
//!
//! ```
//! use std::{sync::Arc, time::Duration};
//! use repose_proto::{CallError, Payload, Service, load::WorkerLoad, perception::LatestRequest};
//! use repose_runtime::{Call, CallOptions, ComputeQueue, Handler, QueueSettings, RuntimeConfig, Session};
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
//! # #[tokio::main]
//! # async fn main() -> Result<(), Box<dyn std::error::Error>> {
//! // A service and its caller, here in one process.
//! let session = Session::open(RuntimeConfig::default()).await?;
//! let queue = ComputeQueue::start(QueueSettings { name: "perception".into(), ..Default::default() })?;
//! let server = session.start(Service::Perception, Arc::new(Endpoints { queue })).await?;
//!
//! let perception = session.caller(Service::Perception).await?;
//! let request = Payload::json(&LatestRequest { camera: "front".into() })?;
//! let answer = perception.call("latest", request, CallOptions::within(Duration::from_secs(10))).await?;
//! assert_eq!(answer.payload.decode_json::<LatestRequest>()?.camera, "front");
//! assert_eq!(answer.worker, server.worker());
//! assert!(answer.timing_ms.contains_key("lookup"));
//! server.drain().await;
//! # Ok(())
//! # }
//! ```

mod alive;
mod attempt;
mod call;
mod call_key;
mod call_options;
mod caller;
mod cancel;
mod cell_callers;
mod config;
pub mod deployment;
mod diagnosis;
mod directory;
mod endpoint;
mod error;
mod expiry;
pub mod fake;
mod frame_link;
mod gauge;
mod health;
mod heeded;
mod host;
mod http;
mod job;
mod journal;
mod kept_out;
mod line;
mod lives;
mod log_lines;
pub mod mailbox;
mod moves;
mod namesakes;
mod open_files;
mod opening;
mod outage;
mod queue;
pub mod raw;
mod registry;
mod robots;
mod scenes;
mod scheduling;
mod server;
mod session;
mod shares;
mod shutdown;
mod silence;
mod stages;
mod tally;
mod target;
mod telemetry;
mod token;
mod trace;
pub mod transport;
mod waiting;
mod zenoh_session;
mod zenoh_transport;

pub use call::{Call, Handler};
pub use call_options::CallOptions;
pub use caller::{Answer, Caller};
pub use cell_callers::CellCallers;
pub use config::{
    CallerConfig, RuntimeConfig, SECTIONS, SessionConfig, SessionMode, TelemetryConfig, WorkerConfig, check_counts, list_or_commas,
    load_config,
};
pub use directory::{Accept, WorkerView};
pub use endpoint::endpoint_fault;
pub use error::RuntimeError;
pub use expiry::{CertificateExpiry, CertificateReading, certificates_in_use, watch_certificate};
pub use gauge::{LoadGauge, load_of};
pub use health::{HealthServer, METRICS, start_metrics};
pub use host::{host_name, is_own_host};
pub use http::serve_http;
pub use job::{Job, JobContext, JobReply};
pub use journal::COPIES_WAIT;
pub use lives::Lives;
pub use moves::{Moves, OwedAnswer, UnderWay};
pub use queue::{BatchQueue, ComputeQueue, PendingAnswer, QueueSettings};
pub use robots::{
    STATE_WITHIN, call_moving, emergency_stop, emergency_stop_within, now_ns, reaching_robot, read_robot_mode, read_robot_state,
    refuse_a_second_driver, robot_state,
};
pub use scenes::{SCENE_WITHIN, SceneStore, check_scene_id, fetch_newest, fetch_scene, fetch_scene_payload, fetch_stamp, lacks_scene};
pub use scheduling::{prefer_messages, yield_to_messages};
pub use server::Server;
pub use session::{Publisher, Session, run_router};
pub use shares::{CellShare, Shares};
pub use shutdown::Shutdown;
pub use stages::Stages;
pub use target::Target;
pub use telemetry::{FORMAT_VARIABLE, LOG_VARIABLE, start_logging};
pub use token::AccessToken;
pub use tokio_util::sync::CancellationToken;
pub use transport::{AliveWatch, Guard, Sample, Subscription, Traffic};
