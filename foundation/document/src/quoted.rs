/// Formats an excerpt of a file for a message: in back quotes, with control characters escaped, and truncated to 60
/// characters.
pub fn quoted(text: &str) -> String {
    const LONGEST: usize = 60;
    let mut characters = text.chars();
    let shown: String =
        characters.by_ref().take(LONGEST).fold(String::new(), |mut shown, character| {
            match character {
                // Quotes and backslashes are shown as written in the file.
                '"' | '\'' | '\\' => shown.push(character),
                _ => shown.extend(character.escape_debug()),
            }
            shown
        });
    let cut = if characters.next().is_some() { "…" } else { "" };
    format!("`{shown}{cut}`")
}
