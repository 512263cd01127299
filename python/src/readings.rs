//! Readings at targets: files, their evaluation by ISO 230-2, and curves through them.

use std::path::PathBuf;

use numpy::IntoPyArray;
use pyo3::{exceptions::PyTypeError, prelude::*, types::PyDict};
use volcomp_calibrate::fit_readings;
use volcomp_fit::{
    Fit, FitError, fit_bspline, fit_chebyshev, fit_cubic_table, fit_mls, fit_polynomial,
};
use volcomp_metrology::{
    DeviationUnit, Direction, Edition, Measurement, Quantity, Reading, ReadingUnit, TargetUnit,
    evaluate, not_positioning, read_file, shortfalls,
};
use volcomp_model::{curve::Curve, vocabulary::AxisKind, write_curve};

use crate::{arrays::finite_column, failure::Failure, to_python};

/// Read a measurement file: Renishaw, Keysight, API, tables (.csv) and others.
///
/// unit: unit of deviations that the file does not state: "um", "mm", "urad", "arcsec" and others.
///
/// Returns a dict: target (n,) in mm, or deg of a rotary axis; target_unit, "mm", "deg" or None; run (n,) from 1; direction (n,) +1 or -1;
/// deviation_um or deviation_urad (n,), measured minus target; axis, metadata, environment, notes, file.
/// Raises OSError if the file cannot be read, InputError (with file, line, key) if it is invalid or states no unit.
#[pyfunction]
#[pyo3(signature = (path, unit=None))]
pub(crate) fn read_measurements<'py>(
    py: Python<'py>,
    path: PathBuf,
    unit: Option<&str>,
) -> PyResult<Bound<'py, PyDict>> {
    let (measurement, unit) = py.detach(|| of_file(path, unit))?;
    let readings = &measurement.readings;
    let column = |of: &dyn Fn(&Reading) -> f64| -> Vec<f64> { readings.iter().map(of).collect() };
    let result = PyDict::new(py);
    result.set_item("file", &measurement.name)?;
    result.set_item("target", column(&|r| r.target).into_pyarray(py))?;
    let target_unit = volcomp_metrology::axis_kind(&measurement).map(AxisKind::coordinate_unit);
    result.set_item("target_unit", target_unit)?;
    let runs: Vec<i64> = readings.iter().map(|r| i64::from(r.run)).collect();
    result.set_item("run", runs.into_pyarray(py))?;
    let directions: Vec<i64> = readings.iter().map(|r| sign(r.direction)).collect();
    result.set_item("direction", directions.into_pyarray(py))?;
    let deviation = column(&|r| r.deviation).into_pyarray(py);
    result.set_item(format!("deviation_{}", unit.key()), deviation)?;
    result.set_item("axis", &measurement.metadata.axis)?;
    result.set_item("metadata", to_python(py, &measurement.metadata)?)?;
    result.set_item("environment", to_python(py, &measurement.environment)?)?;
    result.set_item("notes", &measurement.notes)?;
    Ok(result)
}

/// Evaluate a positioning test by ISO 230-2.
///
/// data: path of a measurement file, or a mapping of columns as read_measurements returns them: target (n,), deviation_um or
/// deviation_urad (n,), and optionally run (n,), direction (n,) of +1 and -1, target_unit. unit: see read_measurements. edition: 1997, 2006 or 2014.
///
/// Returns a dict with the keys of `volcomp iso230 --json`: unit, A_um, A_forward_um, ..., mean_B_um (A_urad ... for angles; None where it cannot
/// be evaluated), targets, hints, edition, notes.
#[pyfunction]
#[pyo3(signature = (data, *, unit=None, edition=2014))]
pub(crate) fn iso230_2<'py>(
    data: &Bound<'py, PyAny>,
    unit: Option<&str>,
    edition: u16,
) -> PyResult<Bound<'py, PyDict>> {
    let py = data.py();
    let Some(edition) = Edition::of_year(edition) else {
        let message = format!("edition: found {edition}, expected 1997, 2006 or 2014");
        return Err(Failure::argument(message).into());
    };
    let (measurement, unit) = measurement(data, unit)?;
    if measurement.quantity == Some(Quantity::Straightness) {
        let name = &measurement.name;
        let message = format!("{name}: found straightness readings, expected positioning");
        return Err(Failure::argument(message).into());
    }
    if let Some((_, message)) = not_positioning(&measurement, unit) {
        let name = &measurement.name;
        let message = format!(
            "{name}: {message}; where the title is wrong, pass the columns that read_measurements returns"
        );
        return Err(Failure::argument(message).into());
    }
    let found = evaluate(&measurement).map_err(Failure::from)?;
    let kind = volcomp_metrology::axis_kind(&measurement).unwrap_or(AxisKind::Linear);
    let mut notes = measurement.notes.clone();
    notes.extend(shortfalls(&measurement, kind, edition));
    notes.extend(found.outlier_hints.iter().map(|hint| hint.text.clone()));
    let result = PyDict::new(py);
    result.set_item("unit", unit.key())?;
    for quantity in edition.quantities(&found) {
        let key = format!("{}_{}", quantity.symbol, unit.key());
        result.set_item(key, quantity.value)?;
    }
    result.set_item("targets", to_python(py, &found.targets)?)?;
    result.set_item("hints", to_python(py, &found.outlier_hints)?)?;
    result.set_item("edition", edition.year())?;
    result.set_item("notes", notes)?;
    Ok(result)
}

