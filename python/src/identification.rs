//! `calibrate` and `identify`, which compute a machine from measurement files.

use std::path::PathBuf;

use pyo3::prelude::*;
use volcomp_calibrate::{CalibrationFile, CalibrationSummary};
use volcomp_identify::Observations;

use crate::{failure::Failure, machine::Machine, to_python};

/// Fit the measurement files of a calibration file (TOML) to a machine.
///
/// Returns a dict with the keys of `volcomp calibrate --json` (curves, squareness_urad, locations, identified, warnings) and `machine`, the
/// calibrated Machine; `machine.save(path)` writes it.
/// Raises OSError if a file cannot be read, InputError (with file, line, key) if its content is invalid.
#[pyfunction]
pub(crate) fn calibrate(py: Python<'_>, calibration: PathBuf) -> PyResult<Bound<'_, PyAny>> {
    let found = py.detach(|| {
        let file = CalibrationFile::read(&calibration)?;
        Ok::<_, Failure>(volcomp_calibrate::calibrate(&file, |_, _| {})?)
    })?;
    let result = to_python(py, &CalibrationSummary::new(&found))?;
    let machine = found.machine;
    result.set_item("machine", Machine { machine }.into_pyobject(py)?)?;
    Ok(result)
}

/// Identify errors from the observations file (TOML) of trackers, spheres, ballbars, ball rows and diagonals.
///
/// Returns a dict with the keys of `volcomp identify --json` (parameters, rank, score, null, residual_um, left_out_um, next, warnings) and
/// `machine`, the identified Machine.
/// Raises OSError if a file cannot be read, InputError (with file, line, key) if its content is invalid or determines nothing.
#[pyfunction]
pub(crate) fn identify(py: Python<'_>, observations: PathBuf) -> PyResult<Bound<'_, PyAny>> {
    let found = py.detach(|| {
        let observations = Observations::read(&observations)?;
        Ok::<_, Failure>(volcomp_identify::identify(&observations, |_, _| {})?)
    })?;
    let result = to_python(py, &found)?;
    let machine = found.machine;
    result.set_item("machine", Machine { machine }.into_pyobject(py)?)?;
    Ok(result)
}
