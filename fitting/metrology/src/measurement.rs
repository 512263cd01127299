//! Readings of one measurement, with their kind of file, units, metadata and environment, as plain data.
//!
//! Also their means at targets, and the error motions that titles and file names state.

use volcomp_document::quoted;
use volcomp_vocabulary::{AxisKind, AxisName, Direction, ErrorName};

use crate::{DeviationUnit, MetrologyError, ReadingUnit, TargetUnit};

/// One reading: the deviation at one target in one run.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Reading {
    /// Target position, mm or deg.
    pub target: f64,
    /// Number of the run, counted from 1 among the runs of its direction.
    pub run: u32,
    /// Direction in which the target was approached.
    pub direction: Direction,
    /// Measured value minus target, µm or µrad (see [`Measurement::unit`]).
    pub deviation: f64,
}

/// Header of a measurement file: what it states about itself, the machine and the test. Texts that
/// are missing or blank are omitted.
#[derive(Debug, Clone, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Metadata {
    /// File type stated in the header: `rtl`, `rta` or `rts`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub format: Option<String>,
    /// Program that wrote the file (Renishaw: `Owner`).
    #[serde(skip_serializing_if = "Option::is_none")]
    pub owner: Option<String>,
    /// Version number of the program or of the format.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub version: Option<String>,
    /// Name of the measured machine.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub machine: Option<String>,
    /// Serial number of the machine.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub serial: Option<String>,
    /// Date of the test, as written in the file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub date: Option<String>,
    /// The person who measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub by: Option<String>,
    /// Measured axis, as written in the file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub axis: Option<String>,
    /// Location of the machine or of the measured line.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub location: Option<String>,
    /// Title of the test.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub title: Option<String>,
}

/// One environmental quantity, at the start and at the end of the test.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct StartEnd {
    /// Value at the start of the test, in the unit of the file.
    pub start: f64,
    /// Value at the end of the test, in the unit of the file.
    pub end: f64,
    /// Code of the unit in the file, if stated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unit_code: Option<i64>,
}

/// Environment during the test, in the file's units (°C, kPa, %, µm/(m·K) in the known files).
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Environment {
    /// Air temperature.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub air_temperature: Option<StartEnd>,
    /// Air pressure.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub air_pressure: Option<StartEnd>,
    /// Relative humidity of the air.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub air_humidity: Option<StartEnd>,
    /// Material temperatures 1 to 3; `None` without a connected sensor (−10.000000 in the file).
    pub material_temperature: [Option<StartEnd>; 3],
    /// Expansion coefficient of the material.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub expansion_coefficient: Option<StartEnd>,
    /// Environment factor: laser wavelength in air, µm / 2.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub environment_factor: Option<StartEnd>,
    /// Start and end time, as written.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub date_time: Option<String>,
}

/// One measurement of one error of one axis, with all readings of all runs.
#[derive(Debug, Clone, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct Measurement {
    /// Name of the source file, for messages.
    pub name: String,
    /// Unit of the deviations after conversion; `None` if the file does not state it (CSV).
    pub unit: Option<DeviationUnit>,
    /// Kind of the source file; `None` for readings built in code.
    #[serde(default)]
    pub format: Option<FileFormat>,
    /// Measured quantity; `None` if the kind of file does not determine it.
    #[serde(default)]
    pub quantity: Option<Quantity>,
    /// Unit of the deviations in the file; `None` if the header of the file does not state it (CSV).
    #[serde(default)]
    pub stated: Option<ReadingUnit>,
    /// Unit of the targets; `None` if the header of the file does not state it (CSV).
    #[serde(default)]
    pub target_unit: Option<TargetUnit>,
    /// Readings in the order of the file.
    pub readings: Vec<Reading>,
    pub metadata: Metadata,
    pub environment: Environment,
    /// Notes for the user on how the file was read.
    pub notes: Vec<String>,
}

impl Measurement {
    /// Distinct targets, mm or deg, ascending.
    pub fn targets(&self) -> Vec<f64> {
        let mut targets: Vec<f64> = self.readings.iter().map(|r| r.target).collect();
        targets.sort_by(f64::total_cmp);
        targets.dedup_by(|a, b| a == b);
        targets
    }

