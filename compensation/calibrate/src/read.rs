//! Reads a calibration file, its machine file and its measurement files.

use std::path::Path;

use volcomp_document::{Document, FileKind, InputError, Section, Value};
use volcomp_identify::Observations;
use volcomp_metrology::{
    Columns, DeviationUnit, FileFormat, Mapping, Measurement, MotionKind, Quantity, ReadingUnit,
    ReferenceKind,
};
use volcomp_model::{Axis, Machine, Source};
use volcomp_vocabulary::{AxisName, Direction, ErrorName};

use crate::calibration_file::{
    CalibrationFile, Diagonals, Line, Location, Method, Setup, Squareness, Uncertainty,
    decode_motion, set_coordinates, square_of,
};
use crate::checks::{refuse, refuse_serial, refuse_turning, refuse_twice};
use crate::curve_choice::CurveChoice;
use crate::error::CalibrateError;
use crate::proposal::refuse_open;
use crate::tables::{
    Direct, decode_location, decode_observations, decode_squareness, read_measurement, sources_of,
    standard_uncertainty,
};

impl CalibrationFile {
    /// Keys at the root of a calibration file, in addition to [`Observations::KEYS`], which are also allowed.
    pub const KEYS: [&'static str; 9] = [
        "machine",
        "columns",
        "serial",
        "reference",
        "reference_axes",
        "measurement",
        "squareness",
        "location",
        "uncertainty",
    ];

    /// Reads a calibration file, its machine file and its measurement files.
    ///
    /// # Errors
    /// An unreadable file or an invalid entry, with file, line and key.
    pub fn read(path: &Path) -> Result<Self, CalibrateError> {
        let folder = path.parent().unwrap_or(Path::new(""));
        let mut file = Document::read(path)?.decode(|root| decode(&root, folder))?;
        file.files.insert(0, path.to_owned());
        Ok(file)
    }
}

fn decode(root: &Section<'_>, folder: &Path) -> Result<CalibrationFile, CalibrateError> {
    let keys = [&CalibrationFile::KEYS[..], &Observations::KEYS].concat();
    root.allow_in(FileKind::Calibration, &keys)?;
    refuse_open(root)?;
    let machine_file = folder.join(root.require("machine")?.text()?);
    let machine = Machine::read(&machine_file)?;
    let mut reference: Vec<f64> = machine.axes().iter().map(Axis::nearest_zero).collect();
    if let Some(section) = root.section("reference")? {
        set_coordinates(&mut reference, &section, &machine)?;
    }
    let serial = root.get("serial").map(|value| value.text()).transpose()?;
    let reference_axes = decode_reference_axes(root)?;
    let items = |key: &str| root.get(key).map_or_else(|| Ok(Vec::new()), |value| value.items());
    let columns = root.section("columns")?;
    let columns = columns.map(|section| Columns::decode(&section)).transpose()?;
    let common = CommonKeys { folder, serial, columns: columns.map(Mapping::Columns) };
    let mut measurements: Vec<Line> = Vec::new();
    for item in items("measurement")? {
        let section = item.section()?;
        let line = decode_line(&section, &machine, &common)?;
        check_same_curve(&measurements, &line, &section)?;
        refuse_twice(&measurements, &line, &section.require("file")?)?;
        measurements.push(line);
    }
    let mut squareness: Vec<Squareness> = Vec::new();
    let mut diagonals = Vec::new();
    for item in items("squareness")? {
        let section = item.section()?;
        for found in decode_squareness(&section, &machine, reference_axes, folder, &mut diagonals)?
        {
            if squareness.iter().any(|other| other.error == found.error) {
                return Err(item.error(format!("{} appears twice", found.error)).into());
            }
            squareness.push(found);
        }
    }
    let mut locations: Vec<Location> = Vec::new();
    for item in items("location")? {
        let section = item.section()?;
        for found in decode_location(&section, &machine, reference_axes)? {
            check_once(&item, found.error, &locations, &squareness)?;
            locations.push(found);
        }
    }
    let direct =
        Direct { measurements: &measurements, squareness: &squareness, locations: &locations };
    let observations = decode_observations(root, &machine, folder, &direct)?;
    let observed = observations.as_ref().map_or(&[][..], |o| &o.files);
    let observed = sources_of(folder, observed)?;
    let mut files = vec![machine_file];
    files.extend(measurements.iter().map(|line| line.file.clone()));
    files.extend(diagonals.iter().flat_map(|d: &Diagonals| d.observations.files.iter().cloned()));
    files.extend(observations.iter().flat_map(|o| o.files.iter().cloned()));
    Ok(CalibrationFile {
        files,
        serial: serial.map(str::to_owned),
        reference_axes,
        machine,
        reference,
        measurements,
        squareness,
        diagonals,
        locations,
        observations,
        observed,
        uncertainty: match root.section("uncertainty")? {
            Some(section) => decode_uncertainty(&section)?,
            None => Uncertainty::default(),
        },
    })
}

