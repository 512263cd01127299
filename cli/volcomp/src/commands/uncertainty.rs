//! The option `--uncertainty`: Monte Carlo samples from a calibration or from observations.

use std::path::{Path, PathBuf};

use rayon::prelude::*;
use volcomp_calibrate::{
    CalibrationFile, Ensemble, Scatter, calibrate, calibrated_machine, not_observed,
};
use volcomp_document::Document;
use volcomp_identify::{Identification, MachineSampler, Observations, identify};
use volcomp_model::{CompiledMachine, Machine, Tolerance};

use super::{not_counted::Open, same_machine};
use crate::{compensation::refuse_other_geometry, failure::Failure, progress};

/// Maximum deviation of a compiled curve of a Monte Carlo sample from its source, nm and nrad.
const TOLERANCE_NM: f64 = 10.0;

/// Where an uncertainty comes from.
#[derive(clap::Args)]
pub(crate) struct UncertaintyArguments {
    /// Add the standard uncertainty (k = 1) by Monte Carlo, from the calibration or observations file from which the
    /// machine was made
    #[arg(long, value_name = "FILE")]
    pub(crate) uncertainty: Option<PathBuf>,
    /// Number of Monte Carlo samples: 2 to 100000
    #[arg(long, default_value_t = 200, requires = "uncertainty", value_parser = clap::value_parser!(u64).range(2..=100_000))]
    pub(crate) trials: u64,
    /// Random seed; the same seed gives the same digits on any number of cores
    #[arg(long, default_value_t = 1, requires = "uncertainty")]
    pub(crate) seed: u64,
}

pub(crate) enum Measured {
    Calibration(Box<CalibrationFile>),
    Observations(Box<Observations>),
}

impl UncertaintyArguments {
    pub(crate) fn read(
        &self,
        machine: &Machine,
        notes: &mut Vec<String>,
    ) -> Result<Option<Measured>, Failure> {
        let Some(path) = &self.uncertainty else {
            return Ok(None);
        };
        let measured = Measured::read(path)?;
        let found = measured.machine().chain().structure();
        let expected = machine.chain().structure();
        if found != expected {
            return Err(Failure::Input(format!(
                "{}: found the structure `{found}`, expected `{expected}` of --machine",
                path.display()
            )));
        }
        refuse_other_geometry(path, measured.machine(), machine, &"--machine")?;
        if let Measured::Calibration(file) = &measured {
            let single = file.files_without_scatter();
            if !single.is_empty() {
                notes.push(format!(
                    "one run only, no scatter known: {}; state reading_um or reading_urad in [uncertainty]",
                    single.join(", ")
                ));
            }
        }
        Ok(Some(measured))
    }

    /// The Monte Carlo samples with the tool of this machine, and the errors that the measurements do not determine.
    pub(crate) fn ensemble(
        &self,
        measured: &Measured,
        machine: &Machine,
        notes: &mut Vec<String>,
    ) -> Result<(Ensemble, Open), Failure> {
        let shifted: usize = match measured {
            // One step for each machine shifted by one run of these lines, and one for the identified machine.
            Measured::Calibration(file) => {
                file.scatters().map(|of| of.runs.len()).sum::<usize>() + 1
            }
            Measured::Observations(_) => 0,
        };
        let bar = progress::bar(shifted, "machines");
        bar.inc_length(self.trials);
        let compiled = |mut drawn: Machine| {
            drawn.use_tool_of(machine)?;
            let compiled = drawn.compile(Tolerance::from_nm(TOLERANCE_NM))?;
            bar.inc(1);
            Ok::<_, Failure>(compiled)
        };
        let (ensemble, open) = match measured {
            Measured::Calibration(file) => {
                let found = calibrate(file, |_, _| {})?;
                self.is_of(&found.machine, machine, notes);
                notes.extend(as_if_known(found.not_measured));
                let open = match (&file.observations, &found.identified) {
                    (Some(observations), Some(identified)) => {
                        notes.extend(not_determined(&identified.found));
                        let mut observations = observations.clone();
                        observations.machine = found.machine.clone();
                        Open::new(&observations, &identified.found, machine)?
                    }
                    _ => Open::nothing(found.machine.clone()),
                };
                (self.of_calibration(file, found.machine, compiled)?, open)
            }
            Measured::Observations(observations) => {
                let mut observations = Observations::clone(observations);
                // Skip the cross-validation, whose result is not used here.
                observations.folds = 0;
                let found = identify(&observations, |_, _| {})?;
                self.is_of(&found.machine, machine, notes);
                notes.extend(not_determined(&found));
                notes.extend(as_if_known(not_observed(&observations)));
                let draws = MachineSampler::new(&observations, &found)?;
                let drawn = self.drawn(|trial| compiled(draws.machine(self.seed, trial)?))?;
                (drawn, Open::new(&observations, &found, machine)?)
            }
        };
        bar.finish_and_clear();
        // This cannot fail: clap ensures at least two samples, and `read` checks the structure.
        let differ = || Failure::Work("the drawn machines differ in structure".to_owned());
        Ok((ensemble.ok_or_else(differ)?, open))
    }

