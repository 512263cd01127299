//! Computes the machine file and the report from the calibration file, and the drift since earlier models.

use serde::Serialize;
use volcomp_calibrate::{Calibration, CalibrationFile, LeftOver, calibrate};
use volcomp_model::Machine;
use volcomp_report::{
    Report, Stated, Tolerance, Verdict as Outcome, checks, html, plot::escaped, refuse_two_units,
    tolerances,
};
use volcomp_vocabulary::ErrorName;

use crate::{
    error::StudioError,
    folder::{CALIBRATION, FITTED, Folder, INPUTS, MACHINE, REPORT},
    questions::{name_of, with_answers},
};

/// Result of a fit. The report holds the curves with their bands, the map and the figures.
#[derive(Clone, Debug, Serialize)]
pub struct FitResult {
    /// The checksum of the machine file.
    pub machine: String,
    pub verdict: Verdict,
    /// Each figure with its tolerance, in words.
    pub checks: Vec<String>,
    /// Largest volumetric error over poses of all axes after best-fit rigid-body alignment, µm; `None` if the machine
    /// has fewer than two linear axes.
    pub position_um: Option<f64>,
    /// `position_um` of the compared earlier model; `None` if no model was compared.
    pub before_um: Option<f64>,
    /// The pose of the largest volumetric error.
    pub worst_at: Option<String>,
    /// Number of fitted curves.
    pub curves: usize,
    /// Messages to read before using the machine file, the most severe first.
    pub warnings: Vec<String>,
}

/// Overall verdict on the tolerances.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// Every figure is within its limit.
    Pass,
    /// A figure is beyond its limit.
    Fail,
    /// A figure is closer to its limit than its uncertainty, or cannot be evaluated.
    Undecided,
    /// No tolerance was stated.
    None,
}

impl Verdict {
    fn of(report: &Report, limits: &[Tolerance]) -> Self {
        let outcomes = report.checks.iter().map(|check| check.outcome);
        match Outcome::of_all(outcomes) {
            _ if limits.is_empty() => Self::None,
            Outcome::Pass => Self::Pass,
            Outcome::Fail => Self::Fail,
            Outcome::Undecided | Outcome::NotEvaluated => Self::Undecided,
        }
    }
}

struct MachineWithReport {
    machine: Machine,
    report: Report,
    missed: Vec<String>,
    inputs: String,
}

impl Folder {
    /// Fits the measurements, and writes `result/machine.toml` and `result/report.html`. Without measurement files the
    /// result is the machine file with its stated errors.
    ///
    /// `allowed` holds tolerances in the form of `volcomp report --tolerance`, such as `A=10,EC0Y=20`; it may be empty.
    /// `earlier` names one of [`State::models`](crate::State::models), with whose errors the report compares the fitted
    /// ones.
    ///
    /// # Errors
    /// Questions are open, the readings do not determine any error, a tolerance is invalid, or the earlier model has
    /// another geometry.
    pub fn fit(&self, allowed: &str, earlier: Option<&str>) -> Result<FitResult, StudioError> {
        let limits = match allowed.trim() {
            "" => Vec::new(),
            text => tolerances(text)?,
        };
        let MachineWithReport { machine, mut report, missed, inputs } = self.found()?;
        let earlier = earlier.map(|name| self.earlier(name, &machine)).transpose()?;
        let is_cancelled = || self.interrupt.is_cancelled();
        report.add_working_space(&machine, earlier.as_ref(), None, &[], &is_cancelled)?;
        self.interrupt.check()?;
        refuse_two_units(&report, &limits)?;
        report.checks = checks(&report, &limits);
        // File names are relative to the folder, as in the calibration file.
        let folder = escaped(&self.at("").display().to_string());
        let page = html(&report).replace(&folder, "");
        let text = machine.to_toml();
        self.interrupt.check()?;
        self.set_outputs_aside(&text)?;
        self.write(FITTED, text.as_bytes())?;
        self.write(REPORT, page.as_bytes())?;
        self.write(INPUTS, inputs.as_bytes())?;
        let volume = report.volume.as_ref();
        let size = volume.map(|volume| &volume.after.as_ref().unwrap_or(&volume.before).found);
        let before = volume.filter(|volume| volume.after.is_some());
        let warnings = report.warnings.iter().map(|of| of.text.clone());
        let warnings = missed.into_iter().chain(warnings);
        Ok(FitResult {
            machine: machine.checksum(),
            verdict: Verdict::of(&report, &limits),
            checks: report.checks.iter().map(|of| self.relative(of)).collect(),
            position_um: size.map(|size| size.form_max_um),
            before_um: before.map(|volume| volume.before.found.form_max_um),
            worst_at: size.map(volcomp_report::Size::place),
            curves: report.curves.len(),
            warnings: warnings.map(|text| self.relative(&text)).collect(),
        })
    }

    /// An earlier model with the tool of the present one.
    pub(crate) fn earlier(&self, name: &str, machine: &Machine) -> Result<Machine, StudioError> {
        if !self.models()?.iter().any(|known| known.name == name) {
            return Err(StudioError::Request {
                key: "earlier",
                why: format!("found {name:?}, expected one of the earlier models"),
            });
        }
        let mut earlier = Machine::read(self.at(name))?;
        if let Some(difference) = earlier.other_geometry(machine) {
            return Err(StudioError::Request {
                key: "earlier",
                why: format!("{name}: {difference} of the machine"),
            });
        }
        earlier.use_tool_of(machine)?;
        Ok(earlier)
    }

