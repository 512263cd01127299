//! Effect of the errors of a machine on its working space.

use std::collections::BTreeSet;

use volcomp_kinematics::{Form, State as Pose, volumetric_error};
use volcomp_model::{
    DIAGONAL_TARGETS, ErrorField, Machine, ModelError, Temperatures, diagonal_targets, diagonals,
    volumetric,
};
use volcomp_vocabulary::AxisName;

use crate::{
    report::{Diagonal, Diagonals, OfState, Report, State, Warning, WarningKind},
    volume::{tools, volume},
};

impl Report {
    /// Adds the body diagonals and the volumetric error of `machine` without correction, over the tools of its file. `before` is an earlier
    /// machine file of the same geometry, whose diagonals and error are added as the state before. Returns the note on thermal terms, which are
    /// not included. Once `is_cancelled` returns true, the errors count as 0: the search ends soon, and the caller discards the report.
    ///
    /// # Errors
    /// A machine whose errors cannot be evaluated.
    pub fn add_working_space(
        &mut self,
        machine: &Machine,
        before: Option<&Machine>,
        is_cancelled: &dyn Fn() -> bool,
    ) -> Result<Option<String>, ModelError> {
        let found = (State::Found, machine);
        let (first, second) = match before {
            Some(before) => ((State::GivenBefore, before), Some(found)),
            None => (found, None),
        };
        let along = |(state, of): (State, &Machine)| {
            let found = body_diagonals(machine, of, &[], |pose| *pose)?;
            Ok::<_, ModelError>(found.map(|found| OfState { state, found }))
        };
        self.diagonals = match along(first)? {
            Some(before) => {
                Some(Diagonals { before, after: second.map(along).transpose()?.flatten() })
            }
            None => None,
        };
        let tools = tools(machine)?;
        let with_tools = tools.iter().map(|(_, with_tool)| {
            let mut of = before.unwrap_or(machine).clone();
            of.use_tool_of(with_tool)?;
            Ok(of)
        });
        let earlier = with_tools.collect::<Result<Vec<_>, ModelError>>()?;
        let now: Vec<_> = tools.iter().map(|(_, of)| errors(of, is_cancelled)).collect();
        let then: Vec<_> = earlier.iter().map(|of| errors(of, is_cancelled)).collect();
        let now = fields(&tools, &earlier, &now);
        let then = fields(&tools, &earlier, &then);
        let found = volumetric(&now)?;
        self.volume = match before {
            Some(_) => volume(
                [machine; 2],
                &[],
                (State::GivenBefore, &then, volumetric(&then)?),
                Some((State::Found, &now, found)),
            ),
            None => volume([machine; 2], &[], (State::Found, &now, found), None),
        }?;
        let machines = [Some(machine), before].into_iter().flatten();
        Ok(self.leave_out_temperatures(machine.thermal().reference_degc, machines))
    }

    /// Records that the thermal terms of these machines are not included, so that a figure within its tolerance is undecided. Returns the
    /// note; `None` for machines without thermal terms.
    pub fn leave_out_temperatures<'a>(
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

/// Position (mm) and rotation (rad) of the error at a pose, in workpiece axes, at the reference temperature.
fn errors<'a>(
    machine: &'a Machine,
    is_cancelled: &'a dyn Fn() -> bool,
) -> impl Fn(&Pose) -> [f64; 6] + 'a {
    let none = Temperatures::new();
    move |pose| {
        if is_cancelled() {
            return [0.0; 6];
        }
        let source = machine.source(&none);
        let found = volumetric_error(machine.chain(), &source, pose, Form::Exact);
        let (p, r) = (found.position_mm, found.rotation_rad);
        [p.x, p.y, p.z, r.x, r.y, r.z]
    }
}

/// Error fields of each tool. The curves of both machines determine the sampled poses, so that both machines are
/// evaluated at the same poses.
fn fields<'a>(
    tools: &'a [(&'a str, Machine)],
    earlier: &'a [Machine],
    errors: &'a [impl Fn(&Pose) -> [f64; 6]],
) -> Vec<ErrorField<'a>> {
    let all = tools.iter().zip(earlier).zip(errors);
    all.map(|(((tool, machine), earlier), errors)| ErrorField {
        tool,
        machine,
        curves: vec![machine, earlier],
        errors,
    })
    .collect()
}

/// Evaluates the body diagonals of a machine with the errors of `actual`, other axes at `others` (mm or deg). `command` returns the commanded
/// pose of a target. `None` for a machine that lacks one of the axes X, Y and Z.
///
/// # Errors
/// The errors of [`Machine::state`] for `others`.
pub fn body_diagonals(
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
