//! Asking perception: the newest scene of a camera, or a scene by its id. `segment` takes a frame in bulk form.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use safetensors::Dtype;

use crate::bulk::{Bulk, Tensor};
use crate::frame::parse_stamp;
use crate::keys::validate_chunk;
use crate::{CallError, Message, Payload, SceneRef, limits};

/// Asks for the newest scene of a camera.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LatestRequest {
    /// The camera.
    pub camera: String,
}

impl Message for LatestRequest {
    const SCHEMA: &'static str = "LatestRequest.v1";

    fn validate(&self) -> Result<(), CallError> {
        validate_chunk("camera", &self.camera)
    }
}

/// Asks for a scene by its id.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SceneRequest {
    /// The scene's id.
    pub scene_id: String,
    /// Whether it may come packed (`PackedScene.v1`): a fifth as large, at some 50 ms of computing. Workers of release 1 refuse the field.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub packed: bool,
    /// A part of its bytes only (`ScenePart.v1`), so that no message keeps a slow link to itself for seconds. Workers of release 1 refuse the field; a
    /// worker may answer with the whole all the same.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub part: Option<ByteRange>,
}

/// A stretch of bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ByteRange {
    /// Where it begins, from 0.
    pub offset: u32,
    /// How many there are; fewer at the end of what there is, none beyond it.
    #[schemars(range(min = 1))]
    pub length: u32,
}

impl SceneRequest {
    /// Asks for a scene as it is.
    pub fn new(scene_id: impl Into<String>) -> Self {
        Self { scene_id: scene_id.into(), packed: false, part: None }
    }

    /// The answer, from the scene in the form that was asked for: the part that was asked for, where one was.
    ///
    /// # Errors
    /// `internal` where the form has no bulk payload.
    pub fn answer(&self, scene: &Payload) -> Result<Payload, CallError> {
        self.part.map_or_else(|| Ok(scene.clone()), |range| ScenePart::of(scene, range).to_payload())
    }

    /// The same from a scene whose content was seen again at `stamp_ns`, nanoseconds since the Unix epoch. A part says so beside its bytes: these stay as
    /// they were at first, since a scene's parts are asked for one by one and must fit together.
    ///
    /// # Errors
    /// As [`SceneRequest::answer`].
    pub fn answer_as_of(&self, scene: &Payload, stamp_ns: u64) -> Result<Payload, CallError> {
        let part = |range| ScenePart { stamp_ns: Some(stamp_ns), ..ScenePart::of(scene, range) };
        self.part.map_or_else(|| Ok(scene.clone()), |range| part(range).to_payload())
    }
}

/// A part of a scene's payload.
#[derive(Debug, Clone, PartialEq)]
pub struct ScenePart {
    /// The encoding of the whole payload.
    pub encoding: String,
    /// How many bytes the whole has.
    pub total_bytes: usize,
    /// Where the part begins.
    pub offset: usize,
    /// When this content was last seen, nanoseconds since the Unix epoch; the stamp in its bytes may be an earlier one.
    pub stamp_ns: Option<u64>,
    /// Its bytes.
    pub bytes: Vec<u8>,
}

impl ScenePart {
    /// The schema's name.
    pub const SCHEMA: &'static str = "ScenePart.v1";

    /// A part of a payload, as much of the range as there is.
    pub fn of(scene: &Payload, range: ByteRange) -> Self {
        let total_bytes = scene.bytes.len();
        let offset = (range.offset as usize).min(total_bytes);
        let end = offset.saturating_add(range.length as usize).min(total_bytes);
        Self { encoding: scene.encoding.clone(), total_bytes, offset, stamp_ns: None, bytes: scene.bytes[offset..end].to_vec() }
    }

    /// The part as a payload.
    ///
    /// # Errors
    /// As [`Payload::bulk`].
    pub fn to_payload(&self) -> Result<Payload, CallError> {
        let stamp_ns = self.stamp_ns.map(|stamp_ns| ("stamp_ns", stamp_ns.to_string()));
        let metadata =
            [("encoding", self.encoding.clone()), ("offset", self.offset.to_string()), ("total_bytes", self.total_bytes.to_string())];
        let metadata = metadata.into_iter().chain(stamp_ns).map(|(name, value)| (name.to_owned(), value)).collect();
        let tensors = [("bytes".to_owned(), Tensor::u8(&[self.bytes.len()], &self.bytes))].into();
        Payload::bulk(Self::SCHEMA, &Bulk { metadata, tensors })
    }

