//! Tokens by which people and agents show over HTTP who they are.

use std::path::Path;

use repose_proto::CallError;

/// The shortest token, characters.
const SHORTEST: usize = 16;

/// A token that somebody has to show; only its hash is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AccessToken(blake3::Hash);

impl AccessToken {
    /// Reads one from a file that `field` of the settings names.
    ///
    /// # Errors
    /// `invalid_argument` with the field when the file cannot be read or holds no good token.
    pub fn read(field: &str, file: &Path) -> Result<Self, CallError> {
        let fail = |message: String| CallError::invalid(field, format!("{}: {message}", file.display()));
        let text = std::fs::read_to_string(file).map_err(|e| fail(e.to_string()))?;
        Self::of(text.trim()).map_err(fail)
    }

    /// The token that consists of these letters, digits and signs: such as a header and a cookie can carry.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn of(text: &str) -> Result<Self, String> {
        let is_good = text.len() >= SHORTEST && text.bytes().all(|b| b.is_ascii_graphic() && !b";,\"".contains(&b));
        match is_good {
            true => Ok(Self(blake3::hash(text.as_bytes()))),
            false => Err(format!("expected a token of at least {SHORTEST} letters, digits or signs other than , ; and \"")),
        }
    }

    /// Whether it is this that somebody shows. Hashes compare in constant time.
    pub fn is(&self, shown: &str) -> bool {
        blake3::hash(shown.as_bytes()) == self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_token_is_itself_without_the_line_end_and_what_is_none_names_its_field() {
        let folder = tempfile::tempdir().expect("a folder");
        let file = folder.path().join("token");
        let read = |text: &str| {
            std::fs::write(&file, text).expect("written");
            AccessToken::read("token", &file)
        };
        let token = read("a-long-agents-token\n").expect("a token");
        assert!(token.is("a-long-agents-token") && !token.is("a-long-agents-token\n") && !token.is(""));
        for text in ["too-short", "a long agents token", "a-long;agents-token", "a-long-\"agents\"-token"] {
            assert_eq!(read(text).expect_err(text).field.as_deref(), Some("token"));
        }
        assert!(AccessToken::read("token", &folder.path().join("none")).is_err());
    }
}
