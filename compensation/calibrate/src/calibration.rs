//! Calibration of a machine from the lines and the observations of a calibration file.
//!
//! The stages process the lines, then the unknowns are identified from the observations. The result includes messages,
//! the errors that are not measured, and the origin of each error, which is the table `[provenance]` of the machine
//! file.

use std::collections::BTreeMap;

use volcomp_identify::Observations;
use volcomp_metrology::squareness_parts;
use volcomp_model::{Machine, ModelError, Origin, Provenance, Source};
use volcomp_sensitivity::{ErrorTerm, Poses, sensitivity};
use volcomp_vocabulary::{AxisKind, AxisName, Component, Displacement, ErrorName, Urad};

use crate::branches::{Fitted, FittedCurve, FittedLine};
use crate::calibration_file::{
    CalibrationFile, Line, Location, Squareness, SquarenessSource, is_square, lines_of, located,
    measured, partner_of, reference_of, square_of, tilt_of,
};
use crate::checks::{
    different_machines, files_of, odd, odd_values, same_readings, with_files, without_point,
};
use crate::curve_choice::CurveChoice;
use crate::error::CalibrateError;
use crate::identified::{Identified, Scope, not_followed, settled};
use crate::stages::Stages;

/// A calibrated machine, with the quality of its curves.
#[derive(Clone, Debug)]
pub struct Calibration {
    /// The machine with its fitted errors.
    pub machine: Machine,
    /// Each fitted curve, angular errors first.
    pub curves: Vec<FittedCurve>,
    /// Readings to which the curves were fitted, line by line, in the order of the curves.
    pub lines: Vec<FittedLine>,
    /// Each squareness with its name in the calibration file.
    pub squareness: Vec<(ErrorName, Urad)>,
    /// Standard uncertainty of each squareness with known contributions, from lines or stated. It is widened by
    /// Student's t so that twice the value is a 95.45 % interval. Two contributions are not included: the uncertainties
    /// of the tilts subtracted from the lines and, for a single run, the alignment of its reference.
    pub square_uncertainties: BTreeMap<ErrorName, Urad>,
    /// Each location error stated in the calibration file, with its uncertainty.
    pub locations: Vec<Location>,
    /// Unknowns identified from observations of the whole machine; `None` if the file has none.
    pub identified: Option<Identified>,
    /// Messages for the user: errors not measured, Abbe errors not removed, notes on the measurement files.
    pub warnings: Vec<String>,
    /// Subset of `warnings`: contradictory measurement lines, with their error.
    pub contradictions: Vec<(ErrorName, String)>,
    /// Subset of `warnings`: errors not measured, each with its largest effect.
    pub not_measured: Vec<String>,
}

/// Calibrates a machine from measurements. `progress` receives the number of fitted errors and their total.
///
/// Errors of the machine file that were not measured are kept.
///
/// # Errors
/// Readings that do not fit their error, a squareness without its straightness lines, observations from which the
/// unknowns cannot be identified.
pub fn calibrate(
    file: &CalibrationFile,
    mut progress: impl FnMut(usize, usize),
) -> Result<Calibration, CalibrateError> {
    let (mut stages, identified, of_observations) =
        stages_of(file, Scope::Everything, &mut progress)?;
    let (curves, lines) = (stages.curves(), stages.lines());
    let mut warnings = file.machine.notes();
    warnings.extend(different_machines(&files_of(&file.measurements)));
    warnings.extend(same_readings(&file.measurements));
    let measured = file.measurements.iter();
    warnings.extend(measured.flat_map(|line| odd(line, &file.machine)));
    warnings.extend(without_point(&file.measurements, &stages.machine));
    warnings.extend(odd_values(file));
    warnings.extend(notes_of(&file.measurements));
    warnings.append(&mut stages.notes);
    warnings.extend(of_observations);
    warnings.extend(not_followed(&curves, &lines));
    stages.machine = with_provenance(file, &stages, (&curves, &lines))?;
    let not_measured = not_measured(file, &stages);
    warnings.extend(not_measured.iter().cloned());
    Ok(Calibration {
        machine: stages.machine,
        curves,
        lines,
        squareness: stages.squareness,
        square_uncertainties: stages.square_uncertainties,
        locations: file.locations.clone(),
        identified,
        warnings,
        contradictions: stages.contradictions,
        not_measured,
    })
}

