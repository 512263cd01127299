//! Errors of input files.
//!
//! Also excerpts of files for messages, suggestions for misspelt words, and the maximum magnitude of numbers.

use core::ops::Range;

/// Error at a location in a TOML or CSV file.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{file}:{line}: {key}{}{message}", if key.is_empty() { "" } else { ": " })]
pub struct InputError {
    /// Name of the file, as given by the caller.
    pub file: String,
    /// Line in the file, from 1.
    pub line: usize,
    /// Key with the names of its tables (`errors.EXX.table`), or column of a CSV file. Empty if the error is about the
    /// whole file or row.
    pub key: String,
    /// One sentence that states what was found and what was expected.
    pub message: String,
    /// Byte range of the wrong text, for programs that show it.
    pub span: Range<usize>,
    /// Text of the file, for programs that show the location.
    pub text: std::sync::Arc<str>,
}

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

/// Suggests the known word for which `found` is probably a mistake; `None` if no word is similar. A word is similar if
/// it is within the edit distance of a typing error, or if it is `found` with parts added between or after `_`
/// (`limit_um` for `limit`). Case is ignored.
pub fn nearest<'k>(found: &str, known: &[&'k str]) -> Option<&'k str> {
    near(found, known).first().copied()
}

/// Known words similar to `found`, best match first. Words within the edit distance of a typing error come first. Words
/// of which `found` omits some parts between `_` follow, such as `limit_um` for `limit` or `slew_um_per_s` for
/// `slew_um_s`. Case is ignored.
pub(crate) fn near<'k>(found: &str, known: &[&'k str]) -> Vec<&'k str> {
    let small = found.to_lowercase();
    let found: Vec<char> = small.chars().collect();
    let most = (found.len() / 3).clamp(1, 3);
    let rank = |word: &&'k str| {
        let lower = word.to_lowercase();
        let letters: Vec<char> = lower.chars().collect();
        let slips = slips(&found, &letters);
        // A word no longer than the edit distance is excluded, because every letter of it could differ.
        if slips <= most && slips < letters.len() {
            return Some((false, slips));
        }
        let (mut parts, mut stated) = (lower.split('_'), small.split('_'));
        let begins_alike = !found.is_empty() && parts.next() == stated.next();
        let lacks_parts = begins_alike && stated.all(|part| parts.any(|own| own == part));
        lacks_parts.then_some((true, letters.len()))
    };
    let ranked = known.iter().filter_map(|word| Some((rank(word)?, *word)));
    let mut ranked: Vec<((bool, usize), &str)> = ranked.collect();
    ranked.sort_by_key(|(rank, _)| *rank);
    ranked.into_iter().map(|(_, word)| word).collect()
}

/// Minimum number of steps that turn one word into the other. A step omits, adds or changes a letter, or swaps two
/// neighbouring letters (optimal string alignment distance).
fn slips(from: &[char], to: &[char]) -> usize {
    let mut above: Vec<usize> = vec![0; to.len() + 1];
    let mut row: Vec<usize> = (0..=to.len()).collect();
    for (i, letter) in from.iter().enumerate() {
        let mut next = vec![i + 1];
        for (j, other) in to.iter().enumerate() {
            let changed = row[j] + usize::from(letter != other);
            let mut least = changed.min(row[j + 1] + 1).min(next[j] + 1);
            let is_swap = i > 0 && j > 0 && from[i - 1] == *other && to[j - 1] == *letter;
            if is_swap {
                least = least.min(above[j - 1] + 1);
            }
            next.push(least);
        }
        above = std::mem::replace(&mut row, next);
    }
    row.last().copied().unwrap_or_default()
}

/// Maximum magnitude of a number in an input file. It is far above any quantity of a machine in mm, µm, µrad, °C, s or
/// Pa, and small enough for squares and sums to stay finite.
pub const LARGEST_NUMBER: f64 = 1e15;

/// Checks that a number is finite and within the bound. The error describes the expected range.
pub(crate) fn bounded(number: Option<f64>) -> Result<f64, &'static str> {
    match number.filter(|number| number.is_finite()) {
        None => Err("a finite number"),
        Some(number) if number.abs() > LARGEST_NUMBER => Err("a number from -1e15 to 1e15"),
        Some(number) => Ok(number),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slips_are_counted_as_by_hand() {
        for (from, to, expected) in [
            ("travel", "travel", 0),
            ("travl", "travel", 1),
            ("tarvel", "travel", 1),
            ("kitten", "sitting", 3),
            ("", "abc", 3),
            ("abc", "", 3),
        ] {
            let [from, to] = [from, to].map(|word| word.chars().collect::<Vec<_>>());
            assert_eq!(slips(&from, &to), expected, "{from:?} {to:?}");
        }
    }

    #[test]
    fn only_a_slip_of_the_hand_is_taken_for_another_word() {
        let known = ["travel", "point", "direction", "modulo"];
        assert_eq!(nearest("Travl", &known), Some("travel"));
        assert_eq!(nearest("poitn", &known), Some("point"));
        assert_eq!(nearest("backlash", &known), None);
        assert_eq!(nearest("x", &["y"]), None);
        assert_eq!(nearest("", &known), None);
    }

    #[test]
    fn a_key_without_its_unit_is_taken_for_the_key() {
        let known = ["_um", "limit_without_barrier_um", "limit_um", "limit_urad", "hold_ms"];
        assert_eq!(nearest("limit", &known), Some("limit_um"));
        assert_eq!(nearest("hold", &known), Some("hold_ms"));
        assert_eq!(
            nearest("slew_um_s", &["accel_um_per_s2", "slew_um_per_s"]),
            Some("slew_um_per_s")
        );
        assert_eq!(nearest("slew_s_um", &["slew_um_per_s"]), None);
        assert_eq!(nearest("lim", &known), None);
        assert_eq!(nearest("", &known), None);
    }

    #[test]
    fn the_likeliest_word_comes_first() {
        let known = ["limit_without_barrier_um", "limit_um", "limit_urad", "axes"];
        let expected = ["limit_um", "limit_urad", "limit_without_barrier_um"];
        assert_eq!(near("limit", &known), expected);
        assert_eq!(near("limit_umm", &known), ["limit_um", "limit_urad"]);
        assert_eq!(near("nothing", &known), [""; 0]);
    }
}