struct FitSettings<'a> {
    method: &'a str,
    order: Option<usize>,
    support: Option<f64>,
    shape: Option<f64>,
    residual: Option<f64>,
}

/// Fit a curve to the mean deviation at each target.
///
/// data, unit: see iso230_2. method: "auto" (chosen by the leave-one-out error, with a 95 % band), "poly", "chebyshev", "mls", "bspline" or "table".
/// order: of poly, chebyshev, mls (default 4). support, shape: of mls (default 1/3 and 3). residual: largest residual allowed with auto, in the
/// unit of the readings. at: (m,) coordinates at which to evaluate the curve, mm or deg.
///
/// Returns a dict with the keys of `volcomp fit --json`: unit; curve, as in a machine file; residual_um with min, max, rms;
/// leave_one_out_um, None if a target cannot be predicted from the others; values, a dict of at, value_um and outside_range (m,); choice and
/// band (at (k,), half_width (k,), from) with auto; and target (n,), mean_um (n,), the fitted means. For angles the keys end in _urad.
#[pyfunction]
#[pyo3(signature = (data, *, method="auto", order=None, support=None, shape=None, residual=None, at=None, unit=None))]
#[expect(clippy::too_many_arguments, reason = "named in Python")]
pub(crate) fn fit<'py>(
    data: &Bound<'py, PyAny>,
    method: &str,
    order: Option<usize>,
    support: Option<f64>,
    shape: Option<f64>,
    residual: Option<f64>,
    at: Option<&Bound<'py, PyAny>>,
    unit: Option<&str>,
) -> PyResult<Bound<'py, PyDict>> {
    let py = data.py();
    let settings = FitSettings { method, order, support, shape, residual };
    settings.check()?;
    let at = at.map_or_else(|| Ok(Vec::new()), |at| finite_column(at, "at"))?;
    let (measurement, unit) = measurement(data, unit)?;
    measurement.check_directions().map_err(Failure::from)?;
    measurement.check_lines_of_runs().map_err(Failure::from)?;
    let (target, mean): (Vec<f64>, Vec<f64>) = measurement.mean_curve().into_iter().unzip();
    let found = py.detach(|| settings.fit(&measurement, &target, &mean));
    let failed = |error: FitError| Failure::argument(format_args!("{}: {error}", measurement.name));
    let (fit, chosen) = found.map_err(failed)?;
    let result = PyDict::new(py);
    let key = |name: &str| format!("{name}_{}", unit.key());
    result.set_item("unit", unit.key())?;
    result.set_item("curve", curve(py, &fit.curve)?)?;
    let residual = PyDict::new(py);
    residual.set_item("min", fit.min())?;
    residual.set_item("max", fit.max())?;
    residual.set_item("rms", fit.rms())?;
    result.set_item(key("residual"), residual)?;
    let left_out = Some(fit.leave_one_out_rms).filter(|error| error.is_finite());
    result.set_item(key("leave_one_out"), left_out)?;
    let values = PyDict::new(py);
    let value: Vec<f64> = at.iter().map(|at| fit.curve.value(*at)).collect();
    let outside: Vec<bool> = at.iter().map(|at| !fit.curve.contains(*at)).collect();
    values.set_item("at", at.into_pyarray(py))?;
    values.set_item(key("value"), value.into_pyarray(py))?;
    values.set_item("outside_range", outside.into_pyarray(py))?;
    result.set_item("values", values)?;
    if let Some(meets) = fit.meets_required {
        result.set_item("meets_required", meets)?;
    }
    if let Some((choice, band)) = chosen {
        result.set_item("choice", to_python(py, &choice)?)?;
        if let Some(found) = band {
            let band = PyDict::new(py);
            band.set_item("from", to_python(py, &found.source)?)?;
            band.set_item("at", found.at.into_pyarray(py))?;
            band.set_item("half_width", found.half_width.into_pyarray(py))?;
            result.set_item("band", band)?;
        }
    }
    result.set_item("target", target.into_pyarray(py))?;
    result.set_item(key("mean"), mean.into_pyarray(py))?;
    result.set_item("notes", measurement.notes)?;
    Ok(result)
}

