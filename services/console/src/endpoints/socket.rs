//! A viewer's WebSocket: requests in, messages out, until either side goes.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use axum::body::Bytes;
use axum::extract::State as Shared;
use axum::extract::ws::{CloseFrame, Message as Frame, Utf8Bytes, WebSocket, WebSocketUpgrade, close_code};
use axum::http::{HeaderMap, Uri};
use axum::response::Response;
use futures::stream::SplitSink;
use futures::{SinkExt, StreamExt};
use repose_runtime::Shutdown;
use tokio::sync::watch;

use super::requests::Viewer;
use super::state::AppState;
use crate::access::Role;
use crate::messages::{Request, ServerMessage};
use crate::page::page_hash;
use crate::viewers::{Outbox, Outgoing, Topic, ViewerMessage};

/// The largest message of a viewer's, bytes.
const MAX_MESSAGE: usize = 256 * 1024;
/// How often a silent viewer is asked whether it is there.
const PING_EVERY: Duration = Duration::from_secs(5);
/// How long it may take to take the last words.
const GOODBYE_WITHIN: Duration = Duration::from_secs(1);
/// How long a viewer may take to take a message, or to answer a ping, before it counts as gone.
const GONE_AFTER: Duration = Duration::from_secs(20);
/// In the query of the socket's address: the viewer says of every message that it has come, and joins those that come in parts.
const PACED: &str = "paced";
/// The close code of a viewer without a good token; 4000 to 4999 are free for applications.
const UNKNOWN: u16 = 4401;
/// The close code of a viewer for whom there is no room.
const FULL: u16 = 4503;

/// Makes a viewer of an HTTP request.
pub async fn upgraded(
    Shared(state): Shared<Arc<AppState>>,
    headers: HeaderMap,
    uri: Uri,
    upgrade: WebSocketUpgrade,
    shutdown: Shutdown,
) -> Response {
    let upgrade = upgrade.max_message_size(MAX_MESSAGE).max_frame_size(MAX_MESSAGE);
    // Browsers hide the status of a refused upgrade from the page: why it is let go is told by a close code.
    let Some(role) = state.role(&headers) else {
        return upgrade.on_upgrade(|socket| closed(socket, UNKNOWN, Utf8Bytes::from_static("this console asks for a token")));
    };
    let most = places(state.config.max_viewers, role);
    let Some(place) = Place::take(&state, most) else {
        let reason = format!("this console serves {most} pages at once, and as many are open");
        return upgrade.on_upgrade(|socket| closed(socket, FULL, Utf8Bytes::from(reason)));
    };
    let is_paced = uri.query().is_some_and(|query| query.split('&').any(|option| option == PACED));
    let outbox = if is_paced { Outbox::paced() } else { Outbox::default() };
    upgrade.on_upgrade(move |socket| async move {
        serve(socket, state, role, outbox, shutdown).await;
        drop(place);
    })
}

/// How many pages may be open when one of a role comes: all but operators leave a quarter of the places to them, so that whoever looks on keeps
/// nobody from the robot.
fn places(max_viewers: usize, role: Role) -> usize {
    match role {
        Role::Operator => max_viewers,
        Role::Planner | Role::Viewer => max_viewers - max_viewers / 4,
    }
}

/// One of the places that `max_viewers` gives.
struct Place(watch::Sender<usize>);

impl Place {
    fn take(state: &AppState, most: usize) -> Option<Self> {
        let is_taken = state.open_viewers.send_if_modified(|open| {
            let is_free = *open < most;
            *open += usize::from(is_free);
            is_free
        });
        is_taken.then(|| Self(state.open_viewers.clone()))
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.0.send_modify(|open| *open -= 1);
    }
}

/// Waits until every viewer that takes the last words has them.
pub async fn goodbyes(state: &AppState) {
    let mut open = state.open_viewers.subscribe();
    drop(tokio::time::timeout(GOODBYE_WITHIN, open.wait_for(|open| *open == 0)).await);
}

async fn closed(mut socket: WebSocket, code: u16, reason: Utf8Bytes) {
    // Whoever is gone already need not be told.
    drop(socket.send(Frame::Close(Some(CloseFrame { code, reason }))).await);
}

