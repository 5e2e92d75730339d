//! Whether anybody still reads the response to a request over HTTP.
//!
//! The protocol's kit lets a call of a session go on when its connection is lost, so that a client may come back for the answer. An arm is not to
//! move for whoever may come back.

use axum::body::Body;
use axum::extract::Request;
use axum::middleware::Next;
use axum::response::Response;
use futures::StreamExt as _;
use repose_runtime::CancellationToken;

/// Is cancelled when nobody reads the response any more: it has come to its end, or its connection is gone. An extension of the request.
#[derive(Debug, Clone)]
pub struct Unread(pub CancellationToken);

/// Gives a request its [`Unread`].
pub async fn watched(mut request: Request, next: Next) -> Response {
    let unread = CancellationToken::new();
    let reading = unread.clone().drop_guard();
    request.extensions_mut().insert(Unread(unread));
    let response = next.run(request).await;
    response.map(|body| {
        let parts = body.into_data_stream().map(move |part| {
            // Goes with the stream, which the server drops together with its connection.
            let _reading = &reading;
            part
        });
        Body::from_stream(parts)
    })
}
