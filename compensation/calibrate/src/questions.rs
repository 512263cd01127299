//! Open values, `"?"`, of a calibration file.

use std::fmt::Write as _;

use volcomp_document::{InputError, Section, Value};
use volcomp_vocabulary::AxisName;

/// Placeholder of a value that the user has to state.
pub const OPEN: &str = "?";

/// Tables in which values may be open.
const TABLES: [&str; 2] = ["measurement", "squareness"];
/// Tables within a `[[measurement]]` whose values may be open individually.
const INNER: [&str; 3] = ["at", "columns", "channels"];

/// Question for an open value. `key` is a key of a `[[measurement]]` or a `[[squareness]]`; `inner` is a key of a table
/// that is the value of `key`.
pub(crate) fn question(key: &str, inner: Option<&str>) -> String {
    match (key, inner) {
        ("at", Some(axis)) => {
            // The decoder rejects a key that is not an axis.
            let unit = axis
                .parse::<AxisName>()
                .map_or("mm or deg", |axis| axis.kind().coordinate_unit());
            return format!(
                "where did axis {axis} stand during this test, {unit}? Default: at 0."
            );
        }
        ("channels", Some("target")) => "which channel is the position of the axis?",
        ("channels", Some("reading")) => "which channel is the instrument?",
        ("channels", Some("reading_is")) => {
            "does the instrument's channel hold a \"position\" or a \"deviation\"?"
        }
        ("channels", Some("unit")) | ("unit", None) => {
            "in which unit are the readings? An angle for a level or an autocollimator on a bridge, also where the error is a straightness."
        }
        ("error", None) => "which error does this file measure?",
        ("file", None) => "which of these files is the right one?",
        ("at", None) => "where did the other axes stand during this test?",
        ("point", None) => {
            "where was the measured point, [x, y, z] in mm of the machine, with the measured axis at 0? It gives the levers of the tilts. Default: the point of the axis in the machine file."
        }
        ("rides", None) => {
            "on which side of the joint was the measured point? \"carriage\": on the part that this axis moves, as a reflector on its slide is. \"other\": on the part along which it moves, so that the way travelled is a lever as well. Default: \"carriage\"."
        }
        ("sign", None) => {
            "whose motion did the instrument show, and with which sign: 1 or -1? 1 where a positive reading means that the tool went to plus seen from the workpiece; -1 where it means that the table or the guideway did, or where the instrument counts the other way round. Default: 1."
        }
        ("bridge_mm", None) => "how far apart were the feet of the bridge, mm?",
        ("reading", None) => "how is the sign of a tilt meant, \"right-hand\" or \"slope\"?",
        ("holds_location", None) => {
            "were the readings taken against the commanded pose (true) or against the axis itself (false)?"
        }
        ("reference_angle_urad", None) => {
            "by how much is the angle between the plus directions of the two references, the sides of the square or the two beams, more than 90°, µrad? 0 for a perfect square, else the value in its certificate; or state `value_urad`, the squareness itself, in its place."
        }
        _ => "which value is it?",
    }
    .to_owned()
}

/// Rejects a file with open values; the message states the first question and the number of further questions.
pub(crate) fn refuse_open(root: &Section<'_>) -> Result<(), InputError> {
    let mut open = Vec::new();
    for key in TABLES {
        let Some(value) = root.get(key) else { continue };
        for item in value.items()? {
            // The decoder reports items that are not a table.
            if let Ok(section) = item.section() {
                collect(&section, &mut open);
            }
        }
    }
    open.sort_by_key(|error: &InputError| error.line);
    let more = open.len().saturating_sub(1);
    let Some(mut first) = open.into_iter().next() else {
        return Ok(());
    };
    match more {
        0 => {}
        1 => first.message += " (and one more open question below)",
        // Writing to a String cannot fail.
        _ => drop(write!(first.message, " (and {more} more open questions below)")),
    }
    Err(first)
}

fn collect(section: &Section<'_>, open: &mut Vec<InputError>) {
    let is_open = |value: &Value<'_>| value.text().is_ok_and(|text| text == OPEN);
    let mut ask = |value: &Value<'_>, key: &str, inner: Option<&str>| {
        let question = question(key, inner);
        open.push(
            value.error(format!("open question: {question} State it in place of \"{OPEN}\"")),
        );
    };
    for (key, value) in section.values() {
        if is_open(&value) {
            ask(&value, key, None);
        } else if INNER.contains(&key)
            && let Ok(inner) = value.section()
        {
            for (name, value) in inner.values().filter(|(_, value)| is_open(value)) {
                ask(&value, key, Some(name));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_question_for_a_position_has_the_unit_of_its_axis() {
        let asked = |axis| question("at", Some(axis));
        assert_eq!(asked("X"), "where did axis X stand during this test, mm? Default: at 0.");
        assert!(asked("C").contains("this test, deg?"), "{}", asked("C"));
    }
}