/// The machine that [`calibrate`] returns, but without provenance. Faster, because the quality of the curves, the uncertainties of identified
/// parameters, and messages are not computed.
///
/// # Errors
///
/// Same as [`calibrate`].
pub fn calibrated_machine(file: &CalibrationFile) -> Result<Machine, CalibrateError> {
    stages_of(file, Scope::Machine, &mut |_, _| {}).map(|(stages, ..)| stages.machine)
}

/// Runs the stages; also returns the unknowns identified from observations, and notes on the observations.
fn stages_of(
    file: &CalibrationFile,
    wanted: Scope,
    progress: &mut dyn FnMut(usize, usize),
) -> Result<(Stages, Option<Identified>, Vec<String>), CalibrateError> {
    let count = measured(file).len();
    let mut done = 0;
    let known = located(file)?;
    let mut stages = Stages::of(file, &known, || {
        done += 1;
        progress(done, count);
    })?;
    let mut identified = None;
    let mut of_observations = Vec::new();
    if let Some(observations) = &file.observations {
        let (found, last, notes) = settled(file, observations, known, stages, wanted)?;
        of_observations.extend(notes);
        of_observations.extend(found.found.warnings.iter().map(ToString::to_string));
        stages = last;
        stages.machine = found.found.machine.clone();
        identified = Some(found);
    }
    Ok((stages, identified, of_observations))
}

fn notes_of(lines: &[Line]) -> Vec<String> {
    with_files(lines.iter().flat_map(|line| {
        let file = line.file.display().to_string();
        let notes = line.readings.notes.iter();
        notes.map(move |note| (file.clone(), note.clone()))
    }))
}

/// Number of nodes on a rotary axis at which the effect of an error is evaluated. On a linear axis the two ends suffice, because a displacement that
/// is linear in the coordinate is largest at one of them.
const ROTARY_NODES: usize = 8;
/// Size of the error whose effect is stated, µm or µrad.
const EXAMPLE: f64 = 10.0;

fn not_measured(file: &CalibrationFile, stages: &Stages) -> Vec<String> {
    let unknown: Vec<ErrorName> = file.observations.iter().flat_map(unknown).collect();
    let is_measured = |name: ErrorName| {
        let fitted = |fitted: &Fitted| fitted.error == name;
        stages.measured.contains(&name)
            || unknown.contains(&name)
            || stages.fitted.iter().any(fitted)
    };
    let is_stated = |square: ErrorName| {
        let mut locations = file.locations.iter();
        locations.any(|location| square_of(location.error) == square)
            || file.squareness.iter().any(|entry| entry.error == square)
            || unknown.iter().any(|error| square_of(*error) == square)
    };
    notes(&stages.machine, file.reference_axes, &is_measured, &is_stated)
}

/// Notes on the errors of a machine that are not unknowns of the observations, worded as for a calibration.
pub fn not_observed(observations: &Observations) -> Vec<String> {
    let unknown: Vec<ErrorName> = unknown(observations).collect();
    let is_measured = |name: ErrorName| unknown.contains(&name);
    let is_stated = |square: ErrorName| unknown.iter().any(|error| square_of(*error) == square);
    let axes = [AxisName::X, AxisName::Y];
    notes(&observations.machine, axes, &is_measured, &is_stated)
}

/// Notes on the errors for which a machine file has no value, worded as for a calibration.
pub fn not_stated(machine: &Machine) -> Vec<String> {
    let stated: Vec<ErrorName> = machine.locations().keys().copied().collect();
    let is_measured = |name: ErrorName| machine.error(name).is_some();
    let is_stated = |square: ErrorName| stated.iter().any(|error| square_of(*error) == square);
    let axes = [AxisName::X, AxisName::Y];
    notes(machine, axes, &is_measured, &is_stated)
}

/// Number of errors of a machine without a known value, which are treated as 0.
pub fn errors_without_value(machine: &Machine) -> usize {
    let motions = machine.axes().iter().flat_map(|axis| {
        let names = Component::ALL.map(|component| ErrorName::motion(component, axis.name));
        names.into_iter().filter(|name| machine.error(*name).is_none())
    });
    let is_stated = |square: ErrorName| {
        let mut stated = machine.locations().keys();
        stated.any(|error| square_of(*error) == square)
    };
    let axes = [AxisName::X, AxisName::Y];
    motions.count() + locations_not_measured(machine, axes, &is_stated).len()
}

