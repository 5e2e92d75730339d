//! An agent on a pair of streams, as on standard input and output.

use std::sync::Arc;
use std::time::Duration;

use repose_mcp::protocol::serve_streams;
use repose_mcp::{Desk, McpError};
use repose_proto::CallError;
use repose_runtime::Shutdown;
use serde_json::{Value, json};
use tokio::io::{AsyncBufReadExt, AsyncWriteExt, BufReader, DuplexStream};
use tokio::task::JoinHandle;

use super::WITHIN;

/// Room for what is written and not read yet, bytes.
const ROOM: usize = 1 << 16;

/// An agent that has a server of its own.
pub struct Agent {
    pub shutdown: Shutdown,
    stream: BufReader<DuplexStream>,
    asked: u64,
    serving: JoinHandle<Result<(), McpError>>,
}

impl Agent {
    /// One that has introduced itself, to a server that waits so long for what it has begun, when it is to end.
    pub async fn connect(desk: Arc<Desk>, drain: Duration) -> Self {
        let ((stream, server), shutdown) = (tokio::io::duplex(ROOM), Shutdown::new());
        let (input, output) = tokio::io::split(server);
        let serving = tokio::spawn(serve_streams(desk, input, output, drain, shutdown.clone()));
        let mut agent = Self { shutdown, stream: BufReader::new(stream), asked: 0, serving };
        let hello = json!({"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": {"name": "tests", "version": "1"}});
        agent.request("initialize", hello).await;
        agent.answer().await;
        agent.write(json!({"jsonrpc": "2.0", "method": "notifications/initialized"})).await;
        agent
    }

    /// Calls a tool, and does not wait for the answer.
    pub async fn ask(&mut self, tool: &str, arguments: Value) {
        self.request("tools/call", json!({"name": tool, "arguments": arguments})).await;
    }

    /// The next answer.
    pub async fn answer(&mut self) -> Value {
        let reading = async {
            loop {
                let mut line = String::new();
                assert!(self.stream.read_line(&mut line).await.expect("read") > 0, "no answer has come");
                let mut message: Value = serde_json::from_str(&line).expect("a message");
                assert!(message.get("error").is_none(), "{message}");
                if let Some(result) = message.get_mut("result") {
                    return result.take();
                }
            }
        };
        tokio::time::timeout(WITHIN, reading).await.expect("answered in time")
    }

    /// Says that nothing more will come. It reads on.
    pub async fn close_input(&mut self) {
        self.stream.shutdown().await.expect("closed");
    }

    /// Waits until its server has ended.
    pub async fn end(self) {
        tokio::time::timeout(WITHIN, self.serving).await.expect("ended in time").expect("joined").expect("served");
    }

    async fn request(&mut self, method: &str, params: Value) {
        self.asked += 1;
        self.write(json!({"jsonrpc": "2.0", "id": self.asked, "method": method, "params": params})).await;
    }

    async fn write(&mut self, message: Value) {
        self.stream.write_all(format!("{message}\n").as_bytes()).await.expect("written");
    }
}

/// The error that a refusal says.
pub fn error_of(refusal: &Value) -> CallError {
    assert_eq!(refusal["isError"], true, "not refused: {refusal}");
    let data = refusal["content"][1]["text"].as_str().unwrap_or_else(|| panic!("no second text: {refusal}"));
    let mut data: Value = serde_json::from_str(data).expect("JSON");
    let error: CallError = serde_json::from_value(data["error"].take()).expect("an error");
    assert_eq!(refusal["content"][0]["text"], error.to_string());
    error
}
