//! What a command prints: one JSON document on standard output with `--json`, text for people without.

use serde::Serialize;

use crate::failure::{Failure, Outcome};

/// Where a command's result goes.
#[derive(Debug, Clone, Copy)]
pub struct Output {
    /// One JSON document instead of text.
    pub json: bool,
}

impl Output {
    /// Prints `document` as JSON, or `text` for people.
    pub fn print<T: Serialize>(self, document: &T, text: impl FnOnce() -> String) -> Outcome {
        if self.json {
            let line = serde_json::to_string_pretty(document).map_err(Failure::other)?;
            println!("{line}");
        } else {
            println!("{}", text());
        }
        Ok(())
    }
}
