//! Effect of the errors of a machine on its working space.

use std::collections::BTreeSet;

use volcomp_kinematics::{ErrorSource, Form, State as Pose, correct, volumetric_error};
use volcomp_model::{
    DIAGONAL_TARGETS, ErrorField, Machine, ModelError, Temperatures, corrected, diagonal_targets,
    diagonals, residual, volumetric,
};
use volcomp_vocabulary::AxisName;

use crate::{
    report::{Diagonal, Diagonals, OfState, Report, State, Warning, WarningKind},
    volume::{tools, volume},
};

impl Report {
    /// Adds the body diagonals and the volumetric error of `machine`, over the tools of its file, with the axes other than X, Y and Z at `others` (mm
    /// or deg) in the diagonals and maps. `before` and `truth` are machine files of the same geometry: the errors before a compensation, and the true
    /// errors, of which the last state is what correction by `machine` leaves. Returns the note on thermal terms, which are not included. Once
    /// `is_cancelled` returns true, the errors count as 0: the search ends soon, and the caller discards the report.
    ///
    /// # Errors
    /// A machine whose errors cannot be evaluated; the errors of [`Machine::state`] for `others`.
    pub fn add_working_space(
        &mut self,
        machine: &Machine,
        before: Option<&Machine>,
        truth: Option<&Machine>,
        others: &[(AxisName, f64)],
        is_cancelled: &dyn Fn() -> bool,
    ) -> Result<Option<String>, ModelError> {
        let found = (State::Found, machine);
        let left = truth.map(|truth| (State::TruthCorrected, truth));
        let (first, second) = match (before, truth) {
            (Some(before), _) => ((State::GivenBefore, before), left.or(Some(found))),
            (None, Some(truth)) => ((State::Truth, truth), left),
            (None, None) => (found, None),
        };
        let tools = tools(machine)?;
        let with_tools = |(state, actual): (State, &Machine)| {
            let with_tool = |(_, model): &(&str, Machine)| {
                let mut actual = actual.clone();
                actual.use_tool_of(model)?;
                Ok(actual)
            };
            let actual = tools.iter().map(with_tool).collect::<Result<Vec<_>, ModelError>>()?;
            Ok::<_, ModelError>((state, actual))
        };
        let both = [Some(first), second].into_iter().flatten();
        let both = both.map(with_tools).collect::<Result<Vec<_>, ModelError>>()?;
        let along = |(state, actual): &(State, Vec<Machine>)| {
            let source = machine.source(&Temperatures::new());
            let command = |pose: &Pose| command(machine, &source, *state, pose);
            // The first tool is that of the machine.
            let actual = actual.first().unwrap_or(machine);
            let found = body_diagonals(machine, actual, others, command)?;
            Ok(found.map(|found| OfState { state: *state, found }))
        };
        let along = both.iter().map(along).collect::<Result<Vec<_>, ModelError>>()?;
        let mut along = along.into_iter().flatten();
        self.diagonals = along.next().map(|before| Diagonals { before, after: along.next() });
        let errors = both.iter().map(|(state, actual)| {
            let each = tools.iter().zip(actual);
            let each = each.map(|((_, model), actual)| errors(model, actual, *state, is_cancelled));
            each.collect::<Vec<_>>()
        });
        let errors: Vec<Vec<_>> = errors.collect();
        let fields = errors.iter().map(|errors| fields(&tools, &both, errors));
        let fields: Vec<Vec<ErrorField<'_>>> = fields.collect();
        let mut states = Vec::new();
        for ((state, _), fields) in both.iter().zip(&fields) {
            states.push((*state, &fields[..], volumetric(fields)?));
        }
        let mut states = states.into_iter();
        let judged = second.unwrap_or(first).1;
        self.volume = match states.next() {
            Some(first) => volume([machine, judged], others, first, states.next())?,
            None => None,
        };
        let machines = [Some(machine), before, truth].into_iter().flatten();
        Ok(self.leave_out_temperatures(machine.thermal().reference_degc, machines))
    }

