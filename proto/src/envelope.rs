//! What travels beside a payload: the attachment of a call and of each of its replies.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{CallError, limits};

/// Who waits for the answer.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Priority {
    /// A person or a robot.
    #[default]
    Interactive,
    /// Nobody in particular.
    Batch,
}

/// The attachment of a call.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct CallAttachment {
    /// Contract version, 1.
    pub v: u32,
    /// The request's id, a UUID; the same for every attempt.
    pub id: String,
    /// The method of the service.
    pub method: String,
    /// Time left until the deadline, milliseconds, 1 to 600,000.
    pub remaining_ms: u64,
    /// Who waits.
    #[serde(default)]
    pub priority: Priority,
    /// 0 for the first attempt.
    #[serde(default)]
    pub attempt: u32,
    /// W3C trace context, if the caller has one.
    #[serde(default)]
    pub traceparent: Option<String>,
    /// The name that the caller's process goes by, for logs and traces. Whoever sends it may say anything: it is no proof of a user. Left out
    /// where it is not configured, because workers of release 1 refuse it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub caller: Option<String>,
}

impl CallAttachment {
    /// Reads and checks an attachment.
    ///
    /// # Errors
    /// `invalid_argument` that names the field.
    pub fn decode(bytes: &[u8]) -> Result<Self, CallError> {
        // The version is looked at first, so that a newer client is told so and not that some field is unknown.
        #[derive(Deserialize)]
        struct OnlyVersion {
            v: Option<serde_json::Value>,
        }
        let version: OnlyVersion = attachment_json(bytes)?;
        if version.v.as_ref().and_then(serde_json::Value::as_u64) != Some(u64::from(limits::VERSION)) {
            let got = version.v.map_or_else(|| "none".to_owned(), |v| v.to_string());
            return Err(CallError::invalid("v", format!("this worker speaks version {}, got {got}", limits::VERSION)));
        }
        let attachment: Self = attachment_json(bytes)?;
        // Ids become chunks of cancel keys.
        crate::keys::validate_chunk("id", &attachment.id)?;
        if !(1..=limits::MAX_REMAINING_MS).contains(&attachment.remaining_ms) {
            let message = format!("expected 1 to {} ms, got {}", limits::MAX_REMAINING_MS, attachment.remaining_ms);
            return Err(CallError::invalid("remaining_ms", message));
        }
        Ok(attachment)
    }

    /// The attachment's bytes.
    pub fn encode(&self) -> Vec<u8> {
        serde_json::to_vec(self).unwrap_or_default()
    }
}

/// Reads an attachment; what is no JSON at all is the attachment's fault and not the payload's.
fn attachment_json<T: serde::de::DeserializeOwned>(bytes: &[u8]) -> Result<T, CallError> {
    crate::message::from_json(bytes).map_err(|e| if e.field.as_deref() == Some("payload") { e.at("attachment") } else { e })
}

/// What a reply is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ReplyKind {
    /// One of any number before the terminal reply.
    Progress,
    /// The one terminal reply: the result.
    Result,
    /// The one terminal reply: a [`CallError`].
    Error,
}

/// The attachment of a reply.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ReplyAttachment {
    /// Contract version, 1.
    pub v: u32,
    /// The request's id.
    pub id: String,
    /// Progress, or which terminal reply.
    pub kind: ReplyKind,
    /// Counts progress replies from 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub n: Option<u64>,
    /// The worker that answered (terminal replies).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub worker: Option<String>,
    /// The attempt that this answers (terminal replies).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub attempt: Option<u32>,
    /// Milliseconds spent by stage (terminal replies); never part of the result, which is deterministic.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub timing_ms: BTreeMap<String, f64>,
}

impl ReplyAttachment {
    /// Reads an attachment.
    ///
    /// # Errors
    /// `invalid_argument` that names the field.
    pub fn decode(bytes: &[u8]) -> Result<Self, CallError> {
        let attachment: Self = attachment_json(bytes)?;
        if attachment.v != limits::VERSION {
            return Err(CallError::invalid("v", format!("expected version {}, got {}", limits::VERSION, attachment.v)));
        }
        Ok(attachment)
    }

    /// The attachment's bytes.
    pub fn encode(&self) -> Vec<u8> {
        serde_json::to_vec(self).unwrap_or_default()
    }
}
