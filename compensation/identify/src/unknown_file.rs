//! The key `unknown` of a file of observations.

use volcomp_curve::ErrorCurve;
use volcomp_document::{InputError, Section, Value};
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisName, ErrorName};

use crate::{
    basis::Basis,
    checks::input::{LEAST_SPLINE, MOST_COEFFICIENTS, MOST_SECOND},
    observations::{SecondAxis, Unknown},
};

/// Decodes whether penalties are chosen for unknowns that do not state it.
pub(crate) fn decode_penalty(section: &Section<'_>, default: bool) -> Result<bool, InputError> {
    section.one_of("penalty", &[("auto", true), ("none", false)], default)
}

impl Unknown {
    /// Decodes the key `unknown` of a file of observations: the errors to be identified on this machine.
    ///
    /// # Errors
    /// An entry that is not an error of the machine or is listed twice; a curve that the error cannot have.
    pub fn decode(value: &Value<'_>, machine: &Machine) -> Result<Vec<Self>, InputError> {
        let found = decode_unknown(value, machine, false)?;
        if found.is_empty() {
            return Err(value.error("found no unknown, expected at least one error to be found"));
        }
        Ok(found)
    }

    /// Formats the item of the key `unknown` that decodes to this, in a file whose own `penalty` is `auto` (`by_default`) or missing.
    pub fn to_toml(&self, by_default: bool) -> String {
        let mut keys = vec![format!("error = \"{}\"", self.error)];
        match self.basis {
            Some(Basis::Legendre { order }) => keys.push(format!("legendre = {order}")),
            Some(Basis::BSpline { coefficients }) => {
                keys.push(format!("bspline = {coefficients}"));
            }
            Some(Basis::Fourier { harmonics }) => keys.push(format!("fourier = {harmonics}")),
            // A reversal value with a constant is written as a polynomial of order 0.
            Some(Basis::Constant) if self.reversal => keys.push("legendre = 0".to_owned()),
            Some(Basis::Constant) | None => {}
        }
        if let Some(second) = self.second {
            let curve = match second.basis {
                Basis::Fourier { harmonics } => format!("fourier = {harmonics}"),
                Basis::BSpline { coefficients } => format!("bspline = {coefficients}"),
                other => format!("legendre = {}", other.highest_order()),
            };
            let axis = second.axis;
            keys.push(format!("second = {{ axis = \"{axis}\", {curve} }}"));
        }
        if self.reversal {
            keys.push("reversal = true".to_owned());
        }
        if self.penalised != by_default {
            let penalty = if self.penalised { "auto" } else { "none" };
            keys.push(format!("penalty = \"{penalty}\""));
        }
        format!("{{ {} }}", keys.join(", "))
    }
}

/// Decodes every unknown. An empty list is valid: the observations then validate the machine as it is.
pub(crate) fn decode_unknown(
    value: &Value<'_>,
    machine: &Machine,
    penalised: bool,
) -> Result<Vec<Unknown>, InputError> {
    let mut found: Vec<Unknown> = Vec::new();
    for item in value.items()? {
        let unknown = decode_item(&item, machine, penalised)?;
        match found.iter_mut().find(|other| other.error == unknown.error) {
            None => found.push(unknown),
            // `{ error = "ECC", reversal = true }` together with `{ error = "ECC", legendre = 3 }`.
            Some(other)
                if (other.basis.is_none() || unknown.basis.is_none())
                    && !(other.reversal && unknown.reversal) =>
            {
                other.reversal |= unknown.reversal;
                other.penalised |= unknown.basis.is_some() && unknown.penalised;
                other.basis = other.basis.or(unknown.basis);
                other.second = other.second.or(unknown.second);
            }
            Some(_) => return Err(item.error(format!("{} stands twice", unknown.error))),
        }
        refuse_both_tilts(&item, unknown.error, &found)?;
    }
    Ok(found)
}

/// Rejects the tilts of two linear axes about the same direction: together they rotate everything that the tool and the
/// workpiece do alike, so that only their difference, a squareness, is observable.
fn refuse_both_tilts(
    item: &Value<'_>,
    error: ErrorName,
    found: &[Unknown],
) -> Result<(), InputError> {
    let is_tilt =
        |name: ErrorName| name.location && !name.axis.is_rotary() && name.component.is_angular();
    let of_other = |unknown: &&Unknown| {
        let other = unknown.error;
        is_tilt(other) && other.component == error.component && other.axis != error.axis
    };
    match found.iter().find(of_other).filter(|_| is_tilt(error)) {
        Some(other) => {
            let (first, second) = if other.error.axis < error.axis {
                (other.error, error)
            } else {
                (error, other.error)
            };
            Err(item.error(format!(
                "found {first} beside {second}, expected one of them: no measurement tells more than their difference, the squareness of {} and {}. {first} is zero by definition where {} is the reference axis",
                first.axis, second.axis, first.axis
            )))
        }
        None => Ok(()),
    }
}

