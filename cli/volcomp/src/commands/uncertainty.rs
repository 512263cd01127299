//! The option `--uncertainty`: Monte Carlo samples from a calibration or from observations of the same machine.
//!
//! The samples do not include errors that the observations do not determine; these errors are listed.

use std::path::{Path, PathBuf};

use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Serialize;
use volcomp_calibrate::{
    CalibrationFile, Ensemble, Scatter, calibrate, calibrated_machine, not_observed,
};
use volcomp_document::Document;
use volcomp_identify::{
    Identification, MachineSampler, Observations, UndeterminedError, identify, machine_with,
};
use volcomp_kinematics::{Form, State, nalgebra::Vector3};
use volcomp_model::{CompiledMachine, Machine, MapGrid, Temperatures, Tolerance};
use volcomp_vocabulary::Component;

use super::fixed;
use crate::{compensation::refuse_other_geometry, failure::Failure, output};

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
        let bar = output::bar(shifted, "machines");
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
            notes.extend(notes_on_machine(file, found, machine));
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

/// An error that the observations do not determine and an uncertainty does not include, and its
/// effect on the tool for a plausible size.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub(crate) struct NotCounted {
    /// Name of the unknown, such as `ECZ legendre 1`.
    pub(crate) unknown: String,
    /// Size for which the effect is stated.
    pub(crate) size: f64,
    /// The unit of the size: `um` or `urad`.
    pub(crate) unit: &'static str,
    /// Displacement of the tool by an error of this size, µm; for a map the maximum over its nodes.
    pub(crate) moves_um: f64,
    /// Rotation of the tool by an error of this size, µrad; for a map the maximum over its nodes.
    turns_urad: f64,
}

/// Size of an undetermined error for which its effect is reported, µm or µrad.
const EXAMPLE: f64 = 10.0;
/// Effects on the tool below this are not printed, µm.
const NOTHING_UM: f64 = 5e-4;

/// The errors that the observations do not determine. For each of them there is a machine in which it is [`EXAMPLE`]
/// larger, and the other errors are adjusted so that the observations stay the same.
pub(crate) struct Open {
    found: Machine,
    others: Vec<(UndeterminedError, Machine)>,
}

impl Open {
    pub(crate) fn nothing(found: Machine) -> Self {
        Self { found, others: Vec::new() }
    }

    pub(crate) fn new(
        observations: &Observations,
        found: &Identification,
        machine: &Machine,
    ) -> Result<Self, Failure> {
        let with = |by: &dyn Fn(&str) -> f64| -> Result<Machine, Failure> {
            let parameters = found.parameters.iter();
            let values: Vec<(String, f64)> =
                parameters.map(|of| (of.name.clone(), of.value + by(&of.name))).collect();
            let mut made = machine_with(observations, &values)?;
            made.use_tool_of(machine)?;
            Ok(made)
        };
        let other = |open: &UndeterminedError| {
            let moved = |name: &str| {
                let own = open.moves.iter().find(|(moved, _)| moved == name);
                own.map_or(0.0, |(_, by)| EXAMPLE * by)
            };
            Ok((open.clone(), with(&moved)?))
        };
        Ok(Self {
            found: with(&|_| 0.0)?,
            others: found.undetermined.iter().map(other).collect::<Result<_, Failure>>()?,
        })
    }

    /// The largest effect of each error on the tool over these states, largest first.
    pub(crate) fn at(&self, states: &[State]) -> Vec<NotCounted> {
        let place = |machine: &Machine, state: &State| {
            let error = machine.error_at(state, Form::Exact, &Temperatures::default());
            (error.position_mm, error.rotation_rad)
        };
        let found: Vec<_> = (states.iter()).map(|state| place(&self.found, state)).collect();
        let effect = |(open, machine): &(UndeterminedError, Machine)| {
            let longest = |of: &dyn Fn((Vector3<f64>, Vector3<f64>)) -> Vector3<f64>| {
                let pairs = states.iter().zip(&found);
                let moved =
                    pairs.map(|(state, found)| (of(place(machine, state)) - of(*found)).norm());
                moved.fold(0.0, f64::max)
            };
            NotCounted {
                unknown: open.name.clone(),
                size: EXAMPLE,
                unit: open.unit,
                moves_um: 1e3 * longest(&|(position, _)| position),
                turns_urad: 1e6 * longest(&|(_, rotation)| rotation),
            }
        };
        let mut effects: Vec<NotCounted> = self.others.iter().map(effect).collect();
        effects.sort_by(|a, b| b.moves_um.total_cmp(&a.moves_um));
        effects
    }
}

/// States on a grid over all axes, with at most five nodes per axis, ends included.
pub(crate) fn all_over(machine: &Machine, grid: &MapGrid) -> Result<Vec<State>, Failure> {
    const MOST: usize = 5;
    let mut places = vec![grid.others.clone()];
    for (axis, nodes) in grid.axes.iter().zip(&grid.nodes_mm) {
        let last = nodes.len().saturating_sub(1);
        let mut own: Vec<usize> = (0..MOST).map(|k| k * last / (MOST - 1)).collect();
        own.dedup();
        let own = nodes.iter().enumerate().filter(|(node, _)| own.contains(node));
        let with = |place: &Vec<_>| {
            own.clone().map(|(_, at)| [&place[..], &[(*axis, *at)]].concat()).collect::<Vec<_>>()
        };
        places = places.iter().flat_map(with).collect();
    }
    let states = places.iter().map(|place| Ok(machine.state(place)?));
    states.collect()
}