    /// A part that came.
    ///
    /// # Errors
    /// `invalid_argument` that names what is amiss.
    pub fn from_payload(payload: &Payload) -> Result<Self, CallError> {
        let bulk = payload.decode_bulk(Self::SCHEMA)?;
        let number = |name: &str| {
            let given = bulk.text(name)?;
            let number = given.parse::<usize>().ok().filter(|n| *n <= limits::MAX_MESSAGE_BYTES);
            number.ok_or_else(|| CallError::invalid(name, format!("expected 0 to {}, got {given}", limits::MAX_MESSAGE_BYTES)))
        };
        let (_, bytes) = bulk.values::<u8>("bytes", Dtype::U8, "[n]", |shape| shape.len() == 1)?;
        let stamp_ns = bulk.metadata.contains_key("stamp_ns").then(|| parse_stamp(&bulk)).transpose()?;
        let (total_bytes, offset) = (number("total_bytes")?, number("offset")?);
        let part = Self { encoding: bulk.text("encoding")?.to_owned(), total_bytes, offset, stamp_ns, bytes };
        if part.offset + part.bytes.len() > part.total_bytes {
            return Err(CallError::invalid("bytes", format!("the part ends behind the {} bytes of the whole", part.total_bytes)));
        }
        Ok(part)
    }
}

impl Message for SceneRequest {
    const SCHEMA: &'static str = "SceneRequest.v1";

    fn validate(&self) -> Result<(), CallError> {
        SceneRef { scene_id: self.scene_id.clone() }.validate().map_err(|e| e.at("scene_id"))?;
        match self.part {
            Some(range) if range.length == 0 => Err(CallError::invalid("part.length", "expected 1 or more")),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene() -> Payload {
        Payload { encoding: "application/octet-stream;repose.Scene.v1".to_owned(), bytes: (0..=255).collect::<Vec<u8>>().into() }
    }

    fn part(offset: u32, length: u32) -> ScenePart {
        let request = SceneRequest { part: Some(ByteRange { offset, length }), ..SceneRequest::new("0".repeat(64)) };
        ScenePart::from_payload(&request.answer(&scene()).unwrap()).unwrap()
    }

    #[test]
    fn parts_make_the_whole_again_and_beyond_its_end_there_is_nothing() {
        let parts = [part(0, 100), part(100, 100), part(200, 100)];
        let together: Vec<u8> = parts.iter().flat_map(|part| part.bytes.clone()).collect();
        assert_eq!(together, scene().bytes);
        assert!(parts.iter().all(|part| part.total_bytes == 256 && part.encoding == scene().encoding));
        assert_eq!((part(256, 1).bytes.len(), part(u32::MAX, u32::MAX).bytes.len()), (0, 0));
        assert_eq!(SceneRequest::new("0".repeat(64)).answer(&scene()).unwrap(), scene());
    }

    #[test]
    fn a_part_says_when_the_scene_was_seen_last_where_that_is_known() {
        let range = ByteRange { offset: 0, length: 100 };
        let request = SceneRequest { part: Some(range), ..SceneRequest::new("0".repeat(64)) };
        let seen_again = ScenePart::from_payload(&request.answer_as_of(&scene(), u64::MAX).unwrap()).unwrap();
        assert_eq!(seen_again, ScenePart { stamp_ns: Some(u64::MAX), ..part(0, 100) });
        assert_eq!(part(0, 100).stamp_ns, None);
        assert_eq!(SceneRequest::new("0".repeat(64)).answer_as_of(&scene(), 7).unwrap(), scene());
    }

    #[test]
    fn a_part_that_cannot_be_is_refused() {
        let wrong = ScenePart { total_bytes: 10, offset: 5, stamp_ns: None, bytes: vec![0; 6], encoding: String::new() };
        assert_eq!(ScenePart::from_payload(&wrong.to_payload().unwrap()).unwrap_err().field.as_deref(), Some("bytes"));
        let wrong =
            ScenePart { total_bytes: limits::MAX_MESSAGE_BYTES + 1, offset: 0, stamp_ns: None, bytes: vec![], encoding: String::new() };
        assert_eq!(ScenePart::from_payload(&wrong.to_payload().unwrap()).unwrap_err().field.as_deref(), Some("total_bytes"));
        let request = SceneRequest { part: Some(ByteRange { offset: 0, length: 0 }), ..SceneRequest::new("0".repeat(64)) };
        assert_eq!(request.validate().unwrap_err().field.as_deref(), Some("part.length"));
    }
}
