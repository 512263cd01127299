//! Correction of a command before the error is computed. The error is that of the model itself, or of another machine
//! file used as the truth. The correction may be rounded to the resolution of a control.

use std::{path::PathBuf, sync::OnceLock};

use clap::Args;
use schemars::JsonSchema;
use serde::Serialize;
use volcomp_kinematics::{CorrectionOptions, ErrorSource, Form, State, correct, volumetric_error};
use volcomp_model::{
    CompiledMachine, FINE_CURVES_NM, Machine, Temperatures, Tolerance, corrected, quantised,
    residual,
};

use crate::{commands::thermal_note, failure::Failure, table::folded};

/// Position (mm) and rotation (rad) of the error at a state, in workpiece axes.
pub(crate) type ErrorAt<'a> = Box<dyn Fn(&State) -> [f64; 6] + Sync + 'a>;

/// The error to all orders at many states.
pub(crate) fn errors<'a>(machine: &'a Machine, temperatures: &Temperatures) -> ErrorAt<'a> {
    errors_by(machine, machine.fine_source(temperatures), Form::Exact)
}

/// The error by a form of the model, with the curves of `source`.
pub(crate) fn errors_by<'a>(
    machine: &'a Machine,
    source: Box<dyn ErrorSource + Sync + 'a>,
    form: Form,
) -> ErrorAt<'a> {
    Box::new(move |state| {
        let found = volumetric_error(machine.chain(), &&*source, state, form);
        let (p, r) = (found.position_mm, found.rotation_rad);
        [p.x, p.y, p.z, r.x, r.y, r.z]
    })
}

/// How the correction is applied.
#[derive(Args)]
pub(crate) struct CompensationArguments {
    /// Apply the correction of the machine file; implied by --truth and --resolution
    #[arg(long)]
    pub(crate) compensated: bool,
    /// Machine file with the real errors; a compensated result proves nothing about the machine if this is not given
    #[arg(long, value_name = "MACHINE")]
    pub(crate) truth: Option<PathBuf>,
    /// Step of the control to which the correction is rounded: µm on linear, µrad on rotary axes
    #[arg(long, value_name = "STEP", value_parser = resolution)]
    pub(crate) resolution: Option<f64>,
}

pub(crate) fn resolution(text: &str) -> Result<f64, String> {
    let step = text.parse().ok().filter(|step: &f64| *step > 0.0 && step.is_finite());
    step.ok_or_else(|| "expected a step above 0 (µm, µrad)".to_owned())
}

impl CompensationArguments {
    pub(crate) fn is_asked_for(&self) -> bool {
        self.compensated || self.truth.is_some() || self.resolution.is_some()
    }
}

/// How a correction was applied before the errors were computed.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub(crate) struct Compensated {
    /// Machine file whose errors act on the corrected command; null: the model itself, so that the
    /// result is no proof of accuracy.
    pub(crate) truth: Option<String>,
    /// Step to which the correction of linear axes is rounded, µm; null: not rounded.
    pub(crate) resolution_um: Option<f64>,
    /// Step to which the correction of rotary axes is rounded, µrad; the same number as for linear
    /// axes.
    pub(crate) resolution_urad: Option<f64>,
}

/// The machine whose correction is applied (the model), and the machine to which the correction is applied (the truth
/// if given, otherwise the model).
pub(crate) struct Compensation<'a> {
    machine: &'a Machine,
    temperatures: &'a Temperatures,
    options: CorrectionOptions,
    truth: Option<Machine>,
    document: Option<Compensated>,
    /// Compiled curves of the model and of the truth, created on first use; `None` if the curves cannot be compiled.
    compiled: OnceLock<Option<[CompiledMachine; 2]>>,
}

impl<'a> Compensation<'a> {
    pub(crate) fn new(
        arguments: &CompensationArguments,
        machine: &'a Machine,
        temperatures: &'a Temperatures,
    ) -> Result<Self, Failure> {
        let truth = match &arguments.truth {
            Some(path) => Some(read_truth(path, machine)?),
            None => None,
        };
        let document = arguments.is_asked_for().then(|| Compensated {
            truth: arguments.truth.as_ref().map(|p| p.display().to_string()),
            resolution_um: arguments.resolution,
            resolution_urad: arguments.resolution,
        });
        Ok(Self {
            machine,
            temperatures,
            options: machine.correction_options(),
            truth,
            document,
            compiled: OnceLock::new(),
        })
    }