fn check_once(
    item: &Value<'_>,
    error: ErrorName,
    locations: &[Location],
    squareness: &[Squareness],
) -> Result<(), InputError> {
    if locations.iter().any(|other| other.error == error) {
        return Err(item.error(format!("{error} is in two [[location]] tables")));
    }
    let square = square_of(error);
    if squareness.iter().any(|other| other.error == square) {
        return Err(item.error(format!(
            "{error} is in [[location]], and [[squareness]] states {square}: expected one of them"
        )));
    }
    Ok(())
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

/// Key of [`decode_holds_location`].
pub const HOLDS_LOCATION: &str = "holds_location";

/// Decodes whether a line of a rotary axis was measured relative to the commanded pose, so that its readings contain
/// the contributions of the location errors of the axis. Default: true.
///
/// # Errors
/// A value that is not a boolean, or the key on a line of a linear axis.
pub fn decode_holds_location(section: &Section<'_>, error: ErrorName) -> Result<bool, InputError> {
    let value = section.get(HOLDS_LOCATION);
    if let Some(value) = value.filter(|_| !error.axis.is_rotary()) {
        return Err(value
            .error(format!("found it for {error}, expected it for errors of a rotary axis only")));
    }
    section.truth_or(HOLDS_LOCATION, true)
}

struct CommonKeys<'a> {
    folder: &'a Path,
    serial: Option<&'a str>,
    columns: Option<Mapping>,
}

fn refuse_unstated_export(
    section: &Section<'_>,
    file: &Value<'_>,
    readings: &Measurement,
) -> Result<(), InputError> {
    let is_stated = ["unit", "sign"].iter().all(|key| section.get(key).is_some());
    if readings.format != Some(FileFormat::RenishawExport) || is_stated {
        return Ok(());
    }
    Err(file.error(
        "the file holds compensation values for a control, not readings: expected `unit`, and `sign` (-1 where the values are what is added to the command)",
    ))
}

fn decode_line(
    section: &Section<'_>,
    machine: &Machine,
    common: &CommonKeys<'_>,
) -> Result<Line, CalibrateError> {
    let own =
        ["columns", "channels", "error", "file", "unit", "curve", "reference_line", HOLDS_LOCATION];
    section.allow(&[&own[..], &Setup::KEYS].concat())?;
    let error_value = section.require("error")?;
    let error = decode_motion(&error_value, machine)?;
    refuse_turning(&error_value, error, machine)?;
    let setup = Setup::decode(section, error, machine)?;
    let holds_location = decode_holds_location(section, error)?;
    let file_value = section.require("file")?;
    let own_mapping = Mapping::decode_keys(section)?;
    let named = common.folder.join(file_value.text()?);
    let mapping = match own_mapping {
        Some(mapping) => Some(mapping),
        None => Mapping::read_beside(&named)?.or_else(|| common.columns.clone()),
    };
    let (file, mut readings) = read_measurement(&file_value, common.folder, mapping.as_ref())?;
    refuse_unstated_export(section, &file_value, &readings)?;
    tracing::debug!("{error}: {} readings from {}", readings.readings.len(), file.display());
    readings.check_targets(error.axis)?;
    apply_unit(section, &file_value, &mut readings, setup.reads_angles())?;
    for reading in &mut readings.readings {
        reading.deviation *= setup.sign;
    }
    refuse_serial(&file_value, &readings, common.serial)?;
    refuse(&file_value, &setup, &readings, machine)?;
    if MotionKind::of(error) == MotionKind::Straightness && setup.method == Method::Direct {
        // For a straightness, runs that lack targets are aligned by their slopes as well as by their offsets.
        readings.quantity = Some(Quantity::Straightness);
    }
    let at = file_value.error("");
    let source = source_of(&file_value, &file, &setup, &readings, machine)?;
    Ok(Line {
        sources: vec![source],
        setup,
        file,
        place: format!("{}:{}", at.file, at.line),
        readings,
        curve: section
            .get("curve")
            .map(|value| CurveChoice::decode(&value, error.axis))
            .transpose()?,
        reference_line: decode_reference_line(section, error)?,
        holds_location,
    })
}

