//! The Model Context Protocol, by its official kit. The only file that knows the kit, whose interface changes often.

use std::pin::pin;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::http::request::Parts;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use repose_proto::CallError;
use repose_runtime::{CancellationToken, Shutdown};
use rmcp::model::{
    CallToolRequestParams, CallToolResponse, CallToolResult, ContentBlock, Implementation, ListToolsResult, PaginatedRequestParams,
    ServerCapabilities, ServerConfig, ToolAnnotations,
};
use rmcp::service::{RequestContext, serve_server_with_ct};
use rmcp::transport::streamable_http_server::session::local::LocalSessionManager;
use rmcp::transport::streamable_http_server::{StreamableHttpServerConfig, StreamableHttpService};
use rmcp::{ErrorData, RoleServer, ServerHandler};
use serde_json::{Value, json};
use tokio::io::{AsyncRead, AsyncWrite};

use crate::McpError;
use crate::answer::ToolResult;
use crate::asker::Asker;
use crate::desk::Desk;
use crate::input::AgentInput;
use crate::response::Unread;
use crate::tools::{INSTRUCTIONS, Tool, call};

/// The header that names a session over HTTP.
const SESSION: &str = "mcp-session-id";
/// What the one session on standard input and output is called.
const STDIO: &str = "stdio";
/// How long a session over HTTP may say nothing: people think between a plan and its execution.
const IDLE: Duration = Duration::from_secs(3600);
/// Longest name that is taken of a client, characters.
const NAME: usize = 100;
/// How long an agent on standard input and output may take to read its last answers. The kit itself writes them for two seconds.
const LAST_ANSWERS: Duration = Duration::from_secs(3);

/// Serves one agent on standard input and output.
pub async fn serve_stdio(desk: Arc<Desk>, drain: Duration, shutdown: Shutdown) -> Result<(), McpError> {
    let (input, output) = rmcp::transport::stdio();
    serve_streams(desk, input, output, drain, shutdown).await
}

/// Serves one agent whose messages come by `input`, and who reads what is written to `output`: until it leaves, or until `shutdown` and then until the
/// execution under way is over, at most for `drain`.
pub async fn serve_streams<R, W>(desk: Arc<Desk>, input: R, output: W, drain: Duration, shutdown: Shutdown) -> Result<(), McpError>
where
    R: AsyncRead + Send + Unpin + 'static,
    W: AsyncWrite + Send + Unpin + 'static,
{
    let agent_ends = CancellationToken::new();
    let mut agent = pin!(async {
        let input = AgentInput::new(input);
        let server = Server { desk: desk.clone(), input_ended: Some(input.ended()) };
        let running = serve_server_with_ct(server, (input, output), agent_ends.clone()).await;
        running.map_err(|e| McpError::Serve(e.to_string()))?.waiting().await.map(drop).map_err(|e| McpError::Serve(e.to_string()))
    });
    let ending = async {
        shutdown.requested().await;
        desk.end(drain).await;
    };
    tokio::select! {
        ended = &mut agent => ended,
        () = ending => {
            // What is answered by then is still written; an agent that does not read it is left.
            agent_ends.cancel();
            drop(tokio::time::timeout(LAST_ANSWERS, agent).await);
            Ok(())
        }
    }
}

/// The route of agents over HTTP, whose sessions `ending` ends. Every request of a web page is refused: agents say no origin. Under which names it is asked
/// is the door's to look at.
pub fn http(desk: Arc<Desk>, ending: CancellationToken) -> Router {
    let config = StreamableHttpServerConfig::default().disable_allowed_hosts().enforce_origin_validation().with_cancellation_token(ending);
    let mut sessions = LocalSessionManager::default();
    sessions.session_config.keep_alive = Some(IDLE);
    let server = move || Ok(Server { desk: desk.clone(), input_ended: None });
    let service = StreamableHttpService::new(server, Arc::new(sessions), config);
    Router::new().route_service("/mcp", service)
}

#[derive(Clone)]
struct Server {
    desk: Arc<Desk>,
    /// Of the agent on standard input and output: is cancelled when nothing comes from it any more. None over HTTP.
    input_ended: Option<CancellationToken>,
}

