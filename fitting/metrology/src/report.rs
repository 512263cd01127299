//! What text reports of different makers have in common.

use std::fmt::Write as _;

use crate::Metadata;

/// Digits behind the decimal point.
pub(crate) fn decimals_of(text: &str) -> usize {
    let mantissa = text.split(['e', 'E']).next().unwrap_or_default();
    crate::number::decimals(mantissa)
}

/// The same lines, CRLF, for what is known; line breaks in texts become blanks.
pub(crate) fn head_of(metadata: &Metadata) -> String {
    let texts = [
        ("Machine", &metadata.machine),
        ("Serial No", &metadata.serial),
        ("Date", &metadata.date),
        ("By", &metadata.by),
        ("Axis", &metadata.axis),
        ("Location", &metadata.location),
        ("Title", &metadata.title),
    ];
    let mut head = String::new();
    for (key, text) in texts {
        if let Some(text) = text {
            // Writing to a String cannot fail.
            let _ = write!(head, "{key}: {}\r\n", text.replace(char::is_control, " "));
        }
    }
    head
}

/// Lines `key: value` with keys that say the same in every report; others are passed over.
pub(crate) fn metadata_of<'t>(lines: impl Iterator<Item = &'t str>) -> Metadata {
    let mut metadata = Metadata::default();
    for line in lines {
        let Some((key, value)) = line.split_once(':') else {
            continue;
        };
        let value = value.trim();
        let field = match key.trim().to_ascii_lowercase().as_str() {
            "machine" => &mut metadata.machine,
            "serial no" | "serial number" => &mut metadata.serial,
            "date" => &mut metadata.date,
            "by" | "operator" => &mut metadata.by,
            "axis" => &mut metadata.axis,
            "location" => &mut metadata.location,
            "title" => &mut metadata.title,
            _ => continue,
        };
        if !value.is_empty() && field.is_none() {
            *field = Some(value.to_owned());
        }
    }
    metadata
}
