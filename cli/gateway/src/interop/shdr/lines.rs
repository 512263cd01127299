//! Lines of SHDR: what a client is told, and what it was told before.

use std::time::{Duration, SystemTime};

use super::super::{
    alarms::{Alarm, Level, Place, places},
    quantities::{Kind, Part, Quantity, Shape, Unit, Value, key_of, quantities},
};
use crate::{
    audit::utc,
    documents::{StateName, Status},
};

/// What is not known.
const UNAVAILABLE: &str = "UNAVAILABLE";
/// The key of the item that says whether the gateway tells anything at all.
pub(super) const AVAILABILITY: &str = "avail";

/// The items that are told of a gateway, in order.
pub struct Items {
    /// Those with values.
    pub quantities: Vec<Quantity>,
    /// Those with conditions: key and place.
    pub conditions: Vec<(String, Place)>,
}

impl Items {
    /// The items of a gateway.
    pub fn of(shape: &Shape) -> Self {
        let mut quantities = quantities(shape);
        // Reasons are told as conditions.
        quantities.retain(|quantity| quantity.row != "reasons");
        let key = |place| match place {
            Place::Guard => "guard".to_owned(),
            // The same sensor, the same name: they are told apart in the list of quantities.
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

/// What one client was told last.
pub struct Told {
    available: Option<bool>,
    values: Vec<Option<String>>,
    conditions: Vec<Condition>,
}

/// The last that was told of one condition.
#[derive(Clone, PartialEq)]
enum Condition {
    Nothing,
    Unavailable,
    Normal,
    Active(Vec<Alarm>),
}

impl Told {
    /// Nothing was told so far.
    pub fn nothing(items: &Items) -> Self {
        Self {
            available: None,
            values: vec![None; items.quantities.len()],
            conditions: vec![Condition::Nothing; items.conditions.len()],
        }
    }

    /// The lines that say what a state has changed, each with its end; from now on they count as told.
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

/// The lines from one condition to another: what has ended is normal by its code, what is new or another level is told.
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

/// A value in the unit of MTConnect.
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

/// A number in MILLIMETER, DEGREE, CELSIUS or SECOND. Times are whole seconds, so that an age is told when it grows and not
/// with every look.
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

/// One line of a time and fields.
fn line(text: &mut String, now: SystemTime, age_ms: f64, fields: &[&str]) {
    let age = Duration::try_from_secs_f64(age_ms * 1e-3).unwrap_or_default();
    text.push_str(&utc(now.checked_sub(age).unwrap_or(now)));
    for field in fields {
        text.push('|');
        text.push_str(&escaped(field));
    }
    text.push('\n');
}

/// A field that a reader takes for the same text. Only `|`, `"` and `\` can be written otherwise than as they are, so every
/// control character, such as the end of a line, becomes a space, and spaces around the text are left out.
pub fn escaped(text: &str) -> String {
    let plain: String = text
        .chars()
        .map(|c| if c.is_control() { ' ' } else { c })
        .collect();
    let plain = plain.trim_matches(|c: char| c.is_ascii_whitespace());
    // Between quotation marks a backslash takes the sign behind it as it is; without them nothing does.
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
