//! Configurations that are written again: what the roles say is new, and what an operator has set besides stays. A service of a deployment reads no
//! other file, so that what its arm must keep out of is in there, too.

use toml::{Table, Value};

/// Settings of `deploy` that are removed when the roles no longer say them: section and field.
const ONLY_WHERE_SAID: [(&str, &str); 1] = [("caller", "pool")];

/// A configuration that is written again.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct WrittenAgain {
    /// Its text.
    pub(super) text: String,
    /// The lists in which ours now stands beside entries of which one may have been ours before: a sentence each.
    pub(super) unsure: Vec<String>,
}

/// A configuration as `deploy` makes it, with what else `earlier` sets. Of a list of endpoints one is ours, and takes the place of `endpoint_before`,
/// where it is known which was ours before; the others are the operator's, as further routers to connect to. Where nothing changes, the text stays
/// with its comments.
///
/// # Errors
/// When `earlier` is no TOML.
pub(super) fn written_again(earlier: &str, ours: &str, endpoint_before: Option<&str>) -> Result<WrittenAgain, toml::de::Error> {
    let (before, said): (Table, Table) = (earlier.parse()?, ours.parse()?);
    let (mut after, mut unsure) = (before.clone(), Vec::new());
    for (section, field) in ONLY_WHERE_SAID {
        let is_said = said.get(section).is_some_and(|fields| fields.get(field).is_some());
        if let Some(fields) = after.get_mut(section).and_then(Value::as_table_mut).filter(|_| !is_said) {
            fields.remove(field);
        }
    }
    for (section, fields) in said {
        let there = after.entry(section).or_insert_with(|| Value::Table(Table::new()));
        match (there, fields) {
            (Value::Table(there), Value::Table(fields)) => {
                unsure.extend(fields.into_iter().filter_map(|(field, value)| put(there, field, value, endpoint_before)));
            }
            (there, fields) => *there = fields,
        }
    }
    if after == before {
        return Ok(WrittenAgain { text: earlier.to_owned(), unsure });
    }
    let title = ours.lines().next().unwrap_or_default();
    Ok(WrittenAgain { text: format!("{title}\n{after}"), unsure })
}

/// Sets a field. A list keeps what is not ours; says so where one of that may have been ours before.
fn put(fields: &mut Table, field: String, value: Value, endpoint_before: Option<&str>) -> Option<String> {
    let (Some(Value::Array(there)), Value::Array(ours)) = (fields.get_mut(&field), &value) else {
        fields.insert(field, value);
        return None;
    };
    if ours.iter().all(|one| there.contains(one)) {
        return None;
    }
    let is_alone = there.len() == 1;
    let was_ours = |one: &Value| endpoint_before.map_or(is_alone, |before| one.as_str() == Some(before));
    let place = there.iter().position(was_ours);
    let rest = there.split_off(place.unwrap_or(0));
    there.extend(ours.iter().cloned());
    there.extend(rest.into_iter().skip(usize::from(place.is_some())));
    let is_unsure = place.is_none() && there.len() > ours.len();
    is_unsure.then(|| {
        let list = Value::Array(there.clone());
        format!("{field} is now {list}: of the earlier ones it is not known which the roles had said, so all stay; take out what is no longer good")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const OURS: &str =
        "# motion: repose serve motion\n[session]\nmode = \"client\"\nconnect = [\"quic/a:1\"]\n\n[worker]\nname = \"motion-1\"\n";

    fn table(text: &str) -> Table {
        text.parse().expect("TOML")
    }

    /// What is written over `earlier` where the roles said `endpoint_before`, as a table, and whether it is said that something is not known.
    fn again(earlier: &str, ours: &str, endpoint_before: Option<&str>) -> (Table, bool) {
        let again = written_again(earlier, ours, endpoint_before).expect("TOML");
        (table(&again.text), !again.unsure.is_empty())
    }

    #[test]
    fn what_an_operator_has_set_stays_and_what_the_roles_say_is_new() {
        let own = "[motion]\nkeep_out = [{ name = \"door\", min_m = [0.0, 0.0, 0.0], max_m = [1.0, 1.0, 2.0] }]\n";
        let earlier = format!("{OURS}drain_ms = 2000\n# The door opens inwards.\n{own}");
        assert_eq!(written_again(&earlier, OURS, Some("quic/a:1")).expect("TOML").text, earlier, "nothing is new");
        let (moved, _) = again(&earlier, &OURS.replace("quic/a:1", "quic/b:1").replace("motion-1", "arm"), Some("quic/a:1"));
        assert_eq!((&moved["session"]["connect"][0], &moved["worker"]["name"]), (&Value::from("quic/b:1"), &Value::from("arm")));
        assert_eq!((&moved["worker"]["drain_ms"], &moved["motion"]), (&Value::from(2000), &table(own)["motion"]));
    }

    #[test]
    fn a_second_router_stays_whatever_the_first_is_called() {
        for (earlier, expected) in [
            (["quic/b:1", "quic/a:1"], ["quic/b:1", "quic/c:1"]),
            (["quic/a:1", "quic/b:1"], ["quic/c:1", "quic/b:1"]),
            (["quic/c:1", "quic/a:1"], ["quic/c:1", "quic/a:1"]),
        ] {
            let earlier = OURS.replace("[\"quic/a:1\"]", &format!("{earlier:?}"));
            let unchanged = written_again(&earlier, OURS, Some("quic/a:1")).expect("TOML");
            assert_eq!(unchanged, WrittenAgain { text: earlier.clone(), unsure: Vec::new() });
            let (moved, is_unsure) = again(&earlier, &OURS.replace("quic/a:1", "quic/c:1"), Some("quic/a:1"));
            assert_eq!((&moved["session"]["connect"], is_unsure), (&Value::from(expected.to_vec()), false));
        }
    }

    #[test]
    fn where_it_is_not_known_which_endpoint_was_ours_all_are_kept_and_that_is_said() {
        let moved = |earlier: &[&str], before| {
            let earlier = OURS.replace("[\"quic/a:1\"]", &format!("{earlier:?}"));
            let (moved, is_unsure) = again(&earlier, &OURS.replace("quic/a:1", "quic/c:1"), before);
            (moved["session"]["connect"].clone(), is_unsure)
        };
        let list = |endpoints: &[&str]| Value::from(endpoints.to_vec());
        assert_eq!(moved(&["quic/b:1", "quic/a:1"], None), (list(&["quic/c:1", "quic/b:1", "quic/a:1"]), true));
        assert_eq!(moved(&["quic/b:1"], Some("quic/a:1")), (list(&["quic/c:1", "quic/b:1"]), true), "the operator has taken ours out");
        assert_eq!(moved(&["quic/a:1"], None), (list(&["quic/c:1"]), false), "the only one was ours");
        assert_eq!(moved(&[], Some("quic/a:1")), (list(&["quic/c:1"]), false));
    }

    #[test]
    fn a_cell_that_has_no_pool_any_more_calls_none() {
        let earlier = format!("{OURS}[caller]\npool = \"rack\"\nretries = 3\n");
        let (after, _) = again(&earlier, OURS, Some("quic/a:1"));
        assert_eq!(after["caller"], Value::from(table("retries = 3")));
        written_again("[motion\n", OURS, None).expect_err("nothing is overwritten that cannot be read");
    }
}
