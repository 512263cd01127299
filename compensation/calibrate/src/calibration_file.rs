//! The calibration file: which error each measurement file holds, along which line.

use std::{
    fs,
    path::{Path, PathBuf},
};

use volcomp_kinematics::{AxisName, JointKind};
use volcomp_metrology::{
    DeviationUnit, Measurement, Rides, TiltReading, read_file, squareness_parts,
};
use volcomp_model::{
    ErrorName, InputError, Machine, UnknownError,
    document::{Document, Section, Value},
};

use crate::error::CalibrateError;

/// A calibration file with everything it names read.
#[derive(Clone, Debug)]
pub struct CalibrationFile {
    /// The machine as its file states it.
    pub machine: Machine,
    /// Coordinates at which curves are zero, mm or deg, by the place of the axis in the chain.
    pub reference: Vec<f64>,
    /// The measurements.
    pub measurements: Vec<Line>,
    /// The squareness errors.
    pub squareness: Vec<Squareness>,
}

/// One measurement: an error along one line.
#[derive(Clone, Debug)]
pub struct Line {
    /// The error that was measured.
    pub error: ErrorName,
    /// The measurement file.
    pub file: PathBuf,
    /// Its readings, in the sign of the error, µm or µrad; of the bridge for the angular method.
    pub readings: Measurement,
    /// Where every axis stood, mm or deg, by its place in the chain; the measured one at 0.
    pub at: Vec<f64>,
    /// The measured point m, mm in MCS with the measured axis at 0; `None`: the point at which the
    /// axis's errors are stated.
    pub point_mcs: Option<[f64; 3]>,
    /// Which side of the joint the point is on.
    pub rides: Rides,
    /// How the readings become the error.
    pub method: Method,
    /// The kind of curve wanted.
    pub curve: CurveChoice,
}

/// How readings become the error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Method {
    /// They are the error.
    Direct,
    /// Tilts of a bridge, to be summed up to a straightness.
    Angular {
        /// Foot spacing, mm.
        bridge_mm: f64,
        /// Sign of the readings.
        reading: TiltReading,
    },
}

/// The kind of curve that a measurement is fitted with.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum CurveChoice {
    /// The kind with the smallest leave-one-out error.
    #[default]
    Auto,
    /// A polynomial.
    Polynomial {
        /// Its order.
        order: usize,
    },
    /// A Chebyshev series.
    Chebyshev {
        /// Its order.
        order: usize,
    },
    /// Moving least squares.
    MovingLeastSquares {
        /// Order of the local polynomials.
        order: usize,
        /// Half width of the weight as a share of the range.
        support: f64,
        /// Shape of the weight.
        shape: f64,
    },
    /// A smoothing B-spline.
    BSpline,
    /// A linear table.
    LinearTable,
    /// A monotone cubic table.
    CubicTable,
    /// A Fourier series.
    Fourier {
        /// Number of harmonics.
        order: usize,
        /// Its period, deg.
        period: f64,
    },
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
        let file = path.display().to_string();
        let text = fs::read_to_string(path).map_err(|source| CalibrateError::Read {
            file: file.clone(),
            source,
        })?;
        let folder = path.parent().unwrap_or(Path::new(""));
        Document::new(&file, &text).decode(|root| decode(&root, folder))
    }
}

fn decode(root: &Section<'_>, folder: &Path) -> Result<CalibrationFile, CalibrateError> {
    root.allow(&["machine", "reference", "measurement", "squareness"])?;
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
    let mut measurements = Vec::new();
    for item in items("measurement")? {
        measurements.push(decode_line(&item.section()?, &machine, folder)?);
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
        machine,
        reference,
        measurements,
        squareness,
    })
}

/// 0, or the travel end nearest to it.
fn nearest_zero([low, high]: [f64; 2]) -> f64 {
    0.0_f64.clamp(low, high)
}

fn set_coordinates(
    coordinates: &mut [f64],
    section: &Section<'_>,
    machine: &Machine,
) -> Result<(), InputError> {
    for (key, value) in section.values() {
        let place = machine
            .axes()
            .iter()
            .position(|axis| axis.name.to_string() == key);
        let structure = machine.chain().structure();
        let place = place
            .ok_or_else(|| value.error(format!("the structure `{structure}` has no axis {key}")))?;
        coordinates[place] = value.number()?;
    }
    Ok(())
}

fn decode_error(value: &Value<'_>, machine: &Machine) -> Result<ErrorName, InputError> {
    let name: ErrorName = value
        .text()?
        .parse()
        .map_err(|e: UnknownError| value.error(e.to_string()))?;
    if machine.axis(name.axis).is_none() {
        let structure = machine.chain().structure();
        return Err(value.error(format!(
            "the structure `{structure}` has no axis {}",
            name.axis
        )));
    }
    Ok(name)
}

