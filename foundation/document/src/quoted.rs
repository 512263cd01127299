//! Pieces of a file in messages.

/// A piece of a file for a message: in back quotes, control characters escaped, cut after 60 characters.
pub fn quoted(text: &str) -> String {
    const LONGEST: usize = 60;
    let mut characters = text.chars();
    let shown: String = characters
        .by_ref()
        .take(LONGEST)
        .flat_map(char::escape_debug)
        .collect();
    let cut = if characters.next().is_some() {
        "…"
    } else {
        ""
    };
    format!("`{shown}{cut}`")
}
