//! Who may connect over HTTP: this machine, or whoever shows the token; never a page of another site.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use axum::Router;
use axum::extract::{Request, State};
use axum::http::{HeaderMap, StatusCode, header};
use axum::middleware::{Next, from_fn, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use repose_proto::CallError;
use repose_runtime::{AccessToken, Shutdown, is_own_host, serve_http};
use tokio::net::TcpListener;

use crate::McpError;
use crate::desk::Desk;
use crate::protocol;
use crate::response::watched;

/// Where agents connect.
#[derive(Debug, Clone, PartialEq)]
pub struct HttpSettings {
    /// Address and port; beyond loopback it needs a token.
    pub listen: SocketAddr,
    /// A file with the token that agents show as `Authorization: Bearer …`. Without one, everybody on this machine may connect.
    pub token: Option<PathBuf>,
    /// Names, without a port, by which agents may ask for it; addresses and `localhost` always may.
    pub hosts: Vec<String>,
}

/// A server that is bound to its address and does not serve yet.
pub struct BoundServer {
    listener: TcpListener,
    address: SocketAddr,
    token: Option<AccessToken>,
    hosts: Vec<String>,
}

impl BoundServer {
    /// Checks the settings and takes the address.
    ///
    /// # Errors
    /// When a setting is unusable or the address taken.
    pub async fn open(settings: HttpSettings) -> Result<Self, McpError> {
        let HttpSettings { listen, token, hosts } = settings;
        if !listen.ip().is_loopback() && token.is_none() {
            let message = format!("{listen} can be reached from other machines: that needs a token");
            return Err(McpError::Setting(CallError::invalid("token", message)));
        }
        let token = token.as_deref().map(|file| AccessToken::read("token", file)).transpose().map_err(McpError::Setting)?;
        let listener = TcpListener::bind(listen).await.map_err(|source| McpError::Listen { address: listen, source })?;
        let address = listener.local_addr().map_err(|source| McpError::Listen { address: listen, source })?;
        Ok(Self { listener, address, token, hosts })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// What an agent is given.
    pub fn url(&self) -> String {
        format!("http://{}/mcp", self.address)
    }

    /// Serves until `shutdown`, and then until the execution under way is over and its answer read, at most for `drain`: until then agents are told of it,
    /// and may stop the robot.
    pub async fn serve(self, desk: Arc<Desk>, drain: Duration, shutdown: Shutdown) {
        let agents_end = Shutdown::new();
        let agents = protocol::http(desk.clone(), agents_end.token());
        let door = Arc::new(Door { token: self.token, hosts: self.hosts });
        let routes = Router::new().merge(agents).layer(from_fn(watched)).layer(from_fn_with_state(door, guarded));
        let ending = async {
            shutdown.requested().await;
            desk.end(drain).await;
            agents_end.trigger();
        };
        tokio::join!(ending, serve_http(self.listener, routes, &agents_end));
    }
}

/// What it takes to be let in.
struct Door {
    token: Option<AccessToken>,
    hosts: Vec<String>,
}

/// Refuses whoever comes under a name that is not this server's, or does not show the token where there is one.
async fn guarded(State(door): State<Arc<Door>>, request: Request, next: Next) -> Response {
    let named = request.headers().get(header::HOST).and_then(|host| host.to_str().ok());
    let named = named.or_else(|| request.uri().authority().map(|authority| authority.as_str()));
    if !named.is_some_and(|host| is_own_host(host, &door.hosts)) {
        let message = "the request's Host is no name of this server: expected an address, localhost or one of --host\n";
        return (StatusCode::FORBIDDEN, message).into_response();
    }
    match admits(door.token, request.headers()) {
        true => next.run(request).await,
        false => (StatusCode::UNAUTHORIZED, [(header::WWW_AUTHENTICATE, "Bearer")], "this server needs its token\n").into_response(),
    }
}

fn admits(token: Option<AccessToken>, headers: &HeaderMap) -> bool {
    let Some(token) = token else { return true };
    let shown = headers.get(header::AUTHORIZATION).and_then(|value| value.to_str().ok()).and_then(|value| value.strip_prefix("Bearer "));
    shown.is_some_and(|shown| token.is(shown.trim()))
}

#[cfg(test)]
mod tests {
    use axum::http::HeaderValue;

    use super::*;

    #[test]
    fn only_the_token_opens_a_door_that_has_one() {
        let token = AccessToken::of("a-long-agents-token").ok();
        let with = |value: &'static str| HeaderMap::from_iter([(header::AUTHORIZATION, HeaderValue::from_static(value))]);
        assert!(admits(None, &HeaderMap::new()) && admits(token, &with("Bearer a-long-agents-token")));
        for headers in [HeaderMap::new(), with("Bearer a-guess"), with("a-long-agents-token"), with("Basic a-long-agents-token")] {
            assert!(!admits(token, &headers), "{headers:?}");
        }
    }

    #[test]
    fn an_address_and_a_name_that_was_told_are_the_servers_and_no_other_name_is() {
        let hosts = ["robot-1.example".to_owned()];
        for host in
            ["localhost:7449", "127.0.0.1:7449", "192.168.1.20:7449", "[::1]:7449", "[fe80::1]", "robot-1.example", "Robot-1.example:7449"]
        {
            assert!(is_own_host(host, &hosts), "{host}");
        }
        for host in ["evil.example:7449", "localhost.evil.example", "127.0.0.1.evil.example", ""] {
            assert!(!is_own_host(host, &hosts), "{host}");
        }
    }

    #[tokio::test]
    async fn other_machines_are_let_in_with_a_token_only() {
        let beyond = HttpSettings { listen: "0.0.0.0:0".parse().expect("an address"), token: None, hosts: Vec::new() };
        let refused = BoundServer::open(beyond.clone()).await.err().map(|e| e.to_string());
        assert!(refused.as_deref().is_some_and(|e| e.contains("token")), "{refused:?}");
        let here = HttpSettings { listen: "127.0.0.1:0".parse().expect("an address"), ..beyond };
        let door = BoundServer::open(here.clone()).await.expect("it listens");
        assert!(door.url().starts_with("http://127.0.0.1:") && door.address().port() != 0);
        let short = HttpSettings { token: Some("/dev/null".into()), ..here };
        assert!(BoundServer::open(short).await.err().is_some_and(|e| e.to_string().contains("at least 16")));
    }
}