/// Describes the errors that an uncertainty does not include; empty if none of them moves the tool.
pub(crate) fn words(not_counted: &[NotCounted], place: &str) -> String {
    const SHOWN: usize = 6;
    let moving: Vec<&NotCounted> =
        not_counted.iter().filter(|of| of.moves_um >= NOTHING_UM).collect();
    if moving.is_empty() {
        return String::new();
    }
    let mut told: Vec<String> = moving.iter().take(SHOWN).map(|of| of.words()).collect();
    if moving.len() > SHOWN {
        told.push(format!("{} more that move it by less", moving.len() - SHOWN));
    }
    format!(
        "the observations do not determine these errors, and the uncertainty does not count them; {place} they move the tool by: {}",
        told.join(", ")
    )
}

impl NotCounted {
    /// Text such as `ECZ legendre 1 2.70 µm per 10 µrad`.
    pub(crate) fn words(&self) -> String {
        let symbol = if self.unit == "urad" { "µrad" } else { "µm" };
        format!("{} {} µm per {} {symbol}", self.unknown, fixed(self.moves_um, 3), self.size)
    }
}

/// Differences below this are ignored, µm and µrad. They are below measurement resolution, and rounding in other
/// program versions causes them.
const NO_MATTER: f64 = 0.05;
const MOST_NAMED: usize = 6;

fn notes_on_machine(file: &Path, found: &Machine, machine: &Machine) -> Vec<String> {
    let mut notes = Vec::new();
    if found.name != machine.name {
        notes.push(format!(
            "{} is of the machine {:?}, --machine is {:?}: is the uncertainty that of another machine?",
            file.display(),
            found.name,
            machine.name
        ));
    }
    notes.extend(other_places(file, found, machine));
    notes.extend(other_assembly(file, found, machine));
    notes.extend(other_thermal(file, found, machine));
    let mut differences = machine.differences(found);
    // NaN counts as a difference.
    differences.retain(|(_, by)| by.is_nan() || *by > NO_MATTER);
    if differences.is_empty() {
        return notes;
    }
    differences.sort_by(|a, b| b.1.total_cmp(&a.1));
    let more = differences.len().saturating_sub(MOST_NAMED);
    let named: Vec<String> = (differences.iter().take(MOST_NAMED))
        .map(|(name, by)| format!("{name} by {by:.2} {}", name.component.symbol()))
        .collect();
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    notes.push(format!(
        "--machine was not made from {}, whose measurements give other errors: at most {}{more}; the uncertainty is that of the errors which that file gives",
        file.display(),
        named.join(", ")
    ));
    notes
}

/// Note if errors of an axis refer to another point, which changes the lever of tilts, or if a travel differs;
/// otherwise `None`.
fn other_places(file: &Path, found: &Machine, machine: &Machine) -> Option<String> {
    let joints = found.chain().joints().iter().zip(machine.chain().joints());
    let points = joints.filter(|(a, b)| a.point_mm != b.point_mm);
    let points = points.map(|(joint, _)| format!("point of {}", joint.name));
    let axes = found.axes().iter().zip(machine.axes());
    let travels = axes.filter(|(a, b)| a.travel != b.travel);
    let travels = travels.map(|(axis, _)| format!("travel of {}", axis.name));
    let others: Vec<String> = points.chain(travels).collect();
    (!others.is_empty()).then(|| {
        format!(
            "{}: its machine is another one than --machine ({}): the uncertainty is that of the machine of that file",
            file.display(),
            others.join(", ")
        )
    })
}

fn other_assembly(file: &Path, found: &Machine, machine: &Machine) -> Option<String> {
    let axes = machine.axes().iter().enumerate();
    let differences = axes.flat_map(|(index, axis)| {
        let [a, b] = [found, machine].map(|of| of.assembly(index));
        let by = a.into_iter().zip(b).map(|(a, b)| (a - b).abs());
        by.zip(Component::ALL).map(move |(by, component)| (axis.name, component, by))
    });
    let matters = differences.filter(|(.., by)| *by > NO_MATTER);
    let (name, component, by) = matters.max_by(|a, b| a.2.total_cmp(&b.2))?;
    Some(format!(
        "{}: its machine has other [assembly] errors than --machine ({component:?} of {name} by {by:.2} {}): the uncertainty is that of the errors which that file gives",
        file.display(),
        component.symbol()
    ))
}

/// Note if the thermal terms differ, because the measurements then contain another thermal effect; otherwise `None`.
fn other_thermal(file: &Path, found: &Machine, machine: &Machine) -> Option<String> {
    let terms = |of: &Machine| {
        let thermal = of.thermal();
        let any = !thermal.expansion.is_empty() || !thermal.drift.is_empty();
        any.then(|| thermal.clone())
    };
    (terms(found) != terms(machine)).then(|| {
        format!(
            "{}: its machine has other [thermal] terms than --machine: the uncertainty is that of the terms of that file",
            file.display()
        )
    })
}
