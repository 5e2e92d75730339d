//! RIHS01, the hash by which ROS 2 names a type: SHA-256 of the JSON of its description (REP 2016).
//!
//! A hash that is off by anything makes data vanish without a word, since it is part of every key. So hashes are computed from the
//! definitions in `interfaces/`, and tests compare them with those that others publish.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::sync::LazyLock;

use sha2::{Digest, Sha256};

use super::catalog::FILES;
use super::definition::{Field, Kind, Many, Structure, structures_of};

/// A type as keys name it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TypeName {
    /// `sensor_msgs/msg/Image`.
    pub name: String,
    /// `sensor_msgs::msg::dds_::Image_`.
    pub dds: String,
    /// `RIHS01_` and 64 hexadecimal digits.
    pub hash: String,
}

static TYPES: LazyLock<BTreeMap<String, Structure>> = LazyLock::new(|| {
    let mut types = BTreeMap::new();
    for (package, file, text) in FILES {
        match structures_of(package, file, text) {
            Ok(structures) => types.extend(structures.into_iter().map(|s| (s.name.clone(), s))),
            // A test reads them all.
            Err(error) => tracing::error!(%error, "a definition cannot be read"),
        }
    }
    types
});

/// A type that comes with the program, by its full name.
///
/// # Errors
/// The name of the type that is missing: itself, or one that it is made of.
pub fn type_named(name: &str) -> Result<TypeName, UnknownType> {
    Ok(TypeName { name: name.to_owned(), dds: dds_name(name), hash: hash_of(name, &TYPES)? })
}

/// A type without a definition.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("no definition of {0} comes with this program")]
pub struct UnknownType(pub String);

/// `pkg/msg/Type` as `pkg::msg::dds_::Type_`.
fn dds_name(name: &str) -> String {
    match name.rsplit_once('/') {
        Some((path, last)) => format!("{}::dds_::{last}_", path.replace('/', "::")),
        None => name.to_owned(),
    }
}

fn hash_of(name: &str, types: &BTreeMap<String, Structure>) -> Result<String, UnknownType> {
    let mut referenced = BTreeSet::new();
    let mut open = vec![name.to_owned()];
    while let Some(next) = open.pop() {
        let structure = types.get(&next).ok_or_else(|| UnknownType(next.clone()))?;
        for field in &structure.fields {
            if let Kind::Nested(of) = &field.kind
                && referenced.insert(of.clone())
            {
                open.push(of.clone());
            }
        }
    }
    let described = |name: &String| types.get(name).map(description).ok_or_else(|| UnknownType(name.clone()));
    let referenced = referenced.iter().map(described).collect::<Result<Vec<_>, _>>()?.join(", ");
    let own = described(&name.to_owned())?;
    let json = format!("{{\"type_description\": {own}, \"referenced_type_descriptions\": [{referenced}]}}");
    let mut hash = "RIHS01_".to_owned();
    for byte in Sha256::digest(json.as_bytes()) {
        // Writing to a string cannot fail.
        let _ = write!(hash, "{byte:02x}");
    }
    Ok(hash)
}

/// One structure in the JSON that is hashed, with its spaces. Names have no letters that JSON would escape.
fn description(structure: &Structure) -> String {
    let fields: Vec<String> = structure.fields.iter().map(field).collect();
    format!("{{\"type_name\": \"{}\", \"fields\": [{}]}}", structure.name, fields.join(", "))
}

fn field(field: &Field) -> String {
    let (base, string_capacity, nested) = match &field.kind {
        Kind::Primitive(id) => (*id, 0, ""),
        Kind::Text { wide, bound } => (if *bound > 0 { 21 } else { 17 } + u8::from(*wide), *bound, ""),
        Kind::Nested(name) => (1, 0, name.as_str()),
    };
    let (offset, capacity) = match field.many {
        Many::One => (0, 0),
        Many::Array(size) => (48, size),
        Many::Bounded(size) => (96, size),
        Many::Unbounded => (144, 0),
    };
    let (name, id) = (&field.name, base + offset);
    format!(
        "{{\"name\": \"{name}\", \"type\": {{\"type_id\": {id}, \"capacity\": {capacity}, \"string_capacity\": {string_capacity}, \
         \"nested_type_name\": \"{nested}\"}}}}"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// From the metadata of recordings of ROS 2 Jazzy, from the tokens of running nodes, and computed by two packages of others' making
    /// (`rosbags` 0.11.9 from its own copy of the definitions; `zenoh-ros2-sdk` 0.1.8): `scripts/ros2-tests` compares all types with both.
    const PUBLISHED: &str = include_str!("published_hashes.txt");

    #[test]
    fn hashes_are_those_that_others_publish() {
        let lines: Vec<(&str, &str)> = PUBLISHED.lines().filter(|l| !l.starts_with('#')).filter_map(|l| l.split_once(' ')).collect();
        assert!(lines.len() >= 20, "{} types", lines.len());
        for (name, hash) in lines {
            assert_eq!(type_named(name).expect("a shipped type").hash, hash, "{name}");
        }
    }

    #[test]
    fn what_is_derived_from_an_action_has_the_hash_that_its_servers_have() {
        let text = "int32 order\n---\nint32[] sequence\n---\nint32[] partial_sequence\n";
        let package = "action_tutorials_interfaces";
        let mut types = TYPES.clone();
        let structures = structures_of(package, "action/Fibonacci.action", text).expect("a definition");
        types.extend(structures.into_iter().map(|s| (s.name.clone(), s)));
        let hash = hash_of(&format!("{package}/action/Fibonacci_GetResult"), &types);
        // Of rmw_zenoh_cpp's demo server, as ZettaScale's ros-z tests it.
        assert_eq!(hash.as_deref(), Ok("RIHS01_8b47e383f1e31f6d8df6417ab54957e7d5ea24dad315646ad711ac3fdea81d58"));
    }

    #[test]
    fn every_shipped_type_has_a_hash_and_others_are_named() {
        assert!(TYPES.len() > 60);
        for name in TYPES.keys() {
            assert_eq!(type_named(name).map(|t| t.hash.len()), Ok(71), "{name}");
        }
        assert_eq!(type_named("my_msgs/msg/Thing"), Err(UnknownType("my_msgs/msg/Thing".to_owned())));
        let image = type_named("sensor_msgs/msg/Image").expect("a shipped type");
        assert_eq!(image.dds, "sensor_msgs::msg::dds_::Image_");
    }

    #[test]
    fn every_file_of_the_interfaces_is_in_the_catalog() {
        let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("interfaces");
        let mut files = Vec::new();
        for package in std::fs::read_dir(&root).expect("interfaces").flatten().filter(|e| e.path().is_dir()) {
            for kind in std::fs::read_dir(package.path()).expect("a package").flatten().filter(|e| e.path().is_dir()) {
                for file in std::fs::read_dir(kind.path()).expect("a kind").flatten() {
                    let name = |entry: &std::fs::DirEntry| entry.file_name().to_string_lossy().into_owned();
                    files.push((name(&package), format!("{}/{}", name(&kind), name(&file))));
                }
            }
        }
        files.sort();
        let mut listed: Vec<(String, String)> = FILES.iter().map(|(p, f, _)| ((*p).to_owned(), (*f).to_owned())).collect();
        listed.sort();
        assert_eq!(files, listed);
    }
}
