//! Machine with given values of the unknown errors.

use volcomp_curve::{ErrorCurve, Field};
use volcomp_model::Machine;

use crate::{
    coefficients::{Role, micro},
    error::IdentifyError,
    observations::Observations,
    params::Values,
    system::System,
};

/// Returns the machine of the observations with `values` for the unknown errors, as parameter names and values in
/// parameter units. Unknowns without a value are 0.
///
/// # Errors
/// Unknowns that [`crate::identify()`] rejects; a name that is neither an unknown nor part of the set-up.
pub fn machine_with(
    observations: &Observations,
    values: &[(String, f64)],
) -> Result<Machine, IdentifyError> {
    let system = System::new(observations)?;
    let mut names = (0..system.params.len()).map(|param| system.name(param));
    for (name, _) in values {
        if !names.clone().any(|known| known == *name) {
            let known: Vec<String> = names.by_ref().collect();
            return Err(IdentifyError::NoSuchUnknown {
                found: name.clone(),
                known: known.join(", "),
            });
        }
    }
    let given = system.unknowns.coefficients.iter().map(|coefficient| {
        let value = values.iter().find(|(name, _)| *name == coefficient.name);
        value.map_or(0.0, |(_, value)| value / micro(coefficient.error.component))
    });
    let stated = Values::stated(&system.setup, given.collect());
    machine_of(&system, &stated)
}

pub(crate) fn machine_of(system: &System, values: &Values) -> Result<Machine, IdentifyError> {
    let mut machine = system.machine.clone();
    for (place, unknown) in system.unknowns.curves.iter().enumerate() {
        let error = unknown.error;
        let scale = micro(error.component);
        let own = system.unknowns.coefficients.iter().zip(&values.coefficients);
        let own = own.filter(|(coefficient, _)| coefficient.curve == place);
        let mut modes = vec![0.0; unknown.modes.as_ref().map_or(0, crate::basis::Modes::len)];
        let mut products = vec![0.0; unknown.products.as_ref().map_or(0, |p| p.pairs().len())];
        let mut reversal = None;
        for (coefficient, value) in own {
            match coefficient.role {
                Role::Location => machine.set_location(error, value * scale)?,
                Role::Mode(mode) => modes[mode] = value * scale,
                Role::Product(place) => products[place] = value * scale,
                Role::Reversal => reversal = Some(value * scale),
            }
        }
        if unknown.error.location {
            continue;
        }
        let before = machine.error(error).cloned();
        let mean = match &unknown.modes {
            Some(own) => {
                let field = match &unknown.products {
                    Some(found) => {
                        let go_round = [unknown.axis, found.axis()]
                            .map(|axis| machine.axes()[axis].modulo.is_some());
                        found
                            .grid(own, unknown.axis, [&modes, &products], go_round)
                            .map(Field::Grid)
                    }
                    None => own.curve(&modes).map(Field::Curve),
                };
                field.map_err(|source| IdentifyError::Curve { error, source })?
            }
            None => match &before {
                Some(ErrorCurve::Single(mean) | ErrorCurve::Reversal { mean, .. }) => mean.clone(),
                _ => Field::Curve(volcomp_curve::Curve::Constant(0.0)),
            },
        };
        // A reversal value that is not an unknown is kept.
        let reversal = reversal.or(match before {
            Some(ErrorCurve::Reversal { reversal, .. }) => Some(reversal),
            _ => None,
        });
        let curve = match reversal {
            Some(reversal) => ErrorCurve::with_reversal(mean, reversal)
                .map_err(|source| IdentifyError::Curve { error, source })?,
            None => ErrorCurve::Single(mean),
        };
        machine.set_error(error, curve)?;
    }
    Ok(machine)
}
