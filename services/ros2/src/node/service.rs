//! Services: those that the node offers, and those that it calls.

use std::marker::PhantomData;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::Duration;

use repose_ros_messages::{decode, encode};
use repose_runtime::now_ns;
use repose_runtime::raw::{QueryRecipients, RawMessage, RawQueries, RawQuery, RawSession};
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::endpoints::{Declared, Node};
use crate::error::BridgeError;
use crate::wire::attachment::Attachment;
use crate::wire::names::Qos;
use crate::wire::token::EntityKind;
use crate::wire::type_hash::type_named;

/// Requests that may wait to be taken.
const WAITING: usize = 8;

impl Node {
    /// Offers a service.
    ///
    /// # Errors
    /// When the name or the type is unknown, or the network refuses.
    pub async fn serve<Q: DeserializeOwned, A: Serialize>(
        &self,
        service: &str,
        type_name: &'static str,
    ) -> Result<RosServer<Q, A>, BridgeError> {
        let declared = self.declare(EntityKind::Service, service, &type_named(type_name)?, Qos::DEFAULT).await?;
        let queries = self.session().serve(&declared.key, WAITING).await?;
        Ok(RosServer { queries, type_name, _declared: declared, _of: PhantomData })
    }

    /// Something to call a service with.
    ///
    /// # Errors
    /// When the name or the type is unknown, or the network refuses.
    pub async fn client<Q: Serialize, A: DeserializeOwned>(
        &self,
        service: &str,
        type_name: &'static str,
    ) -> Result<RosClient<Q, A>, BridgeError> {
        let declared = self.declare(EntityKind::Client, service, &type_named(type_name)?, Qos::DEFAULT).await?;
        let (session, service) = (self.session().clone(), service.to_owned());
        Ok(RosClient { session, service, declared, type_name, sent: AtomicI64::new(0), _of: PhantomData })
    }
}

/// A service that the node offers.
pub struct RosServer<Q, A> {
    queries: RawQueries,
    type_name: &'static str,
    _declared: Declared,
    _of: PhantomData<fn(Q) -> A>,
}

/// A request and its way back.
pub struct RosRequest<Q, A> {
    /// What was asked.
    pub request: Q,
    query: RawQuery,
    attachment: Attachment,
    type_name: &'static str,
    _of: PhantomData<fn(A)>,
}

impl<Q: DeserializeOwned, A: Serialize> RosServer<Q, A> {
    /// The next request that can be read; none when the session has closed. Cancel safe.
    pub async fn next(&mut self) -> Option<RosRequest<Q, A>> {
        loop {
            let query = self.queries.next().await?;
            // Without its attachment nobody could tell whose response it is.
            let Some(attachment) = Attachment::decode(&query.message.attachment) else {
                tracing::warn!(key = query.message.key, "a request without the attachment of rmw_zenoh is left unanswered");
                continue;
            };
            match decode(&query.message.payload, self.type_name) {
                Ok(request) => return Some(RosRequest { request, query, attachment, type_name: self.type_name, _of: PhantomData }),
                Err(error) => tracing::warn!(key = query.message.key, %error, "a request that cannot be read is left unanswered"),
            }
        }
    }
}

impl<Q, A: Serialize> RosRequest<Q, A> {
    /// Answers.
    ///
    /// # Errors
    /// When the network refuses.
    pub async fn answer(self, response: &A) -> Result<(), BridgeError> {
        let payload = encode(response, self.type_name)?.into();
        let attachment = Attachment { stamp_ns: now_ns() as i64, ..self.attachment }.encode();
        Ok(self.query.reply(payload, attachment).await?)
    }
}

/// Calls one service.
pub struct RosClient<Q, A> {
    session: RawSession,
    service: String,
    declared: Declared,
    type_name: &'static str,
    sent: AtomicI64,
    _of: PhantomData<fn(Q) -> A>,
}

impl<Q: Serialize, A: DeserializeOwned> RosClient<Q, A> {
    /// Calls, and waits for the answer.
    ///
    /// # Errors
    /// [`BridgeError::NoAnswer`] where there is no server, it goes, or it takes longer than `patience`.
    pub async fn call(&self, request: &Q, patience: Duration) -> Result<A, BridgeError> {
        let payload = encode(request, self.type_name)?.into();
        let sequence = self.sent.fetch_add(1, Ordering::Relaxed) + 1;
        let attachment = Attachment { sequence, stamp_ns: now_ns() as i64, gid: self.declared.gid }.encode();
        let message = RawMessage { key: self.declared.key.clone(), payload, attachment };
        let started = tokio::time::Instant::now();
        let mut replies = self.session.query(QueryRecipients::Servers, message, patience).await?;
        let none = || BridgeError::NoAnswer { service: self.service.clone(), waited_ms: started.elapsed().as_millis() };
        let reply = tokio::time::timeout(patience, replies.next()).await.map_err(|_| none())?.ok_or_else(none)?;
        Ok(decode(&reply.payload, self.type_name)?)
    }
}
