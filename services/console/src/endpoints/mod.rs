//! The console over HTTP: the page, signing in, the stop, and the way to a viewer's WebSocket.
//!
//! Every request passes [`guarded`] first: nothing is answered to a page of another site, or under a name that is not ours.

mod arrangement;
mod calls;
mod cells;
mod ending;
mod planned;
mod refusal;
mod requests;
mod sequence;
mod site;
mod socket;
mod state;
mod stop;

use std::sync::Arc;

use axum::Json;
use axum::Router;
use axum::body::Body;
use axum::extract::{Request, State as Shared};
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use axum::middleware::{Next, from_fn_with_state};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use repose_proto::CallError;
use repose_runtime::Shutdown;

pub use self::ending::end;
use self::refusal::refused;
pub use self::state::AppState;
use crate::access::COOKIE;
use crate::page::{INDEX, file};

/// The largest body of a request, bytes: a token or a stop.
const MAX_BODY: usize = 4096;

/// All routes.
pub fn router(state: Arc<AppState>, shutdown: Shutdown) -> Router {
    let socket =
        move |state: Shared<Arc<AppState>>, headers: HeaderMap, uri: Uri, upgrade| socket::upgraded(state, headers, uri, upgrade, shutdown);
    Router::new()
        .route("/", get(index))
        .route("/socket", get(socket))
        .route("/stop", post(stop::stop))
        .route("/sign-in", post(sign_in))
        .route("/health", get(|| async { "ok\n" }))
        .fallback(page_file)
        .layer(axum::extract::DefaultBodyLimit::max(MAX_BODY))
        .layer(from_fn_with_state(state.clone(), guarded))
        .with_state(state)
}

/// Refuses other sites and other names, and tells the browser to be as strict.
async fn guarded(Shared(state): Shared<Arc<AppState>>, request: Request, next: Next) -> Response {
    if let Err(reason) = admitted(&state, &request) {
        tracing::debug!(path = request.uri().path(), reason, "refused");
        return (StatusCode::FORBIDDEN, format!("{reason}\n")).into_response();
    }
    let mut response = next.run(request).await;
    let headers = response.headers_mut();
    for (name, value) in [
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::X_FRAME_OPTIONS, "DENY"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    response
}

fn admitted(state: &AppState, request: &Request) -> Result<(), String> {
    let text = |name: header::HeaderName| request.headers().get(name).and_then(|v| v.to_str().ok());
    // A link on another site may lead here; nothing else of another site may reach more than the page.
    let acts = ["/socket", "/stop", "/sign-in"].contains(&request.uri().path());
    let site = text(header::HeaderName::from_static("sec-fetch-site")).filter(|_| acts);
    state.access.admits(text(header::HOST), text(header::ORIGIN), site)
}

async fn index(Shared(state): Shared<Arc<AppState>>, headers: HeaderMap) -> Response {
    if state.role(&headers).is_some() {
        state.expect_viewer();
    }
    let nonce = uuid::Uuid::new_v4().simple().to_string();
    let policy = format!(
        "default-src 'none'; script-src 'self' 'nonce-{nonce}'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; \
         base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    );
    let headers = [
        (header::CONTENT_TYPE, "text/html; charset=utf-8".to_owned()),
        (header::CACHE_CONTROL, "no-store".to_owned()),
        (header::CONTENT_SECURITY_POLICY, policy),
    ];
    (headers, INDEX.replace("NONCE", &nonce)).into_response()
}

async fn page_file(request: Request) -> Response {
    let Some(file) = file(request.uri().path()) else {
        return (StatusCode::NOT_FOUND, "no such page\n").into_response();
    };
    let tag = format!("\"{}\"", file.hash());
    let is_known = request.headers().get(header::IF_NONE_MATCH).is_some_and(|known| known.as_bytes() == tag.as_bytes());
    let headers =
        [(header::ETAG, tag), (header::CACHE_CONTROL, "no-cache".to_owned()), (header::CONTENT_TYPE, file.media_type().to_owned())];
    match is_known {
        true => (StatusCode::NOT_MODIFIED, headers).into_response(),
        false => (headers, Body::from(file.bytes)).into_response(),
    }
}

/// Takes a token and leaves it with the browser, where scripts cannot read it.
async fn sign_in(Shared(state): Shared<Arc<AppState>>, token: String) -> Response {
    let Some(role) = state.access.role_of(Some(token.trim())) else {
        return refused(StatusCode::UNAUTHORIZED, &CallError::invalid("token", "this token is not known here"));
    };
    let secure = if state.over_tls { "; Secure" } else { "" };
    let cookie = format!("{COOKIE}={}; Path=/; HttpOnly; SameSite=Strict{secure}", token.trim());
    ([(header::SET_COOKIE, cookie)], Json(serde_json::json!({"role": role}))).into_response()
}
