//! Logs of EPICS `camonitor`: interleaved channels. Each channel has its own time stamps, and a line whenever its value
//! changes.

use std::collections::BTreeMap;

use volcomp_document::quoted;

use crate::MetrologyError;
use crate::encoding::{decode, refuse_empty};
use crate::number::Place;

const EXPECTED: &str =
    "lines of channel, date, time and value: `X:POS 2026-03-14 10:15:00.250000 12.5`";
const US_PER_S: f64 = 1e6;

#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ChannelLog {
    /// Name of the source file, for messages.
    pub name: String,
    /// Date of the first line, as written in the log.
    pub date: Option<String>,
    pub channels: Vec<Channel>,
    /// Notes for the user on how the file was read.
    pub notes: Vec<String>,
}

#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Channel {
    pub name: String,
    /// Pairs of time (s since the earliest line of the log) and value, by ascending time.
    pub samples: Vec<(f64, f64)>,
    /// Number of values with each alarm, such as `LOLO MAJOR`. Values with the alarm `INVALID` are omitted from
    /// `samples`.
    pub alarms: BTreeMap<String, usize>,
}

impl ChannelLog {
    pub fn channel(&self, name: &str) -> Option<&Channel> {
        self.channels.iter().find(|channel| channel.name == name)
    }

    /// Duration of the log, s.
    pub fn duration_s(&self) -> f64 {
        let last = self.channels.iter().filter_map(|channel| channel.samples.last());
        last.map(|(time, _)| *time).fold(0.0, f64::max)
    }
}

/// Whether most of the first lines of a text are in the format of `camonitor`.
pub(crate) fn is_log(text: &str) -> bool {
    let lines: Vec<&str> = text.lines().filter(|line| !line.trim().is_empty()).take(20).collect();
    let read = lines.iter().filter(|line| Line::of(line).is_some()).count();
    read > 0 && 2 * read >= lines.len()
}

/// Reads a log of `camonitor` with lines `<channel> <YYYY-MM-DD> <hh:mm:ss.ffffff> <value> [<alarm words>]`.
///
/// Values are sorted by time within their channel. Values with the alarm `INVALID` are dropped, values with other
/// alarms are kept. Lines without a number (a disconnected channel, a text) are skipped. Notes state how many values
/// and lines were dropped or skipped.
///
/// # Errors
/// A text without a line of this kind.
pub fn parse_camonitor(bytes: &[u8], name: &str) -> Result<ChannelLog, MetrologyError> {
    let (text, encoding_note) = decode(bytes, name)?;
    refuse_empty(&text, name, EXPECTED)?;
    let mut raw: BTreeMap<&str, RawValue> = BTreeMap::new();
    let (mut unread, mut first_unread) = (0_usize, None);
    let mut date = None;
    for (index, line) in text.lines().enumerate() {
        if line.trim().is_empty() {
            continue;
        }
        let Some(read) = Line::of(line) else {
            unread += 1;
            first_unread.get_or_insert((index + 1, line.trim()));
            continue;
        };
        date.get_or_insert(read.date);
        raw.entry(read.channel).or_default().add(&read);
    }
    let Some(start) = raw.values().filter_map(RawValue::earliest).min() else {
        let (line, found) = first_unread.unwrap_or((1, ""));
        return Err(Place::new(name, line).wrong_kind(quoted(found), EXPECTED));
    };
    let mut notes: Vec<String> = encoding_note.into_iter().collect();
    if let Some((line, found)) = first_unread {
        notes.push(format!(
            "{unread} lines hold no number and were passed over, first line {line}: {}",
            quoted(found)
        ));
    }
    if !text.ends_with(['\n', '\r']) {
        notes.push("the last line does not end in a line break: the file may be cut off".into());
    }
    for (channel, of) in &raw {
        notes.extend(of.notes(channel));
    }
    let channel = |(name, raw): (&str, RawValue)| Channel {
        name: name.to_owned(),
        samples: raw.sorted(start),
        alarms: raw.alarms,
    };
    Ok(ChannelLog {
        name: name.into(),
        date: date.map(str::to_owned),
        channels: raw.into_iter().map(channel).collect(),
        notes,
    })
}

#[derive(Default)]
struct RawValue {
    /// Pairs of time in µs and value.
    samples: Vec<(i64, f64)>,
    alarms: BTreeMap<String, usize>,
    out_of_order: usize,
    invalid: usize,
}