type Chosen = (volcomp_fit::Choice, Option<volcomp_fit::Band>);

impl FitSettings<'_> {
    /// Refuses settings that the method ignores.
    fn check(&self) -> Result<(), Failure> {
        let method = self.method;
        let known = ["auto", "poly", "chebyshev", "mls", "bspline", "table"];
        if !known.contains(&method) {
            return Err(Failure::argument(format_args!(
                "method: found {method:?}, expected one of {}",
                known.join(", ")
            )));
        }
        let has_order = matches!(method, "poly" | "chebyshev" | "mls");
        let (mls, auto) = (method == "mls", method == "auto");
        for (name, is_given, is_used, methods) in [
            ("order", self.order.is_some(), has_order, "poly, chebyshev or mls"),
            ("support", self.support.is_some(), mls, "mls"),
            ("shape", self.shape.is_some(), mls, "mls"),
            ("residual", self.residual.is_some(), auto, "auto"),
        ] {
            if is_given && !is_used {
                return Err(Failure::argument(format_args!(
                    "{name}: found it with method={method:?}, expected it with {methods} only"
                )));
            }
        }
        Ok(())
    }

    fn fit(
        &self,
        measurement: &Measurement,
        x: &[f64],
        u: &[f64],
    ) -> Result<(Fit, Option<Chosen>), FitError> {
        // Targets are ascending, and there is at least one.
        let domain = [x, x].map(|x| x.first().copied().unwrap_or_default());
        let domain = [domain[0], x.last().copied().unwrap_or(domain[1])];
        let order = self.order.unwrap_or(4);
        let fit = match self.method {
            "poly" => fit_polynomial(x, u, order, domain)?,
            "chebyshev" => fit_chebyshev(x, u, order, domain)?,
            "bspline" => fit_bspline(x, u)?,
            "table" => fit_cubic_table(x, u)?,
            "mls" => {
                let (support, shape) =
                    (self.support.unwrap_or(1.0 / 3.0), self.shape.unwrap_or(3.0));
                fit_mls(x, u, order, support, shape)?
            }
            _ => {
                let found = fit_readings(measurement, self.residual)?;
                return Ok((found.fit, Some((found.choice, found.band))));
            }
        };
        Ok((fit, None))
    }
}

/// Converts a curve to the table that a machine file has for it.
fn curve<'py>(py: Python<'py>, curve: &Curve) -> PyResult<Bound<'py, PyAny>> {
    let text = format!("curve = {}", write_curve(curve));
    let table: toml::Table = text.parse().map_err(Failure::argument)?;
    to_python(py, &table["curve"])
}

/// The readings of a file, or of a mapping of columns.
fn measurement(
    data: &Bound<'_, PyAny>,
    unit: Option<&str>,
) -> Result<(Measurement, DeviationUnit), Failure> {
    if data.hasattr("keys")? {
        if unit.is_some() {
            let message = "unit: found it together with columns, expected it with a path only: the name of the column states the unit";
            return Err(Failure::argument(message));
        }
        return of_columns(data);
    }
    let path: PathBuf = data.extract().map_err(|_| {
        let found = data.get_type();
        PyTypeError::new_err(format!(
            "data: found {found}, expected a path or a mapping of columns (target, deviation_um or deviation_urad, run, direction)"
        ))
    })?;
    data.py().detach(|| of_file(path, unit))
}

