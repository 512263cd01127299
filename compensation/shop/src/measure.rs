//! Simulates the measurement lines of a virtual shop and generates their measurement files.

use std::collections::BTreeMap;
use std::fmt::Write;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use volcomp_calibrate::{ArtefactPoses, HOLDS_LOCATION, LineOfSight, Method, location_seen};
use volcomp_document::toml_string;
use volcomp_kinematics::{ErrorMotion, ErrorSource, State};
use volcomp_metrology::{
    DeviationUnit, Environment, Measurement, Metadata, MotionKind, Quantity, StartEnd, TiltReading,
    squareness_parts, tilt_sign, write_csv, write_keysight_report, write_pos, write_renishaw,
};
use volcomp_model::{Axis, Temperatures};
use volcomp_vocabulary::{AxisName, Direction, ErrorName, Urad};

use crate::error::{InstrumentError, ShopError};
use crate::instrument::bridge_targets;
use crate::shop::{Format, Header, Shop, ShopLine, ShopLocation};

/// Number of the first random stream of location errors, separate from the streams of lines and observations.
const FIRST_LOCATION: u64 = 1 << 33;

impl Shop {
    /// Makes all files, each with its name: the machine without errors; the measurements and `calibration.toml`, unless there are only observations;
    /// the observations and `observations.toml`, if there are any. `progress` receives the number of finished lines and observations and their
    /// total number.
    ///
    /// # Errors
    /// A line that does not fit the machine, an observation that cannot be made.
    pub fn files(
        &self,
        mut progress: impl FnMut(usize, usize),
    ) -> Result<Vec<(String, String)>, ShopError> {
        for line in &self.lines {
            line.instrument
                .check()
                .map_err(|source| ShopError::Instrument { error: line.setup.error, source })?;
        }
        for observation in &self.observations {
            observation.check().map_err(|source| ShopError::Observation {
                name: observation.name.clone(),
                source: Box::new(source),
            })?;
        }
        self.check_size()?;
        let alignments = self.alignments();
        // Without rotary axes the set-up is a rigid motion of the workpiece, which does not affect
        // any reading.
        let turns = self.truth.axes().iter().any(|axis| axis.name.is_rotary());
        let set_up = turns.then(|| self.set_up());
        let mut machine = self.truth.clone();
        machine.clear_errors();
        let mut files = vec![("machine.toml".to_owned(), machine.to_toml())];
        let mut calibration = String::from("machine = \"machine.toml\"\n");
        for (index, line) in self.lines.iter().enumerate() {
            let alignment = alignments.get(&line.setup.error).copied();
            let measurement =
                self.measure(index, line, alignment.unwrap_or_default(), set_up.as_ref())?;
            let (name, text) = self.measurement_file(line, &measurement);
            let setup = line.setup.to_toml(&self.truth);
            let file = toml_string(&name);
            let _ = write!(calibration, "\n[[measurement]]\n{setup}file = {file}\n");
            if let Some(curve) = line.curve {
                let _ = writeln!(calibration, "curve = {}", curve.to_toml());
            }
            if !line.holds_location {
                let _ = writeln!(calibration, "{HOLDS_LOCATION} = false");
            }
            files.push((name, text));
            progress(index + 1, self.count());
        }
        for (error, angle) in &self.squareness {
            let _ = write!(
                calibration,
                "\n[[squareness]]\nerror = \"{error}\"\nreference_angle_urad = {:?}\n",
                angle.0
            );
        }
        for (index, location) in self.locations.iter().enumerate() {
            calibration.push_str(&self.read_location(index, location)?);
        }
        if self.has_calibration() {
            files.push(("calibration.toml".to_owned(), calibration));
        }
        let mut done = self.lines.len();
        files.extend(self.observe(|| {
            done += 1;
            progress(done, self.count());
        })?);
        Ok(files)
    }

    /// Names of the [`files`](Self::files), without generating them.
    pub fn file_names(&self) -> Vec<String> {
        let mut names = vec!["machine.toml".to_owned()];
        names.extend(self.lines.iter().map(ShopLine::file_name));
        if self.has_calibration() {
            names.push("calibration.toml".to_owned());
        }
        for observation in &self.observations {
            names.extend(observation.file_names().iter().map(|name| format!("{name}.csv")));
        }
        if !self.observations.is_empty() {
            names.push("observations.toml".to_owned());
        }
        names
    }

    /// Whether there is a calibration file: if there is something to calibrate, or if there are no observations.
    pub(crate) fn has_calibration(&self) -> bool {
        !self.lines.is_empty()
            || !self.squareness.is_empty()
            || !self.locations.is_empty()
            || self.observations.is_empty()
    }

