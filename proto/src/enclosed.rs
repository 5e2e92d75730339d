//! A request and the scene that it names in one message: what a caller sends to a worker that does not hold the scene.

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::message::from_json;
use crate::{Bulk, CallError, Message, Payload, Scene};

impl Payload {
    /// A request as JSON, or in bulk form where its scene goes along, enclosed.
    ///
    /// # Errors
    /// As [`Payload::json`].
    pub fn with_scene<T: Message + Serialize>(request: &T, scene: Option<&Scene>) -> Result<Self, CallError> {
        match scene {
            None => Self::json(request),
            Some(scene) => Self::bulk(T::SCHEMA, &enclose(request, Some(scene))),
        }
    }
}

/// A JSON request in bulk form, with the scene enclosed if given: metadata `request`, and the scene's own entries and tensors.
pub fn enclose<T: Serialize>(request: &T, scene: Option<&Scene>) -> Bulk {
    let mut bulk = scene.map(Scene::to_bulk).unwrap_or_default();
    bulk.metadata.insert("request".to_owned(), serde_json::to_string(request).unwrap_or_default());
    bulk
}

/// The request and the enclosed scene of a bulk form made by [`enclose`]. Validates neither against the other: the receiver compares ids.
///
/// # Errors
/// `invalid_argument` that names the field.
pub fn disclose<T: Message + DeserializeOwned>(bulk: &Bulk) -> Result<(T, Option<Scene>), CallError> {
    let request: T = from_json(bulk.text("request")?.as_bytes())?;
    request.validate()?;
    let scene = bulk.tensors.contains_key("points").then(|| Scene::from_bulk(bulk)).transpose()?;
    Ok((request, scene))
}
