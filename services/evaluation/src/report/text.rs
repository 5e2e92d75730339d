//! Tables for people: at most 120 columns wide, with a legend under them.

use comfy_table::{ContentArrangement, Table};
use repose_pictures::drawing::wrapped;

/// The widest line that a report prints.
pub const WIDTH: usize = 120;

/// An empty table with a header. Cells wrap where they would make it wider than [`WIDTH`].
pub fn table<T: ToString>(header: impl IntoIterator<Item = T>) -> Table {
    let mut table = Table::new();
    table.set_content_arrangement(ContentArrangement::Dynamic).set_width(WIDTH as u16);
    table.set_header(header.into_iter().map(|cell| cell.to_string()));
    table
}

/// A paragraph, broken between words.
pub fn paragraph(text: &str) -> String {
    wrapped(text, WIDTH).join("\n")
}

/// What the columns of a table mean, one entry a line.
pub fn legend(entries: &[(&str, &str)]) -> String {
    let lines = entries.iter().map(|(column, meaning)| paragraph(&format!("  {column}: {meaning}")));
    lines.collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn widest(text: &str) -> usize {
        text.lines().map(|line| line.chars().count()).max().unwrap_or(0)
    }

    #[test]
    fn nothing_is_wider_than_a_page() {
        let mut wide = table(["a", "b"]);
        wide.add_row(["word ".repeat(40), "word ".repeat(30)]);
        assert!(widest(&wide.to_string()) <= WIDTH);
        assert!(widest(&legend(&[("joint", &"word ".repeat(60))])) <= WIDTH);
    }
}
