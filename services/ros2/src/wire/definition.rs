//! Definitions of messages, services and actions, as `.msg`, `.srv` and `.action` files have them.
//!
//! Only what the type's description is made of is kept: fields with their types, in order. Constants, defaults and comments are no part of it
//! (`rosidl_adapter`, `parser.py`).

/// The member that a message without fields has in its place, because IDL has no empty structures.
const NOTHING: &str = "structure_needs_at_least_one_member";

/// A definition that cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{type_name}: line {line:?}: {reason}")]
pub struct DefinitionError {
    /// The type.
    pub type_name: String,
    /// The line.
    pub line: String,
    /// What is wrong.
    pub reason: &'static str,
}

/// How often a field's value is there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Many {
    /// Once.
    One,
    /// So many times.
    Array(u64),
    /// At most so many times.
    Bounded(u64),
    /// As often as it likes.
    Unbounded,
}

/// What a field's value is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Kind {
    /// A number, a truth value or a byte, by the id that `type_description_interfaces/msg/FieldType` gives it.
    Primitive(u8),
    /// Words, with the most characters (0: no bound).
    Text {
        /// Whether they are wide.
        wide: bool,
        /// The most characters.
        bound: u64,
    },
    /// Another type, by its full name.
    Nested(String),
}

/// A field.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Field {
    /// Its name.
    pub name: String,
    /// What its value is.
    pub kind: Kind,
    /// How often.
    pub many: Many,
}

impl Field {
    fn nested(name: &str, type_name: &str) -> Self {
        Self { name: name.to_owned(), kind: Kind::Nested(type_name.to_owned()), many: Many::One }
    }
}

/// A structure: what a description describes.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Structure {
    /// Its full name, `sensor_msgs/msg/Image`.
    pub name: String,
    /// Its fields.
    pub fields: Vec<Field>,
}

/// The structures that a file defines: `package` and `file` (`msg/Image.msg`) say their names.
///
/// # Errors
/// [`DefinitionError`] with the line at fault.
pub fn structures_of(package: &str, file: &str, text: &str) -> Result<Vec<Structure>, DefinitionError> {
    let (stem, extension) = file.rsplit_once('.').unwrap_or((file, "msg"));
    let name = format!("{package}/{stem}");
    let part = |suffix: &str, text: &str| structure(package, format!("{name}{suffix}"), text);
    let parts = split(text);
    let count = match extension {
        "msg" => 1,
        "srv" => 2,
        _ => 3,
    };
    if parts.len() != count {
        return Err(DefinitionError { type_name: name, line: "---".to_owned(), reason: "another number of parts than its kind has" });
    }
    Ok(match extension {
        "msg" => vec![part("", &parts[0])?],
        "srv" => service(&name, part("_Request", &parts[0])?, part("_Response", &parts[1])?),
        _ => {
            let (goal, result, feedback) = (part("_Goal", &parts[0])?, part("_Result", &parts[1])?, part("_Feedback", &parts[2])?);
            action(&name, goal, result, feedback)
        }
    })
}

/// The parts between lines of `---`.
fn split(text: &str) -> Vec<String> {
    let mut parts = vec![String::new()];
    for line in text.lines() {
        if line.trim_end() == "---" {
            parts.push(String::new());
        } else if let Some(part) = parts.last_mut() {
            part.push_str(line);
            part.push('\n');
        }
    }
    parts
}

/// A service with what is derived from its two messages.
fn service(name: &str, request: Structure, response: Structure) -> Vec<Structure> {
    let bounded = |field: &str, of: &Structure| Field { many: Many::Bounded(1), ..Field::nested(field, &of.name) };
    let event_name = format!("{name}_Event");
    let info = Field::nested("info", "service_msgs/msg/ServiceEventInfo");
    let event = Structure { name: event_name, fields: vec![info, bounded("request", &request), bounded("response", &response)] };
    let messages = [("request_message", &request), ("response_message", &response), ("event_message", &event)];
    let whole = Structure { name: name.to_owned(), fields: messages.map(|(field, of)| Field::nested(field, &of.name)).into() };
    vec![whole, request, response, event]
}

/// An action with the services and the message that are derived from its three messages.
fn action(name: &str, goal: Structure, result: Structure, feedback: Structure) -> Vec<Structure> {
    let goal_id = || Field::nested("goal_id", "unique_identifier_msgs/msg/UUID");
    let primitive = |field: &str, id| Field { name: field.to_owned(), kind: Kind::Primitive(id), many: Many::One };
    let made = |suffix: &str, fields| Structure { name: format!("{name}{suffix}"), fields };
    let send_request = made("_SendGoal_Request", vec![goal_id(), Field::nested("goal", &goal.name)]);
    let stamp = Field::nested("stamp", "builtin_interfaces/msg/Time");
    let send_response = made("_SendGoal_Response", vec![primitive("accepted", BOOLEAN), stamp]);
    let result_request = made("_GetResult_Request", vec![goal_id()]);
    let result_response = made("_GetResult_Response", vec![primitive("status", INT8), Field::nested("result", &result.name)]);
    let message = made("_FeedbackMessage", vec![goal_id(), Field::nested("feedback", &feedback.name)]);
    let mut all = vec![goal, result, feedback, message];
    all.extend(service(&format!("{name}_SendGoal"), send_request, send_response));
    all.extend(service(&format!("{name}_GetResult"), result_request, result_response));
    all
}