impl Server {
    /// Who asks, as the client says it of itself and the transport knows its session.
    fn asker(&self, context: &RequestContext<RoleServer>) -> Asker {
        let said = context.client_info().map(|client| format!("{} {}", client.name, client.version));
        let client: String = said.unwrap_or_else(|| "unknown".to_owned()).chars().filter(|c| !c.is_control()).take(NAME).collect();
        let session = match self.input_ended {
            Some(_) => STDIO.to_owned(),
            // Clients of the newer protocol have no session: then it is the name, and an id that nobody can guess.
            None => {
                let header = context.extensions.get::<Parts>().and_then(|parts| parts.headers.get(SESSION)?.to_str().ok());
                header.map_or_else(|| client.clone(), str::to_owned)
            }
        };
        Asker { client, session }
    }

    /// Waits until a call is not to go on for who asked. Over HTTP that is when nobody reads the answer any more. On standard input and output an agent
    /// may close its input and read on, as a script does: the kit ends what is open only seconds after that, and an arm is to come to rest at once.
    async fn deserted(&self, tool: &str, context: &RequestContext<RoleServer>) {
        let only_reads = Tool::parse(tool).is_some_and(Tool::only_reads);
        match (unread(context), &self.input_ended) {
            (Some(Unread(unread)), _) => unread.cancelled().await,
            (None, Some(ended)) if !only_reads => ended.cancelled().await,
            (None, _) => std::future::pending().await,
        }
    }
}

impl ServerHandler for Server {
    fn get_info(&self) -> ServerConfig {
        ServerConfig::new(ServerCapabilities::builder().enable_tools().build())
            .with_server_info(Implementation::new("repose", env!("CARGO_PKG_VERSION")))
            .with_instructions(INSTRUCTIONS)
    }

    async fn list_tools(&self, _: Option<PaginatedRequestParams>, _: RequestContext<RoleServer>) -> Result<ListToolsResult, ErrorData> {
        let allow_execute = self.desk.settings().allow_execute;
        let offered = Tool::ALL.into_iter().filter(|tool| tool.is_offered(allow_execute));
        Ok(ListToolsResult::with_all_items(offered.map(described).collect()))
    }

    async fn call_tool(&self, request: CallToolRequestParams, context: RequestContext<RoleServer>) -> Result<CallToolResponse, ErrorData> {
        let asker = self.asker(&context);
        let owed = (Tool::parse(&request.name) == Some(Tool::Execute)).then(|| self.desk.moves.owe());
        let arguments = request.arguments.map_or(Value::Null, Value::Object);
        let cancel = context.ct.child_token();
        let mut answered = pin!(call(&self.desk, &request.name, arguments, &asker, cancel.clone()));
        let answered = tokio::select! {
            answered = &mut answered => answered,
            () = self.deserted(&request.name, &context) => {
                cancel.cancel();
                answered.await
            }
        };
        // The end of the kit's sessions cuts off what is read over HTTP.
        if let (Some(owed), Some(Unread(unread))) = (owed, unread(&context).cloned()) {
            tokio::spawn(async move {
                unread.cancelled().await;
                drop(owed);
            });
        }
        Ok(match answered {
            Ok(answer) => result(answer),
            Err(error) => refusal(&error),
        }
        .into())
    }
}

/// What says that nobody reads the response any more, over HTTP.
fn unread(context: &RequestContext<RoleServer>) -> Option<&Unread> {
    context.extensions.get::<Parts>().and_then(|parts| parts.extensions.get::<Unread>())
}

fn described(tool: Tool) -> rmcp::model::Tool {
    let hints = ToolAnnotations::new()
        .read_only(tool.only_reads())
        .destructive(tool == Tool::Execute)
        .idempotent(tool != Tool::Execute)
        .open_world(false);
    rmcp::model::Tool::new(tool.name(), tool.description(), Arc::new(tool.input()))
        .with_raw_output_schema(Arc::new(tool.output()))
        .with_annotations(hints)
}

fn result(answer: ToolResult) -> CallToolResult {
    let mut content = vec![ContentBlock::text(answer.text)];
    content.extend(answer.picture.map(|jpeg| ContentBlock::image(STANDARD.encode(jpeg), "image/jpeg")));
    let mut result = CallToolResult::success(content);
    result.structured_content = Some(answer.data);
    result
}

/// An error that the agent reads, with its code and field as everywhere else in a second text. Not as structured content: clients hold that against the
/// schema of what the tool answers, an error's too, and where it does not fit they show the agent nothing of it.
fn refusal(error: &CallError) -> CallToolResult {
    let data = json!({"error": error}).to_string();
    CallToolResult::error(vec![ContentBlock::text(error.to_string()), ContentBlock::text(data)])
}
