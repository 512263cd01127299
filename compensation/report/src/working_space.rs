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
    /// Adds the body diagonals and the volumetric error of `machine` without correction, for the shortest and the longest tool. Returns the
    /// note on thermal terms, which are not included.
    ///
    /// # Errors
    /// A machine whose errors cannot be evaluated.
    pub fn add_working_space(&mut self, machine: &Machine) -> Result<Option<String>, ModelError> {
        let along = body_diagonals(machine, machine, &[], |pose| *pose)?;
        self.diagonals = along.map(|found| Diagonals {
            before: OfState {
                state: State::Found,
                found,
            },
            after: None,
        });
        let tools = tools(machine)?;
        let none = Temperatures::new();
        let errors_of = |(_, machine)| {
            let (machine, none): (&Machine, _) = (machine, &none);
            move |pose: &Pose| {
                let source = machine.source(none);
                let found = volumetric_error(machine.chain(), &source, pose, Form::Exact);
                let (p, r) = (found.position_mm, found.rotation_rad);
                [p.x, p.y, p.z, r.x, r.y, r.z]
            }
        };
        let errors: Vec<_> = tools
            .iter()
            .map(|(tool, machine)| errors_of((tool, machine)))
            .collect();
        let fields = tools.iter().zip(&errors);
        let fields: Vec<_> = fields
            .map(|((tool, machine), errors)| ErrorField {
                tool,
                machine,
                curves: vec![machine],
                errors,
            })
            .collect();
        let found = volumetric(&fields)?;
        self.volume = volume([machine; 2], &[], (State::Found, &fields, found), None)?;
        Ok(self.leave_out_temperatures(machine.thermal().reference_degc, [machine]))
    }

    /// Records that the thermal terms of these machines are not included, which makes a figure within its tolerance undecided. Returns the
    /// note; `None` for machines without thermal terms.
    pub fn leave_out_temperatures<'a>(
        &mut self,
        reference_degc: f64,
        machines: impl IntoIterator<Item = &'a Machine>,
    ) -> Option<String> {
        let sensors: BTreeSet<&str> = machines
            .into_iter()
            .flat_map(|of| of.thermal().sensors())
            .collect();
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
        self.warnings.push(Warning {
            kind: WarningKind::Temperature,
            text: text.clone(),
        });
        Some(text)
    }
}

/// The body diagonals of a machine with the errors of `actual`, other axes at `others` (mm or deg); `command` returns the commanded pose of
/// a target. `None` for a machine that lacks one of the axes X, Y and Z.
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
