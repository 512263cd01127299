//! Logs of channels from EPICS `camonitor`, and the readings that such a log contains.
//!
//! Each channel has its own time stamps, and a line whenever its value changes. A reading is the value of the
//! instrument at a standstill of the axis.

use std::collections::BTreeMap;

use volcomp_document::quoted;

use crate::text::{Place, decode, range, refuse_empty};
use crate::{Direction, FileFormat, Measurement, Metadata, MetrologyError, Reading, ReadingUnit};

const EXPECTED: &str =
    "lines of channel, date, time and value: `X:POS 2026-03-14 10:15:00.250000 12.5`";
const US_PER_S: f64 = 1e6;

#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ChannelLog {
    /// Name of the source file, for messages.
    pub name: String,
    /// Date of the first line, as written in the log.
    pub date: Option<String>,
    pub channels: Vec<Channel>,
    /// Notes for the user on how the file was read.
    pub notes: Vec<String>,
}

#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
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

/// Roles of the channels of a log, and the criteria for standstill of the axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Channels {
    /// Channel of the axis position, mm or deg: the command or the display of the machine.
    pub target: String,
    /// Channel of the instrument.
    pub reading: String,
    /// Whether the instrument reads positions, from which the target is subtracted. If `false`, it reads deviations.
    pub reads_position: bool,
    pub unit: ReadingUnit,
    /// Nominal targets, mm or deg. If empty, the targets are the positions at which the axis stopped.
    pub targets: Vec<f64>,
    /// Maximum distance of the axis from its stop position during a standstill, mm or deg.
    pub within: f64,
    /// Minimum duration of a standstill, s.
    pub dwell_s: f64,
    /// Initial part of each standstill that is ignored, s. With 0 it is detected: samples are ignored while they differ
    /// from the second half of the standstill by more than the scatter of that half.
    pub settle_s: f64,
    /// Whether the deviation at the first target is subtracted from all deviations, for an instrument that was not
    /// zeroed.
    pub zero_at_first: bool,
}

/// Standstill of the axis: start and end, s, and mean position, mm or deg.
struct Standstill {
    from_s: f64,
    to_s: f64,
    position: f64,
}

/// Takes readings from a log at the standstills of the axis. A reading is the mean of the instrument's values during a
/// standstill or, if the instrument reported no change during it, the last value before. Runs and directions follow the
/// order of travel.
///
/// # Errors
/// A channel that is missing in the log, no standstill that is long enough, or no value of the instrument before the
/// end of a standstill.
pub fn readings_at_dwells(
    log: &ChannelLog,
    channels: &Channels,
) -> Result<Measurement, MetrologyError> {
    let axis = channel_of(log, &channels.target)?;
    let reading = channel_of(log, &channels.reading)?;
    let standstills = standstills(axis, log.duration_s(), channels);
    let read = DwellReadings::of(log, axis, reading, &standstills, channels)?;
    let mut readings = read.readings;
    let Some(first) = readings.first().map(|reading| reading.deviation) else {
        return Err(MetrologyError::readings(
            log.name.clone(),
            format!("channel {}", axis.name),
            format!(
                "no standstill of {} s within ±{} at a target",
                channels.dwell_s, channels.within
            ),
            "an axis that stops at its targets: check the channel, `within`, `dwell_s` and `targets`",
        ));
    };
    if channels.zero_at_first {
        for reading in &mut readings {
            reading.deviation -= first;
        }
    }
    let unit = channels.unit.deviation_unit();
    let mut notes = log.notes.clone();
    notes.push(format!(
        "{} standstills of at least {} s read; during a standstill the instrument moved by up to {:.2} {unit}",
        readings.len(),
        channels.dwell_s,
        read.widest
    ));
    if read.skipped > 0 {
        notes.push(format!("{} standstills away from targets skipped", read.skipped));
    }
    if read.joined > 0 {
        notes.push(format!(
            "{} repeated standstills at one target skipped: the axis crept, or overran the target by at most {}",
            read.joined,
            reach(channels)
        ));
    }
    if channels.targets.is_empty() {
        notes.push(
            "the targets are where the axis stood, to the nearest 0.001: state them as `targets`"
                .into(),
        );
    }
    notes.extend(crate::csv_file::incomplete_runs(&readings));
    Ok(Measurement {
        name: log.name.clone(),
        format: Some(FileFormat::Camonitor),
        unit: Some(unit),
        stated: Some(channels.unit),
        metadata: Metadata { date: log.date.clone(), ..Metadata::default() },
        readings,
        notes,
        ..Measurement::default()
    })
}