    /// Records that the thermal terms of these machines are not included, so that a figure within its tolerance is undecided. Returns the
    /// note; `None` for machines without thermal terms.
    fn leave_out_temperatures<'a>(
        &mut self,
        reference_degc: f64,
        machines: impl IntoIterator<Item = &'a Machine>,
    ) -> Option<String> {
        let sensors: BTreeSet<&str> =
            machines.into_iter().flat_map(|of| of.thermal().sensors()).collect();
        if sensors.is_empty() {
            return None;
        }
        if let Some(volume) = &mut self.volume {
            volume.has_thermal = true;
        }
        let text = format!(
            "the figures computed from the model hold at {reference_degc} °C: thermal terms of {} are left out; `volcomp map --temperature` gives the volumetric error at others, `volcomp check` what each kelvin adds",
            sensors.into_iter().collect::<Vec<_>>().join(", ")
        );
        self.warnings.push(Warning { kind: WarningKind::Temperature, text: text.clone() });
        Some(text)
    }
}

/// The command for a target in this state: the target, or the target with the correction of the model, whose errors are `source`.
fn command(model: &Machine, source: &impl ErrorSource, state: State, target: &Pose) -> Pose {
    if state != State::TruthCorrected {
        return *target;
    }
    let found = correct(model.chain(), source, target, &model.correction_options());
    corrected(target, &found.delta)
}

/// Position (mm) and rotation (rad) of the error at a pose, in workpiece axes, at the reference temperature.
fn errors<'a>(
    model: &'a Machine,
    actual: &'a Machine,
    state: State,
    is_cancelled: &'a dyn Fn() -> bool,
) -> impl Fn(&Pose) -> [f64; 6] + 'a {
    let none = Temperatures::new();
    let of_model = (state == State::TruthCorrected).then(|| model.fine_source(&none));
    let of_actual = actual.fine_source(&none);
    move |pose| {
        if is_cancelled() {
            return [0.0; 6];
        }
        let (chain, source) = (actual.chain(), &&*of_actual);
        if let Some(of_model) = &of_model {
            return residual(chain, source, &command(model, &&**of_model, state, pose), pose);
        }
        let found = volumetric_error(chain, source, pose, Form::Exact);
        let (p, r) = (found.position_mm, found.rotation_rad);
        [p.x, p.y, p.z, r.x, r.y, r.z]
    }
}

/// Error fields of each tool. The curves of all machines determine the sampled poses, so that all states are evaluated at the same ones.
fn fields<'a>(
    tools: &'a [(&'a str, Machine)],
    states: &'a [(State, Vec<Machine>)],
    errors: &'a [impl Fn(&Pose) -> [f64; 6]],
) -> Vec<ErrorField<'a>> {
    let all = tools.iter().zip(errors).enumerate();
    all.map(|(place, ((tool, machine), errors))| {
        let actual = states.iter().filter_map(|(_, actual)| actual.get(place));
        ErrorField { tool, machine, curves: [machine].into_iter().chain(actual).collect(), errors }
    })
    .collect()
}

/// Evaluates the body diagonals of a machine with the errors of `actual`, other axes at `others` (mm or deg). `command` returns the commanded
/// pose of a target. `None` for a machine that lacks one of the axes X, Y and Z.
///
/// # Errors
/// The errors of [`Machine::state`] for `others`.
fn body_diagonals(
    machine: &Machine,
    actual: &Machine,
    others: &[(AxisName, f64)],
    command: impl Fn(&Pose) -> Pose,
) -> Result<Option<Vec<Diagonal>>, ModelError> {
    let mut linear = [AxisName::X, AxisName::Y, AxisName::Z].into_iter();
    if !linear.all(|name| machine.axis(name).is_some()) {
        return Ok(None);
    }
    let points = DIAGONAL_TARGETS as usize;
    let none = Temperatures::new();
    let along = diagonals(actual, &actual.source(&none), points, others, command)?;
    let targets = diagonal_targets(actual, points, others)?;
    let named = along.into_iter().zip(targets).map(|(found, (_, poses))| {
        let tips = poses.iter().map(|pose| machine.chain().ideal_tip_mm(pose));
        let tips: Vec<_> = tips.collect();
        let from = tips.first().copied().unwrap_or_default();
        let places = tips.iter().map(|tip| (tip - from).norm());
        Diagonal {
            name: found.name.to_owned(),
            points: places.zip(found.deviation_um).collect(),
            range_um: found.range_um,
        }
    });
    Ok(Some(named.collect()))
}
