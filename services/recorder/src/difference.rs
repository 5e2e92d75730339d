//! Two answers to one request side by side: the same bytes, or how they differ.

use repose_proto::Payload;
use serde_json::Value;

/// Fields that are named of those that differ; the rest is counted.
const NAMED: usize = 6;

/// How an answer differs from the recorded one; none where the bytes are the same.
pub fn difference(recorded: &Payload, now: &Payload) -> Option<String> {
    if recorded == now {
        return None;
    }
    if recorded.encoding != now.encoding {
        return Some(format!("it was {}, and is {}", recorded.encoding, now.encoding));
    }
    let parsed = |payload: &Payload| serde_json::from_slice::<Value>(&payload.bytes).ok();
    let (Some(was), Some(is)) = (parsed(recorded), parsed(now)) else {
        return Some(format!("{} and {} bytes, which are not the same", recorded.bytes.len(), now.bytes.len()));
    };
    let mut fields = Vec::new();
    collect(&was, &is, "", &mut fields);
    let more = fields.len().saturating_sub(NAMED);
    let mut said = fields.into_iter().take(NAMED).collect::<Vec<_>>().join("; ");
    if more > 0 {
        said.push_str(&format!("; and {more} more"));
    }
    Some(if said.is_empty() { "the same values, spelt otherwise".to_owned() } else { said })
}

/// Adds every place at which two documents differ, `placements[0].cost: 0.5, now 0.6`.
fn collect(was: &Value, is: &Value, path: &str, fields: &mut Vec<String>) {
    let below = |name: &str| if path.is_empty() { name.to_owned() } else { format!("{path}.{name}") };
    match (was, is) {
        (was, is) if was == is => {}
        (Value::Object(was), Value::Object(is)) => {
            for (name, value) in was {
                collect(value, is.get(name).unwrap_or(&Value::Null), &below(name), fields);
            }
            for (name, value) in is.iter().filter(|(name, _)| !was.contains_key(*name)) {
                collect(&Value::Null, value, &below(name), fields);
            }
        }
        (Value::Array(was), Value::Array(is)) if was.len() == is.len() => {
            for (k, (was, is)) in was.iter().zip(is).enumerate() {
                collect(was, is, &format!("{path}[{k}]"), fields);
            }
        }
        (Value::Array(was), Value::Array(is)) => fields.push(format!("{path}: {} entries, now {}", was.len(), is.len())),
        (was, is) => fields.push(format!("{path}: {}, now {}", short(was), short(is))),
    }
}

fn short(value: &Value) -> String {
    let text = value.to_string();
    match text.char_indices().nth(24) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn json(text: &str) -> Payload {
        Payload { encoding: "application/json;repose.PlaceResult.v1".to_owned(), bytes: text.to_owned().into() }
    }

    #[test]
    fn what_differs_is_named_by_its_place() {
        let was = json(r#"{"outcome":"found","placements":[{"cost":0.5},{"cost":1.0}],"seed":3}"#);
        assert_eq!(difference(&was, &was.clone()), None);
        let is = json(r#"{"outcome":"found","placements":[{"cost":0.75},{"cost":1.0}],"seed":3,"kernel":"avx2"}"#);
        assert_eq!(difference(&was, &is).as_deref(), Some("placements[0].cost: 0.5, now 0.75; kernel: null, now \"avx2\""));
        let fewer = json(r#"{"outcome":"none","placements":[],"seed":3}"#);
        assert_eq!(difference(&was, &fewer).as_deref(), Some("outcome: \"found\", now \"none\"; placements: 2 entries, now 0"));
        assert_eq!(difference(&json("{\"a\":1}"), &json("{ \"a\":1}")).as_deref(), Some("the same values, spelt otherwise"));
    }

    #[test]
    fn many_differences_are_counted_and_what_is_no_json_is_measured() {
        let (was, is) = (json("[0,0,0,0,0,0,0,0,0]"), json("[1,1,1,1,1,1,1,1,1]"));
        assert!(difference(&was, &is).expect("they differ").ends_with("[5]: 0, now 1; and 3 more"));
        let bulk = |bytes: &'static [u8]| Payload { encoding: "application/octet-stream;repose.Scene.v1".to_owned(), bytes: bytes.into() };
        assert_eq!(difference(&bulk(b"ab"), &bulk(b"abc")).as_deref(), Some("2 and 3 bytes, which are not the same"));
        assert!(difference(&was, &bulk(b"ab")).expect("they differ").starts_with("it was application/json"));
    }
}