#[derive(Default)]
struct DwellReadings {
    readings: Vec<Reading>,
    /// Number of skipped standstills: they are at no target, or at a target that was already read in the same run.
    skipped: usize,
    /// Number of standstills that were merged with the previous standstill, because the axis had not left the target.
    joined: usize,
    /// Largest change of the instrument's reading during a standstill, µm or µrad.
    widest: f64,
}

impl DwellReadings {
    fn of(
        log: &ChannelLog,
        axis: &Channel,
        reading: &Channel,
        standstills: &[Standstill],
        channels: &Channels,
    ) -> Result<Self, MetrologyError> {
        let nominal = nominal_targets(standstills, channels);
        let reach = reach(channels);
        let at_target = |standstill: &Standstill| {
            nearest(&nominal, standstill.position)
                .filter(|target| (target - standstill.position).abs() <= reach)
        };
        // An axis that creeps at a target, or overruns it by less than the reach, has approached the target once. The
        // first standstill counts.
        let is_left = |from: &Standstill, to: &Standstill| {
            let target = at_target(from);
            let stays = |(_, value): &(f64, f64)| {
                target.is_some_and(|target| (target - value).abs() <= reach)
            };
            target != at_target(to) || !between(axis, from, to).iter().all(stays)
        };
        let visits: Vec<&Standstill> = standstills
            .chunk_by(|from, to| !is_left(from, to))
            .filter_map(<[Standstill]>::first)
            .collect();
        // Positions that are not targets, such as overruns, also define the direction of approach.
        let order: Vec<f64> = visits
            .iter()
            .map(|standstill| at_target(standstill).unwrap_or(standstill.position))
            .collect();
        let mut read = Self { joined: standstills.len() - visits.len(), ..Self::default() };
        for (standstill, (run, direction)) in visits.into_iter().zip(runs_by_travel(&order)) {
            let Some(target) = at_target(standstill) else {
                read.skipped += 1;
                continue;
            };
            let is_same = |r: &Reading| (r.run, r.direction, r.target) == (run, direction, target);
            if read.readings.iter().any(is_same) {
                // The target was approached again at the beginning of a run. Keep one reading per target.
                read.skipped += 1;
                continue;
            }
            let Some((value, spread)) = mean_within(reading, standstill, channels.settle_s) else {
                return Err(MetrologyError::readings(
                    log.name.clone(),
                    format!("channel {}", reading.name),
                    format!(
                        "no value before the standstill at {target} ended, {:.1} s after the start",
                        standstill.to_s
                    ),
                    "a value of the instrument at every target",
                ));
            };
            let micro = channels.unit.micro();
            read.widest = read.widest.max(spread * micro);
            let zero = if channels.reads_position {
                target * channels.unit.micro_of_coordinate()
            } else {
                0.0
            };
            read.readings.push(Reading { target, run, direction, deviation: value * micro - zero });
        }
        Ok(read)
    }
}

fn channel_of<'l>(log: &'l ChannelLog, name: &str) -> Result<&'l Channel, MetrologyError> {
    log.channel(name).ok_or_else(|| {
        let names: Vec<&str> = log.channels.iter().map(|channel| channel.name.as_str()).collect();
        MetrologyError::readings(
            log.name.clone(),
            "channel",
            format!("no `{name}`"),
            format!("one of {}", names.join(", ")),
        )
    })
}

