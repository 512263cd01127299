//! Error motions named in a title or a file name.

use volcomp_vocabulary::ErrorName;

/// All errors that are words of a text, in either case, in the order of the words: of titles, of locations and of file names. `EYX at Z-150` names
/// EYX; the location error of a squareness may be written `EC0Y` or `EC(0X)Y`.
pub fn errors_named(text: &str) -> Vec<ErrorName> {
    let error = |word: &str| -> Option<ErrorName> {
        let word = word.to_ascii_uppercase();
        // `C0Y` is an error too; as a word of a title it may be anything.
        word.parse().ok().filter(|_| word.starts_with('E'))
    };
    let words = text.split(|c: char| !(c.is_ascii_alphanumeric() || "()".contains(c)));
    words
        .flat_map(|word| match error(word) {
            Some(error) => vec![error],
            // Brackets around a name, as in `(EXY)` or `exx(1)`.
            None => word.split(['(', ')']).filter_map(error).collect(),
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_words_of_their_own() {
        for (text, names) in [
            ("EXY straightness, table", "EXY"),
            ("exx(1)-y200", "EXX"),
            ("(EYX) and EC(0X)Y", "EYX EC0Y"),
            ("FLEXYTHING EXQ C0Y, text", ""),
        ] {
            let found: Vec<String> = errors_named(text).iter().map(ToString::to_string).collect();
            assert_eq!(found.join(" "), names, "{text}");
        }
    }
}