fn source_of(
    value: &Value<'_>,
    path: &Path,
    setup: &Setup,
    readings: &Measurement,
    machine: &Machine,
) -> Result<Source, InputError> {
    let read = Source::read(value.text()?, path);
    let source = read.map_err(|e| value.error(format!("{}: {e}", path.display())))?;
    let runs = Direction::BOTH.map(|direction| readings.runs(direction).len());
    let axes = machine.axes().iter().map(|axis| axis.name);
    let mut at: Vec<(AxisName, f64)> =
        axes.zip(setup.at.iter().copied()).filter(|(_, q)| *q != 0.0).collect();
    at.sort_by_key(|(axis, _)| *axis);
    Ok(Source {
        runs: runs.into_iter().max(),
        targets: Some(readings.targets().len()),
        at,
        date: readings.metadata.date.clone(),
        ..source
    })
}

fn decode_reference_line(
    section: &Section<'_>,
    error: ErrorName,
) -> Result<ReferenceKind, InputError> {
    if let Some(value) = section.get("reference_line")
        && MotionKind::of(error) != MotionKind::Straightness
    {
        return Err(
            value.error(format!("found it for {error}, expected it for a straightness error only"))
        );
    }
    let words = [
        ("least-squares", ReferenceKind::LeastSquares),
        ("end-points", ReferenceKind::EndPoints),
        ("minimum-zone", ReferenceKind::MinimumZone),
    ];
    section.one_of("reference_line", &words, ReferenceKind::LeastSquares)
}

fn check_same_curve(before: &[Line], line: &Line, section: &Section<'_>) -> Result<(), InputError> {
    let error = line.setup.error;
    let earlier = before.iter().find(|other| other.setup.error == error && other.curve.is_some());
    match (earlier, section.get("curve")) {
        (Some(earlier), Some(value)) if earlier.curve != line.curve => Err(value.error(format!(
            "another kind of curve for {error} than with {}, expected the same for all lines of an error",
            earlier.file.display()
        ))),
        _ => Ok(()),
    }
}

/// Converts the readings to µm or µrad; `unit` is used if the file states none.
fn apply_unit(
    section: &Section<'_>,
    file: &Value<'_>,
    readings: &mut Measurement,
    angular: bool,
) -> Result<(), InputError> {
    const LENGTHS: [(&str, ReadingUnit); 3] =
        [("um", ReadingUnit::Um), ("µm", ReadingUnit::Um), ("mm", ReadingUnit::Mm)];
    const ANGLES: [(&str, ReadingUnit); 5] = [
        ("urad", ReadingUnit::Urad),
        ("µrad", ReadingUnit::Urad),
        ("mrad", ReadingUnit::Mrad),
        ("arcsec", ReadingUnit::Arcsec),
        ("deg", ReadingUnit::Deg),
    ];
    if let Some(unit) = section.get("unit") {
        let asked = unit.one_of(if angular { &ANGLES[..] } else { &LENGTHS[..] })?;
        let text = unit.text()?;
        return readings.convert_from(asked).map_err(|stated| {
            unit.error(format!(
                "found \"{text}\", but the file states that its deviations are in {stated}: expected no `unit`"
            ))
        });
    }
    match (readings.unit, angular) {
        (Some(DeviationUnit::Um), true) => Err(file.error(
            "the file holds lengths, expected angles: check `error`",
        )),
        (Some(DeviationUnit::Urad), false) => Err(file.error(
            "the file holds angles, expected lengths: check `error`, or state `method = \"angular\"`",
        )),
        _ => Ok(()),
    }
}

fn decode_uncertainty(section: &Section<'_>) -> Result<Uncertainty, InputError> {
    section.allow(&["laser_um_per_m", "square_urad", "reading_um", "reading_urad"])?;
    let number = |key: &str| {
        let Some(value) = section.get(key) else {
            return Ok(0.0);
        };
        standard_uncertainty(&value)
    };
    Ok(Uncertainty {
        laser_um_per_m: number("laser_um_per_m")?,
        square_urad: number("square_urad")?,
        reading_um: number("reading_um")?,
        reading_urad: number("reading_urad")?,
    })
}