    /// Note on thermal terms of the truth without a given temperature; otherwise `None`.
    pub(crate) fn note(&self) -> Option<String> {
        let truth = self.truth.as_ref()?;
        let note = thermal_note(truth, self.temperatures)?;
        let path = self.document.as_ref()?.truth.as_ref()?;
        Some(format!("{path}: {note}"))
    }

    pub(crate) fn actual(&self) -> &Machine {
        self.truth.as_ref().unwrap_or(self.machine)
    }

    /// The command for a target: the target itself, or the target plus the correction.
    pub(crate) fn command(&self, target: &State) -> State {
        self.command_by(&self.machine.source(self.temperatures), target)
    }

    fn command_by(&self, model: &impl ErrorSource, target: &State) -> State {
        let Some(asked) = &self.document else {
            return *target;
        };
        let found = correct(self.machine.chain(), model, target, &self.options);
        let delta = match (asked.resolution_um, asked.resolution_urad) {
            (Some(um), Some(urad)) => quantised(self.machine, &found.delta, um * 1e-3, urad * 1e-6),
            _ => found.delta,
        };
        corrected(target, &delta)
    }

    /// Position (mm) and rotation (rad) of the tool at the corrected command relative to the ideal machine at the target, in workpiece axes: to all
    /// orders, with curves within [`FINE_CURVES_NM`].
    pub(crate) fn residual(&self, target: &State) -> [f64; 6] {
        let compiled = self.compiled.get_or_init(|| {
            let tolerance = Tolerance::from_nm(FINE_CURVES_NM);
            let compiled = |of: &Machine| of.compile_at(tolerance, self.temperatures).ok();
            Some([compiled(self.machine)?, compiled(self.actual())?])
        });
        match compiled {
            Some([model, actual]) => self.residual_by(model, actual, target),
            None => self.exact_residual(target),
        }
    }

    /// The residual with the curves of the machine files instead of the compiled curves.
    pub(crate) fn exact_residual(&self, target: &State) -> [f64; 6] {
        let [model, actual] = [self.machine, self.actual()].map(|of| of.source(self.temperatures));
        self.residual_by(&model, &actual, target)
    }

    fn residual_by<S: ErrorSource>(&self, model: &S, actual: &S, target: &State) -> [f64; 6] {
        residual(self.actual().chain(), actual, &self.command_by(model, target), target)
    }

    pub(crate) fn document(&self) -> Option<Compensated> {
        self.document.clone()
    }

    /// A paragraph to print below the figures: the correction, its rounding and its machine; empty without a
    /// correction.
    pub(crate) fn words(&self) -> String {
        let Some(asked) = &self.document else {
            return String::new();
        };
        let step = match (asked.resolution_um, asked.resolution_urad) {
            (Some(um), Some(urad)) => format!(", rounded to {um} µm and {urad} µrad"),
            _ => ", not rounded".to_owned(),
        };
        let sentence = match &asked.truth {
            Some(truth) => format!("With the correction of the model{step}, on {truth}."),
            None => format!(
                "With the correction{step}: the model against itself. What it is worth on a machine whose errors are \
                 not the model's is shown by --truth MACHINE."
            ),
        };
        format!("\n{}", folded(&sentence, ""))
    }
}

fn read_truth(path: &std::path::Path, machine: &Machine) -> Result<Machine, Failure> {
    let mut truth = Machine::read(path)?;
    refuse_other_geometry(path, &truth, machine, &"--machine")?;
    truth.use_tool_of(machine)?;
    Ok(truth)
}

/// Rejects a file whose machine differs in geometry from the expected machine. `of` names the option or file of the
/// expected machine.
pub(crate) fn refuse_other_geometry(
    path: &std::path::Path,
    found: &Machine,
    machine: &Machine,
    of: &dyn std::fmt::Display,
) -> Result<(), Failure> {
    match found.other_geometry(machine) {
        Some(difference) => Err(Failure::in_file(path, format_args!("{difference} of {of}"))),
        None => Ok(()),
    }
}
