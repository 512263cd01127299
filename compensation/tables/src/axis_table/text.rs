//! Numbers as texts, and texts as numbers.

/// A text file: its name and what it holds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TextFile {
    /// The name, without folders where it is to be written.
    pub name: String,
    /// The content.
    pub text: String,
}

impl TextFile {
    /// The name behind the last slash.
    pub(crate) fn base(&self) -> &str {
        self.name.rsplit(['/', '\\']).next().unwrap_or(&self.name)
    }
}

/// Larger numbers are no positions or deviations of a machine.
const LARGEST: f64 = 1e9;

/// A number in a file: finite, and none that no machine has. `-0.000` is 0.
pub(crate) fn number(text: &str) -> Option<f64> {
    let number: f64 = text.trim().parse().ok()?;
    let sane = text.bytes().any(|byte| byte.is_ascii_digit()) && number.abs() <= LARGEST;
    sane.then_some(number + 0.0)
}

/// A number with so many decimals, never `-0`.
pub(crate) fn fixed(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(rest) if rest.bytes().all(|byte| matches!(byte, b'0' | b'.')) => rest.to_owned(),
        _ => text,
    }
}

/// A number with at most so many decimals, without zeros at its end.
pub(crate) fn short(value: f64, decimals: usize) -> String {
    let text = fixed(value, decimals);
    if !text.contains('.') {
        return text;
    }
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// A number with its sign and so many decimals.
pub(crate) fn signed(value: f64, decimals: usize) -> String {
    let text = fixed(value, decimals);
    if text.starts_with('-') {
        text
    } else {
        format!("+{text}")
    }
}

/// The nearest whole number; `None` where it is beyond those that files hold.
pub(crate) fn whole(value: f64) -> Option<i64> {
    let rounded = value.round();
    #[expect(clippy::cast_possible_truncation, reason = "checked beside it")]
    (rounded.abs() <= 1e15).then_some(rounded as i64)
}