    /// Distinct numbers of the runs in one direction, ascending.
    pub fn runs(&self, direction: Direction) -> Vec<u32> {
        let in_direction = self.readings.iter().filter(|r| r.direction == direction);
        let mut runs: Vec<u32> = in_direction.map(|r| r.run).collect();
        runs.sort_unstable();
        runs.dedup();
        runs
    }

    pub fn most_runs(&self) -> usize {
        let [forward, backward] = Direction::BOTH.map(|direction| self.runs(direction).len());
        forward.max(backward)
    }

    pub fn has(&self, direction: Direction) -> bool {
        self.readings.iter().any(|r| r.direction == direction)
    }

    /// Checks that the targets are in the coordinate unit of an axis. Always succeeds if the file does not state the
    /// unit of the targets.
    ///
    /// # Errors
    /// Targets in deg for a linear axis, or in mm for a rotary axis.
    pub fn check_targets(&self, axis: AxisName) -> Result<(), MetrologyError> {
        let expected = axis.kind().coordinate_unit();
        match self.target_unit {
            Some(found) if found.kind() != axis.kind() => Err(MetrologyError::readings(
                self.name.clone(),
                "the head of the targets",
                format!("`target {}`", found.key()),
                format!("`target` or `target {expected}` for axis {axis}"),
            )),
            _ => Ok(()),
        }
    }

    /// Checks that each target was read in each direction that was measured. If a target lacks a direction, the mean
    /// over both directions jumps there by half of the reversal value.
    ///
    /// # Errors
    ///
    /// The first target that lacks a direction.
    pub fn check_directions(&self) -> Result<(), MetrologyError> {
        for readings in self.by_target() {
            for direction in Direction::BOTH {
                if readings.of(direction).is_empty() && self.has(direction) {
                    return Err(MetrologyError::TargetLacking {
                        name: self.name.clone(),
                        target: readings.target,
                        direction,
                    });
                }
            }
        }
        Ok(())
    }

    /// All deviations at one target in one direction, in the order of the readings.
    pub fn deviations_at(&self, target: f64, direction: Direction) -> Vec<f64> {
        let here = |r: &&Reading| r.target == target && r.direction == direction;
        self.readings.iter().filter(here).map(|r| r.deviation).collect()
    }

    /// Mean of the deviations at one target in one direction (x̄_i↑ or x̄_i↓); `None` without readings.
    pub fn mean_at(&self, target: f64, direction: Direction) -> Option<f64> {
        mean(&self.deviations_at(target, direction))
    }

    /// Distinct targets, ascending, with their means: x̄_i of ISO 230-2 if both directions were measured, else the mean
    /// of the single direction. If some runs lack targets, the runs are aligned.
    pub fn mean_curve(&self) -> Vec<(f64, f64)> {
        let at = |readings: &TargetReadings| {
            let means = Direction::BOTH.map(|direction| mean(&readings.deviations(direction)));
            Some((readings.target, mean(&means.into_iter().flatten().collect::<Vec<_>>())?))
        };
        let readings = by_target(&self.aligned_readings());
        readings.iter().filter_map(at).collect()
    }

    /// Targets and means of one direction, ascending, aligned like [`Self::mean_curve`]. Empty if the direction was not
    /// measured.
    pub fn mean_curve_in(&self, direction: Direction) -> Vec<(f64, f64)> {
        let readings = self.aligned_readings();
        let in_direction = readings.iter().filter(|r| r.direction == direction);
        let mut sorted: Vec<&Reading> = in_direction.collect();
        sorted.sort_by(|a, b| a.target.total_cmp(&b.target).then(a.run.cmp(&b.run)));
        let at = |readings: &[&Reading]| {
            let sum: f64 = readings.iter().map(|r| r.deviation).sum();
            (readings[0].target, sum / readings.len() as f64)
        };
        let groups = sorted.chunk_by(|a, b| a.target == b.target);
        groups.map(at).collect()
    }

    /// Raw readings (no alignment line subtracted), sorted by target, then by run.
    pub(crate) fn by_target(&self) -> Vec<TargetReadings> {
        by_target(&self.readings)
    }
}

