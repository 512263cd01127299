//! Content of a calibration file and of every file that it names, as plain data: lines with their set-up, locations and
//! squareness.

use std::path::PathBuf;

use volcomp_document::{InputError, Section, Value};
use volcomp_identify::Observations;
use volcomp_kinematics::Side;
use volcomp_metrology::{Measurement, ReferenceKind, Rides, TiltReading};
use volcomp_model::{Machine, ModelError, Source};
use volcomp_vocabulary::{AxisName, Component, ErrorName, Urad};

use crate::curve_choice::CurveChoice;

/// A calibration file with the content of every file that it names.
#[derive(Clone, Debug)]
pub struct CalibrationFile {
    /// Paths of the calibration file, its machine file and its measurement files. None of them may be overwritten.
    pub files: Vec<PathBuf>,
    /// Serial number of the machine, if the calibration file states it.
    pub serial: Option<String>,
    /// The machine as stated in its file.
    pub machine: Machine,
    /// Coordinates at which the curves are zero, mm or deg, by index of the axis in the chain; 0
    /// for an axis without a value.
    pub reference: Vec<f64>,
    /// Primary and secondary reference axis. The primary axis has no squareness tilt; the secondary axis has no tilt
    /// about the primary axis.
    pub reference_axes: [AxisName; 2],
    /// Every measured line, in the order of the file.
    pub measurements: Vec<Line>,
    /// Every squareness error, in the order of the file.
    pub squareness: Vec<Squareness>,
    /// Sets of diagonals that determine squareness errors.
    pub diagonals: Vec<Diagonals>,
    /// Every location error that an instrument measured directly, in the order of the file.
    pub locations: Vec<Location>,
    /// Unknowns and observations of the whole machine.
    pub observations: Option<Observations>,
    /// Files of the observations, for the provenance.
    pub observed: Vec<Source>,
    /// Uncertainty contributions that the scatter of the readings does not show.
    pub uncertainty: Uncertainty,
}

/// One measurement: an error along one line.
#[derive(Clone, Debug)]
pub struct Line {
    /// The error, with the method and the location of the measurement.
    pub setup: Setup,
    /// The measurement file, for messages.
    pub file: PathBuf,
    /// Measurement files of the readings, for the provenance: usually one; none for readings without a file, several for readings computed from several
    /// files.
    pub sources: Vec<Source>,
    /// Location in the calibration file, for messages: `calibration.toml:12`.
    pub place: String,
    /// Readings with the sign of the error, µm or µrad; for the angular method the tilts of the bridge.
    pub readings: Measurement,
    /// Kind of curve stated in the file; `None` if it states none.
    pub curve: Option<CurveChoice>,
    /// Kind of reference line that is subtracted from a straightness; the slope of the line is part of the squareness.
    pub reference_line: ReferenceKind,
    /// For a rotary axis: whether the readings were taken relative to the commanded pose, so that
    /// they include the effect of the location errors of the axis; `false` if the instrument was
    /// centred on the axis itself (ISO 230-7).
    pub holds_location: bool,
}

/// A location error measured by an instrument: `EX0C`, `EA0C`, `EC0Y`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Location {
    pub error: ErrorName,
    /// Value, µm or µrad.
    pub value: f64,
    /// The standard uncertainty (k = 1) of the value, µm or µrad.
    pub uncertainty: f64,
}

/// A squareness error, and how the calibration file determines it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Squareness {
    /// EC0Y, EA0Z or EB0Z.
    pub error: ErrorName,
    /// Stated value, slopes or diagonals.
    pub source: SquarenessSource,
}

/// How the value of a squareness is determined.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SquarenessSource {
    Value(Urad),
    /// From the slopes of its two straightness errors, with the angle of their reference.
    Slopes {
        /// φ − π/2, φ the angle between the + directions of the two reference beams.
        reference_angle: Urad,
    },
    /// From body diagonals, [`CalibrationFile::diagonals`].
    Diagonals,
}

/// Standard uncertainties (k = 1) that the scatter of the readings does not show: the table `[uncertainty]` of a
/// calibration file. All are 0 by default.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Uncertainty {
    /// Uncertainty of the laser's scale, including the material temperature, µm/m: common to all positioning lines.
    pub laser_um_per_m: f64,
    /// Uncertainty of the reference angle of each squareness, µrad.
    pub square_urad: f64,
    /// Uncertainty of the mean of linear readings at each target, µm; independent between targets.
    pub reading_um: f64,
    /// Uncertainty of the mean of angular readings at each target, µrad; independent between targets.
    pub reading_urad: f64,
}

