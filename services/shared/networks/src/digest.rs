//! One hash of several files: what was made with them carries it, and is told apart from what was made with others.

/// BLAKE3 of parts with their names, hexadecimal: another one when a name, a byte or the order is another.
pub fn digest<'a>(parts: impl IntoIterator<Item = (&'a str, &'a [u8])>) -> String {
    let mut hasher = blake3::Hasher::new();
    for (name, bytes) in parts {
        // Each with its length, or the end of one could be the beginning of the next.
        for field in [name.as_bytes(), bytes] {
            hasher.update(&(field.len() as u64).to_le_bytes()).update(field);
        }
    }
    hasher.finalize().to_hex().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_a_byte_the_order_and_where_a_part_ends_make_another_hash() {
        let of = |parts: &[(&str, &str)]| digest(parts.iter().map(|(name, text)| (*name, text.as_bytes())));
        let own = of(&[("a", "xy"), ("b", "z")]);
        assert_eq!(own, of(&[("a", "xy"), ("b", "z")]));
        let others: [&[(&str, &str)]; 5] = [
            &[("c", "xy"), ("b", "z")],
            &[("a", "xz"), ("b", "z")],
            &[("b", "z"), ("a", "xy")],
            &[("a", "x"), ("yb", "z")],
            &[("a", "xy")],
        ];
        for other in others {
            assert_ne!(of(other), own, "{other:?}");
        }
    }
}
