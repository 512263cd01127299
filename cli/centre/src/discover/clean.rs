//! Texts from the wire, made harmless.

/// The longest text that is kept, characters.
const LONGEST: usize = 100;

/// A text as it may be shown: one line of at most a hundred characters, without control characters (which move a terminal's
/// cursor) and without those that turn the direction of writing.
pub fn clean(text: &str) -> String {
    let shown: String = text
        .chars()
        .map(|c| if is_harmless(c) { c } else { ' ' })
        .take(4 * LONGEST)
        .collect();
    let words: Vec<&str> = shown.split_whitespace().collect();
    words.join(" ").chars().take(LONGEST).collect()
}

fn is_harmless(c: char) -> bool {
    let turns = matches!(c, '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}' | '\u{feff}');
    !c.is_control() && !turns
}

#[cfg(test)]
mod tests {
    use super::clean;

    #[test]
    fn nothing_moves_a_terminal() {
        assert_eq!(clean("  31i\u{1b}[2J\r\n B\0 "), "31i [2J B");
        assert_eq!(clean("a\u{202e}b"), "a b");
        assert_eq!(clean(&"ä".repeat(500)).chars().count(), 100);
    }
}
