//! Text encoding of measurement files: UTF-8, or else GBK or Latin-1 (Windows-1252), which occur in their free text.

use crate::MetrologyError;
use crate::number::Place;

/// Decodes the text of a file. Also returns a note if the text is not UTF-8.
pub(crate) fn decode(bytes: &[u8], file: &str) -> Result<(String, Option<String>), MetrologyError> {
    let refuse = |at: usize, found: &str| {
        let line = bytes[..at].split(|b| *b == b'\n').count();
        let expected = "text in UTF-8, GBK or Latin-1";
        MetrologyError::Encoding(Place::new(file, line).finding("encoding", found, expected))
    };
    if bytes.starts_with(&[0xFF, 0xFE]) || bytes.starts_with(&[0xFE, 0xFF]) {
        return Err(refuse(0, "UTF-16"));
    }
    if let Some(at) = bytes.iter().position(|b| *b == 0) {
        return Err(refuse(at, "a zero byte (a binary file, or UTF-16)"));
    }
    let bytes = bytes.strip_prefix(&[0xEF, 0xBB, 0xBF]).unwrap_or(bytes);
    if let Ok(text) = std::str::from_utf8(bytes) {
        return Ok((text.to_owned(), None));
    }
    let (encoding, called) = if looks_like_gbk(bytes) {
        (encoding_rs::GBK, "GBK")
    } else {
        (encoding_rs::WINDOWS_1252, "Latin-1")
    };
    let (text, _) = encoding.decode_without_bom_handling(bytes);
    let note = format!("text that is not UTF-8 was read as {called}");
    Ok((text.into_owned(), Some(note)))
}

/// Whether the bytes are Chinese text in GBK. GBK has pairs of high bytes, mostly punctuation (lead bytes A1 to A3) or
/// common characters (lead bytes B0 to D7). In Latin-1, high bytes are isolated between letters.
fn looks_like_gbk(bytes: &[u8]) -> bool {
    let runs = || bytes.split(u8::is_ascii).filter(|run| !run.is_empty());
    let all_pairs =
        runs().all(|run| run.len() % 2 == 0 && run.iter().all(|b| (0xA1..=0xFE).contains(b)));
    let leads: Vec<u8> = runs().flat_map(|run| run.iter().step_by(2).copied()).collect();
    let common = leads.iter().filter(|lead| matches!(lead, 0xA1..=0xA3 | 0xB0..=0xD7)).count();
    all_pairs && 2 * common > leads.len()
}

pub(crate) fn refuse_empty(text: &str, file: &str, expected: &str) -> Result<(), MetrologyError> {
    if text.trim().is_empty() {
        return Err(MetrologyError::Empty { file: file.into(), expected: expected.into() });
    }
    Ok(())
}

/// First line that is not blank, trimmed, and its number from 1.
pub(crate) fn first_line(text: &str) -> Option<(usize, &str)> {
    text.lines()
        .enumerate()
        .map(|(i, line)| (i + 1, line.trim()))
        .find(|(_, line)| !line.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn latin_1_and_gbk_are_distinguished() {
        let text_of = |bytes: &[u8]| decode(bytes, "f").unwrap();
        assert_eq!(
            text_of(b"Gr\xF6\xDFe M\xFCller"),
            ("Größe Müller".into(), Some("text that is not UTF-8 was read as Latin-1".into()))
        );
        assert_eq!(
            text_of(b"\xCE\xDE\xCE\xFD: \xBB\xFA\xB4\xB2"),
            ("无锡: 机床".into(), Some("text that is not UTF-8 was read as GBK".into()))
        );
        assert_eq!(text_of(b"\xEF\xBB\xBFa\xC2\xB5"), ("aµ".into(), None));
    }

    #[test]
    fn wide_text_and_binary_are_refused() {
        assert!(decode(b"\xFF\xFEh\0", "f").is_err());
        assert!(decode(b"a\nb\0", "f").unwrap_err().to_string().starts_with("f:2:"));
    }
}
