//! From a sentence to its words: lower case, commas kept, politeness and other words that change nothing left out.

/// Words that change nothing.
const EMPTY: [&str; 8] = ["please", "kindly", "just", "somewhere", "down", "directly", "now", "thanks"];
/// Those of them that after "not" take back less than "not" alone: "not just near the bowl" may be near it, "not directly behind it" behind it.
const NARROWED: [&str; 2] = ["just", "directly"];
/// What people write in one word and the vocabulary has in two, and contractions.
const SPELLED: [(&str, &str); 17] = [
    ("dont", "do not"),
    ("doesnt", "does not"),
    ("mustnt", "must not"),
    ("shouldnt", "should not"),
    ("isnt", "is not"),
    ("its", "it is"),
    ("id", "i would"),
    ("lets", "let us"),
    ("thats", "that is"),
    ("infront", "in front"),
    ("ontop", "on top"),
    ("gray", "grey"),
    ("centre", "center"),
    ("centred", "centered"),
    ("leftmost", "left most"),
    ("rightmost", "right most"),
    ("righthand", "right hand"),
];

/// The words of a sentence. `#` before a number becomes the word `number`, and what separates clauses a comma. Signs that change the meaning
/// stay: nothing knows them.
pub fn words_of(sentence: &str) -> Vec<String> {
    let mut words: Vec<String> = Vec::new();
    let mut word = String::new();
    for c in sentence.to_lowercase().chars().chain([' ']) {
        match c {
            '\'' | '’' => {}
            c if c.is_alphanumeric() => word.push(c),
            c => {
                push(&mut words, &std::mem::take(&mut word));
                match c {
                    ',' | ';' | ':' => words.push(",".to_owned()),
                    '#' => words.push("number".to_owned()),
                    // An end inside the text separates clauses too.
                    '.' | '!' | '?' => words.push(",".to_owned()),
                    // Signs that mean something which the vocabulary does not know: an aside, a choice, "and", "not".
                    '(' | '[' | '{' | '/' | '\\' | '|' | '&' | '+' | '~' | '¬' => words.push(c.to_string()),
                    _ => {}
                }
            }
        }
    }
    words.dedup_by(|a, b| a == "," && b == ",");
    while words.last().is_some_and(|w| w == ",") {
        words.pop();
    }
    words
}

fn push(words: &mut Vec<String>, word: &str) {
    let is_narrowed = NARROWED.contains(&word) && words.last().is_some_and(|before| before == "not");
    if word.is_empty() || (EMPTY.contains(&word) && !is_narrowed) {
        return;
    }
    match SPELLED.iter().find(|(short, _)| *short == word) {
        Some((_, long)) => words.extend(long.split(' ').map(str::to_owned)),
        None => words.push(word.to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn punctuation_and_politeness_leave_the_words_that_count() {
        let words = words_of("Please, don't put the left-most mug near #3 … the box!");
        assert_eq!(words.join(" "), ", do not put the left most mug near number 3 the box");
        assert_eq!(words_of("the mug (that's red)").join(" "), "the mug ( that is red", "an aside is not a part of the sentence");
        assert_eq!(words_of("just left, don't just turn, not directly on").join(" "), "left , do not just turn , not directly on");
        assert_eq!(words_of(" \u{0} "), Vec::<String>::new());
    }
}