const INT8: u8 = 2;
const BOOLEAN: u8 = 15;

fn structure(package: &str, name: String, text: &str) -> Result<Structure, DefinitionError> {
    let mut fields = Vec::new();
    for line in text.lines() {
        let code = line.split('#').next().unwrap_or_default().trim();
        if code.is_empty() {
            continue;
        }
        let wrong = |reason| DefinitionError { type_name: name.clone(), line: line.to_owned(), reason };
        let (kind, rest) = code.split_once(char::is_whitespace).ok_or_else(|| wrong("expected a type and a name"))?;
        // A sign of equality after the type makes it a constant, wherever it stands.
        if rest.contains('=') {
            continue;
        }
        // What follows the name is its default.
        let field = rest.split_whitespace().next().ok_or_else(|| wrong("expected a name"))?;
        let (kind, many) = type_of(package, kind).map_err(wrong)?;
        fields.push(Field { name: field.to_owned(), kind, many });
    }
    if fields.is_empty() {
        fields.push(Field { name: NOTHING.to_owned(), kind: Kind::Primitive(3), many: Many::One });
    }
    Ok(Structure { name, fields })
}

/// A type as it is written, such as `string<=8[<=3]`.
fn type_of(package: &str, written: &str) -> Result<(Kind, Many), &'static str> {
    let number = |text: &str| text.parse::<u64>().map_err(|_| "expected a number of elements");
    let (base, many) = match written.strip_suffix(']').and_then(|text| text.rsplit_once('[')) {
        None => (written, Many::One),
        Some((base, "")) => (base, Many::Unbounded),
        Some((base, size)) => match size.strip_prefix("<=") {
            Some(bound) => (base, Many::Bounded(number(bound)?)),
            None => (base, Many::Array(number(size)?)),
        },
    };
    let (base, bound) = match base.split_once("<=") {
        Some((base, bound)) => (base, number(bound)?),
        None => (base, 0),
    };
    // `char` is an unsigned byte in message files, and `byte` an octet.
    let primitives = [
        ("int8", INT8),
        ("uint8", 3),
        ("char", 3),
        ("int16", 4),
        ("uint16", 5),
        ("int32", 6),
        ("uint32", 7),
        ("int64", 8),
        ("uint64", 9),
        ("float32", 10),
        ("float64", 11),
        ("bool", BOOLEAN),
        ("byte", 16),
    ];
    let kind = match base {
        "string" => Kind::Text { wide: false, bound },
        "wstring" => Kind::Text { wide: true, bound },
        _ => match primitives.iter().find(|(name, _)| *name == base) {
            Some((_, id)) => Kind::Primitive(*id),
            None => Kind::Nested(full_name(package, base)),
        },
    };
    Ok((kind, many))
}

fn full_name(package: &str, written: &str) -> String {
    match written.split('/').collect::<Vec<_>>()[..] {
        // The one name that needs no package.
        ["Header"] => "std_msgs/msg/Header".to_owned(),
        [name] => format!("{package}/msg/{name}"),
        [package, name] => format!("{package}/msg/{name}"),
        _ => written.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_read_with_their_bounds_and_constants_and_defaults_are_not() {
        let text = "int8 A = 1\nstring<=8[<=3] words \"x y\" # a remark = nothing\nfloat64[9] k\nHeader header\nPoint[] at\ngeometry_msgs/Pose p\n";
        let all = structures_of("my_msgs", "msg/Thing.msg", text).expect("a definition");
        let field = |name: &str, kind, many| Field { name: name.to_owned(), kind, many };
        assert_eq!(all[0].name, "my_msgs/msg/Thing");
        assert_eq!(
            all[0].fields,
            [
                field("words", Kind::Text { wide: false, bound: 8 }, Many::Bounded(3)),
                field("k", Kind::Primitive(11), Many::Array(9)),
                field("header", Kind::Nested("std_msgs/msg/Header".to_owned()), Many::One),
                field("at", Kind::Nested("my_msgs/msg/Point".to_owned()), Many::Unbounded),
                field("p", Kind::Nested("geometry_msgs/msg/Pose".to_owned()), Many::One),
            ]
        );
    }

    #[test]
    fn services_and_actions_bring_what_is_derived_from_them() {
        let names = |file, text| structures_of("p", file, text).expect("a definition").into_iter().map(|s| s.name).collect::<Vec<_>>();
        assert_eq!(names("srv/T.srv", "---\nbool ok\n"), ["p/srv/T", "p/srv/T_Request", "p/srv/T_Response", "p/srv/T_Event"]);
        let of_action = names("action/A.action", "int8 a\n---\n---\n");
        assert!(
            of_action.contains(&"p/action/A_SendGoal_Event".to_owned()) && of_action.contains(&"p/action/A_FeedbackMessage".to_owned())
        );
        assert!(structures_of("p", "srv/T.srv", "bool ok\n").is_err());
        assert_eq!(structures_of("p", "msg/T.msg", "lonely\n").unwrap_err().reason, "expected a type and a name");
    }
}