fn decode_line(
    section: &Section<'_>,
    machine: &Machine,
    folder: &Path,
) -> Result<Line, CalibrateError> {
    section.allow(&[
        "error",
        "file",
        "at",
        "point",
        "rides",
        "sign",
        "method",
        "bridge_mm",
        "reading",
        "unit",
        "curve",
    ])?;
    let error_value = section.require("error")?;
    let error = decode_error(&error_value, machine)?;
    if error.location {
        let message =
            format!("found {error}, expected an error motion E?N; squareness has its own table");
        return Err(error_value.error(message).into());
    }
    let mut at = vec![0.0; machine.axes().len()];
    if let Some(held) = section.section("at")? {
        if let Some(own) = held.get(&error.axis.to_string()) {
            let message = format!(
                "{} is the measured axis, expected the other axes only",
                error.axis
            );
            return Err(own.error(message).into());
        }
        set_coordinates(&mut at, &held, machine)?;
    }
    let method = decode_method(section)?;
    let angular_readings = error.component.is_angular() || method != Method::Direct;
    let file_value = section.require("file")?;
    let file = folder.join(file_value.text()?);
    let mut readings = read_file(&file)?;
    let factor =
        decode_sign(section)? * unit_factor(section, &file_value, &readings, angular_readings)?;
    for reading in &mut readings.readings {
        reading.deviation *= factor;
    }
    Ok(Line {
        error,
        file,
        readings,
        at,
        point_mcs: section
            .get("point")
            .map(|value| value.vector())
            .transpose()?,
        rides: one_of(
            section,
            "rides",
            &[("carriage", Rides::Carriage), ("other", Rides::Other)],
        )?,
        method,
        curve: decode_curve(section, error.axis)?,
    })
}

/// The value that a word stands for; the first when the key is not there.
fn one_of<T: Copy>(section: &Section<'_>, key: &str, words: &[(&str, T)]) -> Result<T, InputError> {
    let Some(value) = section.get(key) else {
        return Ok(words[0].1);
    };
    let found = value.text()?;
    let known = words.iter().find(|(word, _)| *word == found);
    known.map(|(_, meaning)| *meaning).ok_or_else(|| {
        let words: Vec<&str> = words.iter().map(|(word, _)| *word).collect();
        value.error(format!(
            "found \"{found}\", expected one of: {}",
            words.join(", ")
        ))
    })
}

fn decode_sign(section: &Section<'_>) -> Result<f64, InputError> {
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
    if !one_of(section, "method", &[("direct", false), ("angular", true)])? {
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
    let words = [
        ("right-hand", TiltReading::RightHand),
        ("slope", TiltReading::Slope),
    ];
    Ok(Method::Angular {
        bridge_mm,
        reading: one_of(section, "reading", &words)?,
    })
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
    if section.get("unit").is_some() {
        return one_of(
            section,
            "unit",
            if angular { &ANGULAR[..] } else { &LINEAR[..] },
        );
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

fn decode_curve(section: &Section<'_>, axis: AxisName) -> Result<CurveChoice, InputError> {
    let Some(value) = section.get("curve") else {
        return Ok(CurveChoice::Auto);
    };
    if value.text().is_ok() {
        return one_of(section, "curve", &[("auto", CurveChoice::Auto)]);
    }
    let table = value.section()?;
    table.allow(&["poly", "chebyshev", "mls", "bspline", "table", "fourier"])?;
    let kinds: Vec<_> = table.values().collect();
    let [(kind, options)] = &kinds[..] else {
        return Err(value.error(format!(
            "found {} kinds of curve, expected one",
            kinds.len()
        )));
    };
    let options = options.section()?;
    let order = |default| options.get("order").map_or(Ok(default), |v| v.count(40));
    let number = |key: &str, default| options.get(key).map_or(Ok(default), |v| v.number());
    Ok(match *kind {
        "poly" | "chebyshev" => {
            options.allow(&["order"])?;
            let order = order(6)?;
            if *kind == "poly" {
                CurveChoice::Polynomial { order }
            } else {
                CurveChoice::Chebyshev { order }
            }
        }
        "mls" => {
            options.allow(&["order", "support", "shape"])?;
            CurveChoice::MovingLeastSquares {
                order: order(4)?,
                support: number("support", 1.0 / 3.0)?,
                shape: number("shape", 3.0)?,
            }
        }
        "bspline" => {
            options.allow(&[])?;
            CurveChoice::BSpline
        }
        "fourier" => {
            options.allow(&["order", "period"])?;
            if axis.kind() == JointKind::Linear {
                return Err(value.error(format!(
                    "found fourier for axis {axis}, expected it on a rotary axis"
                )));
            }
            CurveChoice::Fourier {
                order: order(4)?,
                period: number("period", 360.0)?,
            }
        }
        _ => {
            options.allow(&["interpolation"])?;
            let words = [
                ("linear", CurveChoice::LinearTable),
                ("cubic", CurveChoice::CubicTable),
            ];
            one_of(&options, "interpolation", &words)?
        }
    })
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