async fn serve(socket: WebSocket, state: Arc<AppState>, role: Role, outbox: Outbox, shutdown: Shutdown) {
    let id = state.next_viewer.fetch_add(1, Ordering::Relaxed);
    let outbox = Arc::new(outbox);
    let cell = state.session.cell().name().to_owned();
    outbox.put(
        Topic::Welcome,
        ServerMessage::Welcome { version: env!("CARGO_PKG_VERSION"), page: page_hash().to_owned(), role, cell }.encode(),
    );
    let viewer = Viewer::new(id, role, outbox.clone(), state);
    if let Err(error) = viewer.look_everywhere().await {
        tracing::warn!(%error, "the cells cannot be told");
    }
    let (sink, mut stream) = socket.split();
    let mut writing = tokio::spawn(write(sink, viewer.clone(), shutdown));
    loop {
        tokio::select! {
            // Pongs count: a viewer that is there is heard every few seconds.
            heard = tokio::time::timeout(GONE_AFTER, stream.next()) => match heard {
                Ok(Some(Ok(Frame::Text(text)))) => read(&viewer, &text),
                Ok(Some(Ok(Frame::Close(_)) | Err(_)) | None) | Err(_) => break,
                Ok(Some(Ok(_))) => {}
            },
            _ = &mut writing => break,
        }
    }
    outbox.close();
    viewer.leave().await;
    writing.abort();
    tracing::debug!(viewer = id, replaced = outbox.replaced(), "a viewer has left");
}

fn read(viewer: &Arc<Viewer>, text: &Utf8Bytes) {
    match repose_proto::message::from_json::<Request>(text.as_bytes()) {
        Ok(request) => viewer.take(request),
        Err(error) => {
            // The id may be readable where the request is not.
            let id = serde_json::from_str::<serde_json::Value>(text).ok().and_then(|v| v.get("id")?.as_u64()).unwrap_or(0);
            viewer.outbox().put(Topic::Answer(id), ServerMessage::Refused { id, error }.encode());
        }
    }
}

async fn write(mut sink: SplitSink<WebSocket, Frame>, viewer: Arc<Viewer>, shutdown: Shutdown) {
    let mut ping = tokio::time::interval(PING_EVERY);
    loop {
        let frame = tokio::select! {
            message = viewer.outbox().next() => match message {
                Some(message) => frame_of(message, &viewer),
                None => break,
            },
            _ = ping.tick() => Frame::Ping(Bytes::new()),
            () = shutdown.requested() => return say_goodbye(sink, &viewer).await,
        };
        match tokio::time::timeout(GONE_AFTER, sink.send(frame)).await {
            Ok(Ok(())) => {}
            Ok(Err(_)) | Err(_) => return,
        }
    }
}

/// The last words to a viewer: what it was still to be told of what is carried out, the answers that are there, and that the console goes.
async fn say_goodbye(mut sink: SplitSink<WebSocket, Frame>, viewer: &Viewer) {
    let saying = async {
        for message in viewer.outbox().last_words(|topic| matches!(topic, Topic::Activity | Topic::Answer(_))) {
            sink.send(frame_of(Outgoing::Whole(message), viewer)).await?;
        }
        let reason = Utf8Bytes::from_static("the console is ending");
        sink.send(Frame::Close(Some(CloseFrame { code: close_code::RESTART, reason }))).await
    };
    drop(tokio::time::timeout(GOODBYE_WITHIN, saying).await);
}

fn frame_of(message: Outgoing, viewer: &Viewer) -> Frame {
    match message {
        Outgoing::Whole(ViewerMessage::Text(text)) => Frame::Text(Utf8Bytes::from(&*text)),
        Outgoing::Whole(ViewerMessage::Binary(bytes)) => Frame::Binary(bytes),
        Outgoing::Whole(ViewerMessage::View(view)) => {
            viewer.sends(view.clone());
            Frame::Binary(view.bytes.clone())
        }
        Outgoing::Part { bytes, begins } => {
            if let Some(view) = begins {
                viewer.sends(view);
            }
            Frame::Binary(bytes)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_looks_on_leaves_places_to_operators() {
        for (most, others) in [(32, 24), (4, 3), (3, 3), (1, 1)] {
            assert_eq!((places(most, Role::Operator), places(most, Role::Viewer), places(most, Role::Planner)), (most, others, others));
        }
    }
}
