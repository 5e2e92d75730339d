//! How values on the command line are read: variants, splits, kinds of scenes, files for pictures.

use std::path::PathBuf;

use repose_dataset::Split;
use repose_evaluation::scenes::perturbation::Perturbation;
use repose_evaluation::scenes::true_shapes::KnownShapes;
use repose_proto::place::{Rotation, Variant};
use repose_simulator::scene::SceneKind;

use crate::failure::{CommandResult, Failure};

/// The variant of that name.
pub fn parse_variant(name: &str) -> Result<Variant, String> {
    named("the variants are", &Variant::ALL, Variant::as_str, name)
}

/// The rotation of that name.
pub fn parse_rotation(name: &str) -> Result<Rotation, String> {
    match name {
        "fixed" => Ok(Rotation::Fixed),
        "yaw" => Ok(Rotation::Yaw),
        "stable" => Ok(Rotation::Stable),
        _ => Err("expected fixed, yaw or stable".to_owned()),
    }
}

/// The one of a name among all that there are.
fn named<T: Copy>(what_there_is: &str, all: &[T], name_of: impl Fn(T) -> &'static str, name: &str) -> Result<T, String> {
    let names = || all.iter().map(|one| name_of(*one)).collect::<Vec<_>>().join(", ");
    all.iter().copied().find(|one| name_of(*one) == name).ok_or_else(|| format!("{what_there_is} {}", names()))
}

/// The split of that name, of those that anything may be made of.
pub fn parse_split(name: &str) -> Result<Split, String> {
    named("expected one of", &[Split::Train, Split::Validation, Split::Test], Split::name, name)
}

/// The split of that name, of those that tables are made of.
pub fn parse_table_split(name: &str) -> Result<Split, String> {
    named("expected one of", &[Split::Validation, Split::Test, Split::Final], Split::name, name)
}

/// The fault of that name.
pub fn parse_perturbation(name: &str) -> Result<Perturbation, String> {
    named("the faults are", &Perturbation::ALL, Perturbation::name, name)
}

/// Whose shapes are known, by name.
pub fn parse_known_shapes(name: &str) -> Result<KnownShapes, String> {
    named("shapes are known of", &KnownShapes::ALL, KnownShapes::name, name)
}

/// The kind of scenes of that name.
pub fn parse_kind(name: &str) -> Result<SceneKind, String> {
    named("the kinds are", &SceneKind::ALL, SceneKind::name, name)
}

/// A file for a picture: PNG is what is written, so the name must say so.
pub fn parse_png(path: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(path);
    let is_png = path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png"));
    if is_png { Ok(path) } else { Err("pictures are written as PNG: expected a name that ends in .png".to_owned()) }
}

/// How many of something: at least one.
pub fn parse_count(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(0) => Err("expected at least 1".to_owned()),
        Ok(count) => Ok(count),
        Err(error) => Err(format!("expected a number, at least 1: {error}")),
    }
}

/// What was given, or all that there are where nothing was; what was given twice is meant once, and would count twice.
pub fn distinct_or<T: Clone + PartialEq>(given: &[T], all: &[T]) -> Vec<T> {
    let meant = if given.is_empty() { all } else { given };
    let mut distinct: Vec<T> = Vec::with_capacity(meant.len());
    for one in meant {
        if !distinct.contains(one) {
            distinct.push(one.clone());
        }
    }
    distinct
}

/// Refuses scenes beyond a split's last: there the next split begins.
pub fn check_scenes(split: Split, first: u64, count: u64) -> CommandResult {
    SceneNumbers { split, before: 0, count_option: "scenes" }.check(first, count)
}

/// How a command numbers the scenes that it takes of a split.
#[derive(Debug, Clone, Copy)]
pub struct SceneNumbers {
    /// The split.
    pub split: Split,
    /// So many of its scenes come before number 0.
    pub before: u64,
    /// The option that says how many scenes are asked for.
    pub count_option: &'static str,
}

impl SceneNumbers {
    /// Refuses scenes beyond the split's last.
    pub fn check(self, first: u64, count: u64) -> CommandResult {
        if self.split.holds(self.before.saturating_add(first), count) {
            return Ok(());
        }
        // Not every command has both options: from the first scene on it is their number that is at fault.
        let field = if first == 0 { self.count_option } else { "first" };
        let (name, room) = (self.split.name(), self.split.scenes().saturating_sub(self.before));
        Err(Failure::bad_input(field, format!("the split {name} has {room} scenes for this, too few for {count} from number {first} on")))
    }
}

/// The threads to use: as many as asked for, or one a core.
pub fn threads(asked: Option<usize>) -> usize {
    asked.unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from)).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_and_what_is_unknown_is_told_what_there_is() {
        assert_eq!(parse_split("validation"), Ok(Split::Validation));
        assert!(parse_split("tests").is_err_and(|e| e.contains("validation")));
        assert!(
            parse_split("final").is_err() && parse_table_split("final") == Ok(Split::Final),
            "nothing is trained on what figures come from"
        );
        assert!(parse_perturbation("noise").is_err_and(|e| e.contains("found_masks")));
        assert!(parse_known_shapes("mine").is_err_and(|e| e.contains("query")));
        assert!(parse_kind("table").is_err_and(|e| e.contains("open_table")));
        assert!(parse_variant("bets").is_err_and(|e| e.contains("best")));
    }

    #[test]
    fn none_is_no_count() {
        assert_eq!(parse_count("3"), Ok(3));
        assert!(["0", "-1", "many"].iter().all(|text| parse_count(text).is_err_and(|e| e.contains("at least 1"))));
    }

    #[test]
    fn what_is_given_twice_is_meant_once() {
        assert_eq!(
            distinct_or(&[SceneKind::Shelf, SceneKind::Pile, SceneKind::Shelf], &SceneKind::ALL),
            [SceneKind::Shelf, SceneKind::Pile]
        );
        assert_eq!(distinct_or(&[], &SceneKind::ALL), SceneKind::ALL);
    }

    #[test]
    fn scenes_beyond_the_split_are_blamed_on_the_option_that_asks_for_them() {
        let field = |first, count| check_scenes(Split::Validation, first, count).unwrap_err().error().and_then(|e| e.field.clone());
        assert_eq!(field(0, u64::MAX).as_deref(), Some("scenes"));
        assert_eq!(field(Split::Validation.scenes(), 1).as_deref(), Some("first"));
        assert_eq!(field(u64::MAX, 1).as_deref(), Some("first"));
        assert!(check_scenes(Split::Validation, 0, Split::Validation.scenes()).is_ok());
    }

    #[test]
    fn scenes_that_a_command_counts_from_within_the_split_are_told_of_by_its_own_numbers() {
        let numbers = SceneNumbers { split: Split::Train, before: 950_000_000, count_option: "steps" };
        let refused = |first, count| {
            let error = numbers.check(first, count).unwrap_err().into_error();
            (error.field.unwrap_or_default(), error.message)
        };
        let (field, message) = refused(0, 50_000_001);
        assert!(field == "steps" && message.contains("has 50000000 scenes") && message.contains("number 0 on"), "{field}: {message}");
        let (field, message) = refused(49_999_999, 2);
        assert!(field == "first" && message.contains("number 49999999 on"), "{field}: {message}");
        assert!(numbers.check(49_999_999, 1).is_ok());
    }

    #[test]
    fn a_picture_is_a_png() {
        assert_eq!(parse_png("out/a.PNG"), Ok(PathBuf::from("out/a.PNG")));
        assert!(["a.jpg", "a", "png"].iter().all(|name| parse_png(name).is_err()));
    }
}
