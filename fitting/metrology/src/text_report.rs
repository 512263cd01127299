//! Common parts of the text reports of different makers.

use std::fmt::Write as _;

use crate::Metadata;

/// Maximum number of decimals that is considered, because sums of such numbers lose finer digits.
const MOST_DECIMALS: i32 = 12;

/// Decimal place of the last digit of a number: 3 for `1.250`, 4 for `2.0E-03`, −2 for `1.2E+03`. For a zero with an
/// exponent the place is unknown, and the maximum is returned.
pub(crate) fn decimals_of(text: &str) -> i32 {
    let (mantissa, exponent) = match text.split_once(['e', 'E']) {
        Some((mantissa, exponent)) => (mantissa, Some(exponent)),
        None => (text, None),
    };
    let is_zero = !mantissa.contains(|c: char| ('1'..='9').contains(&c));
    if exponent.is_some() && is_zero {
        return MOST_DECIMALS;
    }
    let behind = i32::try_from(crate::number::decimals(mantissa)).unwrap_or(MOST_DECIMALS);
    // A number with an exponent that cannot be parsed is invalid anyway.
    let exponent = exponent.map_or(0, |text| text.parse().unwrap_or(0));
    behind.saturating_sub(exponent).min(MOST_DECIMALS)
}

/// Size of the last digit of the coarsest number. `decimals` are the decimal places of the numbers.
pub(crate) fn step_of(decimals: impl Iterator<Item = i32>) -> f64 {
    10_f64.powi(-decimals.min().unwrap_or(0))
}

/// Writes the lines that `metadata_of` reads, for the known values, with CRLF. Line breaks in texts become blanks.
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

/// Reads lines `key: value` whose keys have the same meaning in every report. Other lines are skipped.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_exponent_moves_the_last_digit() {
        for (text, decimals) in [
            ("1.250", 3),
            ("-7", 0),
            ("0.00", 2),
            ("2.0E-03", 4),
            ("2.0e-3", 4),
            ("-1.25E+01", 1),
            ("1.2E+03", -2),
            ("0.0E+00", MOST_DECIMALS),
            ("1E-99999999999", 0),
            ("1E-2147483648", MOST_DECIMALS),
            ("0.12345678901234567", MOST_DECIMALS),
        ] {
            assert_eq!(decimals_of(text), decimals, "{text}");
        }
    }
}
