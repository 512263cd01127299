//! The clock of the centre and its dates. They are for display: no machine makes decisions from them.

use std::time::{SystemTime, UNIX_EPOCH};

use time::{Date, Month, OffsetDateTime};
use volcomp_model::is_date;

/// Seconds since 1970, rounded to milliseconds so that a value survives writing and reading unchanged. 0 if the clock is before 1970.
pub fn now_s() -> f64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0.0, |since| (since.as_secs_f64() * 1e3).round() / 1e3)
}

/// Start of a UTC day such as `2026-11-25`, seconds since 1970; `None` if the text is not a date.
pub fn date_s(text: &str) -> Option<f64> {
    if !is_date(text) {
        return None;
    }
    let mut parts = text.split('-').map(str::parse::<u16>);
    let mut next = || parts.next()?.ok();
    let (year, month, day) = (next()?, next()?, next()?);
    if year < 1970 {
        return None;
    }
    let month = Month::try_from(u8::try_from(month).ok()?).ok()?;
    let date = Date::from_calendar_date(year.into(), month, u8::try_from(day).ok()?).ok()?;
    Some(date.midnight().assume_utc().unix_timestamp() as f64)
}

/// Formats a time, seconds since 1970, as `2026-11-25 14:03:59` UTC.
#[expect(
    clippy::cast_possible_truncation,
    reason = "a time of this program lies within the years 1970 to 9999"
)]
pub fn date(at_s: f64) -> String {
    let at_s = at_s.clamp(0.0, 253_402_300_799.0) as i64;
    let at = OffsetDateTime::from_unix_timestamp(at_s).unwrap_or(OffsetDateTime::UNIX_EPOCH);
    let (date, time) = (at.date(), at.time());
    let (hour, minute, second) = time.as_hms();
    format!("{date} {hour:02}:{minute:02}:{second:02}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_formatted_as_date_does() {
        // Expected values from `date -u -d @951782400 '+%F %T'`.
        for (at_s, text) in [
            (0.0, "1970-01-01 00:00:00"),
            (951_782_400.0, "2000-02-29 00:00:00"),
            (1_795_661_039.9, "2026-11-26 02:43:59"),
            (253_402_300_799.0, "9999-12-31 23:59:59"),
            (f64::NAN, "1970-01-01 00:00:00"),
        ] {
            assert_eq!(date(at_s), text);
        }
        for day in 0..200_000 {
            let at_s = f64::from(day) * 86_400.0;
            let text = date(at_s);
            assert_eq!(date_s(&text[..10]), Some(at_s), "{text}");
        }
    }

    #[test]
    fn days_are_counted_as_date_does() {
        // Expected values from `date -u -d 2026-11-25 +%s`.
        for (text, s) in [
            ("1970-01-01", 0.0),
            ("2000-02-29", 951_782_400.0),
            ("2026-11-25", 1_795_564_800.0),
            ("2100-03-01", 4_107_542_400.0),
        ] {
            assert_eq!(date_s(text), Some(s), "{text}");
        }
        for text in [
            "",
            "2026",
            "2026-13-01",
            "2026-00-10",
            "1969-12-31",
            "2026-11-x",
            "2026-11-00",
            "2026-11-250",
            "2026-02-31",
            "2026-02-29",
            "2100-02-29",
            "2026-04-31",
            "26-11-25",
            "2026-1-05",
            "+026-11-25",
            "ä026-11-25",
        ] {
            assert_eq!(date_s(text), None, "{text}");
        }
    }
}
