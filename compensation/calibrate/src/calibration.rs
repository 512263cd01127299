//! From readings to a machine, in stages that return values: angular errors, linear ones with Abbe removed, slopes of
//! the straightness lines, squareness, machine. Each stage passes the readings of a file once.

use volcomp_model::Machine;
use volcomp_vocabulary::{ErrorName, Urad};

use crate::{
    angular::angular,
    calibration_file::CalibrationFile,
    checks::{different_machines, odd},
    error::CalibrateError,
    fitted::measured,
    fitted_curve::FittedCurve,
    linear::linear,
    locations::located,
    not_measured::not_measured,
    slopes::slopes,
    squares::{set_square, squares},
};

/// A calibrated machine and how well its curves follow the readings.
#[derive(Clone, Debug)]
pub struct Calibration {
    /// The machine with its fitted errors.
    pub machine: Machine,
    /// Each fitted curve, angular errors first.
    pub curves: Vec<FittedCurve>,
    /// Each squareness, as the calibration file names it.
    pub squareness: Vec<(ErrorName, Urad)>,
    /// Messages that a person should read: errors not measured, levers left in, notes on the measurement files.
    pub warnings: Vec<String>,
}

/// Turns measurements into a machine. `progress` is told how many of how many errors are done.
///
/// Errors of the machine file that were not measured are kept.
///
/// # Errors
/// Readings that do not fit their error, a squareness without its straightness lines.
pub fn calibrate(
    file: &CalibrationFile,
    mut progress: impl FnMut(usize, usize),
) -> Result<Calibration, CalibrateError> {
    let measured = measured(file);
    let mut done = 0;
    let mut step = || {
        done += 1;
        progress(done, measured.len());
    };
    let known = located(file)?;
    let angular = angular(file, &known, &mut step)?;
    let linear = linear(file, &angular.tilted, &mut step)?;
    let slopes = slopes(&linear.removed, &angular.tilted)?;
    let squareness = squares(file, &slopes)?;

    let mut machine = angular.tilted;
    for fitted in &linear.fitted {
        fitted.set_in(&mut machine)?;
    }
    for (error, value) in &squareness {
        set_square(&mut machine, file.reference_axes, *error, *value)?;
    }
    let fitted = angular.fitted.iter().chain(&linear.fitted);
    let curves: Vec<FittedCurve> = fitted
        .flat_map(|fitted| fitted.branches.fitted(fitted.error))
        .collect();
    let mut warnings: Vec<String> = different_machines(&file.measurements).into_iter().collect();
    for line in &file.measurements {
        warnings.extend(odd(line, &file.machine));
    }
    warnings.extend(angular.notes);
    warnings.extend(linear.notes);
    warnings.extend(not_measured(file, &machine, &measured, &curves));
    Ok(Calibration {
        machine,
        curves,
        squareness,
        warnings,
    })
}
