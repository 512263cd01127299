//! How the error at a node is computed.

use std::str::FromStr;

use volcomp_kinematics::{Form, volumetric_error};
use volcomp_model::{Machine, Temperatures, Tolerance};

use super::work::ErrorAt;
use crate::failure::Failure;

/// The form of the model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Model {
    /// The chain with the curves of the machine file.
    Form(Form),
    /// The compiled machine: curves as piecewise cubics, errors to first order.
    Compiled,
}

impl FromStr for Model {
    type Err = &'static str;

    fn from_str(name: &str) -> Result<Self, Self::Err> {
        match name {
            "compiled" => Ok(Self::Compiled),
            _ => name
                .parse()
                .map(Self::Form)
                .map_err(|_| "unknown model form, expected compiled, exact, htm or twist"),
        }
    }
}

impl Model {
    /// The name on the command line.
    pub(super) fn name(self) -> String {
        match self {
            Self::Form(form) => form.to_string(),
            Self::Compiled => "compiled".to_owned(),
        }
    }

    /// How far a compiled curve may be from its source, nm and nrad.
    pub(super) fn tolerance_nm(self) -> Option<f64> {
        (self == Self::Compiled).then(|| Tolerance::default().linear_mm * 1e6)
    }

    /// The function that computes the error at a state: position (mm) and rotation (rad) in workpiece axes.
    pub(super) fn errors<'a>(
        self,
        machine: &'a Machine,
        temperatures: &Temperatures,
    ) -> Result<ErrorAt<'a>, Failure> {
        match self {
            Self::Form(form) => {
                let source = machine.source(temperatures);
                Ok(Box::new(move |state| {
                    let found = volumetric_error(machine.chain(), &source, state, form);
                    let (p, r) = (found.position_mm, found.rotation_rad);
                    [p.x, p.y, p.z, r.x, r.y, r.z]
                }))
            }
            Self::Compiled => {
                let compiled = machine.compile_at(Tolerance::default(), temperatures)?;
                Ok(Box::new(move |state| compiled.evaluate(state).into_six()))
            }
        }
    }
}
