//! `look`: the newest view with its objects told apart, in a picture, in sentences and as data.

use std::collections::BTreeMap;
use std::sync::Arc;

use repose_pictures::jpeg_of;
use repose_pictures::scene::with_numbered_outlines;
use repose_proto::{CallError, Relation};
use repose_relations::observed_margins;
use repose_runtime::now_ns;
use repose_words::{ColorShares, Grade, ObjectAppearance, looks_of};
use schemars::JsonSchema;
use serde::Serialize;

use crate::answer::ToolResult;
use crate::arguments::LookArguments;
use crate::asker::Asker;
use crate::desk::{Desk, computed};
use crate::seen::ShownScene;

/// Quality of the pictures, 1 to 100: numbers stay legible.
pub const QUALITY: u8 = 85;

/// What `look` answers beside the picture.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct Looked {
    /// The scene's name for `plan`.
    pub scene: String,
    /// The camera.
    pub camera: String,
    /// How long ago it was seen, milliseconds.
    pub age_ms: u64,
    /// The objects.
    pub objects: Vec<ObjectTold>,
    /// What was seen and is no object, and what else should be looked into.
    pub notes: Vec<String>,
}

/// An object in words and numbers.
#[derive(Debug, Clone, PartialEq, Serialize, JsonSchema)]
pub struct ObjectTold {
    /// Its number in this scene.
    pub number: u16,
    /// The name of its color, where the camera sees color and one name fits.
    pub color: Option<String>,
    /// Words that its shape bears out.
    pub shape: Vec<String>,
    /// Length, width and height of what was seen of it, centimetres; none of what is too thin to measure.
    pub size_cm: Option<[f64; 3]>,
    /// The mean of what was seen of it, world frame (z is up), metres.
    pub position_m: [f64; 3],
    /// The relations in which it stands, by rule on what was seen, each with the numbers of the other objects.
    pub relations: BTreeMap<String, Vec<u16>>,
    /// How sure it is that this is one whole object, 0 to 1; none where nobody said.
    pub certainty: Option<f64>,
}

impl Desk {
    /// The newest view.
    ///
    /// # Errors
    /// What the cell says; `not_found` on `camera` where it has no scene.
    pub async fn look(&self, _: &LookArguments, asker: &Asker) -> Result<ToolResult, CallError> {
        let seen = self.newest(&asker.session, self.deadline()).await?;
        computed(move || {
            let looked = looked(&seen);
            let picture = jpeg_of(&with_numbered_outlines(&seen.scene)?, QUALITY)?;
            ToolResult::new(sentences(&looked), &looked, Some(picture))
        })
        .await
    }
}

/// What is seen, as the camera sees it.
pub fn looked(seen: &Arc<ShownScene>) -> Looked {
    let scene = &seen.scene;
    let looks = looks_of(scene, scene.meta.view_yaw_rad);
    let told = |look: &ObjectAppearance| {
        let summary = scene.object(look.id);
        let round = |m: f64| (m * 1e3).round() / 1e3;
        ObjectTold {
            number: look.id,
            color: look.colors.as_ref().and_then(ColorShares::name).map(|color| color.as_str().to_owned()),
            shape: shape_of(look),
            size_cm: look.shape.as_ref().map(|s| [s.plan_m[0], s.plan_m[1], s.height_m].map(|m| (m * 1e3).round() / 10.0)),
            position_m: summary.map_or([0.0; 3], |s| s.centroid_m).map(round),
            relations: relations_of(look, &looks),
            certainty: summary.and_then(|s| s.score),
        }
    };
    let left_out = scene.meta.left_out.iter().map(|left| {
        let [x, y, z] = left.centroid_m;
        format!("something at ({x:.2}, {y:.2}, {z:.2}) m is no object: {}", left.reason.in_words())
    });
    let warnings = scene.meta.warnings.iter().map(|warning| format!("{}: {}", warning.field, warning.message));
    Looked {
        scene: seen.handle().to_owned(),
        camera: scene.camera_name.clone(),
        age_ms: now_ns().saturating_sub(scene.stamp_ns) / 1_000_000,
        objects: looks.iter().map(told).collect(),
        notes: left_out.chain(warnings).collect(),
    }
}

fn shape_of(look: &ObjectAppearance) -> Vec<String> {
    let Some(shape) = &look.shape else { return Vec::new() };
    let words =
        [("round", shape.round()), ("boxy", shape.boxy()), ("tall", shape.tall()), ("flat", shape.flat()), ("hollow", shape.hollow())];
    words.into_iter().filter(|(_, grade)| *grade == Grade::Yes).map(|(word, _)| word.to_owned()).collect()
}

/// The relations that hold by the rule that goals are judged by.
fn relations_of(look: &ObjectAppearance, looks: &[ObjectAppearance]) -> BTreeMap<String, Vec<u16>> {
    let mut relations: BTreeMap<String, Vec<u16>> = BTreeMap::new();
    for other in looks.iter().filter(|other| other.id != look.id) {
        let holds = observed_margins(&look.observed, &other.observed).holds();
        for relation in Relation::ALL.into_iter().filter(|relation| holds[relation.index()]) {
            relations.entry(relation.to_string()).or_default().push(other.id);
        }
    }
    relations
}

/// The same for reading.
fn sentences(looked: &Looked) -> String {
    let seen_s = looked.age_ms as f64 / 1e3;
    let mut lines =
        vec![format!("scene {} of camera {}, seen {seen_s:.1} s ago, {} objects", looked.scene, looked.camera, looked.objects.len())];
    for object in &looked.objects {
        let mut words: Vec<String> = object.color.iter().chain(&object.shape).cloned().collect();
        words.extend(object.size_cm.map(|[length, width, height]| format!("{length:.0} x {width:.0} x {height:.0} cm")));
        let [x, y, z] = object.position_m;
        words.push(format!("at ({x:.2}, {y:.2}, {z:.2}) m"));
        let number = |id: &u16| id.to_string();
        let relations = object.relations.iter().map(|(relation, others)| {
            format!("{} {}", relation.replace('_', " "), others.iter().map(number).collect::<Vec<_>>().join(" and "))
        });
        let relations: Vec<String> = relations.collect();
        let stands = if relations.is_empty() { String::new() } else { format!("; {}", relations.join(", ")) };
        lines.push(format!("object {}: {}{stands}", object.number, words.join(", ")));
    }
    lines.extend(looked.notes.iter().map(|note| format!("note: {note}")));
    lines.join("\n")
}
