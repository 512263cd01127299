//! Readings from a log of channels: the value of the instrument at each standstill of the axis.

use crate::camonitor::{Channel, ChannelLog};
use crate::number::range;
use crate::travel::runs_by_travel;
use crate::{FileFormat, Measurement, Metadata, MetrologyError, Reading, ReadingUnit};

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
