//! Asking the recorded requests again, on the recorded scenes, and comparing the answers byte for byte.

use std::collections::BTreeMap;
use std::time::Duration;

use repose_proto::enclosed::disclose;
use repose_proto::motion::MotionPlanRequest;
use repose_proto::{ArrangeRequest, CallError, Message, Payload, PlaceRequest, Scene, Service};
use repose_runtime::{CallOptions, Caller, Session};
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::RecordingError;
use crate::calls::{RecordedCall, RecordedScenes};
use crate::difference::difference;

/// Whether a method is asked again: those whose answers follow from the request, the scene and the weights alone.
pub fn is_repeatable(service: Service, method: &str) -> bool {
    matches!((service, method), (Service::Planner, "place" | "arrange") | (Service::Motion, "plan") | (Service::Perception, "segment"))
}

/// The result of replaying one request.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Repeated {
    /// Its id.
    pub id: String,
    /// The service and the method, `planner.place`.
    pub method: String,
    /// How the answer differs; none where the bytes are the same.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub why: Option<String>,
}

/// Asks again in a cell whose workers are there.
pub struct Replay {
    callers: BTreeMap<Service, Caller>,
    deadline: Duration,
}

impl Replay {
    /// A replay in a session's cell; each request may take `deadline`.
    ///
    /// # Errors
    /// When the network refuses.
    pub async fn new(session: &Session, deadline: Duration) -> Result<Self, RecordingError> {
        let mut callers = BTreeMap::new();
        for service in [Service::Planner, Service::Motion, Service::Perception] {
            callers.insert(service, session.caller(service).await?);
        }
        Ok(Self { callers, deadline })
    }

    /// Waits until the services of these calls are there.
    ///
    /// # Errors
    /// `unavailable` when one is not.
    pub async fn ready(&self, calls: &[RecordedCall]) -> Result<(), CallError> {
        for (service, caller) in &self.callers {
            if calls.iter().any(|asked| asked.service == *service) {
                caller.wait_for_workers(1, self.deadline).await?;
            }
        }
        Ok(())
    }

    /// Asks one request again, on the recorded scenes where nobody holds its own.
    pub async fn repeat(&self, asked: &RecordedCall, scenes: &RecordedScenes) -> Repeated {
        let why = match self.answer(asked, scenes).await {
            Ok(now) => difference(&asked.result, &now),
            Err(error) => Some(format!("there was an answer, now {error}")),
        };
        Repeated { id: asked.id.clone(), method: format!("{}.{}", asked.service, asked.method), why }
    }

    async fn answer(&self, asked: &RecordedCall, scenes: &RecordedScenes) -> Result<Payload, CallError> {
        let caller = self.callers.get(&asked.service).ok_or_else(|| CallError::internal("this service is not asked again"))?;
        let options = CallOptions::within(self.deadline);
        match (asked.service, asked.method.as_str()) {
            (Service::Planner, "arrange") => on_scene::<ArrangeRequest>(caller, asked, |r| &r.scene.scene_id, scenes, options).await,
            (Service::Planner, _) => on_scene::<PlaceRequest>(caller, asked, |r| &r.scene.scene_id, scenes, options).await,
            (Service::Motion, _) => on_scene::<MotionPlanRequest>(caller, asked, |r| &r.scene.scene_id, scenes, options).await,
            _ => Ok(caller.call(&asked.method, asked.request.clone(), options).await?.payload),
        }
    }
}

/// Asks about a scene: by its id first, as it was on the wire, and with the recorded scene where nobody holds it.
async fn on_scene<T: Message + Serialize + DeserializeOwned>(
    caller: &Caller,
    asked: &RecordedCall,
    scene_of: impl Fn(&T) -> &str,
    scenes: &RecordedScenes,
    options: CallOptions,
) -> Result<Payload, CallError> {
    let (request, enclosed) = match asked.request.is_bulk() {
        true => disclose::<T>(&asked.request.decode_bulk(T::SCHEMA)?)?,
        false => (asked.request.decode_json::<T>()?, None),
    };
    let recorded = || scenes.get(scene_of(&request)).map(|payload| Scene::from_bulk(&payload.decode_bulk(Scene::SCHEMA)?)).transpose();
    let scene = match enclosed {
        Some(scene) => Some(scene),
        None => recorded()?,
    };
    let encode = |scene: Option<&Scene>| Payload::with_scene(&request, scene);
    Ok(caller.call_with_scene(&asked.method, scene.as_ref(), encode, options).await?.payload)
}
