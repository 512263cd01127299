//! Converts a quantity to an OPC UA value with status and source time.

use std::time::{Duration, SystemTime};

use opcua::types::{DataValue, DateTime, StatusCode, TimestampsToReturn, Variant};

use super::super::quantities::{Quality, Reading, Value};

/// Offset between the epochs of OPC UA (1601) and Unix (1970), in steps of 100 ns.
const UNIX_EPOCH_TICKS: i64 = 116_444_736_000_000_000;

/// A reading with the requested timestamps.
pub(super) fn value(reading: Reading, now: SystemTime, stamps: TimestampsToReturn) -> DataValue {
    let age = Duration::try_from_secs_f64(reading.age_ms * 1e-3).unwrap_or_default();
    let source = now.checked_sub(age).unwrap_or(now);
    let asks = |own| stamps == own || stamps == TimestampsToReturn::Both;
    DataValue {
        value: reading.value.map(|value| match value {
            Value::Number(number) => Variant::Double(number),
            Value::Whole(number) => Variant::UInt64(number),
            Value::Truth(yes) => Variant::Boolean(yes),
            Value::Text(text) => Variant::String(text.into()),
        }),
        status: Some(match reading.quality {
            Quality::Good => StatusCode::Good,
            Quality::Doubtful => StatusCode::Uncertain,
            Quality::Stale => StatusCode::UncertainLastUsableValue,
            Quality::Unknown => StatusCode::BadNoCommunication,
        }),
        source_timestamp: asks(TimestampsToReturn::Source).then(|| time(source)),
        server_timestamp: asks(TimestampsToReturn::Server).then(|| time(now)),
        ..DataValue::default()
    }
}

fn time(at: SystemTime) -> DateTime {
    let since = at
        .duration_since(SystemTime::UNIX_EPOCH)
        .unwrap_or_default();
    let ticks = i64::try_from(since.as_nanos() / 100).unwrap_or(i64::MAX);
    DateTime::from(ticks.saturating_add(UNIX_EPOCH_TICKS))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_so_is_not_good() {
        let now = SystemTime::UNIX_EPOCH + Duration::from_millis(1_700_000_000_500);
        let told = |quality, value: Option<f64>| {
            let reading = Reading {
                value: value.map(Value::Number),
                quality,
                age_ms: 1500.0,
            };
            super::value(reading, now, TimestampsToReturn::Both)
        };
        for (quality, expected) in [
            (Quality::Good, StatusCode::Good),
            (Quality::Doubtful, StatusCode::Uncertain),
            (Quality::Stale, StatusCode::UncertainLastUsableValue),
        ] {
            let found = told(quality, Some(2.5));
            assert_eq!(found.value, Some(Variant::Double(2.5)));
            assert_eq!(found.status, Some(expected));
            let times = [found.source_timestamp, found.server_timestamp];
            let times = times.map(|time| time.expect("asked for").as_chrono().timestamp_millis());
            assert_eq!(times, [1_699_999_999_000, 1_700_000_000_500]);
        }
        let nothing = told(Quality::Unknown, None);
        assert_eq!(nothing.value, None);
        assert!(nothing.status.expect("told").is_bad());
    }
}