fn by_target(readings: &[Reading]) -> Vec<TargetReadings> {
    let mut sorted: Vec<&Reading> = readings.iter().collect();
    sorted.sort_by(|a, b| a.target.total_cmp(&b.target).then(a.run.cmp(&b.run)));
    let of = |readings: &[&Reading], direction| {
        let here = readings.iter().filter(|r| r.direction == direction);
        here.map(|r| (r.run, r.deviation)).collect()
    };
    let groups = sorted.chunk_by(|a, b| a.target == b.target);
    let group = |readings: &[&Reading]| TargetReadings {
        target: readings[0].target,
        forward: of(readings, Direction::Positive),
        backward: of(readings, Direction::Negative),
    };
    groups.map(group).collect()
}

/// All readings at one target, as pairs of run and deviation.
pub(crate) struct TargetReadings {
    pub(crate) target: f64,
    forward: Vec<(u32, f64)>,
    backward: Vec<(u32, f64)>,
}

impl TargetReadings {
    pub(crate) fn of(&self, direction: Direction) -> &[(u32, f64)] {
        match direction {
            Direction::Positive => &self.forward,
            Direction::Negative => &self.backward,
        }
    }

    pub(crate) fn deviations(&self, direction: Direction) -> Vec<f64> {
        self.of(direction).iter().map(|(_, deviation)| *deviation).collect()
    }
}

pub(crate) fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

impl Measurement {
    /// Converts deviations from `unit` to µm or µrad if the file states no unit. If the file states a unit, the
    /// deviations are already converted, and `unit` must be the stated unit.
    ///
    /// # Errors
    /// The unit stated in the file, if it differs from `unit`. The measurement is then unchanged.
    pub fn convert_from(&mut self, unit: ReadingUnit) -> Result<(), ReadingUnit> {
        match self.stated.or(self.unit.map(ReadingUnit::from)) {
            Some(stated) if stated == unit => Ok(()),
            Some(stated) => Err(stated),
            None => {
                for reading in &mut self.readings {
                    reading.deviation *= unit.micro();
                }
                self.unit = Some(unit.deviation_unit());
                Ok(())
            }
        }
    }
}

/// A kind of measurement file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum FileFormat {
    /// Renishaw laser, linear optics (`.rtl`).
    RenishawLinear,
    /// Renishaw laser, angular optics (`.rta`).
    RenishawAngular,
    /// Renishaw laser, straightness optics (`.rts`).
    RenishawStraightness,
    /// Renishaw `.REN`: an export of compensation values.
    RenishawExport,
    /// API laser `.pos`: means over the runs.
    ApiPos,
    /// Text report of a HP, Agilent or Keysight 5529 or 5530: statistics of each target.
    KeysightReport,
    /// Log of EPICS `camonitor`, with readings taken at the standstills of the axis.
    Camonitor,
    /// The plain table `target,run,direction,deviation`.
    Table,
    /// A table with columns assigned by a mapping file.
    MappedTable,
}

impl FileFormat {
    /// Key of the format in documents and scripts.
    pub fn key(self) -> &'static str {
        match self {
            Self::RenishawLinear => "renishaw-linear",
            Self::RenishawAngular => "renishaw-angular",
            Self::RenishawStraightness => "renishaw-straightness",
            Self::RenishawExport => "renishaw-export",
            Self::ApiPos => "api-pos",
            Self::KeysightReport => "keysight-report",
            Self::Camonitor => "camonitor",
            Self::Table => "table",
            Self::MappedTable => "mapped-table",
        }
    }

    /// Instrument or program that writes this format.
    pub fn instrument(self) -> &'static str {
        match self {
            Self::RenishawLinear => "Renishaw laser, linear optics (.rtl)",
            Self::RenishawAngular => "Renishaw laser, angular optics (.rta)",
            Self::RenishawStraightness => "Renishaw laser, straightness optics (.rts)",
            Self::RenishawExport => "compensation values exported for a control (.REN)",
            Self::ApiPos => "API laser, means over the runs (.pos)",
            Self::KeysightReport => "report of a HP, Agilent or Keysight 5529/5530 laser",
            Self::Camonitor => "log of EPICS camonitor",
            Self::Table => "table of readings",
            Self::MappedTable => "table of readings, columns as stated",
        }
    }

    /// Sign convention of the deviations, in words.
    pub fn sign(self) -> &'static str {
        match self {
            Self::RenishawLinear | Self::ApiPos | Self::Camonitor => "measured minus target",
            Self::RenishawAngular => "as the optics were set up; measured minus target",
            Self::RenishawStraightness => "as the optics were set up; not proven by a real file",
            Self::RenishawExport => "not stated: compensation values, not deviations",
            Self::KeysightReport => {
                "laser reading minus machine reading, positive where the axis goes too far"
            }
            Self::Table | Self::MappedTable => {
                "measured minus target, unless the writer meant another"
            }
        }
    }
}

