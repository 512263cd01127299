//! Plausibility checks of measurement lines and of values in the calibration file.
//!
//! The functions `refuse*` reject; the others return messages.

use std::collections::BTreeMap;

use volcomp_document::{InputError, Value, quoted};
use volcomp_fit::unevenness;
use volcomp_kinematics::MotionFrame;
use volcomp_metrology::{
    KnownReadings, LARGEST_PLAUSIBLE, Measurement, Metadata, MotionKind, Reading, ReferenceLine,
    SMALLEST_PLAUSIBLE, axis_named, errors_named,
};
use volcomp_model::{Axis, Machine, ModelError};
use volcomp_vocabulary::{AxisKind, Component, Direction, Displacement, ErrorName, Urad};

use crate::calibration_file::{CalibrationFile, Line, Method, Setup, SquarenessSource};
use crate::line_of_sight::Lever;
use crate::profile::{Points, Profile};

const TIMES_NOISE: f64 = 3.0;
/// Differences up to this value are insignificant for any machine tool, µm or µrad.
const NEVER_BELOW: f64 = 0.5;
/// Minimum noise of an instrument, µm or µrad.
const LEAST_NOISE: f64 = 0.01;

pub(crate) struct Tilts<'a> {
    pub(crate) machine: &'a Machine,
    /// Standard deviation of each tilt at a target, µrad. Tilts without a value are treated as
    /// exact.
    pub(crate) noise_urad: &'a BTreeMap<ErrorName, f64>,
    /// See `Angular::found_from`.
    pub(crate) found_from: &'a BTreeMap<ErrorName, [Points; 2]>,
}