    /// Table of a location error in the calibration file: its value with noise, and its standard uncertainty.
    fn read_location(&self, index: usize, location: &ShopLocation) -> Result<String, ShopError> {
        let error = location.error;
        let mut random = ChaCha8Rng::seed_from_u64(self.seed);
        random.set_stream(FIRST_LOCATION + index as u64);
        let share: f64 = StandardNormal.sample(&mut random);
        let (reference, axes) = self.reference();
        let seen = location_seen(&self.truth, error.axis, &reference, axes, |error| {
            self.targets_of(error)
        })?;
        let place = error.component.mcs_index();
        let value = if error.component.is_angular() {
            seen.angular_rad[place] * 1e6
        } else {
            seen.linear_mm[place] * 1e3
        };
        // Rounding to a millionth of a µm or µrad removes the rounding errors of the pose computation.
        let value = (value * 1e6).round() / 1e6;
        let read = value + location.noise * share;
        let unit = error.component.unit();
        let uncertainty = if location.noise > 0.0 {
            format!("uncertainty_{unit} = {:?}\n", location.noise)
        } else {
            String::new()
        };
        Ok(format!("\n[[location]]\nerror = \"{error}\"\nvalue_{unit} = {read:?}\n{uncertainty}"))
    }

    /// Number of lines and observations.
    pub fn count(&self) -> usize {
        self.lines.len() + self.observations.len()
    }

    /// Slope of each straightness reference relative to its axis. The two beams of a squareness measurement enclose the angle φ of its reference,
    /// so their slopes add up to φ − π/2.
    fn alignments(&self) -> BTreeMap<ErrorName, Urad> {
        let mut alignments = BTreeMap::new();
        for (index, line) in self.lines.iter().enumerate() {
            if MotionKind::of(line.setup.error) == MotionKind::Straightness {
                let mut random = self.random(2 * index + 1);
                let share: f64 = StandardNormal.sample(&mut random);
                alignments.entry(line.setup.error).or_insert(line.instrument.alignment * share);
            }
        }
        for (error, angle) in &self.squareness {
            if let Ok([first, second]) = squareness_parts(*error)
                && let Some(slope) = alignments.get(&first).copied()
            {
                alignments.insert(second, *angle - slope);
            }
        }
        alignments
    }

    /// Coordinates of all axes at which artefacts are set up, and the axes along which they are aligned.
    fn reference(&self) -> (Vec<f64>, [AxisName; 2]) {
        let axes = self.truth.axes().iter();
        (axes.map(Axis::nearest_zero).collect(), [AxisName::X, AxisName::Y])
    }

    /// Targets of a straightness measurement, mm; `None` if the error is not measured.
    fn targets_of(&self, error: ErrorName) -> Option<Vec<f64>> {
        let line = self.lines.iter().find(|line| line.setup.error == error)?;
        let travel = self.truth.axis(error.axis)?.travel;
        Some(match line.setup.method {
            Method::Direct => line.instrument.targets_over(travel),
            Method::Angular { bridge_mm, .. } => bridge_targets(travel, bridge_mm),
        })
    }

    /// Set-up of the artefacts along the reference lines of the straightness measurements, by default over 21 targets.
    fn set_up(&self) -> ArtefactPoses {
        let (reference, axes) = self.reference();
        ArtefactPoses::of(&self.truth, &reference, axes, |error| self.targets_of(error))
    }

    /// Creates a separate random generator for each line, so that an additional line does not change the others.
    fn random(&self, stream: usize) -> ChaCha8Rng {
        let mut random = ChaCha8Rng::seed_from_u64(self.seed);
        random.set_stream(stream as u64);
        random
    }

    /// Readings of the instrument along a line, µm or µrad. `alignment` is the slope of its straightness reference, `index` selects the
    /// random stream.
    fn measure(
        &self,
        index: usize,
        line: &ShopLine,
        alignment: Urad,
        set_up: Option<&ArtefactPoses>,
    ) -> Result<Measurement, ShopError> {
        let error = line.setup.error;
        let sight = LineOfSight::new(&self.truth, &line.setup)?;
        let sight = match set_up {
            Some(set_up) if line.holds_location => sight.with_artefacts(set_up),
            _ => sight,
        };
        let none = Temperatures::new();
        let whole = self.truth.source(&none);
        let errors = Seen { of: &whole, only: (!line.holds_location).then_some(sight.axis()) };
        let travel = self.truth.axis(error.axis).map(|a| a.travel);
        let travel = travel.unwrap_or_default();
        let joint = self.truth.chain().joints()[self.truth.index_of(error.axis)?];
        let along_mcs = joint.direction[error.axis.mcs_index()].signum();
        let slope_urad = alignment.0 * along_mcs + sight.reference_slope_urad(&errors);
        let perfect = |target: f64, direction: Direction| {
            let state = sight.state(target, direction);
            sight.reading(&errors, &state, &state) + slope_urad * 1e-3 * (target - travel[0])
        };
        let mut random = self.random(2 * index);
        let sign = line.setup.sign;
        Ok(match line.setup.method {
            Method::Direct => {
                let unit =
                    if line.setup.reads_angles() { DeviationUnit::Urad } else { DeviationUnit::Um };
                let targets = line.instrument.targets_over(travel);
                let zero = perfect(travel[0], Direction::Positive);
                let reading = |target, direction| sign * (perfect(target, direction) - zero);
                line.instrument.run(&targets, unit, reading, &mut random)
            }
            Method::Angular { bridge_mm, reading } => {
                let mut sigma = tilt_sign(error, reading)
                    .map_err(|source| ShopError::Method { error, source })?;
                if reading == TiltReading::RightHand {
                    sigma *= along_mcs;
                }
                let tilt = |target: f64, direction| {
                    if target - bridge_mm < travel[0] - 1e-9 {
                        return 0.0;
                    }
                    let rise = perfect(target, direction) - perfect(target - bridge_mm, direction);
                    sign * sigma * rise / bridge_mm * 1e3
                };
                let refused = |source| ShopError::Instrument { error, source };
                if !(bridge_mm.is_finite() && bridge_mm > 0.0) {
                    return Err(refused(InstrumentError::Number {
                        what: "bridge",
                        found: bridge_mm,
                        expected: "a positive length in mm",
                    }));
                }
                let targets = bridge_targets(travel, bridge_mm);
                line.instrument.check_count(targets.len()).map_err(refused)?;
                line.instrument.run(&targets, DeviationUnit::Urad, tilt, &mut random)
            }
        })
    }
}

