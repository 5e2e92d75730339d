//! Who is alive, as widely as a session may look.

use std::collections::BTreeSet;

use repose_proto::{Cell, Service, keys};

use crate::RuntimeError;
use crate::transport::{AliveWatch, Transport};

/// The liveliness tokens of every cell; of a session that is let in as a user, those of its own cell and its pool's workers. Access control drops a question
/// that is wider than what the user may see, whole.
pub struct Lives {
    watches: Vec<AliveWatch>,
}

impl Lives {
    pub(crate) async fn watch(transport: &dyn Transport, cell: &Cell, pool: Option<&Cell>) -> Result<Self, RuntimeError> {
        let of_pool = pool.into_iter().flat_map(|pool| Service::ALL.into_iter().filter(|s| s.is_poolable()).map(|s| pool.lives(s)));
        let visible: Vec<String> = match transport.is_user() {
            true => of_pool.chain([cell.all_lives()]).collect(),
            false => vec![keys::LIVES_EVERYWHERE.to_owned()],
        };
        let mut watches = Vec::new();
        for key in visible {
            watches.push(transport.watch_alive(&key).await?);
        }
        Ok(Self { watches })
    }

    /// The keys alive now.
    pub fn current(&mut self) -> BTreeSet<String> {
        self.watches.iter_mut().flat_map(AliveWatch::current).collect()
    }

    /// Waits until that has changed; false when the transport has closed. Cancel safe.
    pub async fn changed(&mut self) -> bool {
        futures::future::select_all(self.watches.iter_mut().map(|watch| Box::pin(watch.changed()))).await.0
    }
}
