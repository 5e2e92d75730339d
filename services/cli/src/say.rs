//! `--say`: a goal in words, and what it was taken to mean.

use repose_proto::{CallError, GoalTerm, Scene};
use repose_words::{Understood, looks_of, understand};
use serde::Serialize;

use crate::failure::Failure;

/// The meaning of a sentence; printed beside the result.
#[derive(Debug, Clone, Serialize)]
pub struct SentenceMeaning {
    /// The sentence.
    pub say: String,
    /// Each phrase for an object and the object that it was taken to be.
    pub taken: Vec<TakenAs>,
}

/// A phrase and its object.
#[derive(Debug, Clone, Serialize)]
pub struct TakenAs {
    /// The phrase.
    pub phrase: String,
    /// The object's id.
    pub object: u16,
}

impl std::fmt::Display for SentenceMeaning {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let taken: Vec<String> = self.taken.iter().map(|t| format!("{:?} is object {}", t.phrase, t.object)).collect();
        write!(f, "understood: {}", taken.join(", "))
    }
}

/// Reads a sentence about a scene, for a viewer (the camera's where none is given): the object to move, and what must hold.
pub fn wish_of(sentence: &str, scene: &Scene, view_yaw_rad: Option<f64>) -> Result<(u16, Vec<GoalTerm>, SentenceMeaning), Failure> {
    let looks = looks_of(scene, view_yaw_rad.unwrap_or(scene.meta.view_yaw_rad));
    let Understood { query, goal, taken } =
        understand(sentence, &looks).map_err(|refused| Failure::BadInput(CallError::invalid("say", refused.to_string())))?;
    if goal.iter().all(|term| !term.holds) {
        return Err(Failure::bad_input("say", "expected at least one relation that shall hold; the sentence only says what shall not"));
    }
    let taken = taken.into_iter().map(|t| TakenAs { phrase: t.phrase, object: t.object }).collect();
    Ok((query, goal, SentenceMeaning { say: sentence.to_owned(), taken }))
}