/// Error source as an instrument measures it: all errors, or only the error motions of the axis `only` on which it
/// is centred.
struct Seen<S> {
    of: S,
    only: Option<usize>,
}

impl<S: ErrorSource> Seen<S> {
    fn sees(&self, axis: usize) -> bool {
        self.only.is_none_or(|only| only == axis)
    }
}

impl<S: ErrorSource> ErrorSource for Seen<S> {
    fn error_motion(&self, axis: usize, state: &State) -> ErrorMotion {
        if self.sees(axis) { self.of.error_motion(axis, state) } else { ErrorMotion::ZERO }
    }

    fn location(&self, axis: usize) -> ErrorMotion {
        if self.only.is_none() { self.of.location(axis) } else { ErrorMotion::ZERO }
    }

    fn assembly(&self, axis: usize) -> ErrorMotion {
        if self.only.is_none() { self.of.assembly(axis) } else { ErrorMotion::ZERO }
    }
}

impl Format {
    pub(crate) const NAMES: [(&'static str, Self); 4] = [
        ("renishaw", Self::Renishaw),
        ("csv", Self::Csv),
        ("api-pos", Self::ApiPos),
        ("keysight-report", Self::KeysightReport),
    ];

    /// File extension of a format, for angles or lengths, with or without straightness optics.
    fn ending(self, holds_angles: bool, straightness: bool) -> &'static str {
        match (self, holds_angles, straightness) {
            (Self::Csv, ..) => "csv",
            (Self::ApiPos, ..) => "pos",
            (Self::KeysightReport, ..) => "txt",
            (Self::Renishaw, true, _) => "rta",
            (Self::Renishaw, false, true) => "rts",
            (Self::Renishaw, false, false) => "rtl",
        }
    }

    /// Reason why a line cannot be written in this format; `None` if it can.
    pub(crate) fn refuses(self, line: &ShopLine) -> Option<&'static str> {
        match self {
            Self::ApiPos if line.setup.reads_angles() => {
                Some("`api-pos` holds lengths, expected another format for angles")
            }
            Self::KeysightReport if !line.instrument.both_directions => Some(
                "`keysight-report` holds both directions in each row, expected `both_directions = true`",
            ),
            _ => None,
        }
    }
}

impl Header {
    fn environment(&self) -> Environment {
        let constant = |value: Option<f64>, unit_code| {
            value.map(|value| StartEnd { start: value, end: value, unit_code })
        };
        Environment {
            air_temperature: constant(self.air_degc, Some(0)),
            material_temperature: [constant(self.material_degc, Some(0)), None, None],
            expansion_coefficient: constant(self.expansion_um_per_m_k, None),
            ..Environment::default()
        }
    }
}

impl ShopLine {
    fn file_name(&self) -> String {
        let straightness = MotionKind::of(self.setup.error) == MotionKind::Straightness;
        let ending = self.format.ending(self.setup.reads_angles(), straightness);
        format!("{}.{ending}", self.name)
    }
}

impl Shop {
    fn measurement_file(&self, line: &ShopLine, measurement: &Measurement) -> (String, String) {
        let header = &self.header;
        let error = line.setup.error;
        let holds_angles = measurement.unit == Some(DeviationUnit::Urad);
        let straightness = MotionKind::of(error) == MotionKind::Straightness && !holds_angles;
        let described = Measurement {
            quantity: straightness.then_some(Quantity::Straightness),
            metadata: Metadata {
                machine: Some(self.truth.name.clone()),
                axis: Some(error.axis.to_string()),
                title: Some(error.to_string()),
                date: header.date.clone(),
                by: header.by.clone(),
                serial: header.serial.clone(),
                location: header.location.clone(),
                ..Metadata::default()
            },
            environment: header.environment(),
            ..measurement.clone()
        };
        let text = match line.format {
            Format::Csv => write_csv(&described),
            Format::Renishaw => write_renishaw(&described),
            Format::ApiPos => write_pos(&described),
            Format::KeysightReport => write_keysight_report(&described),
        };
        (line.file_name(), text)
    }
}
