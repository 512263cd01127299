//! Pieces of a file in messages.

/// A piece of a file for a message: in back quotes, control characters escaped, cut after 60 characters.
pub fn quoted(text: &str) -> String {
    const LONGEST: usize = 60;
    let mut characters = text.chars();
    let shown: String =
        characters
            .by_ref()
            .take(LONGEST)
            .fold(String::new(), |mut shown, character| {
                match character {
                    // What stands in quotes in a table is shown as it stands there.
                    '"' | '\'' | '\\' => shown.push(character),
                    _ => shown.extend(character.escape_debug()),
                }
                shown
            });
    let cut = if characters.next().is_some() {
        "…"
    } else {
        ""
    };
    format!("`{shown}{cut}`")
}
