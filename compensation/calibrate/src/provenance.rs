//! Origin of the errors of a calibrated machine: the table `[provenance]` of its machine file.

use volcomp_metrology::squareness_parts;
use volcomp_model::{Machine, ModelError, Origin, Provenance, Source};
use volcomp_vocabulary::ErrorName;

use crate::{
    branches::FittedCurve,
    calibration_file::{CalibrationFile, Squareness, SquarenessSource, lines_of},
    curve_choice::CurveChoice,
    error::CalibrateError,
    fitted::FittedLine,
    squareness::tilt_of,
    stages::Stages,
};

const STATED: &str = "stated in the calibration file";

/// Adds the origin of each error to the fitted machine. Origins of errors that were not measured again are kept from
/// the input machine file. No date is added, so that the same files give the same text.
pub(crate) fn with_provenance(
    file: &CalibrationFile,
    stages: &Stages,
    (curves, lines): (&[FittedCurve], &[FittedLine]),
) -> Result<Machine, CalibrateError> {
    let mut machine = stages.machine.clone();
    let not_followed = curves.iter().filter(|curve| !curve.follows());
    machine.leave_undecided(
        (not_followed.map(|curve| curve.error))
            .chain(stages.contradictions.iter().map(|(error, _)| *error))
            .chain(stages.undecided.iter().copied()),
    );
    let mut found = machine.provenance().clone();
    let mut origins = of_curves(file, curves, lines);
    for square in &file.squareness {
        origins.push(of_square(file, square)?);
    }
    let stated = file.locations.iter();
    origins.extend(stated.map(|location| plain(location.error, STATED, Vec::new())));
    let unknown = file.observations.iter().flat_map(|of| &of.unknown);
    origins.extend(unknown.map(|unknown| {
        let method = "identified from observations";
        plain(unknown.error, method, file.observed.clone())
    }));
    let is_stated = |error: ErrorName| {
        machine.error(error).is_some() || machine.locations().contains_key(&error)
    };
    for origin in origins.into_iter().filter(|o| is_stated(o.error)) {
        found.errors.retain(|other| other.error != origin.error);
        found.errors.push(origin);
    }
    found.errors.sort_by_key(|origin| origin.error);
    let provenance = Provenance {
        version: Some(env!("CARGO_PKG_VERSION").to_owned()),
        serial: file.serial.clone().or(found.serial),
        date: None,
        ..found
    };
    if !provenance.errors.is_empty() || !provenance.undecided.is_empty() {
        let refused = machine.set_provenance(provenance);
        refused.map_err(ModelError::from)?;
    }
    Ok(machine)
}

fn of_curves(file: &CalibrationFile, curves: &[FittedCurve], lines: &[FittedLine]) -> Vec<Origin> {
    let mut origins: Vec<Origin> = Vec::new();
    for curve in curves {
        if origins.iter().any(|origin| origin.error == curve.error) {
            continue;
        }
        let of_error = |other: &&FittedCurve| other.error == curve.error;
        let branches: Vec<&FittedCurve> = curves.iter().filter(of_error).collect();
        let lines = lines.iter().filter(|line| line.error == curve.error);
        let is_own = lines.clone().all(|line| line.line.is_some());
        let parallel = if is_own { "" } else { ", of what parallel lines differ by" };
        origins.push(Origin {
            error: curve.error,
            method: format!("{}{parallel}", curve.method),
            rule: Some(rule(file, curve)),
            residual: Some(residual(&branches)),
            leave_one_out: leave_one_out(&branches),
            sources: lines.flat_map(|line| line.sources.clone()).collect(),
        });
    }
    origins
}

fn rule(file: &CalibrationFile, curve: &FittedCurve) -> String {
    if let Some(choice) = &curve.choice {
        let follows = choice.chosen().is_none_or(|score| score.follows);
        let but =
            if follows { "" } else { "; it does not follow the readings within their scatter" };
        return format!("{}{but}", choice.reason);
    }
    let stated = lines_of(file, curve.error).find_map(|line| line.curve);
    match stated {
        Some(CurveChoice::AutoMovingLeastSquares { .. }) => {
            "moving least squares stated in the calibration file, order and support by their leave-one-out error"
                .to_owned()
        }
        _ => STATED.to_owned(),
    }
}

/// Root mean square of mean reading minus curve over the readings of all directions.
fn residual(branches: &[&FittedCurve]) -> f64 {
    let points = branches.iter().flat_map(|curve| &curve.points);
    let (count, squares) = points.fold((0.0, 0.0), |(count, squares), [_, read, value]| {
        (count + 1.0, squares + (read - value).powi(2))
    });
    rounded(f64::sqrt(squares / f64::max(count, 1.0)))
}

/// Rounds to 1e-6 µm or µrad; smaller differences are rounding errors.
fn rounded(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}

/// Leave-one-out error of all directions; `None` if a target cannot be predicted from the others.
fn leave_one_out(branches: &[&FittedCurve]) -> Option<f64> {
    let (mut count, mut sum) = (0.0, 0.0);
    for curve in branches {
        let readings = curve.readings as f64;
        count += readings;
        sum += readings * curve.quality.leave_one_out()?.powi(2);
    }
    Some(rounded(f64::sqrt(sum / f64::max(count, 1.0))))
}

fn of_square(file: &CalibrationFile, square: &Squareness) -> Result<Origin, CalibrateError> {
    let (error, _) = tilt_of(square.error, file.reference_axes);
    let (method, sources) = match square.source {
        SquarenessSource::Value(_) => (STATED.to_owned(), Vec::new()),
        SquarenessSource::Slopes { .. } => {
            let parts = squareness_parts(square.error)?;
            let lines = parts.iter().flat_map(|part| lines_of(file, *part));
            let sources = lines.flat_map(|line| line.sources.clone()).collect();
            let [first, second] = parts;
            (format!("slopes of {first} and {second}"), sources)
        }
        SquarenessSource::Diagonals => {
            let own = file.diagonals.iter();
            let own = own.filter(|diagonals| diagonals.errors.contains(&square.error));
            let sources = own.flat_map(|diagonals| diagonals.sources.clone());
            ("diagonals".to_owned(), sources.collect())
        }
    };
    Ok(plain(error, &method, sources))
}

fn plain(error: ErrorName, method: &str, sources: Vec<Source>) -> Origin {
    Origin {
        error,
        method: method.to_owned(),
        rule: None,
        residual: None,
        leave_one_out: None,
        sources,
    }
}