impl RawValue {
    fn add(&mut self, line: &Line<'_>) {
        if !line.alarm.is_empty() {
            *self.alarms.entry(line.alarm.clone()).or_default() += 1;
        }
        if line.alarm.split(' ').any(|word| word == "INVALID") {
            self.invalid += 1;
            return;
        }
        if self.samples.last().is_some_and(|(last, _)| *last > line.time_us) {
            self.out_of_order += 1;
        }
        self.samples.push((line.time_us, line.value));
    }

    fn earliest(&self) -> Option<i64> {
        self.samples.iter().map(|(time, _)| *time).min()
    }

    fn sorted(&self, start: i64) -> Vec<(f64, f64)> {
        let mut samples = self.samples.clone();
        samples.sort_by_key(|(time, _)| *time);
        samples.dedup();
        let since = |time: i64| time.saturating_sub(start) as f64 / US_PER_S;
        samples.into_iter().map(|(time, value)| (since(time), value)).collect()
    }

    fn notes(&self, channel: &str) -> Vec<String> {
        let mut notes = Vec::new();
        if self.out_of_order > 0 {
            notes.push(format!(
                "{channel}: {} values out of order, put in the order of their time",
                self.out_of_order
            ));
        }
        if self.invalid > 0 {
            notes.push(format!(
                "{channel}: {} values with the alarm INVALID left out",
                self.invalid
            ));
        }
        for (alarm, count) in &self.alarms {
            if !alarm.split(' ').any(|word| word == "INVALID") {
                notes.push(format!("{channel}: {count} values with the alarm {alarm} kept"));
            }
        }
        notes
    }
}

struct Line<'t> {
    channel: &'t str,
    date: &'t str,
    time_us: i64,
    value: f64,
    alarm: String,
}

impl<'t> Line<'t> {
    fn of(line: &'t str) -> Option<Self> {
        let mut words = line.split_ascii_whitespace();
        let (channel, date, time, value) =
            (words.next()?, words.next()?, words.next()?, words.next()?);
        let value = Place::new("", 0).number("value", value).ok()?;
        let alarm: Vec<&str> = words.collect();
        // A waveform has further numbers after the first number.
        let is_word = |word: &&str| word.chars().all(|c| c.is_ascii_alphabetic() || c == '_');
        alarm.iter().all(is_word).then_some(())?;
        Some(Self {
            channel,
            date,
            time_us: days_of(date)?.checked_mul(86_400_000_000)?.checked_add(us_of(time)?)?,
            value,
            alarm: alarm.join(" "),
        })
    }
}

fn digits(text: &str) -> Option<i64> {
    let plain = !text.is_empty() && text.len() <= 9 && text.bytes().all(|b| b.is_ascii_digit());
    plain.then(|| text.parse().ok()).flatten()
}

/// Days since 1970-01-01 of a date in the Gregorian calendar.
fn days_of(date: &str) -> Option<i64> {
    let parts: Vec<i64> = date.split('-').map(digits).collect::<Option<_>>()?;
    let [year, month @ 1..=12, day @ 1..=31] = parts[..] else {
        return None;
    };
    if !(1970..=9999).contains(&year) {
        return None;
    }
    // Count years from March, so that the leap day is the last day of its year.
    let year = if month <= 2 { year - 1 } else { year };
    let month = (month + 9) % 12;
    let of_year = (153 * month + 2) / 5 + day - 1;
    Some(365 * year + year / 4 - year / 100 + year / 400 + of_year - 719_468)
}

fn us_of(time: &str) -> Option<i64> {
    let (whole, fraction) = time.split_once('.').unwrap_or((time, "0"));
    let parts: Vec<i64> = whole.split(':').map(digits).collect::<Option<_>>()?;
    let [hour @ 0..=23, minute @ 0..=59, second @ 0..=60] = parts[..] else {
        return None;
    };
    let micro = digits(fraction)?;
    let places = u32::try_from(fraction.len()).ok()?;
    let micro = match places {
        0..=6 => micro * 10_i64.pow(6 - places),
        _ => micro / 10_i64.pow(places - 6),
    };
    Some(((hour * 60 + minute) * 60 + second) * 1_000_000 + micro)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_and_times_are_those_of_the_calendar() {
        assert_eq!(days_of("1970-01-01"), Some(0));
        assert_eq!(days_of("2000-03-01"), Some(11_017));
        assert_eq!(days_of("2024-02-29"), Some(19_782));
        for wrong in
            ["1970-13-01", "24-02-29", "1969-12-31", "2024/02/29", "2024-02", "<undefined>"]
        {
            assert_eq!(days_of(wrong), None, "{wrong}");
        }
        assert_eq!(us_of("00:00:01.25"), Some(1_250_000));
        assert_eq!(us_of("23:59:59.123456789"), Some(86_399_123_456));
        assert_eq!(us_of("24:00:00"), None);
    }
}