/// Kind of error that the readings of a file represent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Quantity {
    /// Deviation along the axis.
    Positioning,
    /// Deviation across the axis; the file does not state which of the two directions.
    Straightness,
    /// Angular deviation; the file does not state about which of the three axes.
    Angle,
}

impl Quantity {
    pub fn key(self) -> &'static str {
        match self {
            Self::Positioning => "positioning",
            Self::Straightness => "straightness",
            Self::Angle => "angle",
        }
    }
}

/// Kind of an error motion with respect to its axis. It determines the method of measurement and the reference that is
/// removed from the readings.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum MotionKind {
    /// Deviation of the coordinate itself, such as EXX of a linear axis and ECC of a rotary axis.
    Positioning,
    /// Deviation of a linear axis perpendicular to its direction, such as EYX.
    Straightness,
    /// Angular error of a linear axis (EAX), or any error of a rotary axis except positioning (EXC, EAC).
    Other,
}

impl MotionKind {
    /// Kind of an error, by its component and axis. A location error has the kind of the error motion with the same
    /// component.
    pub fn of(error: ErrorName) -> Self {
        let own = error.component.mcs_index() == error.axis.mcs_index();
        match (error.axis.kind(), error.component.is_angular()) {
            (AxisKind::Linear, false) | (AxisKind::Rotary, true) if own => Self::Positioning,
            (AxisKind::Linear, false) => Self::Straightness,
            _ => Self::Other,
        }
    }
}

/// All errors named in a text (title, location or file name), in the order of the words, in upper or lower case. `EYX
/// at Z-150` names EYX. The location error of a squareness may be written `EC0Y` or `EC(0X)Y`.
pub fn errors_named(text: &str) -> Vec<ErrorName> {
    let error = |word: &str| -> Option<ErrorName> {
        let word = word.to_ascii_uppercase();
        // `C0Y` would also parse as an error, but in a title it may be any word.
        word.parse().ok().filter(|_| word.starts_with('E'))
    };
    let words = text.split(|c: char| !(c.is_ascii_alphanumeric() || "()".contains(c)));
    words
        .flat_map(|word| match error(word) {
            Some(error) => vec![error],
            // The name may be in brackets, as in `(EXY)`, or have brackets, as in `exx(1)`.
            None => word.split(['(', ')']).filter_map(error).collect(),
        })
        .collect()
}

/// The error that the title of a file names, if it names only one.
pub fn error_in_title(measurement: &Measurement) -> Option<ErrorName> {
    let mut named = errors_named(measurement.metadata.title.as_deref().unwrap_or_default());
    named.dedup();
    match named[..] {
        [error] => Some(error),
        _ => None,
    }
}

/// The error other than positioning that the title names, such as a straightness, and a message: ISO 230-2 does not
/// evaluate such a file. `None` for angles of a linear axis in µrad, which it evaluates as an angular error motion.
pub fn not_positioning(
    measurement: &Measurement,
    unit: DeviationUnit,
) -> Option<(ErrorName, String)> {
    let error = error_in_title(measurement)?;
    let is_angle = error.component.is_angular() && error.axis.kind() == AxisKind::Linear;
    let what = match MotionKind::of(error) {
        MotionKind::Positioning if !error.location => return None,
        _ if is_angle && unit == DeviationUnit::Urad => return None,
        MotionKind::Straightness if !error.location => "a straightness",
        _ if is_angle => "an angle",
        _ => "no positioning",
    };
    let title = quoted(measurement.metadata.title.as_deref().unwrap_or_default());
    let message =
        format!("found the title {title}, which names {error}, {what}; expected positioning");
    Some((error, message))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn error_names_are_whole_words() {
        for (text, names) in [
            ("EXY straightness, table", "EXY"),
            ("exx(1)-y200", "EXX"),
            ("(EYX) and EC(0X)Y", "EYX EC0Y"),
            ("FLEXYTHING EXQ C0Y, text", ""),
        ] {
            let found: Vec<String> = errors_named(text).iter().map(ToString::to_string).collect();
            assert_eq!(found.join(" "), names, "{text}");
        }
    }
}
