//! Calibration: the stages over the lines of a file, the unknowns identified from its observations, and messages.

use std::collections::BTreeMap;

use volcomp_model::Machine;
use volcomp_vocabulary::{ErrorName, Urad};

use crate::{
    branches::FittedCurve,
    calibration_file::{CalibrationFile, Line, Location, located, measured},
    checks::{
        lines::{
            different_machines, files_of, odd, odd_values, same_readings, with_files, without_point,
        },
        result::not_followed,
    },
    error::CalibrateError,
    fitted::FittedLine,
    identified::{Identified, Scope, settled},
    not_measured::not_measured,
    provenance::with_provenance,
    stages::Stages,
};

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