impl CalibrationFile {
    /// Coordinate at which the curves of an axis are zero, mm or deg, by index of the axis in the chain.
    pub(crate) fn reference_at(&self, place: usize) -> f64 {
        self.reference.get(place).copied().unwrap_or(0.0)
    }
}

/// Diagonals that determine one to three squareness errors together.
#[derive(Clone, Debug)]
pub struct Diagonals {
    /// The squareness errors that the diagonals determine.
    pub errors: Vec<ErrorName>,
    /// The diagonals as observations. Their unknowns include the offset of each diagonal, and one scale error that
    /// laser, material temperature and machine have in common.
    pub observations: Observations,
    /// Files of the diagonals, for the provenance.
    pub sources: Vec<Source>,
}

/// The measured errors of a file, each once: first the angular errors, which the Abbe correction needs, then the linear ones.
pub(crate) fn measured(file: &CalibrationFile) -> Vec<ErrorName> {
    let mut names: Vec<ErrorName> = file.measurements.iter().map(|l| l.setup.error).collect();
    names.sort_unstable_by_key(|name| (!name.component.is_angular(), *name));
    names.dedup();
    names
}

pub(crate) fn lines_of(file: &CalibrationFile, error: ErrorName) -> impl Iterator<Item = &Line> {
    let lines = file.measurements.iter();
    lines.filter(move |line| line.setup.error == error)
}

/// The machine of a calibration file with the location errors stated in the file. A stated tilt of a squareness is the whole squareness, so the
/// tilt of the other axis is set to zero.
pub(crate) fn located(file: &CalibrationFile) -> Result<Machine, ModelError> {
    let mut machine = file.machine.clone();
    for location in &file.locations {
        if is_square(location.error) {
            let value = Urad(location.value);
            set_square(&mut machine, file.reference_axes, location.error, value)?;
        } else {
            machine.set_location(location.error, location.value)?;
        }
    }
    Ok(machine)
}

/// Set-up of one error measured along one line.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// Measured error.
    pub error: ErrorName,
    /// Position of every axis, mm or deg, by index in the chain; the measured axis is at 0. An axis without a value is at 0.
    pub at: Vec<f64>,
    /// Measured point m, mm in MCS with the measured axis at 0; `None`: the point at which the axis's errors are stated.
    pub point_mcs: Option<[f64; 3]>,
    /// Whether the measured point moves with the carriage of the axis.
    pub rides: Rides,
    /// Conversion of the readings to the error.
    pub method: Method,
    /// −1 if the instrument gives the motion of the workpiece-side component, else 1.
    pub sign: f64,
}

/// Conversion of readings to the error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Method {
    /// The readings are the error itself.
    Direct,
    /// Tilts of a bridge, summed to a straightness.
    Angular {
        /// Foot spacing of the bridge, mm.
        bridge_mm: f64,
        /// Sign convention of a tilt.
        reading: TiltReading,
    },
}

impl Setup {
    /// Whether the measured point belongs to the tool side of the machine, for an axis that carries
    /// `side`.
    pub fn point_is_on_tool_side(&self, side: Side) -> bool {
        (side == Side::Tool) == (self.rides == Rides::Carriage)
    }

    /// Whether the readings are angles: of an angular error, or of a bridge.
    pub fn reads_angles(&self) -> bool {
        self.error.component.is_angular() || self.method != Method::Direct
    }
}

impl Setup {
    /// Keys of a `[[measurement]]` that [`Setup::decode`] reads, in addition to the key that names the error.
    pub const KEYS: [&str; 7] = ["at", "point", "rides", "sign", "method", "bridge_mm", "reading"];

