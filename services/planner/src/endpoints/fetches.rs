//! Scenes that are being fetched: of several calls on a scene that is not here the first fetches it, and the others wait for that.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::{Mutex as AsyncMutex, OwnedMutexGuard};

type UnderWay = BTreeMap<String, Arc<AsyncMutex<()>>>;

/// The fetches under way, by scene.
#[derive(Debug, Default)]
pub struct Fetches {
    under_way: Mutex<UnderWay>,
}

/// The right to fetch a scene; it goes to the next call when this is dropped.
#[derive(Debug)]
pub struct Turn<'a> {
    fetches: &'a Fetches,
    scene_id: String,
    held: Option<OwnedMutexGuard<()>>,
}

impl Fetches {
    /// Waits until no other call fetches a scene. What the one before has fetched is kept by then: look again.
    pub async fn turn(&self, scene_id: &str) -> Turn<'_> {
        let scene_id = scene_id.to_owned();
        let lock = self.under_way().entry(scene_id.clone()).or_default().clone();
        // From here on, so that a call that is cancelled while it waits leaves nothing behind either.
        let mut turn = Turn { fetches: self, scene_id, held: None };
        turn.held = Some(lock.lock_owned().await);
        turn
    }

    fn under_way(&self) -> MutexGuard<'_, UnderWay> {
        self.under_way.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Turn<'_> {
    fn drop(&mut self) {
        self.held = None;
        let mut under_way = self.fetches.under_way();
        // Those that wait hold it, too.
        if under_way.get(&self.scene_id).is_some_and(|lock| Arc::strong_count(lock) == 1) {
            under_way.remove(&self.scene_id);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[tokio::test]
    async fn one_call_fetches_a_scene_at_a_time_and_another_scene_waits_for_nobody() {
        let fetches = Fetches::default();
        let first = fetches.turn("a").await;
        let other = tokio::time::timeout(Duration::from_secs(5), fetches.turn("b")).await.expect("at once");
        let mut second = Box::pin(fetches.turn("a"));
        assert!(futures::poll!(&mut second).is_pending());
        {
            let mut cancelled = Box::pin(fetches.turn("a"));
            assert!(futures::poll!(&mut cancelled).is_pending());
        }
        drop(first);
        let second = tokio::time::timeout(Duration::from_secs(5), second).await.expect("its turn");
        assert_eq!(fetches.under_way().len(), 2);
        drop((second, other));
        assert!(fetches.under_way().is_empty(), "nothing is left behind");
    }
}