    fn found(&self) -> Result<MachineWithReport, StudioError> {
        let stated = |machine: &Machine| Stated {
            machine: (!machine.name.is_empty()).then(|| machine.name.clone()),
            ..Stated::default()
        };
        let left_over = if self.is_by_hand() {
            Vec::new()
        } else if self.measurement_files()?.is_empty() {
            let machine = self.machine()?;
            return Ok(MachineWithReport {
                inputs: self.inputs(&[])?,
                report: Report::of_machine(MACHINE, &machine, &stated(&machine)),
                machine,
                missed: Vec::new(),
            });
        } else {
            self.calibration_file()?
        };
        let file = CalibrationFile::read(&self.at(CALIBRATION))?;
        // Hash the inputs before the fit, because a file may change during the fit.
        let inputs = self.inputs(&file.files)?;
        let calibration = calibrate(&file, |_, _| {})?;
        self.interrupt.check()?;
        let stated = stated(&calibration.machine);
        Ok(MachineWithReport {
            report: Report::of_calibration(CALIBRATION, &file, &calibration, &stated),
            missed: missed(&left_over, &calibration, &file).collect(),
            inputs,
            machine: calibration.machine,
        })
    }

    fn calibration_file(&self) -> Result<Vec<LeftOver>, StudioError> {
        let machine = self.machine()?;
        let draft = self.draft(self.measurement_files()?, &machine);
        if draft.proposed.is_empty() {
            let reasons: Vec<String> = draft.left_over.iter().map(ToString::to_string).collect();
            let reasons = match reasons[..] {
                [] => String::new(),
                _ => format!(": {}", reasons.join("; ")),
            };
            return Err(StudioError::NoMeasurement { reasons });
        }
        let given = self.answers()?;
        let whole = with_answers(&draft, &given)?.whole;
        self.keep(&given, &whole)?;
        if let Some(first) = whole.questions.first() {
            return Err(StudioError::Open {
                count: whole.questions.len(),
                first: format!("{} of {}", first.key, first.of),
            });
        }
        if whole.proposed.is_empty() {
            let all: Vec<String> = draft.proposed.iter().map(name_of).collect();
            let reasons = format!(": {} are left out", all.join(", "));
            return Err(StudioError::NoMeasurement { reasons });
        }
        Ok(whole.left_over)
    }
}

/// One warning for each error that was not measured because its file was not used. Two separate messages would be far
/// apart in the list of warnings.
fn missed<'a>(
    left_over: &'a [LeftOver],
    calibration: &'a Calibration,
    file: &'a CalibrationFile,
) -> impl Iterator<Item = String> + 'a {
    left_over.iter().filter_map(|of| {
        let error = of.error?;
        let mut curves = calibration.curves.iter();
        if curves.any(|curve| curve.error == error) {
            return None;
        }
        let taken = match file.machine.error(error) {
            Some(_) => "kept from machine.toml",
            None => "taken as 0",
        };
        Some(format!(
            "{error} is {taken}, because its file was not used: {}: {}",
            of.file, of.reason
        ))
    })
}

/// A model of the folder in comparison with the newest one.
#[derive(Clone, Debug, Serialize)]
pub struct ModelDrift {
    /// Largest volumetric error after best-fit rigid-body alignment, µm, as in the verdict on V.
    pub position_um: Option<f64>,
    /// The errors that differ from the newest model, the largest effect first. The effect of an angle is its
    /// displacement over the diagonal of the travels.
    pub changes: Vec<ErrorChange>,
}

/// Difference of an error between two models.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ErrorChange {
    pub error: String,
    /// Largest difference over the travel, µm or µrad.
    pub largest: f64,
    /// `µm` or `µrad`.
    pub unit: &'static str,
}

impl Folder {
    /// Compares a model with `result/machine.toml`. The model is that file itself or one of
    /// [`State::models`](crate::State::models).
    ///
    /// # Errors
    /// There is no result, the model is unknown, or it has another geometry.
    pub fn drift(&self, name: &str) -> Result<ModelDrift, StudioError> {
        if !self.at(FITTED).exists() {
            return Err(StudioError::NoResult);
        }
        let newest = Machine::read(self.at(FITTED))?;
        let model = if name == FITTED { newest.clone() } else { self.earlier(name, &newest)? };
        let mut report = Report::of_machine(name, &model, &Stated::default());
        report.add_working_space(&model, None, None, &[], &|| self.interrupt.is_cancelled())?;
        self.interrupt.check()?;
        let position_um = report.volume.map(|volume| volume.before.found.form_max_um);
        Ok(ModelDrift { position_um, changes: changes(&model, &newest) })
    }
}

fn changes(model: &Machine, newest: &Machine) -> Vec<ErrorChange> {
    let lever_m = 1e-3 * newest.diagonal_of_travels_mm();
    let effect_um = |(error, largest): &(ErrorName, f64)| {
        if error.component.is_angular() { *largest * lever_m } else { *largest }
    };
    let mut all = newest.differences(model);
    all.retain(|(_, largest)| *largest != 0.0);
    all.sort_by(|a, b| effect_um(b).total_cmp(&effect_um(a)));
    let named = all.into_iter().map(|(error, largest)| ErrorChange {
        error: error.to_string(),
        largest,
        unit: error.component.symbol(),
    });
    named.collect()
}
