//! Quantities as metrics of Sparkplug B.

use std::time::{Duration, SystemTime};

use srad_types::payload::{
    DataType, Metric, Payload, PropertySet, PropertyValue, metric, property_value,
};

use super::super::quantities::{Kind, Quality, Quantity, Reading, Unit, Value};

/// Values of the property `Quality` that the specification allows. The crate `srad-types` 0.3 has the first two exchanged.
const BAD: u32 = 0;
const GOOD: u32 = 192;
const STALE: u32 = 500;

/// Milliseconds since 1970.
pub(super) fn millis(time: SystemTime) -> u64 {
    let since = time.duration_since(SystemTime::UNIX_EPOCH);
    u64::try_from(since.unwrap_or_default().as_millis()).unwrap_or(u64::MAX)
}

/// A message with metrics.
pub(super) fn payload(metrics: Vec<Metric>, seq: Option<u8>, now: SystemTime) -> Payload {
    Payload {
        timestamp: Some(millis(now)),
        metrics,
        seq: seq.map(u64::from),
        uuid: None,
        body: None,
    }
}

/// The number of a birth, which its death has, too.
pub(super) fn bd_seq(number: u8, now: SystemTime) -> Metric {
    let value = metric::Value::LongValue(u64::from(number));
    of(
        srad_types::constants::BDSEQ,
        DataType::Int64,
        Some(value),
        now,
    )
}

/// The metric by which others ask for a birth.
pub(super) fn rebirth(now: SystemTime) -> Metric {
    let value = metric::Value::BooleanValue(false);
    let name = srad_types::constants::NODE_CONTROL_REBIRTH;
    of(name, DataType::Boolean, Some(value), now)
}

/// A text that does not change.
pub(super) fn property(name: &str, text: &str, now: SystemTime) -> Metric {
    let value = metric::Value::StringValue(text.to_owned());
    of(name, DataType::String, Some(value), now)
}

/// A quantity with its value, its quality and the time of the value; in a birth with its unit and meaning, too.
pub(super) fn quantity(
    quantity: &Quantity,
    reading: &Reading,
    is_birth: bool,
    now: SystemTime,
) -> Metric {
    let value = reading.value.clone().map(|value| match value {
        Value::Number(number) => metric::Value::DoubleValue(number),
        Value::Whole(number) => metric::Value::LongValue(number),
        Value::Truth(yes) => metric::Value::BooleanValue(yes),
        Value::Text(text) => metric::Value::StringValue(text),
    });
    let datatype = match quantity.kind {
        Kind::Number(_) => DataType::Double,
        Kind::Whole => DataType::UInt64,
        Kind::Truth => DataType::Boolean,
        Kind::Text => DataType::String,
    };
    let age = Duration::try_from_secs_f64(reading.age_ms * 1e-3).unwrap_or_default();
    let at = now.checked_sub(age).unwrap_or(now);
    let mut metric = of(&name(quantity), datatype, value, at);
    let quality = match reading.quality {
        Quality::Good | Quality::Doubtful => GOOD,
        Quality::Stale => STALE,
        Quality::Unknown => BAD,
    };
    let mut properties = PropertySet {
        keys: vec![srad_types::constants::QUALITY.to_owned()],
        values: vec![PropertyValue {
            r#type: Some(DataType::Int32 as u32),
            is_null: None,
            value: Some(property_value::Value::IntValue(quality)),
        }],
    };
    if is_birth {
        let mut add = |key: &str, text: &str| {
            properties.keys.push(key.to_owned());
            properties.values.push(PropertyValue {
                r#type: Some(DataType::String as u32),
                is_null: None,
                value: Some(property_value::Value::StringValue(text.to_owned())),
            });
        };
        add("Description", quantity.help);
        if let Kind::Number(unit) = quantity.kind {
            add("engUnit", unit.symbol());
        }
    }
    metric.properties = Some(properties);
    metric
}

/// The name of a quantity, folders and all. What divides folders or is a wildcard in a name becomes `_`.
fn name(quantity: &Quantity) -> String {
    let mut parts: Vec<String> = quantity.folder.clone();
    // The folder of a temperature is its sensor.
    if quantity.kind != Kind::Number(Unit::Degc) {
        parts.push(quantity.name.to_owned());
    }
    for part in &mut parts {
        *part = part.replace(['/', '+', '#'], "_");
    }
    parts.join("/")
}

fn of(name: &str, datatype: DataType, value: Option<metric::Value>, at: SystemTime) -> Metric {
    let mut metric = Metric::new();
    metric.set_name(name.to_owned());
    metric.set_datatype(datatype);
    metric.set_timestamp(millis(at));
    match value {
        Some(value) => metric.set_value(value),
        None => metric.set_null(),
    };
    metric
}