/// Finds the standstills. A channel reports only changes, so each value holds until the next value, and the last value
/// until the log ends.
fn standstills(channel: &Channel, end_s: f64, channels: &Channels) -> Vec<Standstill> {
    let samples = &channel.samples;
    let mut standstills = Vec::new();
    let mut start = 0;
    for index in 1..=samples.len() {
        let left = match samples.get(index) {
            Some((_, value)) => (value - samples[start].1).abs() > channels.within,
            None => true,
        };
        if !left {
            continue;
        }
        let from_s = samples[start].0;
        let to_s = samples.get(index).map_or(end_s, |(time, _)| *time);
        if to_s - from_s >= channels.dwell_s {
            let here = &samples[start..index];
            let rest = at_rest(here);
            let position = rest.iter().map(|(_, value)| value).sum::<f64>() / rest.len() as f64;
            standstills.push(Standstill { from_s, to_s, position });
        }
        start = index;
    }
    standstills
}

/// The configured targets, or else the distinct positions of the standstills.
fn nominal_targets(standstills: &[Standstill], channels: &Channels) -> Vec<f64> {
    if !channels.targets.is_empty() {
        return channels.targets.clone();
    }
    let mut positions: Vec<f64> =
        standstills.iter().map(|standstill| standstill.position).collect();
    positions.sort_by(f64::total_cmp);
    let groups = positions.chunk_by(|a, b| b - a <= 2.0 * channels.within);
    // Adding 0 turns −0 into 0.
    let rounded =
        |group: &[f64]| (group.iter().sum::<f64>() / group.len() as f64 * 1e3).round() / 1e3 + 0.0;
    groups.map(rounded).collect()
}

fn nearest(targets: &[f64], position: f64) -> Option<f64> {
    let nearer = |a: &&f64, b: &&f64| (**a - position).abs().total_cmp(&(**b - position).abs());
    targets.iter().min_by(nearer).copied()
}

/// Maximum distance from a target at which the axis counts as being at the target: ten times the standstill limit. An
/// overrun goes farther.
fn reach(channels: &Channels) -> f64 {
    10.0 * channels.within
}

fn between<'c>(channel: &'c Channel, from: &Standstill, to: &Standstill) -> &'c [(f64, f64)] {
    let place = |at: f64| channel.samples.partition_point(|(time, _)| *time < at);
    let samples = channel.samples.get(place(from.to_s)..place(to.from_s));
    samples.unwrap_or_default()
}

/// Samples after settling. They begin after the last sample that differs from the median of the second half by more
/// than every sample of that half. Without this cut, the last micrometres of an approach would resemble a reversal
/// value, because they are within the standstill limit and have the sign of the direction. At least one sample remains.
fn at_rest(samples: &[(f64, f64)]) -> &[(f64, f64)] {
    let (first, second) = samples.split_at(samples.len() / 2);
    let mut values: Vec<f64> = second.iter().map(|(_, value)| *value).collect();
    values.sort_by(f64::total_cmp);
    let Some(&median) = values.get(values.len() / 2) else {
        return samples;
    };
    let scatter = values.iter().map(|value| (value - median).abs()).fold(0.0, f64::max);
    // If the samples are equal, their scatter is only rounding.
    let scatter = scatter + 1e-12 * median.abs();
    let moves = |(_, value): &(f64, f64)| (value - median).abs() > scatter;
    let from = first.iter().rposition(moves).map_or(0, |last| last + 1);
    &samples[from..]
}

/// Mean of a channel during a standstill, and the range of its values; `None` if the channel has no value before the
/// end of the standstill.
fn mean_within(channel: &Channel, standstill: &Standstill, settle_s: f64) -> Option<(f64, f64)> {
    let from = standstill.from_s + settle_s;
    let first = channel.samples.partition_point(|(time, _)| *time < from);
    let end = channel.samples.partition_point(|(time, _)| *time < standstill.to_s);
    let within = channel.samples.get(first..end).unwrap_or_default();
    if within.is_empty() {
        let last = channel.samples.get(end.checked_sub(1)?)?;
        return Some((last.1, 0.0));
    }
    // A configured settling time is used unchanged.
    let read = if settle_s > 0.0 { within } else { at_rest(within) };
    let mean = read.iter().map(|(_, value)| value).sum::<f64>() / read.len() as f64;
    let [low, high] = range(within.iter().map(|(_, value)| *value));
    Some((mean, high - low))
}

