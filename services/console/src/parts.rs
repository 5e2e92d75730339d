//! A large message in parts, each a message of its own, so that others go between them.

use bytes::Bytes;
use repose_proto::{Bulk, Tensor};
use tokio::time::Instant;

/// What a message is written in.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Form {
    /// JSON.
    Text,
    /// The bulk form.
    Bulk,
}

/// A message of which parts are sent.
pub struct Parts {
    /// What it is about; no two of them are sent at once.
    of: String,
    form: Form,
    whole: Bytes,
    /// Bytes that were sent.
    sent: usize,
    begun: Instant,
}

impl Parts {
    /// A message about something, of which nothing was sent yet.
    pub fn new(of: String, form: Form, whole: Bytes) -> Self {
        Self { of, form, whole, sent: 0, begun: Instant::now() }
    }

    /// Whether all of it was sent.
    pub fn are_sent(&self) -> bool {
        self.sent == self.whole.len()
    }

    /// The next part, of at most so many bytes and at least one, in the bulk form.
    pub fn next(&mut self, most: usize) -> Bytes {
        let end = (self.sent + most.max(1)).min(self.whole.len());
        let part = &self.whole[self.sent..end];
        let mut bulk = Bulk::default();
        for (name, text) in [
            ("kind", "part".to_owned()),
            ("of", self.of.clone()),
            ("form", if self.form == Form::Text { "text" } else { "bulk" }.to_owned()),
            ("offset", self.sent.to_string()),
            ("total_bytes", self.whole.len().to_string()),
            ("age_ms", self.begun.elapsed().as_millis().to_string()),
        ] {
            bulk.metadata.insert(name.to_owned(), text);
        }
        bulk.tensors.insert("bytes".to_owned(), Tensor::u8(&[part.len()], part));
        self.sent = end;
        bulk.encode().into()
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[tokio::test(start_paused = true)]
    async fn parts_are_the_message_and_say_where_in_it_they_are_and_how_late() {
        let whole: Vec<u8> = (0..=255).cycle().take(1000).collect();
        let mut parts = Parts::new("scene".to_owned(), Form::Bulk, whole.clone().into());
        let (mut joined, mut ages) = (Vec::new(), Vec::new());
        while !parts.are_sent() {
            let part = Bulk::decode(&parts.next(400)).expect("bulk");
            let said = |name| part.text(name).expect("said").to_owned();
            assert_eq!((said("kind"), said("of"), said("form")), ("part".to_owned(), "scene".to_owned(), "bulk".to_owned()));
            assert_eq!((said("offset"), said("total_bytes")), (joined.len().to_string(), "1000".to_owned()));
            joined.extend_from_slice(&part.tensors["bytes"].bytes);
            ages.push(said("age_ms"));
            tokio::time::advance(Duration::from_millis(70)).await;
        }
        assert_eq!((joined, ages), (whole, ["0", "70", "140"].map(str::to_owned).to_vec()));
    }
}
