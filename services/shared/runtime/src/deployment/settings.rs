//! Configurations that are written again: what the roles say is new, and what an operator has set besides stays. A service of a deployment reads no
//! other file, so that what its arm must keep out of is in there, too.

use toml::{Table, Value};

/// Settings of `deploy` that are removed when the roles no longer say them: section and field.
const ONLY_WHERE_SAID: [(&str, &str); 1] = [("caller", "pool")];

/// A configuration as `deploy` makes it, with what else `earlier` sets. A list that has ours among others stays as it is: the others are the operator's,
/// as further routers to connect to. Where nothing changes, the text stays with its comments.
///
/// # Errors
/// When `earlier` is no TOML.
pub(super) fn written_again(earlier: &str, ours: &str) -> Result<String, toml::de::Error> {
    let (before, said): (Table, Table) = (earlier.parse()?, ours.parse()?);
    let mut after = before.clone();
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
                fields.into_iter().for_each(|(field, value)| put(there, field, value));
            }
            (there, fields) => *there = fields,
        }
    }
    if after == before {
        return Ok(earlier.to_owned());
    }
    let title = ours.lines().next().unwrap_or_default();
    Ok(format!("{title}\n{after}"))
}

fn put(fields: &mut Table, field: String, value: Value) {
    let has_it_among_others = match (fields.get(&field), &value) {
        (Some(Value::Array(there)), Value::Array(ours)) => ours.iter().all(|one| there.contains(one)),
        _ => false,
    };
    if !has_it_among_others {
        fields.insert(field, value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OURS: &str =
        "# motion: repose serve motion\n[session]\nmode = \"client\"\nconnect = [\"quic/a:1\"]\n\n[worker]\nname = \"motion-1\"\n";

    fn table(text: &str) -> Table {
        text.parse().expect("TOML")
    }

    #[test]
    fn what_an_operator_has_set_stays_and_what_the_roles_say_is_new() {
        let own = "[motion]\nkeep_out = [{ name = \"door\", min_m = [0.0, 0.0, 0.0], max_m = [1.0, 1.0, 2.0] }]\n";
        let earlier = format!("{OURS}drain_ms = 2000\n# The door opens inwards.\n{own}");
        assert_eq!(written_again(&earlier, OURS).expect("TOML"), earlier, "nothing is new");
        let moved = written_again(&earlier, &OURS.replace("quic/a:1", "quic/b:1").replace("motion-1", "arm")).expect("TOML");
        let (moved, own) = (table(&moved), table(own));
        assert_eq!((&moved["session"]["connect"][0], &moved["worker"]["name"]), (&Value::from("quic/b:1"), &Value::from("arm")));
        assert_eq!((&moved["worker"]["drain_ms"], &moved["motion"]), (&Value::from(2000), &own["motion"]));
    }

    #[test]
    fn a_second_router_stays_while_the_first_does() {
        let earlier = OURS.replace("[\"quic/a:1\"]", "[\"quic/b:1\", \"quic/a:1\"]");
        assert_eq!(written_again(&earlier, OURS).expect("TOML"), earlier);
        let moved = table(&written_again(&earlier, &OURS.replace("quic/a:1", "quic/c:1")).expect("TOML"));
        assert_eq!(moved["session"]["connect"], Value::from(vec!["quic/c:1"]));
    }

    #[test]
    fn a_cell_that_has_no_pool_any_more_calls_none() {
        let earlier = format!("{OURS}[caller]\npool = \"rack\"\nretries = 3\n");
        let after = table(&written_again(&earlier, OURS).expect("TOML"));
        assert_eq!(after["caller"], Value::from(table("retries = 3")));
        written_again("[motion\n", OURS).expect_err("nothing is overwritten that cannot be read");
    }
}
