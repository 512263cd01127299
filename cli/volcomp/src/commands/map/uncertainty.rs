//! The uncertainty of a map: the readings of the calibration drawn again and again (JCGM 101).

use rayon::prelude::*;
use volcomp_calibrate::{CalibrationFile, calibrate};
use volcomp_model::{Ensemble, Machine, Tolerance};

use super::Arguments;
use crate::{failure::Failure, progress};

/// Reads the calibration whose readings are drawn; it must have the structure of the mapped machine.
pub(super) fn read_calibration(
    path: &std::path::Path,
    machine: &Machine,
    notes: &mut Vec<String>,
) -> Result<CalibrationFile, Failure> {
    let file = CalibrationFile::read(path)?;
    let (found, expected) = (
        file.machine.chain().structure(),
        machine.chain().structure(),
    );
    if found != expected {
        return Err(Failure::Input(format!(
            "{}: found the structure `{found}`, expected `{expected}` of --machine",
            path.display()
        )));
    }
    let single: Vec<String> = file
        .without_scatter()
        .map(|line| line.file.display().to_string())
        .collect();
    if !single.is_empty() {
        notes.push(format!(
            "one run only, no scatter known: {}; state reading_um or reading_urad in [uncertainty]",
            single.join(", ")
        ));
    }
    Ok(file)
}

/// Calibrations of readings drawn again, with the tool of the mapped machine.
pub(super) fn ensemble(
    file: &CalibrationFile,
    arguments: &Arguments,
    mapped: &Machine,
) -> Result<Ensemble, Failure> {
    let bar = progress::bar(0, "calibrations drawn");
    bar.set_length(arguments.trials);
    let trial = |trial: u64| {
        let mut machine = calibrate(&file.varied(arguments.seed, trial), |_, _| {})?.machine;
        machine.use_tool_of(mapped)?;
        let compiled = machine.compile(Tolerance::from_nm(10.0))?;
        bar.inc(1);
        Ok::<_, Failure>(compiled)
    };
    let trials = (0..arguments.trials).into_par_iter().map(trial);
    let machines = trials.collect::<Result<Vec<_>, _>>()?;
    bar.finish_and_clear();
    // At least two trials, all of one structure: clap and `read_calibration` see to it.
    Ensemble::new(machines)
        .ok_or_else(|| Failure::Work("the drawn calibrations differ in structure".to_owned()))
}