    /// Decodes the set-up of `error` from a `[[measurement]]` of a calibration file or shop file.
    ///
    /// # Errors
    /// An axis that the machine does not have, or an invalid word or number.
    pub fn decode(
        section: &Section<'_>,
        error: ErrorName,
        machine: &Machine,
    ) -> Result<Self, InputError> {
        let mut at = vec![0.0; machine.axes().len()];
        if let Some(held) = section.section("at")? {
            if let Some(own) = held.get(&error.axis.to_string()) {
                let message =
                    format!("{} is the measured axis, expected the other axes only", error.axis);
                return Err(own.error(message));
            }
            set_coordinates(&mut at, &held, machine)?;
        }
        Ok(Self {
            error,
            at,
            point_mcs: section.get("point").map(|value| value.vector()).transpose()?,
            rides: section.one_of(
                "rides",
                &[("carriage", Rides::Carriage), ("other", Rides::Other)],
                Rides::Carriage,
            )?,
            method: decode_method(section)?,
            sign: decode_sign(section)?,
        })
    }

    /// Formats the keys of a `[[measurement]]` that decode to this set-up, one per line.
    pub fn to_toml(&self, machine: &Machine) -> String {
        let mut lines = vec![format!("error = \"{}\"", self.error)];
        let held: Vec<String> = machine
            .axes()
            .iter()
            .zip(&self.at)
            .filter(|(_, coordinate)| **coordinate != 0.0)
            .map(|(axis, coordinate)| format!("{} = {coordinate:?}", axis.name))
            .collect();
        if !held.is_empty() {
            lines.push(format!("at = {{ {} }}", held.join(", ")));
        }
        if let Some(point) = self.point_mcs {
            lines.push(format!("point = {point:?}"));
        }
        if self.rides == Rides::Other {
            lines.push("rides = \"other\"".to_owned());
        }
        if self.sign < 0.0 {
            lines.push("sign = -1".to_owned());
        }
        if let Method::Angular { bridge_mm, reading } = self.method {
            lines.push(format!("method = \"angular\"\nbridge_mm = {bridge_mm:?}"));
            if reading == TiltReading::Slope {
                lines.push("reading = \"slope\"".to_owned());
            }
        }
        lines.join("\n") + "\n"
    }
}

/// Assigns coordinates by axis letter, mm or deg, to the indices of the axes in the chain. A coordinate outside the
/// travel of its axis is rejected: it would give a wrong lever arm, or set the zero of a curve outside its readings.
pub(crate) fn set_coordinates(
    coordinates: &mut [f64],
    section: &Section<'_>,
    machine: &Machine,
) -> Result<(), InputError> {
    for (key, value) in section.values() {
        let place = machine.axes().iter().position(|axis| axis.name.to_string() == key);
        let structure = machine.chain().structure();
        let place = place
            .ok_or_else(|| value.error(format!("the structure `{structure}` has no axis {key}")))?;
        let found = value.number()?;
        let stands = machine.axes()[place].check_coordinate(found);
        stands.map_err(|message| value.error(message))?;
        coordinates[place] = found;
    }
    Ok(())
}