fn decode_item(
    item: &Value<'_>,
    machine: &Machine,
    penalised: bool,
) -> Result<Unknown, InputError> {
    let Ok(section) = item.section() else {
        return Ok(Unknown::constant(decode_name(item, machine)?));
    };
    section.allow(&[
        "error", "legendre", "bspline", "fourier", "second", "reversal", "penalty",
    ])?;
    let name = section.require("error")?;
    let error = decode_name(&name, machine)?;
    let mut bases = Vec::new();
    if let Some(value) = section.get("legendre") {
        let order = value.whole(0..=MOST_COEFFICIENTS)?;
        bases.push((value, Basis::Legendre { order }));
    }
    if let Some(value) = section.get("bspline") {
        let coefficients = value.whole(4..=MOST_COEFFICIENTS)?;
        bases.push((value, Basis::BSpline { coefficients }));
    }
    if let Some(value) = section.get("fourier") {
        let harmonics = value.whole(0..=MOST_COEFFICIENTS / 2)?;
        if !error.axis.is_rotary() {
            let message = format!(
                "found a Fourier series for {error}, expected `legendre` or `bspline`: {} is a linear axis",
                error.axis
            );
            return Err(value.error(message));
        }
        bases.push((value, Basis::Fourier { harmonics }));
    }
    let reversal = section.truth_or("reversal", false)?;
    let basis = match bases.as_slice() {
        [] if error.location || !reversal || section.get("second").is_some() => {
            Some(Basis::Constant)
        }
        [] => None,
        [(value, basis)] => {
            let goes_round = machine
                .axis(error.axis)
                .is_some_and(|axis| axis.modulo.is_some());
            if goes_round && !matches!(basis, Basis::Fourier { .. }) {
                return Err(value.error(format!(
                    "found a curve that does not close, expected `fourier`: {} has a modulo",
                    error.axis
                )));
            }
            Some(*basis)
        }
        [_, (value, _), ..] => {
            return Err(
                value.error("found two kinds of curve, expected one of legendre, bspline, fourier")
            );
        }
    };
    let second = match section.get("second") {
        Some(value) => Some(decode_second(&value, error, machine)?),
        None => None,
    };
    if error.location && (reversal || !bases.is_empty() || second.is_some()) {
        return Err(section.error(format!(
            "{error}: a location error is one number, never a curve"
        )));
    }
    if reversal && matches!(machine.error(error), Some(ErrorCurve::Pair { .. })) && basis.is_none()
    {
        return Err(section.error(format!(
            "{error} has `forward` and `backward` in the machine file, expected one curve to which a reversal value is added: state a kind of curve too"
        )));
    }
    Ok(Unknown {
        error,
        basis,
        second,
        reversal,
        penalised: decode_penalty(&section, penalised)?,
    })
}

/// Second axis of an error, and the kind of curve along it.
fn decode_second(
    value: &Value<'_>,
    error: ErrorName,
    machine: &Machine,
) -> Result<SecondAxis, InputError> {
    let section = value.section()?;
    section.allow(&["axis", "legendre", "bspline", "fourier"])?;
    let name = section.require("axis")?;
    let axis = name.text()?.parse::<AxisName>().ok();
    let axis = axis.filter(|axis| machine.axis(*axis).is_some());
    let Some(axis) = axis.filter(|axis| *axis != error.axis) else {
        let others = machine.axes().iter().map(|axis| axis.name);
        let others: Vec<String> = others
            .filter(|other| *other != error.axis)
            .map(|other| other.to_string())
            .collect();
        return Err(name.error(format!(
            "found \"{}\", expected the second axis that {error} depends on, one of {}",
            name.text()?,
            others.join(", ")
        )));
    };
    let goes_round = machine.axis(axis).is_some_and(|a| a.modulo.is_some());
    let open = |value: Value<'_>, basis: Basis| {
        if goes_round {
            return Err(value.error(format!(
                "found a curve that does not close, expected `fourier`: {axis} has a modulo"
            )));
        }
        Ok(basis)
    };
    let keys = ["legendre", "bspline", "fourier"].map(|key| section.get(key));
    let basis = match keys {
        [Some(value), None, None] => {
            let order = value.whole(1..=MOST_SECOND)?;
            open(value, Basis::Legendre { order })?
        }
        [None, Some(value), None] => {
            let coefficients = value.whole(LEAST_SPLINE..=MOST_SECOND)?;
            open(value, Basis::BSpline { coefficients })?
        }
        [None, None, Some(value)] => {
            let harmonics = value.whole(1..=MOST_SECOND)?;
            if !axis.is_rotary() {
                return Err(value.error(format!(
                    "found a Fourier series along {axis}, expected `legendre`: it is a linear axis"
                )));
            }
            Basis::Fourier { harmonics }
        }
        [None, None, None] => {
            return Err(section.error(
                "found no kind of curve along the second axis, expected one of legendre, bspline, fourier",
            ));
        }
        [_, Some(value), _] | [_, _, Some(value)] => {
            return Err(value.error(
                "found two kinds of curve along the second axis, expected one of legendre, bspline, fourier",
            ));
        }
    };
    Ok(SecondAxis { axis, basis })
}

fn decode_name(value: &Value<'_>, machine: &Machine) -> Result<ErrorName, InputError> {
    let name = machine.decode_error(value)?;
    let joint = machine
        .index_of(name.axis)
        .ok()
        .and_then(|index| machine.chain().joints().get(index));
    let no_effect = joint.and_then(|joint| joint.no_effect(name.component));
    match no_effect.filter(|_| name.location) {
        Some(reason) => Err(value.error(format!("{name} {reason}"))),
        None => Ok(name),
    }
}