/// Notes on the errors that were not measured: error motions by axis, then location errors including squareness, each with its possible effect, and
/// whether the machine file has a value.
fn notes(
    machine: &Machine,
    reference_axes: [AxisName; 2],
    is_measured: &dyn Fn(ErrorName) -> bool,
    is_stated: &dyn Fn(ErrorName) -> bool,
) -> Vec<String> {
    let mut notes = Vec::new();
    for axis in machine.axes() {
        let names = Component::ALL.map(|component| ErrorName::motion(component, axis.name));
        let not_measured = names.into_iter().filter(|name| !is_measured(*name));
        let (kept, missing): (Vec<_>, Vec<_>) =
            not_measured.partition(|name| machine.error(*name).is_some());
        for (what, names) in [
            ("not measured, taken as 0", missing),
            ("not measured, kept from the machine file", kept),
        ] {
            let names: Vec<String> = names.iter().map(ErrorName::to_string).collect();
            if !names.is_empty() {
                notes.push(format!("{what}: {}", names.join(" ")));
            }
        }
    }
    let names = locations_not_measured(machine, reference_axes, is_stated);
    let effects = largest_effects(machine, &names);
    for (name, effect) in names.into_iter().zip(effects) {
        let (unit, stated) = (name.component.symbol(), machine.locations().get(&name));
        let moves = |size: f64| {
            effect.map_or_else(String::new, |effect| {
                let most = size.abs() * effect;
                let size = (10.0 * size).round() / 10.0;
                format!(
                    ": {size} {unit} of it move the tool by up to {most:.1} µm within the travel"
                )
            })
        };
        notes.push(match stated {
            Some(value) => format!(
                "{name} was not measured and is kept from the machine file{}",
                moves(*value)
            ),
            None => format!("{name} was not measured and is taken as 0{}", moves(EXAMPLE)),
        });
    }
    notes
}

fn unknown(observations: &Observations) -> impl Iterator<Item = ErrorName> {
    observations.unknown.iter().map(|unknown| unknown.error)
}

/// Location errors that have an effect and are not stated. Of the two tilts that form a squareness, the tilt that is
/// not zero by definition is listed; the other tilt is listed only if the machine file states it.
fn locations_not_measured(
    machine: &Machine,
    reference_axes: [AxisName; 2],
    is_stated: &dyn Fn(ErrorName) -> bool,
) -> Vec<ErrorName> {
    let mut names = Vec::new();
    for joint in machine.chain().joints() {
        for component in Component::ALL {
            let name = ErrorName::location(component, joint.name);
            if joint.no_effect(component).is_some() {
                continue;
            }
            if is_square(name) {
                let is_reference = reference_of(reference_axes, name) == name.axis;
                let is_none = is_reference || machine.axis(partner_of(name)).is_none();
                let kept = machine.locations().get(&name);
                if is_none && kept.is_none_or(|value| *value == 0.0) {
                    continue;
                }
            }
            if !is_stated(square_of(name)) {
                names.push(name);
            }
        }
    }
    names
}

/// Largest displacement of the tool over the travels for 1 µm or 1 µrad of each error, µm: first order, with the tool of the machine file.
fn largest_effects(machine: &Machine, names: &[ErrorName]) -> Vec<Option<f64>> {
    let terms: Vec<ErrorTerm> = names.iter().copied().map(ErrorTerm::Named).collect();
    let nodes = machine.axes().iter().map(|axis| {
        let kind = axis.name.kind();
        let count = match kind {
            AxisKind::Linear => 2,
            AxisKind::Rotary => ROTARY_NODES,
        };
        let nodes = axis.nodes(count).into_iter();
        nodes.map(|at| Displacement::from_coordinate(kind, at).mm_or_rad()).collect()
    });
    let poses = Poses::Grid(nodes.collect());
    match sensitivity(machine.chain(), &terms, &poses) {
        Ok(found) => {
            let effects = found.errors.iter();
            effects.map(|e| Some(e.position_max_um)).collect()
        }
        // The list of names is empty, or there are too many poses.
        Err(_) => vec![None; names.len()],
    }
}

const STATED: &str = "stated in the calibration file";

/// Adds the origin of each error to the fitted machine. Origins of errors that were not measured again are kept from
/// the input machine file. No date is added, so that the same files give the same text.
fn with_provenance(
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
