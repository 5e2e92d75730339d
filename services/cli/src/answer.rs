//! How `plan` and `place` print an answer.

use repose_proto::PlaceResult;
use repose_sentences::placement::describe;
use serde::Serialize;

use crate::failure::{self, Failure};
use crate::output::Output;
use crate::say::SentenceMeaning;

/// A result with how the words that asked for it were taken.
#[derive(Serialize)]
struct Answered<'a> {
    #[serde(flatten)]
    result: &'a PlaceResult,
    #[serde(skip_serializing_if = "Option::is_none")]
    said: Option<&'a SentenceMeaning>,
}

/// Prints a result, where its object's centre is known how far that goes, and how the words that asked for it were taken; ends in [`Failure::NoPlacement`] when it has no placement.
pub fn print_result(
    result: &PlaceResult,
    center_m: Option<[f64; 3]>,
    said: Option<&SentenceMeaning>,
    output: Output,
) -> failure::CommandResult {
    output.print(&Answered { result, said }, || {
        let understood = said.map(|s| format!("{s}\n")).unwrap_or_default();
        format!("{understood}{}", describe(result, center_m))
    })?;
    if result.placements.is_empty() { Err(Failure::NoPlacement) } else { Ok(()) }
}