/// Decodes the errors that a table names by `error` or by `errors`, and passes each value and error to `check`.
/// `missing` returns the message for a table without both keys.
pub(crate) fn decode_errors(
    section: &Section<'_>,
    machine: &Machine,
    missing: impl FnOnce() -> InputError,
    check: impl Fn(&Value<'_>, ErrorName) -> Result<(), InputError>,
) -> Result<Vec<ErrorName>, InputError> {
    let names = match (section.get("error"), section.get("errors")) {
        (Some(one), None) => vec![one],
        (None, Some(several)) => several.items()?,
        (Some(_), Some(both)) => {
            return Err(both.error("found `error` and `errors` together, expected one of them"));
        }
        (None, None) => return Err(missing()),
    };
    let mut errors = Vec::new();
    for name in &names {
        let error = machine.decode_error(name)?;
        check(name, error)?;
        if errors.contains(&error) {
            return Err(name.error(format!("{error} appears twice")));
        }
        errors.push(error);
    }
    if errors.is_empty() {
        return Err(section.error("found no error in `errors`, expected at least one"));
    }
    Ok(errors)
}

/// Decodes the name of an error motion of an axis that the machine has.
///
/// # Errors
/// A text that is not an error name or names a location error, or an axis that the machine does not have.
pub fn decode_motion(value: &Value<'_>, machine: &Machine) -> Result<ErrorName, InputError> {
    let error = machine.decode_error(value)?;
    if error.location {
        let message =
            format!("found {error}, expected an error motion E?N; squareness has its own table");
        return Err(value.error(message));
    }
    Ok(error)
}

pub(crate) fn decode_sign(section: &Section<'_>) -> Result<f64, InputError> {
    let Some(value) = section.get("sign") else {
        return Ok(1.0);
    };
    let sign = value.number()?;
    if sign.abs() == 1.0 {
        Ok(sign)
    } else {
        Err(value.error(format!("found {sign}, expected 1 or -1")))
    }
}

fn decode_method(section: &Section<'_>) -> Result<Method, InputError> {
    if !section.one_of("method", &[("direct", false), ("angular", true)], false)? {
        for key in ["bridge_mm", "reading"] {
            if let Some(value) = section.get(key) {
                return Err(value.error("expected only with method = \"angular\""));
            }
        }
        return Ok(Method::Direct);
    }
    let bridge = section.require("bridge_mm")?;
    let bridge_mm = bridge.number()?;
    if bridge_mm <= 0.0 {
        return Err(bridge.error(format!("found {bridge_mm}, expected a positive length")));
    }
    let words = [("right-hand", TiltReading::RightHand), ("slope", TiltReading::Slope)];
    Ok(Method::Angular {
        bridge_mm,
        reading: section.one_of("reading", &words, TiltReading::RightHand)?,
    })
}

/// Sets a squareness as the tilt of one axis of its pair, and sets the tilt of the other axis to zero. The axis without
/// tilt is the primary reference axis if it belongs to the pair, else the secondary reference axis.
pub(crate) fn set_square(
    machine: &mut Machine,
    reference_axes: [AxisName; 2],
    error: ErrorName,
    value: Urad,
) -> Result<(), ModelError> {
    let (tilt, sign) = tilt_of(error, reference_axes);
    for name in [error, partner_tilt(error)] {
        let value = if name == tilt { sign * value.0 } else { 0.0 };
        // A zero tilt is set only to replace a value of the machine file.
        if value != 0.0 || name == error || machine.locations().contains_key(&name) {
            machine.set_location(name, value)?;
        }
    }
    Ok(())
}

/// The tilt by which a machine with these reference axes states a squareness, and its sign relative
/// to the squareness.
pub(crate) fn tilt_of(squareness: ErrorName, reference_axes: [AxisName; 2]) -> (ErrorName, f64) {
    if reference_of(reference_axes, squareness) == partner_of(squareness) {
        (squareness, 1.0)
    } else {
        (partner_tilt(squareness), -1.0)
    }
}

/// Tilt of the partner axis of a squareness about the same direction.
fn partner_tilt(squareness: ErrorName) -> ErrorName {
    ErrorName::location(squareness.component, partner_of(squareness))
}

/// The axis of a squareness that has no tilt: the primary reference axis if it belongs to the pair, else the secondary
/// reference axis.
pub(crate) fn reference_of([primary, secondary]: [AxisName; 2], squareness: ErrorName) -> AxisName {
    if [squareness.axis, partner_of(squareness)].contains(&primary) { primary } else { secondary }
}

/// The other axis of a squareness: the linear axis that is neither the axis in its name nor parallel to its axis of
/// rotation.
pub(crate) fn partner_of(squareness: ErrorName) -> AxisName {
    let is_partner = |axis: &AxisName| {
        let index = axis.mcs_index();
        index != squareness.axis.mcs_index() && index != squareness.component.mcs_index()
    };
    let primary = [AxisName::X, AxisName::Y, AxisName::Z];
    // A name that is not a squareness may have no partner; the callers reject such names.
    primary.into_iter().find(is_partner).unwrap_or(squareness.axis)
}

/// Whether a location error is one of the tilts of X, Y and Z that form their squareness.
pub fn is_square(error: ErrorName) -> bool {
    volcomp_metrology::opening(error).is_some()
}

/// Name of the squareness that a tilt of X, Y or Z belongs to, the same for both tilts of a pair: `EC0X` and `EC0Y`
/// give `EC0Y`. Every other error is returned unchanged.
pub(crate) fn square_of(error: ErrorName) -> ErrorName {
    if !is_square(error) {
        return error;
    }
    let axis = match error.component {
        Component::EC => AxisName::Y,
        _ => AxisName::Z,
    };
    ErrorName::location(error.component, axis)
}