/// Notes on the lines of an error that disagree beyond their noise, after the contributions of tilts and locations are removed. `tilts` is `None` if
/// no tilt acts on the error.
pub(crate) fn contradictions(
    error: ErrorName,
    cleared: &[Profile<'_>],
    tilts: Option<&Tilts<'_>>,
) -> Result<Vec<(ErrorName, String)>, ModelError> {
    let mut notes = Vec::new();
    for (second, line_2) in cleared.iter().enumerate() {
        for line_1 in cleared.iter().take(second) {
            let note = contradiction(error, [line_1, line_2], tilts)?;
            notes.extend(note.map(|note| (error, note)));
        }
    }
    Ok(notes)
}

fn contradiction(
    error: ErrorName,
    cleared: [&Profile<'_>; 2],
    tilts: Option<&Tilts<'_>>,
) -> Result<Option<String>, ModelError> {
    let is_straightness = MotionKind::of(error) == MotionKind::Straightness;
    let Some(beside) = ParallelReadings::of(&cleared, is_straightness) else {
        return Ok(None);
    };
    let pairs = beside.lines[0].iter().zip(&beside.lines[1]);
    let difference: Vec<f64> = pairs.map(|(first, second)| first - second).collect();
    let Some(noise) = noise(cleared, &beside) else {
        return Ok(None);
    };
    let of_tilts = tilts.map_or(Ok(0.0), |tilts| tilts.noise_um(error, cleared, &beside))?;
    let noise = noise.hypot(of_tilts).max(LEAST_NOISE);
    let rms = (difference.iter().map(|d| d * d).sum::<f64>() / difference.len() as f64).sqrt();
    let largest = difference.iter().fold(0.0_f64, |largest, d| largest.max(d.abs()));
    if rms <= TIMES_NOISE * noise || largest <= NEVER_BELOW {
        return Ok(None);
    }
    let unit = error.component.symbol();
    let [first, second] = cleared.map(|profile| profile.line.file.display().to_string());
    Ok(Some(format!(
        "{error}: {first} and {second} contradict each other by up to ±{largest:.1} {unit}, RMS {rms:.1} {unit}, which is {:.0} times their noise of {noise:.2} {unit}: check the files, and their `point`, `at`, `unit` and `sign`",
        rms / noise
    )))
}

impl Tilts<'_> {
    /// Contribution of the noise of the tilts to the difference of two lines, µm: RMS over the
    /// targets of each tilt's noise times the difference of the lines' lever arms.
    fn noise_um(
        &self,
        error: ErrorName,
        lines: [&Profile<'_>; 2],
        beside: &ParallelReadings,
    ) -> Result<f64, ModelError> {
        let [first, second] = lines.map(|profile| Lever::new(profile.line, self.machine));
        let (first, second) = (first?, second?);
        let angular = Component::ALL.into_iter().filter(|c| c.is_angular());
        let noise_urad: Vec<f64> = angular
            .map(|component| {
                let tilt = ErrorName::motion(component, error.axis);
                self.noise_urad.get(&tilt).copied().unwrap_or_default()
            })
            .collect();
        let mut variance = 0.0;
        for (_, target) in &beside.places {
            let [at_first, at_second] = [&first, &second].map(|lever| lever.um_of_mrad(*target));
            for (about, noise_urad) in noise_urad.iter().enumerate() {
                let um_of_urad = (at_first[about] - at_second[about]) * 1e-3;
                variance += (um_of_urad * noise_urad).powi(2);
            }
        }
        Ok((variance / beside.places.len().max(1) as f64).sqrt())
    }
}

/// Standard deviation of the mean of the lines of one error at a target: from repeated runs, otherwise from the
/// unevenness of each line between targets, which is an upper bound. `None` if the noise of one line is unknown.
pub(crate) fn noise_of_lines(profiles: &[Profile<'_>]) -> Option<f64> {
    let mut variance = 0.0;
    for profile in profiles {
        let uneven = || profile.unevenness();
        variance += profile.noise_of_shape().or_else(uneven)?.powi(2);
    }
    (!profiles.is_empty()).then(|| variance.sqrt() / profiles.len() as f64)
}

/// Standard deviation of the difference of two lines: from repeated runs, otherwise from the
/// unevenness of each line between targets, which also covers the error of interpolated targets.
fn noise(profiles: [&Profile<'_>; 2], beside: &ParallelReadings) -> Option<f64> {
    let mut variance = 0.0;
    for (profile, values) in profiles.iter().zip(&beside.lines) {
        let points = beside.places.iter().zip(values);
        // Each direction is evaluated separately: between the end of one direction and the beginning of the other
        // direction, a value jumps by the total slope.
        let uneven = Direction::BOTH.into_iter().filter_map(|direction| {
            let own = points.clone().filter(|((of, _), _)| *of == direction);
            unevenness(&own.map(|((_, at), value)| (*at, *value)).collect::<Vec<_>>())
        });
        let uneven = uneven.reduce(f64::max);
        let own = match profile.noise_of_shape() {
            Some(noise) if !beside.is_interpolated => noise,
            Some(noise) => noise.max(uneven?),
            None => uneven?,
        };
        variance += own * own;
    }
    Some(variance.sqrt())
}

/// Mean readings of parallel lines at their common targets, offset removed (and, for straightness, the fitted slope).
pub(crate) struct ParallelReadings {
    /// Direction of travel and target of each place, mm or deg.
    pub(crate) places: Vec<(Direction, f64)>,
    /// Values of each line, by place, µm or µrad.
    pub(crate) lines: Vec<Vec<f64>>,
    is_interpolated: bool,
}

impl ParallelReadings {
    /// `None` if the lines have fewer than three targets in common or no common direction.
    pub(crate) fn of(profiles: &[&Profile<'_>], is_straightness: bool) -> Option<Self> {
        let mut side_by_side = Self {
            places: Vec::new(),
            lines: vec![Vec::new(); profiles.len()],
            is_interpolated: false,
        };
        for (branch, direction) in Direction::BOTH.into_iter().enumerate() {
            let points = || profiles.iter().map(|profile| &profile.points[branch]);
            if points().any(Vec::is_empty) {
                continue;
            }
            let firsts = points().filter_map(|points| points.first());
            let from = firsts.map(|(q, _)| *q).fold(f64::NEG_INFINITY, f64::max);
            let lasts = points().filter_map(|points| points.last());
            let to = lasts.map(|(q, _)| *q).fold(f64::INFINITY, f64::min);
            let all = points().flatten().map(|(target, _)| *target);
            let mut targets: Vec<f64> = all.filter(|q| (from..=to).contains(q)).collect();
            targets.sort_by(f64::total_cmp);
            targets.dedup();
            for target in targets {
                side_by_side.places.push((direction, target));
                for (values, points) in side_by_side.lines.iter_mut().zip(points()) {
                    let (value, is_between) = value_at(points, target);
                    values.push(value);
                    side_by_side.is_interpolated |= is_between;
                }
            }
        }
        if side_by_side.places.len() < 3 {
            return None;
        }
        for line in 0..side_by_side.lines.len() {
            let values = std::mem::take(&mut side_by_side.lines[line]);
            side_by_side.lines[line] = side_by_side.without_zero(values, is_straightness);
        }
        Some(side_by_side)
    }

    /// Subtracts from the values of a line their mean, or for straightness their least-squares line.
    fn without_zero(&self, values: Vec<f64>, is_straightness: bool) -> Vec<f64> {
        let targets = self.places.iter().map(|(_, target)| *target);
        let points: Vec<(f64, f64)> = targets.zip(values.iter().copied()).collect();
        if is_straightness && let Ok(line) = ReferenceLine::least_squares(&points) {
            return line.removed_from(&points).into_iter().map(|(_, value)| value).collect();
        }
        let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
        values.into_iter().map(|value| value - mean).collect()
    }
}

/// Value of a profile at a target within its range, and whether the value is linearly interpolated between two targets
/// of the profile.
fn value_at(points: &[(f64, f64)], target: f64) -> (f64, bool) {
    let after = points.partition_point(|(q, _)| *q < target);
    match (points.get(after.wrapping_sub(1)), points.get(after)) {
        (_, Some((q, value))) if *q == target => (*value, false),
        (Some((q_0, x_0)), Some((q_1, x_1))) => {
            (x_0 + (x_1 - x_0) * (target - q_0) / (q_1 - q_0), true)
        }
        (Some((_, value)), None) | (None, Some((_, value))) => (*value, true),
        (None, None) => (0.0, true),
    }
}

/// Maximum error of a machine tool: 100 mm and 100 mrad, in µm and µrad.
pub(crate) const NEVER_ABOVE: f64 = 1e5;
/// Maximum variation of an angular error over the travel of a machine tool: 5 mrad, in µrad. Arc seconds read as mrad exceed it.
const ANGLE_NEVER_VARIES: f64 = 5e3;
/// Rejects a line of an error motion that rotates with its axis: an instrument that does not rotate
/// measures a mixture of two such error motions. Only error motions along and about the axis itself
/// are equal in both frames. `name` is the value that names the error.
pub(crate) fn refuse_turning(
    name: &Value<'_>,
    error: ErrorName,
    machine: &Machine,
) -> Result<(), InputError> {
    let turns =
        machine.axis(error.axis).is_some_and(|axis| axis.motion_frame == MotionFrame::Turning);
    let is_along = error.component.mcs_index() == error.axis.mcs_index();
    if !turns || is_along {
        return Ok(());
    }
    Err(name.error(format!(
        "found {error}, and `motion_frame = \"turning\"` of {} in the machine file: instruments show error motions in the frame that does not turn, expected `motion_frame = \"fixed\"`",
        error.axis
    )))
}

/// Rejects a line whose readings would count twice or belong to another error. `file` is the value that names its file.
/// Rejected are:
///
/// * A file that another line of the same error already names.
/// * A second file for the same error and line, with the same targets in the same direction. The operator must select
///   one file, because the mean of two tests is the result of neither. Files that continue where another ends, or
///   contain the other direction, are one test.
/// * The file of another error, read in the same way. Angles of a bridge may be read twice: as angular error and,
///   summed, as straightness.
pub(crate) fn refuse_twice(
    before: &[Line],
    line: &Line,
    file: &Value<'_>,
) -> Result<(), InputError> {
    let error = line.setup.error;
    let named = quoted(file.text()?);
    // Both files existed when they were read. A file that no longer exists is compared by its stated path.
    let path = |line: &Line| line.file.canonicalize().unwrap_or(line.file.clone());
    let name = |line: &Line| {
        let name = line.file.file_name().unwrap_or_default();
        name.display().to_string()
    };
    let is_same_file = |other: &&Line| other.setup.error == error && path(other) == path(line);
    if let Some(other) = before.iter().find(is_same_file) {
        return Err(file.error(format!(
            "found {named}, which {} names for {error} already, expected each file once for an error: its readings would count twice",
            other.place
        )));
    }
    let is_same_line = |other: &&Line| {
        (error, &other.setup.at, other.setup.point_mcs)
            == (other.setup.error, &line.setup.at, line.setup.point_mcs)
            && other.setup.method == line.setup.method
            && (covers(&other.readings, &line.readings) || covers(&line.readings, &other.readings))
    };
    if let Some(other) = before.iter().find(is_same_line) {
        return Err(file.error(format!(
            "found {named}, and {:?} ({}) measures {error} along the same line already, with the same `at` and `point`: two tests are not averaged, expected one of the files, or different places",
            name(other),
            other.place
        )));
    }
    let is_direct = |line: &Line| line.setup.method == Method::Direct;
    let is_of_another = |other: &&Line| {
        other.file == line.file && other.setup.error != error && is_direct(other) == is_direct(line)
    };
    if let Some(other) = before.iter().find(is_of_another) {
        return Err(file.error(format!(
            "found {:?}, which is the file of {} at {}, expected that of {error}",
            name(line),
            other.setup.error,
            other.place
        )));
    }
    Ok(())
}

/// Whether more than half of the readings of `other` lie in the range that `one` covers in the same direction.
fn covers(one: &Measurement, other: &Measurement) -> bool {
    let span = |direction| {
        let readings = one.readings.iter().filter(|of| of.direction == direction);
        readings.fold(None, |span: Option<[f64; 2]>, of| {
            let [low, high] = span.unwrap_or([of.target; 2]);
            Some([low.min(of.target), high.max(of.target)])
        })
    };
    let spans = Direction::BOTH.map(|direction| (direction, span(direction)));
    let is_covered = |of: &&Reading| {
        spans.iter().any(|(direction, span)| {
            *direction == of.direction
                && span.is_some_and(|[low, high]| (low..=high).contains(&of.target))
        })
    };
    let covered = other.readings.iter().filter(is_covered).count();
    2 * covered > other.readings.len()
}

/// Rejects readings (µm or µrad) that cannot belong to this line: they are of another axis of the
/// machine, none of them is within the travel, or their size indicates a wrong unit. `file` is the
/// value that names the file.
pub(crate) fn refuse(
    file: &Value<'_>,
    setup: &Setup,
    readings: &Measurement,
    machine: &Machine,
) -> Result<(), InputError> {
    let error = setup.error;
    let stated = readings.metadata.axis.as_deref().and_then(axis_named);
    if let Some(other) = stated.filter(|axis| *axis != error.axis && machine.axis(*axis).is_some())
    {
        return Err(file.error(format!(
            "the file states that axis {other} was measured, expected {}, the axis of {error}",
            error.axis
        )));
    }
    let sizes = readings.readings.iter().map(|reading| reading.deviation);
    let largest = sizes.fold(0.0_f64, |largest, size| largest.max(size.abs()));
    if largest > NEVER_ABOVE {
        let unit = if setup.reads_angles() { "mrad" } else { "mm" };
        return Err(file.error(format!(
            "found a deviation of {:.0} {unit}, expected less than 100 {unit}: check the unit of the file, or state `unit`",
            largest * 1e-3
        )));
    }
    if error.component.is_angular() {
        let angles = || readings.readings.iter().map(|reading| reading.deviation);
        let highest = angles().fold(f64::NEG_INFINITY, f64::max);
        let varies = highest - angles().fold(f64::INFINITY, f64::min);
        if varies > ANGLE_NEVER_VARIES {
            return Err(file.error(format!(
                "found angles that vary by {:.1} mrad, expected less than {:.0} mrad: are they in another unit? arcsec, urad, mrad and deg are read; state `unit`, or write it into the header of the file",
                varies * 1e-3,
                ANGLE_NEVER_VARIES * 1e-3
            )));
        }
    }
    let Some(axis) = machine.axis(error.axis) else {
        return Ok(());
    };
    let [low, high] = axis.travel;
    let mut targets = readings.readings.iter().map(|reading| reading.target);
    if let Some([first, last]) = ends(readings)
        && !targets.any(|target| axis.may_stand_at(target))
    {
        let unit = error.axis.kind().coordinate_unit();
        return Err(file.error(format!(
            "found targets from {first} to {last} {unit}, expected some within the travel of {}, {low} to {high} {unit}",
            error.axis
        )));
    }
    Ok(())
}

/// Rejects a stated value (µm or µrad) whose size indicates a wrong unit.
pub(crate) fn refuse_value(
    value: &Value<'_>,
    kind: AxisKind,
    micro: f64,
) -> Result<(), InputError> {
    if micro.abs() <= NEVER_ABOVE {
        return Ok(());
    }
    let unit = match kind {
        AxisKind::Linear => "mm",
        AxisKind::Rotary => "mrad",
    };
    Err(value.error(format!(
        "found {:.0} {unit}, expected less than 100 {unit}: check its unit",
        micro * 1e-3
    )))
}

/// Whether two names or serial numbers denote one machine; case and surrounding blanks are ignored.
fn is_same_name(one: &str, other: &str) -> bool {
    one.trim().eq_ignore_ascii_case(other.trim())
}

pub(crate) fn other_machine(readings: &Measurement, machine: &Machine) -> Option<String> {
    let known = machine.name.trim();
    let stated = readings.metadata.machine.as_deref()?.trim();
    let is_other = !stated.is_empty() && !known.is_empty() && !is_same_name(stated, known);
    is_other.then(|| {
        format!(
            "it states the machine `{stated}`, and the machine file is of `{known}`: is it the right machine?"
        )
    })
}

/// Notes on measurement files that state different machines or serial numbers; each file comes with its name.
pub fn different_machines(files: &[(String, &Metadata)]) -> Vec<String> {
    let mut notes = Vec::new();
    for (what, is_serial) in [("machines", false), ("serial numbers", true)] {
        let mut found: Vec<(&str, &str)> = Vec::new();
        for (file, metadata) in files {
            let text = if is_serial { &metadata.serial } else { &metadata.machine };
            let text = text.as_deref().unwrap_or_default().trim();
            if !text.is_empty() && !found.iter().any(|(known, _)| is_same_name(known, text)) {
                found.push((text, file));
            }
        }
        if found.len() > 1 {
            let each = found.iter().map(|(text, file)| format!("`{text}` ({file})"));
            let each: Vec<String> = each.collect();
            let each = each.join(", ");
            notes.push(format!("the measurement files state different {what}: {each}"));
        }
    }
    notes
}

pub(crate) fn files_of(lines: &[Line]) -> Vec<(String, &Metadata)> {
    let file = |line: &Line| line.file.display().to_string();
    let lines = lines.iter();
    lines.map(|line| (file(line), &line.readings.metadata)).collect()
}

/// Rejects a file that states another serial number than the calibration file. `file` is the value that names the file.
pub(crate) fn refuse_serial(
    file: &Value<'_>,
    readings: &Measurement,
    serial: Option<&str>,
) -> Result<(), InputError> {
    let stated = readings.metadata.serial.as_deref().map(str::trim);
    match (stated.filter(|stated| !stated.is_empty()), serial) {
        (Some(stated), Some(expected)) if !is_same_name(stated, expected) => {
            Err(file.error(format!(
                "the file states the serial number `{stated}`, expected `{expected}`, the `serial` of this calibration file"
            )))
        }
        _ => Ok(()),
    }
}

/// Notes on files with the same readings under two names: no two tests have the same scatter.
pub(crate) fn same_readings(lines: &[Line]) -> Vec<String> {
    let mut seen = KnownReadings::default();
    let mut notes = Vec::new();
    for line in lines {
        // The same file may be read for two errors.
        let other: Option<&&Line> = seen.before(&line.readings, line);
        if let Some(other) = other.filter(|other| other.file != line.file) {
            notes.push(format!(
                "{} ({}) has the same readings as {} ({}): is it one test under two names? No two tests scatter alike",
                line.file.display(),
                line.setup.error,
                other.file.display(),
                other.setup.error
            ));
        }
    }
    notes
}

/// Minimum fraction of the travel that a line covers without a note.
const SHORT_BELOW: f64 = 0.5;
/// Maximum distance of a target beyond the end of the travel, as a fraction of the travel, without a note: targets may
/// be slightly outside because of the overrun.
const BEYOND_ABOVE: f64 = 0.02;

pub(crate) fn ends(readings: &Measurement) -> Option<[f64; 2]> {
    let targets = readings.readings.iter().map(|reading| reading.target);
    targets.fold(None, |ends, target| {
        let [first, last] = ends.unwrap_or([target; 2]);
        Some([target.min(first), target.max(last)])
    })
}

/// Notes on stated location and squareness errors, and on uncertainties of location errors, whose
/// size indicates a wrong unit.
pub(crate) fn odd_values(file: &CalibrationFile) -> Vec<String> {
    let stated = Stated::all(file);
    let note = |of: &Stated, what: &str, micro: f64| {
        let size = Displacement::from_micro(of.error.component.kind(), micro);
        let Stated { table, error, .. } = of;
        format!(
            "{error} in [[{table}]]: {what}{size:.0} is large for a machine tool: check its unit"
        )
    };
    let values = stated.iter().filter(|of| of.value.abs() > LARGEST_PLAUSIBLE);
    let values = values.map(|of| note(of, "", of.value));
    let unsure = (stated.iter())
        .filter(|of| of.table == "location" && of.uncertainty > LARGEST_PLAUSIBLE)
        .map(|of| note(of, "a standard uncertainty of ", of.uncertainty));
    values.chain(unsure).collect()
}

pub(crate) fn beyond_travel(readings: &Measurement, axis: &Axis) -> Option<String> {
    let [first, last] = ends(readings)?;
    let [low, high] = axis.travel;
    let beyond = (low - first).max(last - high);
    let unit = axis.name.kind().coordinate_unit();
    (axis.modulo.is_none() && beyond > BEYOND_ABOVE * (high - low)).then(|| {
        format!(
            "targets from {first} to {last} {unit} go beyond the travel of {}, {low} to {high} {unit}: is it the right axis and machine?",
            axis.name
        )
    })
}

/// Largest deviation of a line, µm or µrad, after removing the alignment of the instrument: the line of a straightness, the mean tilt of a bridge.
fn largest_deviation(line: &Line) -> Option<f64> {
    let largest = |values: &mut dyn Iterator<Item = f64>| {
        values.fold(0.0_f64, |largest, value| largest.max(value.abs()))
    };
    if MotionKind::of(line.setup.error) != MotionKind::Straightness {
        let readings = line.readings.readings.iter();
        return Some(largest(&mut readings.map(|reading| reading.deviation)));
    }
    let points = line.readings.mean_curve();
    if line.setup.reads_angles() {
        let mean = points.iter().map(|p| p.1).sum::<f64>() / points.len() as f64;
        return Some(largest(&mut points.iter().map(|p| p.1 - mean)));
    }
    let reference = ReferenceLine::least_squares(&points).ok()?;
    let left = reference.removed_from(&points);
    Some(largest(&mut left.iter().map(|p| p.1)))
}

/// Notes on anomalies of a line that is not rejected.
pub(crate) fn odd(line: &Line, machine: &Machine) -> Vec<String> {
    let error = line.setup.error;
    let mut notes = Vec::new();
    let mut note = |text: String| {
        notes.push(format!("{} ({}): {text}", line.file.display(), line.place));
    };
    let (Some([first, last]), Some(axis)) = (ends(&line.readings), machine.axis(error.axis)) else {
        return notes;
    };
    let [low, high] = axis.travel;
    let unit = error.axis.kind().coordinate_unit();
    let travel = high - low;
    if let Some(said) = beyond_travel(&line.readings, axis) {
        note(said);
    }
    if last - first < SHORT_BELOW * travel {
        note(format!(
            "targets from {first} to {last} {unit} cover {:.0} % of the travel of {}: beyond them {error} keeps its end values",
            100.0 * (last - first) / travel,
            error.axis
        ));
    }
    let state_unit = if line.readings.unit.is_none() { ", or state `unit`" } else { "" };
    if let Some(largest) = largest_deviation(line).filter(|largest| *largest > LARGEST_PLAUSIBLE) {
        let kind = if line.setup.reads_angles() { AxisKind::Rotary } else { AxisKind::Linear };
        let size = Displacement::from_micro(kind, largest);
        note(format!(
            "a deviation of {size:.0} is large for a machine tool: check the unit of the file{state_unit}"
        ));
    }
    if let Some(said) = other_machine(&line.readings, machine) {
        note(said);
    }
    if let Some(other) = named_in_title(line) {
        note(format!(
            "the title of the file names {other}, expected {error}: is it the right file?"
        ));
    }
    let sizes = line.readings.readings.iter().map(|r| r.deviation.abs());
    let largest = sizes.fold(0.0, f64::max);
    if line.readings.unit.is_none() && largest > 0.0 && largest < SMALLEST_PLAUSIBLE {
        let (taken, perhaps) =
            if line.setup.reads_angles() { ("µrad", "mrad") } else { ("µm", "mm") };
        note(format!(
            "the unit of the deviations is not stated, taken as {taken}; all are below {SMALLEST_PLAUSIBLE} {taken}: are they {perhaps}? State `unit`"
        ));
    }
    notes
}

/// First error named in the title of the file, if the title does not name the error of the line.
fn named_in_title(line: &Line) -> Option<ErrorName> {
    let title = line.readings.metadata.title.as_deref()?;
    let names = errors_named(title);
    let other = *names.first()?;
    (!names.contains(&line.setup.error)).then_some(other)
}

/// Note on lines without a `point` although tilts of their axis are known: the lever arm may have been forgotten.
pub(crate) fn without_point(lines: &[Line], tilted: &Machine) -> Option<String> {
    let named = |line: &Line| {
        let error = line.setup.error;
        if error.component.is_angular() || line.setup.point_mcs.is_some() {
            return None;
        }
        let angular = Component::ALL.into_iter().filter(|c| c.is_angular());
        let tilts = angular.map(|component| ErrorName::motion(component, error.axis));
        let tilts: Vec<String> = tilts
            .filter(|tilt| tilted.error(*tilt).is_some())
            .map(|tilt| tilt.to_string())
            .collect();
        (!tilts.is_empty()).then(|| {
            format!("{} ({}): {error} with {}", line.file.display(), line.place, tilts.join(" "))
        })
    };
    let lines: Vec<String> = lines.iter().filter_map(named).collect();
    (!lines.is_empty()).then(|| {
        format!(
            "no `point` is stated for the lines below, so each error is taken as measured at the point of its axis, and the levers of the tilts named beside it are taken from there; state `point` where a line ran elsewhere: {}",
            lines.join("; ")
        )
    })
}

/// Location or squareness error stated in a calibration file, µm or µrad, with its standard uncertainty.
pub(crate) struct Stated {
    pub(crate) table: &'static str,
    pub(crate) place: usize,
    pub(crate) error: ErrorName,
    pub(crate) value: f64,
    pub(crate) uncertainty: f64,
}

impl Stated {
    pub(crate) fn all(file: &CalibrationFile) -> Vec<Self> {
        let locations = file.locations.iter().enumerate();
        let locations = locations.map(|(place, of)| Self {
            table: "location",
            place,
            error: of.error,
            value: of.value,
            uncertainty: of.uncertainty,
        });
        let squareness = file.squareness.iter().enumerate();
        let squareness = squareness.filter_map(|(place, of)| match of.source {
            SquarenessSource::Value(value) => Some(Self {
                table: "squareness",
                place,
                error: of.error,
                value: value.0,
                uncertainty: file.uncertainty.square_urad,
            }),
            SquarenessSource::Slopes { .. } | SquarenessSource::Diagonals => None,
        });
        locations.chain(squareness).collect()
    }

    pub(crate) fn changed(&self, file: &CalibrationFile, step: f64) -> CalibrationFile {
        let mut other = file.clone();
        if self.table == "location" {
            other.locations[self.place].value += step;
        } else {
            let value = SquarenessSource::Value(Urad(self.value + step));
            other.squareness[self.place].source = value;
        }
        other
    }
}

/// Merges pairs of file name and sentence: each sentence occurs once, in the order of first occurrence, after the names
/// of all files that it concerns.
pub fn with_files(notes: impl IntoIterator<Item = (String, String)>) -> Vec<String> {
    let mut by_note: Vec<(String, Vec<String>)> = Vec::new();
    for (file, note) in notes {
        match by_note.iter_mut().find(|(text, _)| *text == note) {
            Some((_, files)) if files.contains(&file) => {}
            Some((_, files)) => files.push(file),
            None => by_note.push((note, vec![file])),
        }
    }
    let text = |(note, files): (String, Vec<String>)| format!("{}: {note}", files.join(", "));
    by_note.into_iter().map(text).collect()
}
