//! The calibration file: which error each measurement file holds, along which line.

use std::path::{Path, PathBuf};

use volcomp_document::{Document, InputError, Section, Value};
use volcomp_metrology::{DeviationUnit, Measurement, read_file, squareness_parts};
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisName, ErrorName};

use crate::{
    curve_choice::CurveChoice,
    error::CalibrateError,
    setup::{SETUP_KEYS, Setup, decode_error, decode_motion, set_coordinates},
    uncertainty::Uncertainty,
};

/// A calibration file with everything it names read.
#[derive(Clone, Debug)]
pub struct CalibrationFile {
    /// The machine as its file states it.
    pub machine: Machine,
    /// Coordinates at which curves are zero, mm or deg, by the place of the axis in the chain.
    pub reference: Vec<f64>,
    /// Primary and secondary reference axis: the primary has no tilt, the secondary none about the
    /// primary.
    pub reference_axes: [AxisName; 2],
    /// The measurements.
    pub measurements: Vec<Line>,
    /// The squareness errors.
    pub squareness: Vec<Squareness>,
    /// What the scatter of the readings does not show.
    pub uncertainty: Uncertainty,
}

/// One measurement: an error along one line.
#[derive(Clone, Debug)]
pub struct Line {
    /// The error and how it was measured.
    pub setup: Setup,
    /// The measurement file.
    pub file: PathBuf,
    /// Its readings, in the sign of the error, µm or µrad; of the bridge for the angular method.
    pub readings: Measurement,
    /// The kind of curve wanted, where stated.
    pub curve: Option<CurveChoice>,
}

/// A squareness error and where it comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Squareness {
    /// EC0Y, EA0Z or EB0Z.
    pub error: ErrorName,
    /// Its value or the angle of its reference.
    pub source: SquarenessSource,
}

/// Where a squareness value comes from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SquarenessSource {
    /// Given, µrad.
    Value(f64),
    /// From the slopes of the two straightness errors and φ − π/2 of the reference, µrad.
    Slopes {
        /// φ − π/2, µrad.
        reference_angle_urad: f64,
    },
}

impl CalibrationFile {
    /// Reads a calibration file, its machine file and its measurement files.
    ///
    /// # Errors
    /// What is wrong, with file, line and key.
    pub fn read(path: &Path) -> Result<Self, CalibrateError> {
        let folder = path.parent().unwrap_or(Path::new(""));
        Document::read(path)?.decode(|root| decode(&root, folder))
    }
}

fn decode(root: &Section<'_>, folder: &Path) -> Result<CalibrationFile, CalibrateError> {
    root.allow(&[
        "machine",
        "reference",
        "reference_axes",
        "measurement",
        "squareness",
        "uncertainty",
    ])?;
    let machine = Machine::read(&folder.join(root.require("machine")?.text()?))?;
    let mut reference: Vec<f64> = machine
        .axes()
        .iter()
        .map(|axis| nearest_zero(axis.travel))
        .collect();
    if let Some(section) = root.section("reference")? {
        set_coordinates(&mut reference, &section, &machine)?;
    }
    let items = |key: &str| {
        root.get(key)
            .map_or_else(|| Ok(Vec::new()), |value| value.items())
    };
    let mut measurements: Vec<Line> = Vec::new();
    for item in items("measurement")? {
        let section = item.section()?;
        let line = decode_line(&section, &machine, folder)?;
        check_same_curve(&measurements, &line, &section)?;
        measurements.push(line);
    }
    let mut squareness: Vec<Squareness> = Vec::new();
    for item in items("squareness")? {
        let found = decode_squareness(&item.section()?, &machine)?;
        if squareness.iter().any(|other| other.error == found.error) {
            return Err(item.error(format!("{} stands twice", found.error)).into());
        }
        squareness.push(found);
    }
    Ok(CalibrationFile {
        reference_axes: decode_reference_axes(root)?,
        machine,
        reference,
        measurements,
        squareness,
        uncertainty: match root.section("uncertainty")? {
            Some(section) => Uncertainty::decode(&section)?,
            None => Uncertainty::default(),
        },
    })
}

/// 0, or the travel end nearest to it.
fn nearest_zero([low, high]: [f64; 2]) -> f64 {
    0.0_f64.clamp(low, high)
}

