//! An agent that has a session over HTTP.

use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;

use repose_mcp::http::BoundServer;
use repose_mcp::{Desk, HttpSettings};
use repose_runtime::Shutdown;
use serde_json::{Value, json};
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader};
use tokio::net::TcpStream;
use tokio::task::JoinHandle;

use super::WITHIN;

/// What comes back for a request.
pub type Response = BufReader<TcpStream>;

/// An agent that has a server of its own.
pub struct HttpAgent {
    pub shutdown: Shutdown,
    address: SocketAddr,
    session: String,
    asked: u64,
    serving: JoinHandle<()>,
}

impl HttpAgent {
    /// One that has introduced itself, to a server that waits so long for what it has begun, when it is to end.
    pub async fn connect(desk: Arc<Desk>, drain: Duration) -> Self {
        let settings = HttpSettings { listen: "127.0.0.1:0".parse().expect("an address"), token: None, hosts: Vec::new() };
        let (server, shutdown) = (BoundServer::open(settings).await.expect("it listens"), Shutdown::new());
        let address = server.address();
        let serving = tokio::spawn(server.serve(desk, drain, shutdown.clone()));
        let mut agent = Self { shutdown, address, session: String::new(), asked: 0, serving };
        let hello = json!({"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": {"name": "tests", "version": "1"}});
        (agent.session, _) = answered(agent.request("initialize", hello).await).await;
        assert!(!agent.session.is_empty(), "it is a session");
        let mut told = agent.posted(&json!({"jsonrpc": "2.0", "method": "notifications/initialized"})).await;
        told.read_line(&mut String::new()).await.expect("a status");
        agent
    }

    /// Calls a tool, and does not wait for the answer.
    pub async fn ask(&mut self, tool: &str, arguments: Value) -> Response {
        self.request("tools/call", json!({"name": tool, "arguments": arguments})).await
    }

    /// Calls a tool.
    pub async fn answer(&mut self, tool: &str, arguments: Value) -> Value {
        answered(self.ask(tool, arguments).await).await.1
    }

    /// Waits until its server has ended.
    pub async fn end(self) {
        tokio::time::timeout(WITHIN, self.serving).await.expect("ended in time").expect("joined");
    }

    async fn request(&mut self, method: &str, params: Value) -> Response {
        self.asked += 1;
        self.posted(&json!({"jsonrpc": "2.0", "id": self.asked, "method": method, "params": params})).await
    }

    async fn posted(&self, message: &Value) -> Response {
        let Self { address, session, .. } = self;
        let body = message.to_string();
        let session = if session.is_empty() { String::new() } else { format!("Mcp-Session-Id: {session}\r\n") };
        let head = format!(
            "POST /mcp HTTP/1.1\r\nHost: {address}\r\nContent-Type: application/json\r\nAccept: application/json, text/event-stream\r\n\
             MCP-Protocol-Version: 2025-06-18\r\n{session}Content-Length: {}\r\n\r\n",
            body.len()
        );
        let mut stream = TcpStream::connect(address).await.expect("a connection");
        stream.write_all(format!("{head}{body}").as_bytes()).await.expect("sent");
        BufReader::new(stream)
    }
}

/// The session that a response's head names, and the answer.
pub async fn answered(mut response: Response) -> (String, Value) {
    let reading = async {
        let mut session = String::new();
        loop {
            let mut line = String::new();
            assert!(response.read_line(&mut line).await.expect("read") > 0, "no answer has come");
            if let Some(named) = line.to_ascii_lowercase().strip_prefix("mcp-session-id:") {
                session = named.trim().to_owned();
            }
            let Some(Ok(message)) = line.strip_prefix("data:").map(|data| serde_json::from_str::<Value>(data.trim())) else { continue };
            if message.get("result").is_some() {
                return (session, message["result"].clone());
            }
        }
    };
    tokio::time::timeout(WITHIN, reading).await.expect("answered in time")
}