/// Run and direction of approach of each target, for targets in the order of travel. The number of a run counts the
/// runs of its direction, from 1.
///
/// A target is approached in the direction of the move towards it. If a target is repeated, its second approach is from
/// the other side, as after an overrun at the end of the travel. A single move back over several targets, after which
/// the axis continues in the first direction, is the return of a unidirectional test. The target of this move begins
/// the next run.
pub(crate) fn runs_by_travel(targets: &[f64]) -> Vec<(u32, Direction)> {
    let directions = directions(targets);
    let mut runs = [0_u32; 2];
    let mut result: Vec<(u32, Direction)> = Vec::with_capacity(targets.len());
    for (index, (direction, begins)) in directions.iter().enumerate() {
        let is_new = index == 0 || *begins || directions[index - 1].0 != *direction;
        let run = &mut runs[usize::from(*direction == Direction::Negative)];
        *run += u32::from(is_new);
        result.push((*run, *direction));
    }
    result
}

/// Direction of each approach, and whether the approach begins a new run in the same direction.
fn directions(targets: &[f64]) -> Vec<(Direction, bool)> {
    let toward = |from: f64, to: f64| {
        if to > from { Direction::Positive } else { Direction::Negative }
    };
    let Some(moved) = targets.windows(2).position(|pair| pair[0] != pair[1]) else {
        return vec![(Direction::Positive, true); targets.len()];
    };
    let first = toward(targets[moved], targets[moved + 1]);
    let mut found: Vec<(Direction, bool)> = (0..=moved)
        .map(|index| match (moved - index) % 2 {
            0 => (first, false),
            _ => (-first, false),
        })
        .collect();
    for index in moved + 1..targets.len() {
        let direction = if targets[index] == targets[index - 1] {
            -found[index - 1].0
        } else {
            toward(targets[index - 1], targets[index])
        };
        found.push((direction, false));
    }
    let mut sorted: Vec<f64> = targets.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.dedup();
    let place = |target: f64| sorted.partition_point(|other| *other < target);
    for index in 1..found.len().saturating_sub(1) {
        let steps = place(targets[index]).abs_diff(place(targets[index - 1]));
        let alone = found[index].0 != found[index - 1].0 && found[index].0 != found[index + 1].0;
        if alone && steps > 1 {
            found[index] = (found[index + 1].0, true);
        }
    }
    found
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

    fn shown(targets: &[f64]) -> String {
        let found = runs_by_travel(targets);
        let one = |(run, direction): &(u32, Direction)| {
            let sign = if *direction == Direction::Positive { '+' } else { '-' };
            format!("{sign}{run}")
        };
        found.iter().map(one).collect::<Vec<_>>().join(" ")
    }

    #[test]
    fn the_order_of_travel_gives_runs_and_directions() {
        // A bidirectional test with an overrun at both ends.
        assert_eq!(
            shown(&[0.0, 1.0, 2.0, 2.0, 1.0, 0.0, 0.0, 1.0, 2.0]),
            "+1 +1 +1 -1 -1 -1 +2 +2 +2"
        );
        // Without an overrun, the last target is approached once.
        assert_eq!(shown(&[0.0, 1.0, 2.0, 1.0, 0.0]), "+1 +1 +1 -1 -1");
        // A unidirectional test whose return is not measured.
        assert_eq!(shown(&[0.0, 1.0, 2.0, 0.0, 1.0, 2.0]), "+1 +1 +1 +2 +2 +2");
        assert_eq!(shown(&[2.0, 1.0, 0.0, 2.0, 1.0, 0.0]), "-1 -1 -1 -2 -2 -2");
        // The first target is repeated, so it is approached from both sides.
        assert_eq!(shown(&[0.0, 0.0, 1.0]), "-1 +1 +1");
        assert_eq!(shown(&[5.0]), "+1");
        assert_eq!(shown(&[]), "");
    }
}
