//! What a session puts again and again: declared to Zenoh once for each key, so that it goes out only while somebody subscribes to it.
//!
//! A put to a key that was not declared goes to the router whoever listens: a robot's states a hundred times a second, a camera's frames at 10 MB/s. For
//! a declared publisher the session is told who subscribes; until it knows, and again after it has found another router, everything goes out.

use std::collections::HashMap;
use std::sync::Arc;

use tokio::sync::Mutex;
use zenoh::pubsub::Publisher;

use crate::RuntimeError;
use crate::zenoh_transport::Delivery;

/// The publishers of a session, by key.
#[derive(Default)]
pub(crate) struct Streams {
    declared: Mutex<HashMap<String, Arc<Publisher<'static>>>>,
}

impl Streams {
    /// The publisher of a key, declared when it is first asked for. A key carries one kind of traffic.
    ///
    /// # Errors
    /// When the session has closed.
    pub(crate) async fn of(
        &self,
        session: &zenoh::Session,
        key: &str,
        delivery: Delivery,
    ) -> Result<Arc<Publisher<'static>>, RuntimeError> {
        let mut declared = self.declared.lock().await;
        if let Some(publisher) = declared.get(key) {
            return Ok(publisher.clone());
        }
        let publisher = session
            .declare_publisher(key.to_owned())
            .priority(delivery.priority)
            .congestion_control(delivery.congestion)
            .express(delivery.is_express)
            .await
            .map_err(|e| RuntimeError::transport(format!("declaring what is put to {key}"), e))?;
        let publisher = Arc::new(publisher);
        declared.insert(key.to_owned(), publisher.clone());
        Ok(publisher)
    }

    /// Takes the declarations back: before their session closes.
    pub(crate) async fn clear(&self) {
        self.declared.lock().await.clear();
    }
}
