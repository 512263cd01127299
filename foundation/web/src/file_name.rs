//! Names of files sent by a browser.

const MAX_NAME_BYTES: usize = 120;

/// Converts a file name from a browser to one safe path component. Only the part after the last `/` or `\` is kept.
/// Characters other than letters, digits, blanks and `-_.+` become `_`, leading and trailing dots and blanks are
/// removed, and the result has at most 120 bytes. `None` for a name without a letter or a digit.
pub fn sanitised(name: &str) -> Option<String> {
    let last = name.rsplit(['/', '\\']).next().unwrap_or_default();
    let is_plain = |c: char| c.is_alphanumeric() || matches!(c, '-' | '_' | '.' | '+' | ' ');
    let plain: String = last.chars().map(|c| if is_plain(c) { c } else { '_' }).collect();
    let mut plain = plain.trim_matches(['.', ' ']).to_owned();
    if plain.len() > MAX_NAME_BYTES {
        // Keep the extension, because it determines how the file is read.
        let (stem, ending) = plain.rsplit_once('.').unwrap_or((&plain, ""));
        let ending: String = ending.chars().take(10).collect();
        let mut short = String::new();
        for c in stem.chars() {
            if short.len() + c.len_utf8() + ending.len() + 1 > MAX_NAME_BYTES {
                break;
            }
            short.push(c);
        }
        plain = format!("{short}.{ending}");
    }
    plain.chars().any(char::is_alphanumeric).then_some(plain)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use proptest::prelude::*;

    use super::*;

    #[test]
    fn names_cannot_leave_the_folder() {
        for (given, found) in [
            ("exx.rtl", "exx.rtl"),
            ("../x", "x"),
            ("..\\..\\x.csv", "x.csv"),
            ("/etc/passwd", "passwd"),
            ("<script>.rtl", "_script_.rtl"),
            (".hidden", "hidden"),
            ("Gerät 1 (X).rtl", "Gerät 1 _X_.rtl"),
            ("a\0b\n.csv", "a_b_.csv"),
        ] {
            assert_eq!(sanitised(given).expect(given), found);
        }
        for none in ["", ".", "..", "../", "<>", "/"] {
            assert_eq!(sanitised(none), None, "{none}");
        }
    }

    proptest! {
        /// Any file name from a browser becomes one visible path component in this folder.
        #[test]
        fn a_name_is_one_path_component(given in "\\PC{0,300}|.{0,300}") {
            if let Some(name) = sanitised(&given) {
                prop_assert!(!name.starts_with('.') && name.len() <= MAX_NAME_BYTES, "{name}");
                let path = Path::new("/folder").join(&name);
                prop_assert_eq!(path.parent(), Some(Path::new("/folder")));
                prop_assert_eq!(path.components().count(), 3);
                prop_assert!(!name.contains(['<', '>', '"', '\'', '&', '/', '\\', '\0']));
            }
        }
    }
}
