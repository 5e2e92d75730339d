//! What all requests share: the session, who may, and the cells that somebody looks at.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Weak};
use std::time::Duration;

use axum::http::{HeaderMap, HeaderValue, header};
use repose_proto::CallError;
use repose_runtime::{Moves, Session};
use tokio::sync::{Mutex, OnceCell, watch};

use crate::ConsoleConfig;
use crate::access::{Access, Role, token_in};
use crate::cell::WatchedCell;
use crate::viewers::Audience;

use super::cells::follow_cells;

/// How long a page that was asked for may take until it looks at its cell: longer, and the cell is let go until it does.
const PAGE_WITHIN: Duration = Duration::from_secs(5);

/// The state that all HTTP requests share.
pub struct AppState {
    pub(super) session: Session,
    pub(super) config: Arc<ConsoleConfig>,
    pub(super) access: Access,
    pub(super) over_tls: bool,
    pub(super) moves: Moves,
    cells: Mutex<BTreeMap<String, Weak<WatchedCell>>>,
    everywhere: OnceCell<Arc<Audience>>,
    /// Whether the cell is followed for a page that was asked for.
    expects: AtomicBool,
    pub(super) open_viewers: watch::Sender<usize>,
    pub(super) next_viewer: AtomicU64,
}

impl AppState {
    /// For a session and a configuration that has been checked.
    pub fn new(session: Session, config: ConsoleConfig, access: Access, over_tls: bool) -> Self {
        Self {
            session,
            config: Arc::new(config),
            access,
            over_tls,
            moves: Moves::of("the console"),
            cells: Mutex::default(),
            everywhere: OnceCell::new(),
            expects: AtomicBool::new(false),
            open_viewers: watch::Sender::default(),
            next_viewer: AtomicU64::new(1),
        }
    }

    /// A cell, followed from now on if nobody looks at it yet.
    pub(super) async fn cell(&self, name: &str) -> Result<Arc<WatchedCell>, CallError> {
        let mut cells = self.cells.lock().await;
        if let Some(cell) = cells.get(name).and_then(Weak::upgrade) {
            return Ok(cell);
        }
        let cell = Arc::new(WatchedCell::follow(&self.session, name, self.config.clone(), self.moves.clone()).await?);
        cells.retain(|_, known| known.strong_count() > 0);
        cells.insert(name.to_owned(), Arc::downgrade(&cell));
        Ok(cell)
    }

    /// The cells that are followed: those that somebody looks at, and those in which something is carried out.
    pub(super) async fn followed(&self) -> Vec<Arc<WatchedCell>> {
        self.cells.lock().await.values().filter_map(Weak::upgrade).collect()
    }

    /// Begins to follow this console's cell for a page that was asked for: while the browser reads the page, its first picture and scene come.
    pub(super) fn expect_viewer(self: &Arc<Self>) {
        if self.expects.swap(true, Ordering::AcqRel) {
            return;
        }
        let state = self.clone();
        tokio::spawn(async move {
            // What cannot be followed is told to the viewer when it asks.
            if let Ok(cell) = state.cell(state.session.cell().name()).await {
                let _camera = cell.camera(None).await;
                tokio::time::sleep(PAGE_WITHIN).await;
            }
            state.expects.store(false, Ordering::Release);
        });
    }

    /// Those who are told which cells there are.
    pub(super) async fn everywhere(&self) -> Result<&Arc<Audience>, CallError> {
        self.everywhere
            .get_or_try_init(|| async {
                let audience = Arc::new(Audience::default());
                tokio::spawn(follow_cells(&self.session, audience.clone()).await?);
                Ok(audience)
            })
            .await
    }

    pub(super) fn role(&self, headers: &HeaderMap) -> Option<Role> {
        let text = |name| headers.get(name).and_then(|v: &HeaderValue| v.to_str().ok());
        let bearer = text(header::AUTHORIZATION).and_then(|v| v.strip_prefix("Bearer "));
        self.access.role_of(bearer.or_else(|| text(header::COOKIE).and_then(token_in)))
    }
}