fn of_file(path: PathBuf, unit: Option<&str>) -> Result<(Measurement, DeviationUnit), Failure> {
    let mut measurement = read_file(&path)?;
    if let Some(name) = unit {
        let expected = ReadingUnit::named(name).ok_or_else(|| {
            Failure::argument(format_args!(
                "unit: found {name:?}, expected mm, um, nm, deg, arcsec, rad, mrad or urad"
            ))
        })?;
        measurement.convert_from(expected).map_err(|found| {
            let what = format!("found deviations in {found}, expected {expected} (unit={name:?})");
            Failure::in_file(&path, what)
        })?;
    }
    let unit = measurement.unit.ok_or_else(|| {
        let what = "the unit of the deviations is not stated, expected unit=\"um\" or another, or the header `deviation µm`";
        Failure::in_file(&path, what)
    })?;
    Ok((measurement, unit))
}

fn of_columns(data: &Bound<'_, PyAny>) -> Result<(Measurement, DeviationUnit), Failure> {
    let given = |name: &str| -> Result<Option<Bound<'_, PyAny>>, Failure> {
        Ok(if data.contains(name)? { Some(data.get_item(name)?) } else { None })
    };
    let (um, urad) = (given("deviation_um")?, given("deviation_urad")?);
    let (deviation, unit) = match (um, urad) {
        (Some(um), None) => (finite_column(&um, "deviation_um")?, DeviationUnit::Um),
        (None, Some(urad)) => (finite_column(&urad, "deviation_urad")?, DeviationUnit::Urad),
        (found, _) => {
            let found = found.map_or("neither", |_| "both");
            return Err(Failure::argument(format_args!(
                "data: found {found} of deviation_um and deviation_urad, expected one of them"
            )));
        }
    };
    let Some(target) = given("target")? else {
        let message = "data: found no target, expected the targets (n,) in mm or deg";
        return Err(Failure::argument(message));
    };
    let target = finite_column(&target, "target")?;
    let whole = |name: &str, is_valid: fn(f64) -> bool, expected: &str| {
        let values = match given(name)? {
            Some(values) => finite_column(&values, name)?,
            None => vec![1.0; target.len()],
        };
        match values.iter().position(|value| !is_valid(*value)) {
            Some(index) => Err(Failure::argument(format_args!(
                "{name}[{index}]: found {}, expected {expected}",
                values[index]
            ))),
            None => Ok(values),
        }
    };
    let is_run = |run: f64| run.fract() == 0.0 && (1.0..=f64::from(u32::MAX)).contains(&run);
    let run = whole("run", is_run, "a whole number from 1")?;
    let direction = whole("direction", |sign| sign.abs() == 1.0, "+1 or -1")?;
    for (name, found) in
        [("deviation", deviation.len()), ("run", run.len()), ("direction", direction.len())]
    {
        if found != target.len() || found == 0 {
            return Err(Failure::argument(format_args!(
                "{name}: found shape ({found},), expected ({},) as of target, and one reading at least",
                target.len()
            )));
        }
    }
    let target_unit = match given("target_unit")?.filter(|unit| !unit.is_none()) {
        None => None,
        Some(unit) => match unit.extract::<String>().ok().as_deref() {
            Some("mm") => Some(TargetUnit::Mm),
            Some("deg") => Some(TargetUnit::Deg),
            _ => {
                return Err(Failure::argument(format_args!(
                    "target_unit: found {}, expected \"mm\" or \"deg\"",
                    unit.repr()?
                )));
            }
        },
    };
    let readings = (0..target.len()).map(|place| Reading {
        target: target[place],
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "checked above"
        )]
        run: run[place] as u32,
        direction: if direction[place] > 0.0 { Direction::Positive } else { Direction::Negative },
        deviation: deviation[place],
    });
    let measurement = Measurement {
        name: "data".to_owned(),
        unit: Some(unit),
        target_unit,
        readings: readings.collect(),
        ..Measurement::default()
    };
    Ok((measurement, unit))
}

fn sign(direction: Direction) -> i64 {
    match direction {
        Direction::Positive => 1,
        Direction::Negative => -1,
    }
}
