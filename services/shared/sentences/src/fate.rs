//! What became of objects while something was carried out: which of them moved, fell or are gone, and that none did.

use std::collections::BTreeMap;

use repose_tracking::Fate;

/// What became of the objects that do not stand where they were to be, one sentence each; and that no other was disturbed, where that is so.
/// `carried` is the one that was to move.
pub fn describe(carried: Option<u16>, disturbed: &BTreeMap<u16, Fate>) -> Vec<String> {
    let mut said: Vec<String> = disturbed.iter().map(|(id, fate)| sentence(*id, fate)).collect();
    if disturbed.keys().all(|id| Some(*id) == carried) {
        said.push("nothing else has moved or fallen".to_owned());
    }
    said
}

/// What became of an object.
pub fn sentence(id: u16, fate: &Fate) -> String {
    match fate {
        Fate::Stands => format!("object {id} stands where it was to be"),
        Fate::Moved { by_m } => format!("object {id} is {:.0} mm from where it was to be", by_m * 1e3),
        Fate::Fell { by_m } => format!("object {id} fell by {:.0} mm", by_m * 1e3),
        Fate::Hidden => format!("object {id} is not seen: something covers its place, and it may stand there"),
        Fate::Gone => format!("object {id} is gone from its place and is not seen elsewhere"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_disturbed_is_said_and_so_is_that_nothing_was() {
        let off = Fate::Moved { by_m: 0.041 };
        let nothing_else = "nothing else has moved or fallen";
        assert_eq!(describe(Some(1), &BTreeMap::new()), [nothing_else]);
        assert_eq!(describe(Some(1), &BTreeMap::from([(1, off)])), ["object 1 is 41 mm from where it was to be", nothing_else]);
        let fell = BTreeMap::from([(1, off), (2, Fate::Fell { by_m: 0.08 })]);
        assert_eq!(describe(Some(1), &fell), ["object 1 is 41 mm from where it was to be", "object 2 fell by 80 mm"]);
        assert!(
            describe(Some(1), &BTreeMap::from([(3, Fate::Hidden)]))[0].contains("may stand there"),
            "what is not seen is not said to stand"
        );
    }
}
