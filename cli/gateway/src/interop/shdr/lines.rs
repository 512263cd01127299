//! SHDR lines: a client is sent only what has changed since its last update.

use std::time::{Duration, SystemTime};

use super::super::{
    alarms::{Alarm, Level, Place, places},
    quantities::{Kind, Part, Quantity, Shape, Unit, Value, key_of, quantities},
};
use crate::{
    audit::utc,
    documents::{StateName, Status},
};

/// Value of an unknown item.
const UNAVAILABLE: &str = "UNAVAILABLE";
/// Key of the item that reports whether the gateway is available.
pub(super) const AVAILABILITY: &str = "avail";

/// The data items of a gateway, in order.
pub struct Items {
    /// Items with values.
    pub quantities: Vec<Quantity>,
    /// Items with conditions: key and place.
    pub conditions: Vec<(String, Place)>,
}

impl Items {
    /// The data items of a gateway.
    pub fn of(shape: &Shape) -> Self {
        let mut quantities = quantities(shape);
        // Reasons are reported as conditions.
        quantities.retain(|quantity| quantity.row != "reasons");
        let key = |place| match place {
            Place::Guard => "guard".to_owned(),
            // Sensors whose keys would be equal are numbered in the list of quantities: use the same key here.
            Place::Sensor(sensor) => {
                let own = quantities
                    .iter()
                    .find(|quantity| quantity.part == Part::Sensor(sensor));
                format!("{}_condition", own.map_or("", |own| own.key.as_str()))
            }
            Place::Controller(place) => format!("path_{place}_condition"),
        };
        let places = places(shape).into_iter();
        let conditions = places.map(|place| (key(place), place)).collect();
        Self {
            quantities,
            conditions,
        }
    }
}

/// The state last sent to one client.
pub struct Told {
    available: Option<bool>,
    values: Vec<Option<String>>,
    conditions: Vec<Condition>,
}

/// The last sent state of one condition.
#[derive(Clone, PartialEq)]
enum Condition {
    Nothing,
    Unavailable,
    Normal,
    Active(Vec<Alarm>),
}

impl Told {
    /// The initial state: nothing has been sent.
    pub fn nothing(items: &Items) -> Self {
        Self {
            available: None,
            values: vec![None; items.quantities.len()],
            conditions: vec![Condition::Nothing; items.conditions.len()],
        }
    }

    /// The lines for all changes in a state, each with a line feed. They are recorded as sent.
    pub fn changes(&mut self, items: &Items, status: &Status, now: SystemTime) -> String {
        let mut text = String::new();
        let available = status.state != StateName::Unknown;
        if self.available.replace(available) != Some(available) {
            let word = if available { "AVAILABLE" } else { UNAVAILABLE };
            line(&mut text, now, status.age_ms, &[AVAILABILITY, word]);
        }
        for (quantity, told) in items.quantities.iter().zip(&mut self.values) {
            let reading = quantity.read(status);
            let value = reading
                .current()
                .map_or(UNAVAILABLE.to_owned(), |value| shown(quantity, value));
            if told.as_deref() != Some(value.as_str()) {
                line(&mut text, now, reading.age_ms, &[&quantity.key, &value]);
                *told = Some(value);
            }
        }
        for ((key, place), told) in items.conditions.iter().zip(&mut self.conditions) {
            let found = match place.alarms(status) {
                None => Condition::Unavailable,
                Some(alarms) if alarms.is_empty() => Condition::Normal,
                Some(alarms) => Condition::Active(alarms),
            };
            if *told != found {
                condition(&mut text, now, status.age_ms, key, told, &found);
                *told = found;
            }
        }
        text
    }
}

/// The lines for the change of a condition: ended alarms become normal by their code; new ones and those with a changed
/// level are sent.
fn condition(
    text: &mut String,
    now: SystemTime,
    age_ms: f64,
    key: &str,
    before: &Condition,
    found: &Condition,
) {
    let mut tell = |level: &str, code: &str, words: &str| {
        line(text, now, age_ms, &[key, level, code, "", "", words]);
    };
    let alarms = match found {
        Condition::Active(alarms) => alarms,
        Condition::Unavailable => return tell(UNAVAILABLE, "", ""),
        Condition::Normal | Condition::Nothing => return tell("NORMAL", "", ""),
    };
    let known: &[Alarm] = match before {
        Condition::Active(known) => known,
        _ => &[],
    };
    for ended in known {
        if !alarms.iter().any(|alarm| alarm.code == ended.code) {
            tell("NORMAL", &ended.code, "");
        }
    }
    for alarm in alarms.iter().filter(|alarm| !known.contains(alarm)) {
        let level = match alarm.level {
            Level::Warning => "WARNING",
            Level::Fault => "FAULT",
        };
        tell(level, &alarm.code, &alarm.text);
    }
}

/// Formats a value in the unit used by MTConnect.
fn shown(quantity: &Quantity, value: &Value) -> String {
    match (value, quantity.kind) {
        (Value::Number(value), Kind::Number(unit)) => in_unit(*value, unit),
        (Value::Number(value), _) => value.to_string(),
        (Value::Whole(value), _) => value.to_string(),
        (Value::Truth(yes), _) => if *yes { "TRUE" } else { "FALSE" }.to_owned(),
        (Value::Text(text), _) if quantity.row == "state" => key_of(text).to_uppercase(),
        (Value::Text(text), _) => text.clone(),
    }
}

/// A number in MILLIMETER, DEGREE, CELSIUS or SECOND. Times are rounded to whole seconds, so that an age does not
/// change with every update.
fn in_unit(value: f64, unit: Unit) -> String {
    let text = match unit {
        Unit::Mm | Unit::Deg | Unit::Degc => format!("{value:.3}"),
        Unit::Um => format!("{:.6}", value * 1e-3),
        Unit::Urad => format!("{:.8}", (value * 1e-6).to_degrees()),
        Unit::Ms => format!("{:.0}", value * 1e-3),
    };
    let digits = match text.split_once('.') {
        Some(_) => text.trim_end_matches('0').trim_end_matches('.'),
        None => &text,
    };
    if digits == "-0" { "0" } else { digits }.to_owned()
}

/// Appends one line: timestamp, then fields.
fn line(text: &mut String, now: SystemTime, age_ms: f64, fields: &[&str]) {
    let age = Duration::try_from_secs_f64(age_ms * 1e-3).unwrap_or_default();
    text.push_str(&utc(now.checked_sub(age).unwrap_or(now)));
    for field in fields {
        text.push('|');
        text.push_str(&escaped(field));
    }
    text.push('\n');
}

/// Escapes a field. Only `|`, `"` and `\` have an escaped form; control characters, such as line ends, become spaces,
/// and surrounding spaces are removed.
pub fn escaped(text: &str) -> String {
    let plain: String = text
        .chars()
        .map(|c| if c.is_control() { ' ' } else { c })
        .collect();
    let plain = plain.trim_matches(|c: char| c.is_ascii_whitespace());
    // A backslash escapes the next character only within quotation marks.
    if !plain.contains('|') && !plain.starts_with('"') {
        return plain.to_owned();
    }
    let mut quoted = String::from("\"");
    for c in plain.chars() {
        if matches!(c, '|' | '"' | '\\') {
            quoted.push('\\');
        }
        quoted.push(c);
    }
    quoted.push('"');
    quoted
}