    fn is_of(&self, found: &Machine, machine: &Machine, notes: &mut Vec<String>) {
        if let Some(file) = &self.uncertainty {
            notes.extend(same_machine::notes(file, found, machine));
        }
    }

    fn drawn(
        &self,
        trial: impl Fn(u64) -> Result<CompiledMachine, Failure> + Sync + Send,
    ) -> Result<Option<Ensemble>, Failure> {
        let trials = (0..self.trials).into_par_iter().map(trial);
        Ok(Ensemble::new(trials.collect::<Result<Vec<_>, _>>()?))
    }

    fn of_calibration(
        &self,
        file: &CalibrationFile,
        found: Machine,
        compiled: impl Fn(Machine) -> Result<CompiledMachine, Failure> + Sync,
    ) -> Result<Option<Ensemble>, Failure> {
        let calibrated = |file: &CalibrationFile| compiled(calibrated_machine(file)?);
        let Some(ensemble) = self.drawn(|trial| calibrated(&file.varied(self.seed, trial)))? else {
            return Ok(None);
        };
        let mut scatters = Vec::new();
        for scatter in file.scatters() {
            let runs = scatter.runs.par_iter();
            let shifted = runs.map(|&run| calibrated(&file.shifted_by_run(scatter.line, run)));
            scatters.push(Scatter {
                degrees: scatter.degrees as f64,
                shifted: shifted.collect::<Result<Vec<_>, _>>()?,
            });
        }
        Ok(ensemble.with_scatters(compiled(found)?, scatters))
    }
}

impl Measured {
    /// Reads a file. Files with observations only are read as by `volcomp identify`.
    pub(super) fn read(path: &Path) -> Result<Self, Failure> {
        let document = Document::read(path)?;
        let is_calibration = document.decode(|root| {
            let own = CalibrationFile::KEYS.iter();
            let mut own = own.filter(|key| **key != "machine");
            let has_observations = root.get("observation").is_some();
            Ok::<_, Failure>(!has_observations || own.any(|key| root.get(key).is_some()))
        })?;
        Ok(if is_calibration {
            Self::Calibration(Box::new(CalibrationFile::read(path)?))
        } else {
            Self::Observations(Box::new(Observations::read(path)?))
        })
    }

    fn machine(&self) -> &Machine {
        match self {
            Self::Calibration(file) => &file.machine,
            Self::Observations(observations) => &observations.machine,
        }
    }
}

/// The notes on unmeasured errors, preceded by a sentence on their effect on an uncertainty.
fn as_if_known(not_measured: Vec<String>) -> Vec<String> {
    let what = "errors that were not measured are in the uncertainty as if they were known";
    let heading = (!not_measured.is_empty()).then(|| what.to_owned());
    heading.into_iter().chain(not_measured).collect()
}

/// Note on the errors that are the same in every sample, because the observations do not determine them; otherwise
/// `None`.
fn not_determined(found: &Identification) -> Option<String> {
    let names: Vec<&str> = found
        .parameters
        .iter()
        .filter(|parameter| !parameter.determined)
        .map(|parameter| parameter.name.as_str())
        .collect();
    (!names.is_empty()).then(|| {
        format!(
            "not determined by the observations, and in the uncertainty as if it were known: {}",
            names.join(", ")
        )
    })
}