fn decode_reference_axes(root: &Section<'_>) -> Result<[AxisName; 2], InputError> {
    const LINEAR: [AxisName; 3] = [AxisName::X, AxisName::Y, AxisName::Z];
    let Some(value) = root.get("reference_axes") else {
        return Ok([AxisName::X, AxisName::Y]);
    };
    let letters = value.texts()?;
    let axes: Vec<AxisName> = letters
        .iter()
        .filter_map(|letter| LINEAR.into_iter().find(|axis| axis.to_string() == *letter))
        .collect();
    match axes[..] {
        [primary, secondary] if letters.len() == 2 && primary != secondary => {
            Ok([primary, secondary])
        }
        _ => Err(value.error(format!("found {letters:?}, expected two of X, Y, Z"))),
    }
}

fn decode_line(
    section: &Section<'_>,
    machine: &Machine,
    folder: &Path,
) -> Result<Line, CalibrateError> {
    let keys = [&["error", "file", "unit", "curve"][..], &SETUP_KEYS].concat();
    section.allow(&keys)?;
    let error = decode_motion(&section.require("error")?, machine)?;
    let setup = Setup::decode(section, error, machine)?;
    let file_value = section.require("file")?;
    let file = folder.join(file_value.text()?);
    let mut readings = read_file(&file)?;
    tracing::debug!(
        "{error}: {} readings from {}",
        readings.readings.len(),
        file.display()
    );
    let factor = setup.sign * unit_factor(section, &file_value, &readings, setup.reads_angles())?;
    for reading in &mut readings.readings {
        reading.deviation *= factor;
    }
    Ok(Line {
        setup,
        file,
        readings,
        curve: section
            .get("curve")
            .map(|value| CurveChoice::decode(&value, error.axis))
            .transpose()?,
    })
}

/// Several lines of one error make one curve, so they cannot ask for different kinds of it.
fn check_same_curve(before: &[Line], line: &Line, section: &Section<'_>) -> Result<(), InputError> {
    let error = line.setup.error;
    let earlier = before
        .iter()
        .find(|other| other.setup.error == error && other.curve.is_some());
    match (earlier, section.get("curve")) {
        (Some(earlier), Some(value)) if earlier.curve != line.curve => Err(value.error(format!(
            "another kind of curve for {error} than with {}, expected the same for all lines of an error",
            earlier.file.display()
        ))),
        _ => Ok(()),
    }
}

/// µm or µrad for one unit of the readings as `read_file` gives them.
fn unit_factor(
    section: &Section<'_>,
    file: &Value<'_>,
    readings: &Measurement,
    angular: bool,
) -> Result<f64, InputError> {
    const LINEAR: [(&str, f64); 2] = [("um", 1.0), ("mm", 1e3)];
    const ANGULAR: [(&str, f64); 4] = [
        ("urad", 1.0),
        ("mrad", 1e3),
        ("arcsec", 1e6 * core::f64::consts::PI / 648_000.0),
        ("deg", 1e6 * core::f64::consts::PI / 180.0),
    ];
    if let Some(unit) = section.get("unit") {
        return unit.one_of(if angular { &ANGULAR[..] } else { &LINEAR });
    }
    match (readings.unit, angular) {
        (Some(DeviationUnit::Um), true) => Err(file.error(
            "the file holds lengths, expected angles: check `error`, or state `unit`",
        )),
        (Some(DeviationUnit::Urad), false) => Err(file.error(
            "the file holds angles, expected lengths: check `error`, or state `method = \"angular\"`",
        )),
        _ => Ok(1.0),
    }
}

fn decode_squareness(
    section: &Section<'_>,
    machine: &Machine,
) -> Result<Squareness, CalibrateError> {
    section.allow(&["error", "from", "reference_angle_urad", "value_urad"])?;
    let error_value = section.require("error")?;
    let error = decode_error(&error_value, machine)?;
    let parts =
        squareness_parts(&error.to_string()).map_err(|e| error_value.error(e.to_string()))?;
    if let Some(from) = section.get("from") {
        let mut found = from.texts()?;
        let mut expected = parts.to_vec();
        found.sort_unstable();
        expected.sort_unstable();
        if found != expected {
            return Err(from
                .error(format!("found {found:?}, expected {parts:?} for {error}"))
                .into());
        }
    }
    let source = match (
        section.get("value_urad"),
        section.get("reference_angle_urad"),
    ) {
        (Some(value), None) => SquarenessSource::Value(value.number()?),
        (Some(value), Some(_)) => {
            let message =
                "found value_urad and reference_angle_urad together, expected one of them";
            return Err(value.error(message).into());
        }
        (None, angle) => SquarenessSource::Slopes {
            reference_angle_urad: angle.map_or(Ok(0.0), |value| value.number())?,
        },
    };
    Ok(Squareness { error, source })
}
